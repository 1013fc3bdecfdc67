"""Hashes of what the preparation of a capture depends on; torch is not imported for them."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import PurePosixPath

from lambent_core.files import digest


def files_hash(files: Iterable[tuple[str, str]]) -> str:
    """Return the hash of a capture from the path and the SHA-256 of each of its files.

    Files whose names begin with a dot do not count.
    """
    counted = [(PurePosixPath(path), sha256) for path, sha256 in files]
    kept = sorted((path, sha256) for path, sha256 in counted if not path.name.startswith("."))
    return digest([[path.as_posix(), sha256] for path, sha256 in kept])


def cameras_hash(scene: str, seed: int) -> str:
    """Return the hash of what cameras are found from; `scene` is that of the capture.

    Masks that are given later do not move cameras that were found before.
    """
    return digest("cameras", scene, seed)


def ingest_hash(
    scene: str,
    *,
    lights: Sequence[str],
    layout: str,
    known_lights: Mapping[str, str],
    masks: str,
    cameras: str | None,
    light_fixed_to: str = "auto",
) -> str:
    """Return the hash of what the task `ingest` depends on.

    `cameras` is that of `cameras_hash` where they have to be found, the others are those of `RunSpec`.
    """
    given: list[object] = [dict(known_lights)] if known_lights else []
    given += [{"masks": masks}] if masks else []
    given += [{"light_fixed_to": light_fixed_to}] if light_fixed_to != "auto" else []
    given += [{"cameras": cameras}] if cameras is not None else []
    return digest("ingest", scene, list(lights), layout, *given)
