"""`Client`: everything a Lambent server can be asked for, typed."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, Self, Unpack

import httpx2

from lambent import arguments, pictures, scenes
from lambent import fetch as fetching
from lambent.batch_calls import BatchCalls
from lambent.connection import Connection, TransferProgress, ignore_progress
from lambent.errors import JobNotSucceededError, UsageProblemError
from lambent.job_order import JobOrder, order_body
from lambent.models import Artifact, Environment, Event, Job, Scene, SceneReport, Share
from lambent.settings import find_server
from lambent.waiting import ANSWER_S
from lambent.watch import PATIENCE_S, POLL_S, SILENCE_S, Watcher
from lambent.webhook_calls import WebhookCalls

DELETABLE = {
    "scene": "scenes",
    "job": "jobs",
    "bundle": "bundles",
    "env": "environments",
    "share": "shares",
    "webhook": "webhooks",
}
"""Prefixes of the ids that can be deleted, and the path of each kind."""


def _scene(scene_id: str) -> str:
    return f"/v1/scenes/{arguments.identifier(scene_id, 'scene_id')}"


def _job(job_id: str) -> str:
    return f"/v1/jobs/{arguments.identifier(job_id, 'job_id')}"


class Client(BatchCalls):
    """A connection to one server; use it as a context manager or call `close`.

    Without arguments it talks to the server of LAMBENT_URL, or to the one that `lambent serve` runs on
    this machine. Every method raises `UnreachableError` when no server answers and `RefusedError` (with
    `code`, `errors` and `advice`) when it declines. Not for use by several threads at once.
    """

    def __init__(
        self,
        url: str = "",
        api_key: str = "",
        *,
        data: Path | None = None,
        transport: httpx2.BaseTransport | None = None,
        sleep: Callable[[float], None] = time.sleep,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        arguments.text(url, "url")
        arguments.text(api_key, "api_key")
        folder = None if data is None else arguments.file_path(data, "data")
        self.address = find_server(url, api_key, data=folder)
        self._sleep = sleep
        self._clock = clock
        self._connection = Connection(self.address, transport=transport, sleep=sleep)

    def __repr__(self) -> str:
        """Return the server's address, without the key."""
        return f"Client({self.address.url!r})"

    def __enter__(self) -> Self:
        """Return the client itself."""
        return self

    def __exit__(self, *error: object) -> None:
        """Close the connection."""
        self.close()

    def close(self) -> None:
        """Close the connection."""
        self._connection.close()

    @property
    def webhooks(self) -> WebhookCalls:
        """Subscriptions to changes of jobs, and what was delivered."""
        return WebhookCalls(self._connection)

    def version(self) -> Mapping[str, Any]:
        """Return the server's name, version and schema version."""
        return dict(self._connection.json("GET", "/v1/version"))

    def presets(self) -> Mapping[str, Any]:
        """Return the presets that jobs may name."""
        return dict(self._connection.json("GET", "/v1/presets"))

    def push(
        self,
        source: str | Path,
        *,
        name: str = "",
        progress: TransferProgress = ignore_progress,
    ) -> Scene:
        """Upload a scene folder or archive and return the committed scene; a repeat sends nothing twice."""
        return scenes.push(
            self._connection,
            arguments.file_path(source, "source"),
            name=arguments.text(name, "name"),
            progress=progress,
        )

    def scene(self, scene_id: str) -> Scene:
        """Return a scene."""
        return Scene.from_json(self._connection.json("GET", _scene(scene_id)))

    def scene_report(self, scene_id: str) -> SceneReport:
        """Return the findings about a scene, each with what to fix."""
        return SceneReport.from_json(self._connection.json("GET", _scene(scene_id) + "/report"))

    def delete_scene(self, scene_id: str) -> None:
        """Delete a scene."""
        self._connection.send("DELETE", _scene(scene_id))

    def delete(self, identifier: str) -> None:
        """Delete a scene, a job that has ended, a bundle, an environment map, a link or a webhook.

        The id says which it is. A job's bundle outlives it, and so does what was made from a scene, a bundle
        or an environment.
        """
        kind = arguments.identifier(identifier, "identifier").partition("_")[0]
        if kind not in DELETABLE:
            raise UsageProblemError(
                "client.unknown_id",
                f"{identifier!r} is not an id of a {', '.join(DELETABLE)}",
                "take the id as the server gives it",
            )
        self._connection.send("DELETE", f"/v1/{DELETABLE[kind]}/{identifier}")

    def submit(self, scene_id: str, *, idempotency_key: str = "", **order: Unpack[JobOrder]) -> Job:
        """Queue a job and return it; the same `idempotency_key` never makes a second one."""
        body = {"scene_id": arguments.identifier(scene_id, "scene_id"), **order_body(order)}
        return Job.from_json(pictures.post(self._connection, "/v1/jobs", body, idempotency_key))

    def jobs(
        self, *, state: str = "", label: str = "", scene: str = "", kind: str = "", limit: int = 0
    ) -> Iterator[Job]:
        """Return jobs, newest first; `label` is "name=value", `scene` an id, `limit` 0 means all."""
        given = {"state": state, "label": label, "scene": scene, "kind": kind}
        params = {key: value for key, value in given.items() if arguments.text(value, key)}
        limit = arguments.whole(limit, "limit", 0)
        return map(Job.from_json, islice(self._connection.pages("/v1/jobs", params), limit or None))

    def job(self, job_id: str, *, wait_s: int = 0) -> Job:
        """Return a job; with `wait_s`, as soon as it has ended, but after that time (at most 60 s) anyway."""
        params = {"wait": min(arguments.seconds(wait_s, "wait_s"), 60)} if wait_s else {}
        path = _job(job_id)
        return Job.from_json(self._connection.json("GET", path, params=params, timeout_s=60.0 + wait_s))

    def wait(
        self,
        job_id: str,
        *,
        timeout_s: float | None = None,
        progress: Callable[[Job], None] | None = None,
    ) -> Job:
        """Return the job once it is final; look at its `state`, which may be "failed" or "cancelled".

        `progress` is called with the job whenever its state or progress has changed, about once a second.
        After `timeout_s`, WaitTimeoutError (a TimeoutError) is raised and the job continues; None: however
        long it takes.
        """
        path = _job(job_id)

        def read(within_s: float) -> Job:
            asked = {"params": {"wait": within_s}, "timeout_s": within_s + ANSWER_S}
            return Job.from_json(self._connection.json("GET", path, **asked))

        return self._until_final(read, timeout_s, progress)

    def change(
        self,
        identifier: str,
        *,
        labels: Mapping[str, str | None] | None = None,
        priority: int | None = None,
        name: str = "",
    ) -> Mapping[str, Any]:
        """Change a job, a scene or a bundle and return it as the server shows it; the id says which it is.

        `labels` are merged with those it has, None removes one. `priority` is that of a waiting job, and
        `name` that of a scene.
        """
        kind = arguments.identifier(identifier, "identifier").partition("_")[0]
        body: dict[str, Any] = {} if labels is None else {"labels": dict(labels)}
        if priority is not None:
            body["priority"] = arguments.whole(priority, "priority")
        if arguments.text(name, "name"):
            body["name"] = name
        path = f"/v1/{DELETABLE.get(kind, kind)}/{identifier}"
        return dict(self._connection.json("PATCH", path, json=body))

    def cancel(self, job_id: str) -> Job:
        """Ask for a job to be stopped; it is "cancelling" until its process is gone."""
        return Job.from_json(self._connection.json("POST", _job(job_id) + ":cancel", repeatable=True))

    def retry(self, job_id: str) -> Job:
        """Queue a new job with the order of one that failed or was cancelled, and return the new one."""
        return Job.from_json(self._connection.json("POST", _job(job_id) + ":retry"))

    def watch(
        self,
        job_ids: Sequence[str],
        *,
        after: Mapping[str, int] | None = None,
        silence_s: float = SILENCE_S,
        patience_s: float = PATIENCE_S,
        poll_s: float = POLL_S,
    ) -> Iterator[Event | Job]:
        """Yield jobs and events until every job is final (see `lambent.watch.Watcher` for the promises).

        `after` gives the last event number already seen per job; without it, events from now on come. A
        stream that is silent for `silence_s` is opened anew, a server that is unavailable for `patience_s` is
        given up, and where no stream comes through events are asked for every `poll_s`.
        """
        watcher = Watcher(
            connection=self._connection,
            job_ids=arguments.identifiers(job_ids, "job_ids"),
            after=after,
            silence_s=arguments.seconds(silence_s, "silence_s"),
            patience_s=arguments.seconds(patience_s, "patience_s"),
            poll_s=arguments.seconds(poll_s, "poll_s"),
            sleep=self._sleep,
            clock=self._clock,
        )
        return iter(watcher)

    def events(self, job_id: str, *, after: int = 0) -> list[Event]:
        """Return the events of a job after number `after`."""
        params = {"after": arguments.whole(after, "after", 0)}
        return [Event.from_json(item) for item in self._connection.pages(_job(job_id) + "/events", params)]

    def logs(self, job_id: str) -> str:
        """Return the log of a job's runs as text."""
        return self._connection.send("GET", _job(job_id) + "/log").text

    def artifacts(self, job_id: str) -> list[Artifact]:
        """Return the files that a job has published."""
        return [Artifact.from_json(item) for item in self._connection.pages(_job(job_id) + "/artifacts")]

    def read_artifact(self, artifact: Artifact) -> bytes:
        """Return the bytes of a published file; raises `fetch.digest_mismatch` for any others."""
        arguments.instance(artifact, Artifact, "artifact", "give an entry of artifacts(job_id)")
        content = self._connection.send("GET", f"/v1/blobs/{artifact.sha256}").content
        fetching.check_digest(artifact.name, content, artifact.sha256)
        return content

    def download(self, artifact: Artifact, target: str | Path) -> Path:
        """Write a published file to `target`, which appears whole; one that has these bytes is kept."""
        arguments.instance(artifact, Artifact, "artifact", "give an entry of artifacts(job_id)")
        return fetching.download(self._connection, artifact, arguments.file_path(target, "target"))

    def environments(self) -> list[Environment]:
        """Return the environment maps on the server, newest first."""
        return [Environment.from_json(item) for item in self._connection.pages("/v1/environments")]

    def push_environment(self, source: str | Path, *, name: str = "") -> Environment:
        """Upload an environment map (.exr or .hdr); one that the server has under that name is not sent."""
        return pictures.push_environment(
            self._connection, arguments.file_path(source, "source"), name=arguments.text(name, "name")
        )

    def render(
        self,
        bundle_id: str,
        environments: Sequence[str | Mapping[str, Any]],
        cameras: Mapping[str, Any],
        *,
        quality: str | Mapping[str, Any] = "refined",
        idempotency_key: str = "",
        **more: Any,
    ) -> Job:
        """Queue pictures of a bundle and return the job whose artifacts they will be.

        `environments` are ids or {"environment_id": ..., "rotate_deg": ...}, `cameras` is such as
        {"turntable": 8, "size": 512} or {"views": ["r_000"]}; `more`: other fields of `POST /v1/renders`.
        """
        body = {
            "bundle_id": arguments.identifier(bundle_id, "bundle_id"),
            "environments": [
                {"environment_id": e}
                if isinstance(e, str)
                else arguments.mapping(e, "an entry of environments")
                for e in environments
            ],
            "cameras": arguments.mapping(cameras, "cameras"),
            "quality": {"quality": quality}
            if isinstance(quality, str)
            else arguments.mapping(quality, "quality"),
            **more,
        }
        return Job.from_json(pictures.post(self._connection, "/v1/renders", body, idempotency_key))

    def peek(self, bundle_id: str, target: str | Path) -> Path:
        """Write manifest.json and cameras.json of a bundle into the folder `target`, and no other file."""
        return fetching.peek(
            self._connection,
            arguments.identifier(bundle_id, "bundle_id"),
            arguments.file_path(target, "target"),
        )

    def login_link(self) -> str:
        """Return a link that opens the server's pages in one browser, once."""
        return str(self._connection.json("POST", "/v1/login-links")["url"])

    def fetch(
        self,
        job_or_bundle_id: str,
        target: str | Path,
        *,
        progress: TransferProgress = ignore_progress,
    ) -> fetching.FetchedBundle:
        """Download the bundle of a finished job (or a bundle by its id) into the folder `target`.

        Verified, atomic and resumable: see `lambent.fetch.fetch`. The server's signed statement of where the
        bundle is from, if it has one, comes beside it: `TARGET.provenance.json`. Raises `job.not_succeeded`
        when the job has no bundle.
        """
        folder = arguments.file_path(target, "target")
        bundle_id = self._bundle_id(job_or_bundle_id)
        fetched = fetching.fetch(self._connection, bundle_id, folder, progress=progress)
        fetching.fetch_statement(self._connection, bundle_id, folder)
        return fetched

    def share(
        self, job_or_bundle_id: str, *, expires_in_s: int = 7 * 24 * 3600, frame_ancestors: Sequence[str] = ()
    ) -> Share:
        """Return a new link that lets everyone who has it see the bundle of a job until it expires.

        Pages of the origins `frame_ancestors`, such as "https://shop.example", may show the bundle too, in a
        frame or with the viewer's element. `delete(share.id)` revokes the link. Raises
        `job.not_succeeded` when the job has no bundle.
        """
        given = arguments.text_list(frame_ancestors, "frame_ancestors")
        body = {"expires_in_s": arguments.whole(expires_in_s, "expires_in_s", 60), "frame_ancestors": given}
        path = f"/v1/bundles/{self._bundle_id(job_or_bundle_id)}/shares"
        return Share.from_json(self._connection.json("POST", path, json=body))

    def _bundle_id(self, job_or_bundle_id: str) -> str:
        """Return the id of a bundle: the one given, or that of a job."""
        bundle_id = arguments.identifier(job_or_bundle_id, "job_or_bundle_id")
        if job_or_bundle_id.startswith("bundle"):
            return bundle_id
        job = self.job(job_or_bundle_id)
        if not job.bundle_id:
            raise JobNotSucceededError(
                "job.not_succeeded",
                f"job {job.id} is {job.state} and has no bundle",
                f"watch it with `lambent watch {job.id}`"
                if not job.is_final
                else f"see `lambent logs {job.id}`, then `lambent retry {job.id}`",
            )
        return job.bundle_id
