"""Films are decoded again: size, count, rate, colours and their tags."""

import gc
import re
import sys
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest
from lambent.errors import LambentError, UsageProblemError
from lambent.ffmpeg import encoder
from lambent.film import FilmWriter
from support.films import decoded

# Flat areas of the colours that tell matrices and ranges apart.
COLOURS = [(255, 0, 0), (0, 255, 0), (0, 0, 255), (16, 16, 16), (235, 235, 235), (120, 60, 180)]
# imageio-ffmpeg leaves its pipes to the garbage collector.
pytestmark = pytest.mark.filterwarnings("ignore::ResourceWarning")


@pytest.fixture(autouse=True)
def collected():
    """Collect garbage before the next test, whose warnings are errors."""
    yield
    gc.collect()


def picture(shift: int = 0, width: int = 96, height: int = 64) -> np.ndarray:
    frame = np.zeros((height, width, 3), np.uint8)
    step = width // len(COLOURS)
    for number in range(len(COLOURS)):
        frame[:, number * step : (number + 1) * step] = COLOURS[(number + shift) % len(COLOURS)]
    return frame


def broken_off():
    yield picture()
    raise ZeroDivisionError


def write(path, pictures):
    with FilmWriter(path, fps=5) as film:
        for frame in pictures:
            film.add(frame)


@pytest.mark.parametrize(("name", "codec"), [("spin.mp4", "h264"), ("spin.webm", "vp9")])
def test_a_film_holds_its_pictures_with_the_colours_they_had(tmp_path, name, codec):
    with FilmWriter(tmp_path / name, fps=12, crf=4) as film:
        for number in range(7):
            film.add(picture(number))
    assert [path.name for path in tmp_path.iterdir()] == [name]
    found = decoded(tmp_path / name)
    assert len(found.frames) == film.num_frames == 7
    assert found.size == (96, 64)
    assert found.fps == pytest.approx(12.0)
    assert codec in found.stream
    assert re.search(r"yuv420p\(tv, bt709/bt709/iec61966-2-1", found.stream), found.stream
    for number, frame in enumerate(found.frames):
        # In the middle of the areas chroma of half resolution does not matter.
        difference = np.abs(frame.astype(int) - picture(number))[:, 8::16]
        assert difference.max() <= 6, number


def test_odd_sides_are_made_even_by_their_last_pixels(tmp_path):
    frame = np.full((33, 21, 3), 200, np.uint8)
    with FilmWriter(tmp_path / "odd.mp4", fps=5) as film:
        film.add(frame)
    found = decoded(tmp_path / "odd.mp4")
    assert found.size == (22, 34)
    assert found.frames.shape == (1, 34, 22, 3)
    assert np.abs(found.frames.astype(int) - 200).max() <= 3


def test_a_lower_rate_factor_is_a_larger_and_better_film(tmp_path):
    noise = np.random.default_rng(0).integers(0, 255, (3, 64, 64, 1), dtype=np.uint8).repeat(3, axis=-1)
    size, error = [], []
    for crf in (4, 40):
        with FilmWriter(tmp_path / f"{crf}.mp4", fps=5, crf=crf) as film:
            for frame in noise:
                film.add(frame)
        size.append((tmp_path / f"{crf}.mp4").stat().st_size)
        frames = decoded(tmp_path / f"{crf}.mp4").frames
        error.append(np.abs(frames.astype(int).mean(-1) - noise.mean(-1)).mean())
    assert size[0] > 3 * size[1]
    assert error[0] < 0.5 * error[1]


def test_an_error_on_the_way_leaves_no_file_and_the_old_one(tmp_path):
    path = tmp_path / "spin.mp4"
    path.write_bytes(b"old")
    with pytest.raises(ZeroDivisionError):
        write(path, broken_off())
    assert [(p.name, p.read_bytes()) for p in tmp_path.iterdir()] == [("spin.mp4", b"old")]


def test_an_encoder_that_fails_is_named_with_its_reason(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules["lambent.film"]._CODECS, ".mp4", ("libx264", ["-preset", "none-such"]))
    with pytest.raises(LambentError, match=r"film\.encoder.*spin\.mp4"):
        write(tmp_path / "spin.mp4", [picture(width=960, height=640)] * 50)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("name", "crf", "code"),
    [("a.avi", None, "film.format"), ("a.mp4", 52, "film.quality"), ("a.webm", -1, "film.quality")],
)
def test_what_cannot_be_written_is_refused_before_anything_is_rendered(tmp_path, name, crf, code):
    with pytest.raises(UsageProblemError, match=re.escape(code)):
        FilmWriter(tmp_path / name, fps=5, crf=crf)


def test_without_the_package_or_the_program_the_message_says_what_to_install(tmp_path, monkeypatch):
    def missing():
        raise RuntimeError("no ffmpeg")

    with monkeypatch.context() as patch:
        patch.setattr(imageio_ffmpeg, "get_ffmpeg_exe", missing)
        with pytest.raises(UsageProblemError, match=r"film\.no_ffmpeg"):
            FilmWriter(tmp_path / "a.mp4", fps=5)
        assert encoder() is None
    assert Path(encoder()).is_file()
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(UsageProblemError, match=r"lambent\[film\]"):
        FilmWriter(tmp_path / "a.mp4", fps=5)
