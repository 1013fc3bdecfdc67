"""The masks of a run: given ones are kept with it, missing ones are estimated."""

from pathlib import Path

from lambent_capture.pictures.pictures import PICTURE_SUFFIXES
from lambent_core.errors import UsageError
from lambent_core.files import digest, file_sha256

AUTOMATIC = ""
"""Take what the capture says; estimate where it says nothing."""
WHOLE_VIEW = "none"
"""Take everything in view for the object where the capture says nothing."""
KEPT_FOLDER = "masks"


def kept_masks(source: Path | None) -> dict[str, Path]:
    """Return the masks that were given by the place where the run keeps them; it does not need the folder."""
    if source is None:
        return {}
    return {f"{KEPT_FOLDER}/{path.relative_to(source).as_posix()}": path for path in mask_files(source)}


def masks_setting(source: Path | None, *, whole_view: bool) -> str:
    """Return the value of `RunSpec.masks` for `--masks` and `--no-masks`: given masks by their contents.

    Raises `UsageError` where both are given, or the folder has no masks.
    """
    if source is None:
        return WHOLE_VIEW if whole_view else AUTOMATIC
    if whole_view:
        raise UsageError("config.masks_twice", "--masks and --no-masks contradict each other; leave one out")
    files = mask_files(source) if source.is_dir() else []
    if not files:
        raise UsageError(
            "config.masks_missing",
            f'--masks "{source}" is not a folder with pictures; give the folder of masks',
        )
    return digest([[path.relative_to(source).as_posix(), file_sha256(path)] for path in files])


def mask_files(folder: Path) -> list[Path]:
    """Return the pictures below a folder, in order."""
    return sorted(path for path in folder.rglob("*") if path.suffix.lower() in PICTURE_SUFFIXES)


def given_masks(run_dir: Path, setting: str) -> Path | None:
    """Return the folder of the masks that were given, or None where none were."""
    return None if setting in (AUTOMATIC, WHOLE_VIEW) else run_dir / KEPT_FOLDER
