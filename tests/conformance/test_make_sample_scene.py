"""The stored sample scene against the script that made it."""

from pathlib import Path

import lambent
import make_sample_scene
import numpy as np
import pytest
from lambent_relight.environment.maps import load_environment
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


def shading_agreement(light: str, suffix: str, turned_deg: float, mirrored: bool) -> float:
    """Return how well matte pixels correlate with their irradiance under a turned or mirrored light."""
    environment = load_environment(SAMPLE / "envmaps" / f"{light}.hdr").rotated(turned_deg)
    generator = np.random.default_rng(0)
    omega_i = generator.normal(size=(1500, 3))
    omega_i /= np.linalg.norm(omega_i, axis=-1, keepdims=True)
    radiance = environment.lookup(omega_i * [1.0, -1.0 if mirrored else 1.0, 1.0]).mean(axis=-1)
    seen, expected = [], []
    for folder in sorted(SAMPLE.glob("test_*")):
        picture, albedo = read(folder / f"rgba_{light}{suffix}.png"), read(folder / "albedo.png")
        normal = read(folder / "normal.png")
        matte = (normal[..., 3] == 1.0) & (read(folder / "roughness.png") > 0.6)
        bright = np.where(picture > 0.04045, ((picture + 0.055) / 1.055) ** 2.4, picture / 12.92)[matte]
        seen.append((bright[:, 0]) / albedo[matte][:, 0])
        cosine = np.maximum((2.0 * normal[matte][:, :3] - 1.0) @ omega_i.T, 0.0)
        expected.append(cosine @ radiance)
    return float(np.corrcoef(np.concatenate(seen), np.concatenate(expected))[0, 1])


@pytest.mark.parametrize(("light", "suffix"), [("morning", "_000"), ("studio", ""), ("sunset", "")])
def test_photographs_are_lit_from_where_our_reader_sees_the_light(light: str, suffix: str):
    right = shading_agreement(light, suffix, 0.0, mirrored=False)
    wrong = [shading_agreement(light, suffix, turn, mirrored=False) for turn in (90.0, 180.0, 270.0)]
    wrong.append(shading_agreement(light, suffix, 0.0, mirrored=True))
    # Shadows and bounced light keep the correlation below one; wrong frames reach 0.52 at most.
    assert right > max(0.4, *wrong) + 0.3
