"""The parameters of an order for a run on a capture, read once."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any

from lambent_capture.loading.light_turns import LightFixedTo, as_light_fixed_to

if TYPE_CHECKING:
    from lambent_capture.masks.corrections import Correction

    from lambent_run.run.card_option import GreyCard


@dataclass(frozen=True, kw_only=True, slots=True)
class JobParameters:
    """Parameters of an order."""

    lights: tuple[str, ...] = ()
    """Training lights by name; empty for the scene's first."""
    layout: str = ""
    """Layout to read the capture as; empty to detect it."""
    known_lights: tuple[str, ...] = ()
    """Files of the capture, `[LIGHT=]FILE`."""
    masks: str = ""
    """A folder of the capture, or as in `RunSpec`."""
    light_fixed_to: LightFixedTo = "auto"
    corrections: tuple["Correction", ...] = ()
    grey_card: "GreyCard | None" = None
    settings: Mapping[str, str] = field(default_factory=dict)
    """Settings of the method that differ from the preset."""

    @classmethod
    def of(cls, params: Mapping[str, str]) -> "JobParameters":
        """Return parameters from their texts; raises `UsageError` for one that cannot be read."""
        own = {each.name for each in fields(cls)} - {"settings"}
        return cls(
            **{name: _read(name, text) for name, text in params.items() if name in own and text},
            settings={name: text for name, text in params.items() if name not in own},
        )


def _read(name: str, text: str) -> Any:
    if name in ("lights", "known_lights"):
        return tuple(item.strip() for item in text.split(",") if item.strip())
    if name == "light_fixed_to":
        return as_light_fixed_to(text)
    # Both need libraries for pictures, which take time to import.
    if name == "corrections":
        from lambent_capture.masks.corrections import parse_corrections

        return tuple(parse_corrections(text, '"corrections"'))
    if name == "grey_card":
        from lambent_run.run.card_option import parse_grey_card

        return parse_grey_card(text)
    return text
