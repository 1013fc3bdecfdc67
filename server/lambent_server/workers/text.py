"""Texts and numbers in the messages of run processes, checked before anything is done with them."""

import math
import re
from collections.abc import Iterator
from typing import Any

from google.protobuf.message import Message
from lambent_proto.v1 import worker_pb2

from lambent_server.api import outside_text
from lambent_server.api.problems import Problem, invalid

MAX_INTEGER = 2**31 - 1
"""Of a column of whole numbers."""
_SHA256 = re.compile(r"[0-9a-f]{64}")
# Of blobs; others are only compared.
_HASHES = frozenset({"sha256", "page_sha256", "thumbnail_sha256"})
# What programs and people write; a NUL in the output of a program does not end its run.
_FREE = frozenset({"message", "name", "doing", "subject"})


def admit(request: Message) -> None:
    """Check every field of a message, nested ones too; removes NUL from free text.

    Raises `text_invalid`, `number_invalid` or `media_type_invalid` for what cannot be stored or sent on.
    """
    if isinstance(request, worker_pb2.ReportRequest) and request.HasField("progress"):
        _drop_unknown(request.progress)
    _check(request, "#")


def _drop_unknown(progress: Message) -> None:
    """Set figures that are not finite to 0, which says "not known": a loss may overflow for one step."""
    for field, value in progress.ListFields():
        if isinstance(value, float) and not math.isfinite(value):
            setattr(progress, field.name, 0.0)


def _check(message: Message, pointer: str) -> None:
    for field, value in message.ListFields():
        here = f"{pointer}/{field.name}"
        if isinstance(value, str) and field.name in _FREE and "\0" in value:
            setattr(message, field.name, value.replace("\0", ""))
            continue
        for each in _values(field, value):
            if isinstance(each, Message):
                _check(each, here)
            else:
                _check_value(field.name, each, here)


def _values(field: Any, value: Any) -> Iterator[Any]:
    """Yield the values of a field; of a map, its keys too."""
    if field.message_type is not None and field.message_type.GetOptions().map_entry:
        yield from value.keys()
        yield from value.values()
    elif field.is_repeated:
        yield from value
    else:
        yield value


def _check_value(name: str, value: Any, pointer: str) -> None:
    if isinstance(value, float) and not math.isfinite(value):
        raise invalid("number_invalid", pointer, f"{pointer} is {value}, and must be a finite number")
    if isinstance(value, int) and abs(value) > MAX_INTEGER:
        raise invalid("number_invalid", pointer, f"{pointer} is {value}, above {MAX_INTEGER}")
    if not isinstance(value, str):
        return
    if not outside_text.storable(value):
        raise invalid("text_invalid", pointer, f"{pointer} holds a NUL")
    if name == "media_type" and outside_text.media_type(value) is None:
        raise invalid("media_type_invalid", pointer, f"{value[:80]!r} is not a media type such as image/png")
    if name in _HASHES and _SHA256.fullmatch(value) is None:
        raise _not_a_hash(pointer, value)


def _not_a_hash(pointer: str, value: str) -> Problem:
    return invalid("text_invalid", pointer, f"{value[:80]!r} is not a SHA-256 in 64 hexadecimal digits")
