"""The ffmpeg program behind films, and the package that brings and runs it."""

from typing import Any

from lambent_core.errors import pip_install

from lambent.errors import UsageProblemError


def encoder() -> str | None:
    """Return the ffmpeg program that writes films, or None where there is none."""
    try:
        return str(package().get_ffmpeg_exe())
    except UsageProblemError:
        return None


def package() -> Any:
    """Return the package that runs ffmpeg.

    Raises UsageProblemError `cli.missing_extra` without the package imageio-ffmpeg, and `film.no_ffmpeg`
    without the program.
    """
    try:
        import imageio_ffmpeg
    except ModuleNotFoundError as error:
        raise UsageProblemError(
            "cli.missing_extra", "films need the package 'imageio-ffmpeg'", pip_install("film")
        ) from error
    try:
        imageio_ffmpeg.get_ffmpeg_exe()
    except RuntimeError as error:
        raise UsageProblemError(
            "film.no_ffmpeg",
            "there is no ffmpeg program",
            "install it, or name it in the variable IMAGEIO_FFMPEG_EXE",
        ) from error
    return imageio_ffmpeg
