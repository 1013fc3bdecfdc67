"""Environment maps that strangers bring show the light they hold, or are refused with a remedy."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest
from lambent_core.errors import EnvironmentFileError
from lambent_relight.environment.maps import load_environment
from numpy import ndarray
from strangers import floats
from strangers.colours import SPACES, levels_of
from strangers.statements import STATEMENTS

SKY = np.array([0.5, 0.25, 0.125])
"""Light of every direction, linear Rec. 709: exact in the eight bits of a Radiance file."""
FACES = np.array([[4, 0, 0], [0, 4, 0], [0, 0, 4], [4, 4, 0], [0, 4, 4], [4, 0, 4]], float)
SIDE = 16
MARGIN = 0.012
Make = Callable[[Path], Path]


def _hdr(pixels: ndarray, *header: str, **options: object) -> Make:
    def make(folder: Path) -> Path:
        path = folder / "sky.hdr"
        floats.write_hdr(path, floats.rgbe(pixels), header=header, **options)  # type: ignore[arg-type]
        return path

    return make


def _exr(pixels: ndarray, space: str = "") -> Make:
    def make(folder: Path) -> Path:
        path = folder / "sky.exr"
        planes = {name: pixels[..., index].astype(np.float32) for index, name in enumerate("RGB")}
        floats.write_exr(path, planes, space=SPACES[space] if space else None)
        return path

    return make


def _even(height: int, width: int, colour: ndarray = SKY) -> ndarray:
    return np.broadcast_to(colour, (height, width, 3)).copy()


def _cross(columns: int, rows: int, places: list[tuple[int, int]]) -> ndarray:
    """Return faces of one light in a black picture."""
    pixels = np.zeros((rows * SIDE, columns * SIDE, 3))
    for row, column in places:
        pixels[row * SIDE : (row + 1) * SIDE, column * SIDE : (column + 1) * SIDE] = SKY
    return pixels


def _strip(across: bool) -> ndarray:
    faces = FACES.reshape(6, 1, 1, 3).repeat(SIDE, 1).repeat(SIDE, 2)
    return np.concatenate(list(faces), axis=1 if across else 0)


def _probe() -> ndarray:
    """Return a ball of one light in black, as angular probes are."""
    rows, columns = np.mgrid[: 4 * SIDE, : 4 * SIDE] - (4 * SIDE - 1) / 2
    return np.where((np.hypot(rows, columns) <= 2 * SIDE)[..., None], SKY, 0.0)


def _in(space: str) -> tuple[Any, ...]:
    """Return the sky in other primaries, and the line that states them."""
    return _even(SIDE, 2 * SIDE, levels_of(SKY, SPACES[space])), *STATEMENTS["hdr"][space].header


def _flat_like_runs() -> ndarray:
    """Return levels whose rows begin as run-length rows do, and are none."""
    pixels = floats.rgbe(_even(SIDE, 2 * SIDE))
    pixels[:, 0] = (2, 2, 0, 2 * SIDE)
    return pixels


_ARMS = [(1, 0), (1, 1), (1, 2), (1, 3), (0, 1), (2, 1)]
_DOWN = [(0, 1), (1, 0), (1, 1), (1, 2), (2, 1), (3, 1)]
SKIES = {
    "even hdr": _hdr(_even(SIDE, 2 * SIDE)),
    "even exr": _exr(_even(SIDE, 2 * SIDE)),
    "flat hdr": _hdr(_even(SIDE, 2 * SIDE), coded=False),
    "hdr with exposure": _hdr(2.0 * _even(SIDE, 2 * SIDE), "EXPOSURE=2.0"),
    "hdr of BT.2020": _hdr(*_in("rec2020-linear")),
    "hdr of P3": _hdr(*_in("p3-linear")),
    "exr of ACEScg": _exr(_even(SIDE, 2 * SIDE, levels_of(SKY, SPACES["ap1"])), "ap1"),
    "exr of P3": _exr(_even(SIDE, 2 * SIDE, levels_of(SKY, SPACES["p3-linear"])), "p3-linear"),
    "hdr from below": _hdr(_even(SIDE, 2 * SIDE), rows="+Y +X"),
    "cross": _hdr(_cross(4, 3, _ARMS)),
    "upright cross": _hdr(_cross(3, 4, _DOWN)),
    "probe": _hdr(_probe()),
    "exr cross": _exr(_cross(4, 3, _ARMS)),
    "exr probe": _exr(_probe()),
}

READ = ("even hdr", "even exr", "flat hdr", "hdr with exposure")


def _light_in(path: Path) -> ndarray | None:
    """Return the light that a map shows, or None where it is refused with a code and its name."""
    try:
        return load_environment(path).radiance
    except EnvironmentFileError as error:
        refusal = error
    assert refusal.code.startswith("environment.")
    assert path.name in str(refusal)
    return None


@pytest.mark.parametrize("name", SKIES)
def test_light_that_is_the_same_everywhere_stays_that_or_is_refused(name: str, tmp_path: Path):
    light = _light_in(SKIES[name](tmp_path))
    if light is None:
        assert name not in READ
        return
    margin = 0.02 if name.startswith("hdr of") else MARGIN
    np.testing.assert_allclose(light / SKY, 1.0, atol=margin)


@pytest.mark.parametrize("across", [True, False])
def test_a_strip_of_six_faces_is_no_panorama(across: bool, tmp_path: Path):
    _assert_turned_into_a_panorama(_light_in(_hdr(_strip(across))(tmp_path)))


def test_a_cube_in_an_exr_is_no_panorama(tmp_path: Path):
    planes = {name: _strip(False)[..., index].astype(np.float32) for index, name in enumerate("RGB")}
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    header["envmap"] = OpenEXR.ENVMAP_CUBE
    path = tmp_path / "sky.exr"
    OpenEXR.File(header, planes).write(str(path))
    _assert_turned_into_a_panorama(_light_in(path))


def _assert_turned_into_a_panorama(light: ndarray | None) -> None:
    if light is None:
        return
    assert light.shape[1] == 2 * light.shape[0]
    for row in (light[0], light[-1]):  # above and below there is one face
        np.testing.assert_allclose(row, np.broadcast_to(row[0], row.shape), atol=0.05)


def test_flat_rows_that_begin_like_runs_are_read_as_flat(tmp_path: Path):
    pixels = _flat_like_runs()
    path = tmp_path / "sky.hdr"
    floats.write_hdr(path, pixels, coded=False)
    sky = load_environment(path)
    np.testing.assert_allclose(sky.radiance[:, 1:] / SKY, 1.0, atol=MARGIN)
