"""Films: pictures go to ffmpeg one by one, so that a long film takes no more memory than a short one.

MP4 holds H.264, WebM holds VP9; both as yuv420p, 8 bit, with Rec. 709 primaries and matrix, the sRGB
transfer curve and limited range written into the file. Sides are made even by repeating the last column
or row.
"""

import os
from collections.abc import Generator
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lambent import ffmpeg
from lambent.errors import LambentError, UsageProblemError

SUFFIXES = (".mp4", ".webm")
DEFAULT_CRF = {".mp4": 18, ".webm": 24}
"""Constant rate factors that are hard to tell from the pictures; lower is better and larger."""
MAX_CRF = {".mp4": 51, ".webm": 63}
_CODECS: dict[str, tuple[str, list[str]]] = {
    ".mp4": ("libx264", ["-preset", "medium", "-movflags", "+faststart"]),
    ".webm": ("libvpx-vp9", ["-b:v", "0", "-deadline", "good", "-cpu-used", "3", "-row-mt", "1"]),
}
_COLOUR = ["-color_primaries", "bt709", "-color_trc", "iec61966-2-1", "-colorspace", "bt709"]
_CONVERT = "scale=in_range=full:out_range=limited:out_color_matrix=bt709,format=yuv420p"
_TAGS = "setparams=range=limited:color_primaries=bt709:color_trc=iec61966-2-1:colorspace=bt709"


def check_film(path: Path, crf: int | None) -> None:
    """Raise UsageProblemError unless a film can be written to `path`.

    `film.format` for a suffix that is not in `SUFFIXES`, `film.quality` for a `crf` out of range,
    `cli.missing_extra` without the package imageio-ffmpeg, and `film.no_ffmpeg` without the program.
    """
    if path.suffix not in SUFFIXES:
        raise UsageProblemError("film.format", f"{path.name} is not a film", f"use {' or '.join(SUFFIXES)}")
    if crf is not None and not 0 <= crf <= MAX_CRF[path.suffix]:
        raise UsageProblemError(
            "film.quality", f"rate factor {crf}", f"use 0 to {MAX_CRF[path.suffix]}; lower is better"
        )
    ffmpeg.package()


class FilmWriter:
    """Writes one film; as a context manager, so that the file appears whole or not at all."""

    def __init__(self, path: Path, *, fps: int, crf: int | None = None) -> None:
        """Write to `path` (.mp4 or .webm) with `fps` pictures per second.

        `crf` defaults to `DEFAULT_CRF`. Raises as `check_film`.
        """
        check_film(path, crf)
        self.path, self.num_frames = path, 0
        self._fps, self._crf = fps, DEFAULT_CRF[path.suffix] if crf is None else crf
        self._partial = path.with_name(f".partial-{path.name}")
        self._encoder: Generator[None, Any, None] | None = None
        self._shape: tuple[int, ...] = ()

    def add(self, frame: NDArray[np.uint8]) -> None:
        """Append sRGB pixels [height, width, 3], all of one size; raises LambentError `film.encoder`."""
        frame = _even(frame)
        if self._encoder is None:
            self._shape = frame.shape
            self._encoder = self._start(frame.shape[1], frame.shape[0])
        assert frame.shape == self._shape, "all pictures of a film have one size"
        try:
            self._encoder.send(np.ascontiguousarray(frame))
        except (OSError, StopIteration) as error:
            raise self._fault(error) from error
        self.num_frames += 1

    def __enter__(self) -> "FilmWriter":
        """Begin."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Finish the file, or remove it after an error."""
        try:
            if self._encoder is not None:
                self._encoder.close()
        except OSError as fault:
            if kind is None:
                self._partial.unlink(missing_ok=True)
                raise self._fault(fault) from fault
        if kind is None and self.num_frames:
            if not self._partial.is_file() or self._partial.stat().st_size == 0:
                raise self._fault("it wrote nothing")
            os.replace(self._partial, self.path)
        else:
            with suppress(OSError):
                self._partial.unlink(missing_ok=True)

    def _start(self, width: int, height: int) -> Generator[None, Any, None]:
        codec, options = _CODECS[self.path.suffix]
        self.path.parent.mkdir(parents=True, exist_ok=True)
        encoder: Generator[None, Any, None] = ffmpeg.package().write_frames(
            str(self._partial),
            (width, height),
            fps=self._fps,
            quality=None,
            codec=codec,
            macro_block_size=1,
            ffmpeg_log_level="error",
            output_params=[
                *("-crf", str(self._crf)),
                *options,
                *("-vf", f"{_CONVERT},{_TAGS}"),
                *_COLOUR,
                *("-color_range", "tv"),
            ],
        )
        encoder.send(None)
        return encoder

    def _fault(self, reason: object) -> LambentError:
        lines = str(reason).strip().splitlines() or ["it stopped"]
        return LambentError(
            "film.encoder",
            f"ffmpeg could not write {self.path.name}: {lines[-1][:300]}",
            "look at free disk space; `-o DIR/` writes single pictures",
        )


def _even(frame: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a picture with even sides."""
    height, width = frame.shape[:2]
    return np.pad(frame, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
