"""Films decoded again by the program that wrote them, which takes the time it needs."""

import re
import subprocess
from dataclasses import dataclass
from pathlib import Path

import imageio_ffmpeg
import numpy as np


@dataclass(frozen=True, kw_only=True, slots=True)
class DecodedFilm:
    """Contents of a film."""

    size: tuple[int, int]
    """Width and height in pixels."""
    fps: float
    stream: str
    """The line that ffmpeg prints of the stream: codec, colours, size, rate."""
    frames: np.ndarray
    """0 to 255 [frame, height, width, 3], signed so that differences are right."""


def decoded(path: Path) -> DecodedFilm:
    """Return what is in the only stream of a film."""
    program = imageio_ffmpeg.get_ffmpeg_exe()
    told = subprocess.run([program, "-hide_banner", "-i", path], capture_output=True, text=True, check=False)
    stream = next(line for line in told.stderr.splitlines() if "Video:" in line)
    width, height = map(int, re.search(r" (\d+)x(\d+)[ ,]", stream).groups())
    command = [program, "-v", "error", "-i", path, "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    pixels = subprocess.run(command, capture_output=True, check=True).stdout
    return DecodedFilm(
        size=(width, height),
        fps=float(re.search(r"([\d.]+) fps", stream)[1]),
        stream=stream,
        frames=np.frombuffer(pixels, np.uint8).reshape(-1, height, width, 3).astype(np.int32),
    )
