"""The stored scenes against the script that made them, and the scenes that are not stored."""

import json
from dataclasses import dataclass
from pathlib import Path

import lambent
import make_sample_scene
import numpy as np
import pytest
from lambent_capture.loading.inspect import inspect_files
from lambent_core.colour import srgb_from_linear
from lambent_core.exr import read_exr_parts
from lambent_relight.environment.maps import load_environment
from PIL import Image

SAMPLE = Path(lambent.__file__).parent / "sample"
STILL_LIFE = Path(__file__).parents[1] / "data" / "still_life"
STORED = {"breakfast": SAMPLE, "still_life": STILL_LIFE}
SPP = {"breakfast": 16, "still_life": 64}
NOISE = {"breakfast": 0.09, "still_life": 0.05}
"""Root mean square of encoded values between SPP and the stored samples per pixel, with room (0.036 measured
for still_life)."""
VIEW = "test_002"


def read(path: Path) -> np.ndarray:
    return np.asarray(Image.open(path), dtype=np.float64) / 255.0


def render(scene: str, folder: Path, spp: int, view: str = VIEW, *more: str) -> Path:
    if make_sample_scene.llvm_library() is None:
        pytest.skip("needs an LLVM library to render with (Debian: libllvm19)")
    make_sample_scene.main(["-o", str(folder), "--scene", scene, "--spp", str(spp), "--only", view, *more])
    return folder


@pytest.fixture(scope="module", params=list(STORED))
def pair(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Path, Path]:
    """Return a scene's name, where it is stored, and one view of it rendered anew."""
    name = request.param
    return name, STORED[name], render(name, tmp_path_factory.mktemp(name), SPP[name], VIEW, "--radiance")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["albedo", "normal", "roughness", "metallic", "material"])
def test_the_stored_truth_is_what_the_script_makes(pair: tuple[str, Path, Path], name: str):
    _, folder, rendered = pair
    stored, fresh = (read(place / VIEW / f"{name}.png") for place in (folder, rendered))
    # Another processor rounds differently, which moves a few rays across an edge.
    wrong = np.abs(stored - fresh) > 1.5 / 255.0
    assert wrong.mean() <= 1e-4


@pytest.mark.slow
@pytest.mark.parametrize("light", ["morning_000", "studio", "sunset"])
def test_the_stored_photographs_are_what_the_script_renders(pair: tuple[str, Path, Path], light: str):
    name, folder, rendered = pair
    stored, fresh = (read(place / VIEW / f"rgba_{light}.png") for place in (folder, rendered))
    inside = stored[..., 3] == 1.0
    difference = (stored - fresh)[inside][:, :3]
    assert np.sqrt((difference**2).mean()) < NOISE[name]
    assert np.abs(difference.mean(axis=0)).max() < NOISE[name] / 4


@pytest.mark.slow
@pytest.mark.parametrize("light", ["morning_000", "studio", "sunset"])
def test_linear_pictures_are_the_photographs_without_their_limit(pair: tuple[str, Path, Path], light: str):
    _, _, rendered = pair
    photograph = read(rendered / VIEW / f"rgba_{light}.png")
    path = rendered / VIEW / f"radiance_{light}.exr"
    channels = read_exr_parts(path, max_pixels=1 << 20)[0].channels
    linear = np.stack([channels[name].pixels.astype(np.float64) for name in "RGBA"], axis=-1)
    encoded = np.concatenate([srgb_from_linear(linear[..., :3]), linear[..., 3:]], axis=-1)
    # A half float, and a level of the photograph.
    assert np.abs(encoded - photograph).max() < 0.6 / 255.0
    assert linear[..., :3].max() > 1.0


@pytest.mark.slow
@pytest.mark.parametrize("light", ["morning", "studio", "sunset"])
def test_the_stored_environments_are_what_the_script_computes(pair: tuple[str, Path, Path], light: str):
    _, folder, rendered = pair
    stored, fresh = ((place / "envmaps" / f"{light}.hdr").read_bytes() for place in (folder, rendered))
    assert stored == fresh


@pytest.mark.slow
def test_the_stored_description_is_what_the_script_writes_but_for_the_samples(pair: tuple[str, Path, Path]):
    _, folder, rendered = pair
    stored, fresh = (json.loads((place / "scene.json").read_text()) for place in (folder, rendered))
    for figures in (stored, fresh):
        del figures["spp"], figures["renderer"]
    assert stored == fresh


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "view"),
    [("lamps", "test_000"), ("metals", "train_000"), ("sunlit", "train_000"), ("tinware", "train_000")],
)
def test_a_scene_that_is_not_stored_lies_within_its_pictures(name: str, view: str, tmp_path: Path):
    folder = render(name, tmp_path / name, 4, view) / view
    stated = json.loads((folder.parent / "scene.json").read_text())
    names = {"metadata.json", "albedo.png", "normal.png", f"rgba_{stated['train_env']}_000.png"}
    if view.startswith("test"):
        names |= {"roughness.png", "metallic.png", "distance.exr", "material.png"}
        names |= {f"rgba_{light}.png" for light in stated["test_envs"]}
    assert {path.name for path in folder.iterdir()} == names
    for light in (stated["train_env"], *stated["test_envs"]):
        radiance = load_environment(folder.parent / "envmaps" / f"{light}.hdr").radiance
        assert radiance.shape == (256, 512, 3)
    coverage = read(folder / "albedo.png")[..., 3]
    border = np.concatenate([coverage[0], coverage[-1], coverage[:, 0], coverage[:, -1]])
    assert border.max() == 0.0
    assert 0.15 < coverage.mean() < 0.7


def test_the_sample_ships_within_its_size():
    files = [path for path in SAMPLE.rglob("*") if path.is_file()]
    assert len([path for path in files if path.name == "metadata.json"]) == 46
    assert sum(path.stat().st_size for path in files) <= 5e6


@pytest.mark.parametrize("folder", [SAMPLE, STILL_LIFE])
def test_material_is_one_number_where_albedo_is_uniform(folder: Path):
    seen = set()
    for view in sorted(folder.glob("test_*")):
        material = np.asarray(Image.open(view / "material.png"))
        albedo = read(view / "albedo.png")
        assert ((material == 0) <= (albedo[..., 3] == 0.0)).all()
        for number in np.unique(material[(material > 0) & (material < 255)]):
            seen.add(int(number))
            assert np.ptp(albedo[material == number][:, :3], axis=0).max() <= 1.5 / 255.0
    assert len(seen) >= 3


@pytest.mark.slow
@pytest.mark.parametrize("folder", [SAMPLE, STILL_LIFE])
def test_the_reader_finds_nothing_wrong_and_nothing_that_does_not_belong(folder: Path):
    report = inspect_files(folder).report
    assert report.usable
    assert [f"{finding.code}: {finding.message}" for finding in report.findings] == []


@dataclass(frozen=True)
class Judged:
    """A stored scene, its pixels whose shading follows irradiance, and how much so."""

    folder: Path
    min_roughness: float
    min_albedo: float
    margin: float
    """Between the right frame's correlation and the best wrong one's, half of what was measured at least."""


JUDGED = [Judged(SAMPLE, 0.1, 0.4, 0.15), Judged(STILL_LIFE, 0.6, 0.0, 0.3)]


def shading_agreement(
    scene: Judged, light: str, suffix: str, turned_deg: float, *, mirrored: bool = False
) -> float:
    """Return how well dull pixels correlate with their irradiance under a turned or mirrored light."""
    environment = load_environment(scene.folder / "envmaps" / f"{light}.hdr").rotated(turned_deg)
    generator = np.random.default_rng(0)
    omega_i = generator.normal(size=(1500, 3))
    omega_i /= np.linalg.norm(omega_i, axis=-1, keepdims=True)
    radiance = environment.lookup(omega_i * [1.0, -1.0 if mirrored else 1.0, 1.0]).mean(axis=-1)
    seen, expected = [], []
    for view in sorted(scene.folder.glob("test_*")):
        picture, albedo = read(view / f"rgba_{light}{suffix}.png"), read(view / "albedo.png")
        normal = read(view / "normal.png")
        dull = (normal[..., 3] == 1.0) & (read(view / "metallic.png") == 0.0)
        dull &= (read(view / "roughness.png") > scene.min_roughness) & (albedo[..., 0] > scene.min_albedo)
        bright = np.where(picture > 0.04045, ((picture + 0.055) / 1.055) ** 2.4, picture / 12.92)[dull]
        seen.append((bright[:, 0]) / albedo[dull][:, 0])
        cosine = np.maximum((2.0 * normal[dull][:, :3] - 1.0) @ omega_i.T, 0.0)
        expected.append(cosine @ radiance)
    return float(np.corrcoef(np.concatenate(seen), np.concatenate(expected))[0, 1])


@pytest.mark.parametrize("scene", JUDGED, ids=lambda scene: scene.folder.name)
@pytest.mark.parametrize(("light", "suffix"), [("morning", "_000"), ("studio", ""), ("sunset", "")])
def test_photographs_are_lit_from_where_our_reader_sees_the_light(scene: Judged, light: str, suffix: str):
    right = shading_agreement(scene, light, suffix, 0.0)
    wrong = [shading_agreement(scene, light, suffix, turn) for turn in (90.0, 180.0, 270.0)]
    wrong.append(shading_agreement(scene, light, suffix, 0.0, mirrored=True))
    # Shadows and bounced light keep the correlation below one.
    assert right > max(wrong) + scene.margin
