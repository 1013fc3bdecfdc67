"""Messages as JSON files: ProtoJSON with proto field names and default values written."""

import json
from pathlib import Path
from typing import Any, TypeVar

from google.protobuf import json_format
from google.protobuf.message import Message

from lambent_core.errors import WorkerError

M = TypeVar("M", bound=Message)


def message_to_dict(message: Message) -> dict[str, Any]:
    """Return a message as JSON-compatible values, every field present; sizes in bytes are integers."""
    given = json_format.MessageToDict(
        message, preserving_proto_field_name=True, always_print_fields_with_no_presence=True
    )
    _make_sizes_whole(given)
    return given


def _make_sizes_whole(value: Any) -> None:
    """Make the numbers of bytes below a value integers, in place.

    They are doubles in messages because ProtoJSON writes 64-bit integers as strings; readers with a type of
    integers refuse 3084.0.
    """
    for each in value if isinstance(value, list) else value.values() if isinstance(value, dict) else ():
        _make_sizes_whole(each)
    if isinstance(value, dict):
        for name, number in value.items():
            if name.endswith("_bytes") and isinstance(number, float) and number.is_integer():
                value[name] = int(number)


def read_message(path: Path, message: M) -> M:
    """Fill `message` from a JSON file and return it; raises `WorkerError` where the file cannot be read."""
    try:
        return json_format.ParseDict(json.loads(path.read_text(encoding="utf-8")), message)
    except (OSError, ValueError, json_format.ParseError) as error:
        raise WorkerError(
            "run.file_unreadable",
            f'"{path.name}" of the run cannot be read; run the task that writes it again',
        ) from error
