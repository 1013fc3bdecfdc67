"""Conversion of protobuf messages to the JSON of the REST interface.

That is ProtoJSON with proto field names and every field written, except that enumerations are lower-case
words without their prefix ("queued"), a message that is not set is null, and sizes are integers.
"""

from typing import Any

from google.protobuf.internal.enum_type_wrapper import EnumTypeWrapper
from google.protobuf.message import Message


def _prefix(enum_name: str) -> str:
    words = "".join(f"_{letter}" if letter.isupper() else letter for letter in enum_name)
    return words.strip("_").upper() + "_"


def enum_text(enum: Any, number: int) -> str:
    """Return the word for a value of an enumeration ("" for the unspecified one)."""
    descriptor = enum.DESCRIPTOR if isinstance(enum, EnumTypeWrapper) else enum
    name = descriptor.values_by_number[number].name.removeprefix(_prefix(descriptor.name)).lower()
    return "" if name == "unspecified" else str(name)


def _is_map(field: Any) -> bool:
    return field.message_type is not None and bool(field.message_type.GetOptions().map_entry)


def _value_to_rest(field: Any, value: Any) -> Any:
    if field.message_type is not None:
        return to_rest(value)
    if field.enum_type is not None:
        return enum_text(field.enum_type, value)
    # Sizes are doubles in messages, as ProtoJSON writes 64-bit integers as strings.
    is_size = field.name.endswith("_bytes") and isinstance(value, float) and value.is_integer()
    return int(value) if is_size else value


def to_rest(message: Message) -> dict[str, Any]:
    """Return the REST object of a message."""
    result: dict[str, Any] = {}
    fields: Any = message.DESCRIPTOR.fields
    for field in fields:
        value = getattr(message, field.name)
        if _is_map(field):
            inner = field.message_type.fields_by_name["value"]
            result[field.name] = {key: _value_to_rest(inner, value[key]) for key in sorted(value)}
        elif field.is_repeated:
            result[field.name] = [_value_to_rest(field, each) for each in value]
        elif field.message_type is not None and not message.HasField(field.name):
            result[field.name] = None
        else:
            result[field.name] = _value_to_rest(field, value)
    return result
