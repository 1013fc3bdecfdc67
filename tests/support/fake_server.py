"""A Lambent server in memory, for the client's tests: only the calls they need, and faults on demand."""

import hashlib
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import httpx2


def sha256(data: bytes) -> str:
    """Return the lower-case hexadecimal SHA-256."""
    return hashlib.sha256(data).hexdigest()


def problem(status: int, code: str, **more: Any) -> httpx2.Response:
    """Return a problem document."""
    body = {"title": code, "status": status, "code": code, "detail": f"detail of {code}", **more}
    return httpx2.Response(status, json=body, headers={"content-type": "application/problem+json"})


class Time:
    """A clock that only sleeping moves."""

    def __init__(self) -> None:
        self.now = 0.0

    def sleep(self, seconds: float) -> None:
        self.now += seconds

    def clock(self) -> float:
        return self.now


@dataclass
class FakeServer:
    """State of the server; `requests` lists "METHOD path" in order, `faults` may answer instead of it."""

    scenes: dict[str, dict[str, Any]] = field(default_factory=dict)
    blobs: dict[str, bytes] = field(default_factory=dict)
    jobs: dict[str, dict[str, Any]] = field(default_factory=dict)
    events: dict[str, list[dict[str, Any]]] = field(default_factory=dict)
    bundles: dict[str, dict[str, bytes]] = field(default_factory=dict)
    requests: list[str] = field(default_factory=list)
    headers: list[httpx2.Headers] = field(default_factory=list)
    faults: list[Callable[[httpx2.Request], httpx2.Response | None]] = field(default_factory=list)
    streams: list[Callable[[httpx2.Request], httpx2.Response]] = field(default_factory=list)

    @property
    def transport(self) -> httpx2.MockTransport:
        """Return the transport to pass to a client."""
        return httpx2.MockTransport(self.handle)

    def handle(self, request: httpx2.Request) -> httpx2.Response:
        """Answer one request."""
        request.read()
        self.requests.append(f"{request.method} {request.url.path}")
        self.headers.append(request.headers)
        for fault in self.faults:
            answer = fault(request)
            if answer is not None:
                return answer
        parts = request.url.path.removeprefix("/v1/").split("/")
        return getattr(self, f"_{parts[0]}")(request, parts[1:])

    def _scenes(self, request: httpx2.Request, parts: list[str]) -> httpx2.Response:
        if not parts:
            name = json.loads(request.content)["name"]
            scene = {
                "id": f"scene_{len(self.scenes) + 1}",
                "state": "open",
                "name": name,
                "files": [],
            }
            self.scenes[scene["id"]] = scene
            return httpx2.Response(201, json=scene)
        scene_id, _, verb = parts[0].partition(":")
        if scene_id not in self.scenes:
            return problem(404, "not_found")
        scene = self.scenes[scene_id]
        if parts[1:] == ["files:plan"]:
            scene["files"] = json.loads(request.content)
            missing = [entry["sha256"] for entry in scene["files"] if entry["sha256"] not in self.blobs]
            return httpx2.Response(200, json={"missing": missing, "unsupported": [], "uploads": []})
        if parts[1:2] == ["files"]:
            if sha256(request.content) != parts[2]:
                return problem(422, "digest_mismatch")
            self.blobs[parts[2]] = request.content
            return httpx2.Response(204)
        if parts[1:] == ["archive"]:
            if scene["state"] != "open":
                return problem(409, "scene_committed")
            self.blobs["archive"] = request.content
            scene["state"] = "uploaded"
        if verb == "commit":
            scene["state"] = "uploaded"
        return httpx2.Response(200, json=scene)

    def _jobs(self, request: httpx2.Request, parts: list[str]) -> httpx2.Response:
        if not parts and request.method == "POST":
            job = {"id": f"job_{len(self.jobs) + 1}", "state": "queued", **json.loads(request.content)}
            self.jobs[job["id"]] = job
            return httpx2.Response(202, json=job)
        if not parts:
            cursor = int(request.url.params.get("cursor", 0))
            items = list(self.jobs.values())
            more = str(cursor + 2) if len(items) > cursor + 2 else None
            return httpx2.Response(200, json={"items": items[cursor : cursor + 2], "next_cursor": more})
        job_id, _, verb = parts[0].partition(":")
        if job_id not in self.jobs:
            return problem(404, "not_found")
        if verb == "cancel":
            self.jobs[job_id]["state"] = "cancelling"
        if parts[1:] == ["events"]:
            after = int(request.url.params["after"])
            items = [event for event in self.events.get(job_id, []) if event["seq"] > after]
            return httpx2.Response(200, json={"items": items})
        if parts[1:] == ["log"]:
            return httpx2.Response(200, text="a line\n")
        return httpx2.Response(200, json=self.jobs[job_id])

    def _events(self, request: httpx2.Request, parts: list[str]) -> httpx2.Response:
        return self.streams.pop(0)(request)

    def _bundles(self, request: httpx2.Request, parts: list[str]) -> httpx2.Response:
        if parts[0] not in self.bundles:
            return problem(404, "not_found")
        files = self.bundles[parts[0]]
        if parts[1] == "manifest":
            return httpx2.Response(200, content=files["manifest.json"])
        if parts[1] == "provenance":
            return problem(404, "provenance_not_found")
        data = files["/".join(parts[2:])]
        first = request.headers.get("Range")
        if first:
            start = int(first.removeprefix("bytes=").removesuffix("-"))
            return httpx2.Response(206, content=data[start:])
        return httpx2.Response(200, content=data)

    def add_bundle(self, bundle_id: str, files: dict[str, bytes]) -> None:
        """Publish a bundle of these files with its manifest."""
        entries = [{"path": p, "size_bytes": float(len(d)), "sha256": sha256(d)} for p, d in files.items()]
        self.bundles[bundle_id] = {**files, "manifest.json": json.dumps({"files": entries}).encode()}


def event(job_id: str, seq: int, **more: Any) -> dict[str, Any]:
    """Return an event as the server writes it."""
    return {"job_id": job_id, "seq": seq, "type": "progress", "run": 1, **more}


def event_stream(*events: dict[str, Any], then: Exception | None = None) -> httpx2.Response:
    """Return a server-sent event stream that ends after `events`, normally or with an exception."""

    def body() -> Iterator[bytes]:
        yield b": ping\n\n"
        for item in events:
            yield f"id: {item['job_id']}:{item['seq']}\ndata: {json.dumps(item)}\n\n".encode()
        if then is not None:
            raise then

    return httpx2.Response(200, content=body(), headers={"content-type": "text/event-stream"})
