"""Parameters of a job as REST accepts them: many short settings, and one that may be long."""

from typing import Annotated, Any

from pydantic import AfterValidator, Field

SettingName = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*(\.[a-z][a-z0-9_]*)*$", max_length=100)]
MAX_CHARACTERS = 200
SettingValue = Annotated[str, Field(max_length=MAX_CHARACTERS, pattern=r"^[^\x00-\x1f\x7f]*$")]
CORRECTIONS = "corrections"
"""The setting that holds a person's corrections of masks, as JSON; the only long one."""
MAX_CORRECTIONS_CHARACTERS = 64 * 1024
SIZE_STEP = 16
"""Texels: sizes of textures are multiples of it (as `flashcache.config.SIZE_STEP` has it)."""
SIZES = ("export.atlas_size", "export.transport_size")
LongValue = Annotated[str, Field(max_length=MAX_CORRECTIONS_CHARACTERS, pattern=r"^[^\x00-\x1f\x7f]*$")]


def _require_short(settings: dict[str, str]) -> dict[str, str]:
    long = [name for name, value in settings.items() if name != CORRECTIONS and len(value) > MAX_CHARACTERS]
    if long:
        raise ValueError(f"{long[0]!r} is longer than {MAX_CHARACTERS} characters")
    return settings


def _describe_settings(schema: dict[str, Any]) -> None:
    """Say in the schema that only one setting may be long."""
    ((pattern, value),) = schema["patternProperties"].items()
    schema["properties"] = {CORRECTIONS: value}
    others = f"^(?!{CORRECTIONS}$){pattern.removeprefix('^')}"
    schema["patternProperties"] = {others: {**value, "maxLength": MAX_CHARACTERS}}
    schema["additionalProperties"] = False


Settings = Annotated[
    dict[SettingName, LongValue],
    Field(max_length=64, json_schema_extra=_describe_settings),
    AfterValidator(_require_short),
]


def odd_size(settings: dict[str, str]) -> str | None:
    """Return the name of a texture's size that no run can make, or None; other values are left to the run."""
    return next((name for name in SIZES if _is_odd(settings.get(name, ""))), None)


def _is_odd(text: str) -> bool:
    # A run reads values as JSON, which may have blanks around it.
    text = text.strip(" ")
    return text.isascii() and text.isdigit() and int(text) % SIZE_STEP != 0
