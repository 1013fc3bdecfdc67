"""The process that reads one untrusted file: `python -m lambent_server.storage.decoding_child ORDER`.

The file is its standard input, the order JSON in its first argument, its answer goes to standard output:
messages, each a length in 4 bytes and JSON. After the message of an entry that belongs in a scene come its
contents, in pieces with a length each; a length of zero ends them, the largest one announces a message that
says what went wrong.
"""

import codecs
import json
import os
import socket
import sys
from typing import IO, Any

from lambent_sandbox.sandbox import EXIT_REFUSED, Layers, Limits, SandboxError, enter

from lambent_server.api.problems import Problem
from lambent_server.storage import archive_entries, environment_files
from lambent_server.storage.paths import in_archive, is_scene_file

PIECE = 1024 * 1024
INTERRUPTED = 0xFFFFFFFF
# Nothing can be loaded any more once the sandbox is closed: what the readers look up by name must be there.
_ENCODINGS = ("utf-8", "ascii", "cp437", "iso8859-1", "utf-16-le", "idna")


def main() -> int:
    """Do what the order says; the exit code is 0 also if the file was refused."""
    order = json.loads(sys.argv[1])
    load()
    out = os.fdopen(1, "wb", buffering=0, closefd=False)
    source = os.fdopen(0, "rb", closefd=False)
    try:
        layers = enter(Limits(**order["limits"]), order["sandbox"], as_nobody=True)
    except SandboxError:
        return EXIT_REFUSED
    do(order, layers, source, out)
    return 0


def load() -> None:
    """Load what the readers look up by name."""
    for name in _ENCODINGS:
        codecs.lookup(name)


def do(order: dict[str, Any], layers: Layers, source: IO[bytes], out: IO[bytes]) -> None:
    """Read the file as the order says, and send the result."""
    try:
        if order["task"] == "archive":
            send_entries(source, out, order["budget"], order["max_files"])
        elif order["task"] == "environment":
            head = environment_files.parse_head(
                source.read(environment_files.HEAD_BYTES), order["max_pixels"]
            )
            send(out, {name: getattr(head, name) for name in ("format", "width", "height")})
        else:
            try_out(out, layers)
    except Problem as problem:
        pointer = problem.errors[0].pointer if problem.errors else "#"
        refuse(out, problem.code, pointer.removeprefix("#").removeprefix("/"), problem.detail)
    except MemoryError:
        code = "archive_unsafe" if order["task"] == "archive" else "environment_invalid"
        refuse(out, code, "", "reading it takes too much memory")


def send_entries(source: IO[bytes], out: IO[bytes], budget: int, max_files: int) -> None:
    """Send the entries of an archive, and the contents of those that belong in a scene."""
    for name, size, member in archive_entries.entries_of(source, budget, max_files):
        send(out, {"name": name, "size": size})
        if is_scene_file(in_archive(name)):
            send_contents(name, member, out)
    send(out, {"done": True})


def send_contents(name: str, member: IO[bytes], out: IO[bytes]) -> None:
    """Send the contents of an entry; raises `archive_broken` where they cannot be read to their end."""
    try:
        while piece := member.read(PIECE):
            write(out, len(piece).to_bytes(4, "big") + piece)
    except archive_entries.READER_ERRORS as error:
        write(out, INTERRUPTED.to_bytes(4, "big"))
        raise archive_entries.broken(f"the archive cannot be read: {error}", name) from error
    except (Problem, MemoryError):
        write(out, INTERRUPTED.to_bytes(4, "big"))
        raise
    write(out, bytes(4))


def try_out(out: IO[bytes], layers: Layers) -> None:
    """Send which layers are said to be in force, and whether a file can be opened; then open a socket."""
    try:
        os.close(os.open("/proc/self/status", os.O_RDONLY))
        opened = True
    except OSError:
        opened = False
    send(out, {"in_force": layers.in_force, "missing": layers.missing, "opened": opened})
    socket.socket().close()


def send(out: IO[bytes], message: dict[str, Any]) -> None:
    """Send one message."""
    data = json.dumps(message).encode("ascii")
    write(out, len(data).to_bytes(4, "big") + data)


def refuse(out: IO[bytes], code: str, subject: str, text: str) -> None:
    """Send why the file is refused."""
    send(out, {"problem": code, "subject": subject, "message": text})


def write(out: IO[bytes], data: bytes) -> None:
    """Write all of `data`: a pipe takes what fits."""
    view = memoryview(data)
    while view:
        view = view[out.write(view) or 0 :]


if __name__ == "__main__":
    sys.exit(main())
