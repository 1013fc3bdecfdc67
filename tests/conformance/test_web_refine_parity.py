"""Refined pictures of the web viewer against Python's, by noise alone: mesh, and trained cache in WASM."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from lambent_relight import RelitPicture, load_bundle, load_environment
from lambent_relight.cameras import Camera
from lambent_relight.edits import MaterialEdit
from lambent_relight.renderer import Renderer
from support.chromium import program
from support.engine_page import WEB, WEBGPU
from support.refine_page import RefinePage, build_viewer, refine_page, write_light, write_refine_bundle

pytestmark = [pytest.mark.browser, pytest.mark.slow, pytest.mark.timeout(600)]
SAMPLES = 192


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("data")
    write_refine_bundle(folder / "boxes")
    write_light(folder / "light.exr")
    return folder


@pytest.fixture(scope="module")
def page(data, tmp_path_factory) -> Iterator[RefinePage]:
    if program() is None or not (WEB / "node_modules" / "vite").is_dir():
        pytest.skip("needs Chromium and `npm ci` in client/web")
    folder = tmp_path_factory.mktemp("pages")
    build_viewer(folder / "pages")
    with refine_page(folder / "pages", data, folder / "profile", more=WEBGPU) as opened:
        yield opened


def expected(
    data: Path, camera: Camera, edit: MaterialEdit, rotate_deg: float, occlusion: str
) -> RelitPicture:
    """Return Python's refined picture of the same view."""
    renderer = Renderer(load_bundle(data / "boxes"), reader="onnx")
    light = load_environment(data / "light.exr")
    return renderer.render(
        camera,
        light,
        rotate_deg=rotate_deg,
        spp=SAMPLES,
        seed=7,
        antialias=2,
        bounces="transport",
        occlusion=occlusion,
        edit=edit,
    )


@pytest.mark.parametrize(
    ("backend", "workers", "edited"),
    [("mesh", 1, False), ("mesh", 3, True), ("wasm", 1, False), ("wasm", 1, True)],
)
def test_the_browser_refines_what_python_does(page, data, backend, workers, edited):
    edit, rotate_deg, state = MaterialEdit(), 0.0, ""
    if edited:
        edit, rotate_deg = MaterialEdit(albedo_gain=(1.2, 0.8, 1.0), roughness_scale=1.5), 50.0
        state = "&rotate=50,0,0&gain=1.2,0.8,1&roughness=1.5"
    view = f"env=url:data/light.exr&camera=30,35,2.6,0,0,0&refine=1{state}"
    options = {"backend": backend, "workers": workers, "relativeError": 0, "samplesPerPixel": SAMPLES}
    page.open("boxes", view, **options)
    status = page.wait("done", "failed")
    assert status["phase"] == "done", status
    assert status["backend"] == backend
    # Passes of several workers come when they are done.
    assert SAMPLES <= status["samplesPerPixel"] <= SAMPLES * (1 if workers == 1 else 4)
    occlusion = "mesh" if backend == "mesh" else "cache"
    found, wanted = page.refined(), expected(data, page.camera(), edit, rotate_deg, occlusion)
    assert np.abs(found["coverage"] - wanted.coverage).mean() < 2e-3

    whole = (found["coverage"][..., 0] > 0.99) & (wanted.coverage[..., 0] > 0.99)
    assert whole.sum() > 150
    radiance = (found["directRgb"] + found["indirectRgb"])[whole].astype(np.float64)
    reference = wanted.rgb[whole].astype(np.float64)
    errors = found["standardErrorRgb"][whole], wanted.standard_error[whole]
    both = np.sqrt(errors[0].astype(np.float64) ** 2 + errors[1].astype(np.float64) ** 2)
    assert (both > 0.0).all()
    z = (radiance - reference) / both
    mean_z = (radiance - reference).mean(axis=0) / (np.sqrt((both**2).sum(axis=0)) / len(both))
    print(f"{backend}: rms z {np.sqrt((z**2).mean()):.3f}, largest {np.abs(z).max():.2f}, of means {mean_z}")
    print(f"relative difference of means {(radiance.mean(axis=0) / reference.mean(axis=0) - 1.0)}")
    print(f"noise, browser over Python: {errors[0].mean() / errors[1].mean():.3f}")
    # Seeds are fixed: these bounds leave room for other roundings, not for chance.
    assert 0.8 < np.sqrt((z**2).mean()) < 1.25
    # A sample on an edge of a box may show either side of it, and rays against the mesh know the difference.
    assert (np.abs(z).max(axis=1) > 7.0).sum() <= (2 if backend == "mesh" else 0)
    assert np.percentile(np.abs(z), 99.0) < 4.5
    assert np.abs(mean_z).max() < 4.5
    # The browser does not share a sequence among the rays of a pixel as Python does.
    assert 0.7 < errors[0].mean() / errors[1].mean() < 3.0
    # Parts have no errors of their own: other seeds move the bounces by 1 % and visibility by 2 %.
    shares = [part[whole].sum() / reference.sum() for part in (found["indirectRgb"], wanted.indirect)]
    assert shares[1] > 0.1
    assert shares[0] == pytest.approx(shares[1], rel=0.06)
    free = [part[whole].mean() for part in (found["visibility"], wanted.visibility)]
    assert free[0] == pytest.approx(free[1], rel=0.1)
    assert page.page.console == []
