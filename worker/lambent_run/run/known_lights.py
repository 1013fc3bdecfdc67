"""Environments that are given instead of learned: files of the user, kept in the run folder by their hash."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from lambent_capture.pictures.resample import averaged
from lambent_core.errors import RelightError, UsageError
from lambent_core.files import file_sha256
from lambent_relight.environment.maps import load_environment

if TYPE_CHECKING:
    from flashcache.physical.model import InverseModel

FOLDER = "known_lights"
ANY_LIGHT = ""
"""Stands for the only light, or for the one environment that rotated lights share."""


def parse_known_lights(items: Sequence[str]) -> dict[str, Path]:
    """Return files by light from `FILE` or `LIGHT=FILE`; a bare file belongs to `ANY_LIGHT`.

    Raises `UsageError` for a light given twice, and for files that are not environment maps.
    """
    files: dict[str, Path] = {}
    for item in items:
        light, equals, name = item.partition("=")
        light, path = (light, Path(name)) if equals else (ANY_LIGHT, Path(item))
        if light in files:
            raise UsageError("light.known_twice", f'--known-light "{item}": this light has a file already')
        try:
            load_environment(path)
        except RelightError as error:
            raise UsageError(error.code, f'--known-light "{item}": {error}') from error
        files[light] = path
    return files


def kept_lights(files: Mapping[str, Path]) -> tuple[dict[str, str], dict[str, Path]]:
    """Return the name under which a run keeps each light's file, and the files by their place in the run.

    The name is the file's SHA-256 with its suffix: the run does without the original, and recognises another.
    """
    names = {light: file_sha256(path) + path.suffix.lower() for light, path in files.items()}
    return names, {f"{FOLDER}/{names[light]}": path for light, path in files.items()}


def known_names(known: Mapping[str, str], lights: Sequence[str], *, rotated: bool) -> tuple[str, ...]:
    """Return the lights whose environment is given, with `ANY_LIGHT` replaced by a name.

    Raises `UsageError` where it could be any of several, or a name is not among the training lights.
    """
    if ANY_LIGHT in known and not rotated and len(lights) > 1:
        raise UsageError(
            "light.known_unnamed",
            f"--known-light: there are {len(lights)} lights ({', '.join(lights)}); give LIGHT=FILE for each "
            "that is known, or --rotated if they are one environment turned",
        )
    for light in known:
        if light != ANY_LIGHT and light not in lights:
            raise UsageError(
                "light.known_unknown",
                f'--known-light {light}=...: "{light}" is none of the training lights {", ".join(lights)}',
            )
    return tuple(light or lights[0] for light in known)


def give_known_lights(model: "InverseModel", run_dir: Path, known: Mapping[str, str]) -> None:
    """Put the given environments into `model`, whose domain names their lights in the order of `known`."""
    import torch

    rows = model.config.environment.known_height
    for light, name in zip(model.domain.known_lights, known.values(), strict=True):
        image = averaged(load_environment(run_dir / FOLDER / name).radiance, (2 * rows, rows))
        device = next(model.parameters()).device
        model.environment.set_known(model.domain.lights.index(light), torch.from_numpy(image).to(device))
