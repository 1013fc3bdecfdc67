"""Many clients of one server in one process: idle event streams and slow senders, on plain sockets.

The first line of standard input is the order, as JSON; standard output says when all are there. The second
line has the number of the last event of each job; when every stream has them, or time is up, the result is
printed.
"""

import asyncio
import contextlib
import json
import re
import resource
import sys
import time
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import urlsplit

_EVENT = re.compile(rb'data: \{"(?:job_id": "(\w+)", "seq": (\d+)|id": "(\w+)"[^\n]*"last_event": (\d+)[,}])')
DRIP_BYTES = 1000
UPLOAD_BYTES = 64 * 2**20


@dataclass
class Client:
    """One identity: a key, and the address that its connections come from."""

    url: str
    key: str
    address: str
    counts: dict[str, int]

    async def connect(self) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        """Open a connection."""
        parts = urlsplit(self.url)
        assert parts.hostname is not None
        return await asyncio.open_connection(parts.hostname, parts.port, local_addr=(self.address, 0))

    def head(self, method: str, path: str, *more: str) -> bytes:
        """Return the head of a request."""
        host = f"Host: {urlsplit(self.url).netloc}"
        lines = [f"{method} {path} HTTP/1.1", host, f"Authorization: Bearer {self.key}", *more, "", ""]
        return "\r\n".join(lines).encode()


@dataclass
class Stream:
    """One event stream and what came through it."""

    client: Client
    job: str | None
    told: dict[str, int] = field(default_factory=dict)
    opened: asyncio.Event = field(default_factory=asyncio.Event)
    wrong: int = 0
    """Events that were missing or came twice."""
    rest: bytes = b""

    async def run(self) -> None:
        """Read until cancelled; a stream that ends early is counted."""
        reader, writer = await self.client.connect()
        path = "/v1/events" if self.job is None else f"/v1/events?job={self.job}"
        writer.write(self.client.head("GET", path, "Accept: text/event-stream"))
        try:
            status = (await reader.readuntil(b"\r\n")).split()[1].decode()
            self.client.counts[f"stream {status}"] = self.client.counts.get(f"stream {status}", 0) + 1
            while status == "200" and (data := await reader.read(2**16)):
                self.take(data)
            self.client.counts["streams ended"] = self.client.counts.get("streams ended", 0) + 1
        finally:
            writer.close()

    def take(self, data: bytes) -> None:
        """Count the events in the next part of the response."""
        whole, end, rest = (self.rest + data).rpartition(b"\n\n")
        self.rest = rest
        for job, seq, shown, last in _EVENT.findall(whole + end):
            if shown:
                self.told[shown.decode()] = int(last)
            else:
                name, number = job.decode(), int(seq)
                self.wrong += number != self.told.get(name, 0) + 1
                self.told[name] = number
        if b": hello" in whole:
            self.opened.set()

    def has(self, expected: dict[str, int]) -> bool:
        """Return whether everything has arrived that this stream follows."""
        names = expected if self.job is None else [self.job]
        return all(self.told.get(name, 0) >= expected[name] for name in names)


async def drip(client: Client) -> None:
    """Send the body of a job a byte per second, and again when the server ends that."""
    while True:
        reader, writer = await client.connect()
        with contextlib.suppress(ConnectionError):
            head = ("Content-Type: application/json", f"Content-Length: {DRIP_BYTES}")
            writer.write(client.head("POST", "/v1/jobs", *head) + b"{")
            answer = asyncio.ensure_future(reader.readuntil(b"\r\n"))
            while not answer.done():
                await asyncio.wait({answer}, timeout=1.0)
                if not answer.done():
                    writer.write(b" ")
            count(client, "drip", answer)
        writer.close()


async def upload(client: Client, scene: str, bytes_per_s: int) -> None:
    """Send an archive slowly, but not too slowly."""
    while True:
        reader, writer = await client.connect()
        with contextlib.suppress(ConnectionError):
            head = client.head("PUT", f"/v1/scenes/{scene}/archive", f"Content-Length: {UPLOAD_BYTES}")
            writer.write(head)
            answer = asyncio.ensure_future(reader.readuntil(b"\r\n"))
            while not answer.done():
                writer.write(bytes(bytes_per_s))
                await asyncio.wait({answer}, timeout=1.0)
            count(client, "upload", answer)
        writer.close()


def count(client: Client, kind: str, answer: "asyncio.Future[bytes]") -> None:
    """Count a response by its status; a closed connection has none."""
    status = "closed" if answer.exception() else answer.result().split()[1].decode()
    client.counts[f"{kind} {status}"] = client.counts.get(f"{kind} {status}", 0) + 1


async def opened(streams: list[Stream]) -> None:
    """Wait until all have begun, or half a minute."""
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(30.0):
            await asyncio.gather(*(each.opened.wait() for each in streams))


async def run(order: dict[str, Any]) -> None:
    """Open everything, wait for the second line, and print the result."""
    loop = asyncio.get_running_loop()
    counts: dict[str, int] = {}
    clients = [
        Client(order["url"], key, address, counts)
        for key, address in zip(order["keys"], order["addresses"], strict=True)
    ]
    tasks, streams = [], []
    began = time.monotonic()
    for number in range(order["streams"]):
        # Half follow one job, as its page does, and half all of them.
        job = order["job"] if number % 2 else None
        streams.append(Stream(clients[number % len(clients)], job))
        tasks.append(loop.create_task(streams[-1].run()))
        # Fewer at once than the system's queue of new connections has room for.
        if number % 100 == 99:
            await opened(streams)
    await opened(streams)
    opening_s = time.monotonic() - began
    for number in range(order["senders"]):
        client = clients[number % len(clients)]
        send = drip(client) if number % 2 else upload(client, order["scene"], order["bytes_per_s"])
        tasks.append(loop.create_task(send))
        if number % 50 == 49:
            await asyncio.sleep(0.1)
    say({"open": sum(each.opened.is_set() for each in streams), "opening_s": opening_s})
    expected = json.loads(await asyncio.to_thread(sys.stdin.readline))
    deadline = time.monotonic() + order["patience_s"]
    while time.monotonic() < deadline and not all(each.has(expected) for each in streams):
        await asyncio.sleep(0.1)
    say(
        {
            "complete": sum(each.has(expected) and not each.wrong for each in streams),
            "wrong": sum(each.wrong for each in streams),
            "counts": counts,
        }
    )
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)


def say(what: dict[str, Any]) -> None:
    """Print one line of JSON."""
    print(json.dumps(what), flush=True)


def main() -> None:
    """Take the order and carry it out."""
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    asyncio.run(run(json.loads(sys.stdin.readline())))


if __name__ == "__main__":
    main()
