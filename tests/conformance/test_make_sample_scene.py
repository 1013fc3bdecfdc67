"""The stored sample scene against the script that made it."""

from pathlib import Path

import lambent
import make_sample_scene
import numpy as np
import pytest
from PIL import Image

SAMPLE = Path(lambent.__file__).parent / "sample"
NOISE_AT_64_SPP = 0.05
"""Root mean square of encoded values between 64 and 2048 samples per pixel: 0.036 measured, with room."""


def read(path: Path) -> np.ndarray:
    return np.asarray(Image.open(path), dtype=np.float64) / 255.0


@pytest.fixture(scope="module")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if make_sample_scene.llvm_library() is None:
        pytest.skip("needs an LLVM library to render with (Debian: libllvm19)")
    folder = tmp_path_factory.mktemp("sample")
    make_sample_scene.main(["-o", str(folder), "--spp", "64", "--only", "test_002"])
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("name", ["albedo", "normal", "roughness", "metallic"])
def test_the_stored_truth_is_what_the_script_makes(rendered: Path, name: str):
    stored, fresh = (read(folder / "test_002" / f"{name}.png") for folder in (SAMPLE, rendered))
    assert np.abs(stored - fresh).max() <= 1.5 / 255.0


@pytest.mark.slow
@pytest.mark.parametrize("light", ["morning_000", "studio", "sunset"])
def test_the_stored_photographs_are_what_the_script_renders(rendered: Path, light: str):
    stored, fresh = (read(folder / "test_002" / f"rgba_{light}.png") for folder in (SAMPLE, rendered))
    inside = stored[..., 3] == 1.0
    difference = (stored - fresh)[inside][:, :3]
    assert np.sqrt((difference**2).mean()) < NOISE_AT_64_SPP
    assert np.abs(difference.mean(axis=0)).max() < NOISE_AT_64_SPP / 4


@pytest.mark.slow
@pytest.mark.parametrize("light", ["morning", "studio", "sunset"])
def test_the_stored_environments_are_what_the_script_computes(rendered: Path, light: str):
    stored, fresh = ((folder / "envmaps" / f"{light}.hdr").read_bytes() for folder in (SAMPLE, rendered))
    assert stored == fresh


def test_the_sample_ships_within_its_size():
    files = [path for path in SAMPLE.rglob("*") if path.is_file()]
    assert len([path for path in files if path.name == "metadata.json"]) == 46
    assert sum(path.stat().st_size for path in files) <= 3e6
