"""Refining in the web viewer: it starts, reports progress, ends by itself, and yields to input."""

import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from google.protobuf import json_format
from lambent_proto.v1.bundle_pb2 import BundleManifest
from support.analytic_bundle import write_manifest
from support.chromium import program
from support.engine_page import WEB, WEBGPU
from support.refine_page import SIZE, RefinePage, build_viewer, refine_page, write_light, write_refine_bundle

pytestmark = [pytest.mark.browser, pytest.mark.slow, pytest.mark.timeout(600)]
VIEW = "env=url:data/light.exr&camera=30,35,2.6,0,0,0&ground=0&auto=0&rotate=0,0,0"
FLAGS = {"mesh": (), "cache": WEBGPU, "wasm": ()}
# On graphics hardware "cache" would be "webgpu"; the browser of the tests computes that on the processor.
TAKEN = {"mesh": "mesh", "cache": "wasm", "wasm": "wasm"}
SOFT = "this browser computes WebGPU on the processor"
LEFT = ("ArrowLeft", 37)


@pytest.fixture(scope="module")
def folders(tmp_path_factory) -> tuple[Path, Path]:
    """Return folders of the built viewer, and of bundles: whole, with other weights, without networks."""
    if program() is None or not (WEB / "node_modules" / "vite").is_dir():
        pytest.skip("needs Chromium and `npm ci` in client/web")
    pages, data = tmp_path_factory.mktemp("pages"), tmp_path_factory.mktemp("data")
    build_viewer(pages)
    write_refine_bundle(data / "boxes")
    write_light(data / "light.exr")
    shutil.copytree(data / "boxes", data / "changed")
    weights = data / "changed" / "models" / "weights.bin"
    weights.write_bytes(weights.read_bytes()[:-1] + b"\x55")
    shutil.copytree(data / "boxes", data / "lite")
    shutil.rmtree(data / "lite" / "models")
    manifest = json_format.Parse((data / "lite" / "manifest.json").read_text(), BundleManifest())
    for field in (manifest.graphs, manifest.grids, manifest.tensors):
        del field[:]
    write_manifest(data / "lite", manifest)
    return pages, data


@pytest.fixture(scope="module", params=["mesh", "cache", "wasm"])
def opened(request, folders, tmp_path_factory) -> Iterator[tuple[str, RefinePage]]:
    """Yield what traces, and a browser: with WebGPU in software where that is used."""
    profile = tmp_path_factory.mktemp("profile")
    with refine_page(*folders, profile, more=FLAGS[request.param]) as page:
        yield request.param, page


def tick(page: RefinePage, on: bool) -> None:
    """Tick or untick the box of refining."""
    found = page.page.evaluate(
        f"""(() => {{
            const labels = [...document.querySelector('lambent-viewer').shadowRoot.querySelectorAll('label')];
            const label = labels.find((each) => each.textContent === 'Refine while nothing moves');
            const box = label?.querySelector('input');
            if (box && box.checked !== {json.dumps(on)}) box.click();
            return box?.checked;
        }})()"""
    )
    assert found is on


def fetched(page: RefinePage, part: str) -> bool:
    """Return whether a path that contains `part` was requested from the server."""
    return any(part in path for path in page.asked)


def shown_text(page: RefinePage) -> str:
    """Return the panel's text about refining."""
    return page.page.evaluate(
        "[...document.querySelector('lambent-viewer').shadowRoot.querySelectorAll('p.hint')]"
        ".map((each) => each.hidden ? '' : each.textContent).find((text) => /noise|refine/i.test(text)) ?? ''"
    )


def test_it_starts_rises_stops_and_gives_way_to_input(opened):
    backend, page = opened
    # Smoothed pictures come as passes double; the others as often as there is time.
    page.open("boxes", VIEW, backend=backend, relativeError=0.12, samplesPerPixel=4096, denoise=False)
    page.page.wait("viewer.canvas.width > 1")
    baked = page.picture()
    # Nothing of it is fetched before it is asked for.
    assert not [path for path in page.asked if "models/" in path or "refine" in path or "assets/ort" in path]
    tick(page, True)
    done = page.wait("done", "failed")
    assert done["phase"] == "done", done
    assert done["backend"] == TAKEN[backend]
    assert done["note"] == (SOFT if backend == "cache" else "")
    counts = [status["samplesPerPixel"] for status in page.statuses() if status["phase"] == "running"]
    assert counts == sorted(counts)
    assert counts[0] < counts[-1] < done["samplesPerPixel"] < 4096
    assert done["relativeError"] <= 0.12
    assert f"{done['samplesPerPixel']} samples per pixel" in shown_text(page)
    assert fetched(page, "models/weights.bin") == (backend != "mesh")
    assert fetched(page, "models/fast_cache_sky.onnx") == (backend != "mesh")
    assert fetched(page, ".wasm") == (backend != "mesh")
    refined = page.picture()
    assert np.abs(refined.astype(int) - baked).mean() > 1.0
    assert (page.refined()["standardErrorRgb"] > 0.0).any()

    # Exposure, tone curve and channels are about the refined picture too.
    look = "viewer.state.look"
    page.page.evaluate(f"viewer.update({{ look: {{ ...{look}, exposureEv: 1 }} }})")
    assert page.picture().mean() > refined.mean()
    page.page.evaluate(f"viewer.update({{ look: {{ ...{look}, exposureEv: 0, channel: 'indirect' }} }})")
    page.page.evaluate(f"viewer.update({{ look: {{ ...{look}, channel: 'final' }} }})")
    assert np.array_equal(page.picture(), refined)
    assert page.page.evaluate("viewer.refined.width") == SIZE[0]

    at_input = page.press(*LEFT)
    assert (at_input["refined"], at_input["phase"]) == (False, "waiting")
    turned = at_input["picture"]
    # At rest it begins anew, and it goes away with its box.
    page.wait("done")
    assert not np.array_equal(page.picture(), turned)
    tick(page, False)
    assert page.statuses()[-1]["phase"] == "off"
    assert np.array_equal(page.picture(), turned)
    # Browsers without WebGPU say so themselves.
    assert [text for text in page.page.console if text != "No available adapters."] == []


def test_input_ends_it_before_it_is_done(opened):
    backend, page = opened
    page.open("boxes", f"{VIEW}&refine=1", backend=backend, relativeError=0, samplesPerPixel=1_000_000)
    page.page.wait("viewer.refined !== null", 240.0)
    at_input = page.press(*LEFT)
    assert (at_input["refined"], at_input["phase"]) == (False, "waiting")
    # While a button is held nothing starts, and no late answer is shown.
    before = page.page.evaluate("(() => { viewer.moving = true; return statuses.length; })()")
    page.page.evaluate("new Promise((resolve) => setTimeout(resolve, 1500))")
    assert page.page.evaluate("viewer.refined") is None
    assert all(status["phase"] == "waiting" for status in page.statuses()[before:])
    page.page.evaluate("viewer.moving = false")
    page.page.wait("viewer.refined !== null", 240.0)
    page.page.evaluate("document.querySelector('lambent-viewer').remove()")


@pytest.mark.parametrize(
    ("bundle", "code"), [("changed", "bundle.digest_mismatch"), ("lite", "bundle.graph_missing")]
)
def test_without_its_networks_a_bundle_is_refined_by_its_mesh_alone(opened, bundle, code):
    backend, page = opened
    page.open(bundle, f"{VIEW}&refine=1", backend=backend, relativeError=0.3)
    ended = page.wait("failed", "done")
    if backend == "mesh":
        assert ended["phase"] == "done", ended
        return
    assert code in ended["message"]
    assert code in shown_text(page)
    assert page.page.evaluate("viewer.refined") is None
    assert page.picture()[..., 3].max() == 255


def test_a_page_that_forbids_webassembly_refines_all_the_same(opened):
    backend, page = opened
    page.open("boxes", f"{VIEW}&refine=1", backend=backend, below="strict/")
    status = page.wait("failed", "running")
    # onnxruntime-web is WebAssembly also where graphics hardware does the work.
    assert status["phase"] == ("running" if backend == "mesh" else "failed"), status
    if backend != "mesh":
        assert "WebAssembly does not work here" in status["message"]
        assert (SOFT in status["message"]) == (backend == "cache")
        assert "refine.unavailable" in shown_text(page)


def choose(page: RefinePage, rays: str) -> None:
    """Choose what rays are traced against, as a person does."""
    found = page.page.evaluate(
        f"""(() => {{
            const labels = [...document.querySelector('lambent-viewer').shadowRoot.querySelectorAll('label')];
            const label = labels.find((each) => each.textContent.startsWith('Rays against'));
            const list = label?.querySelector('select');
            const option = [...(list?.options ?? [])].find((each) => each.textContent === {json.dumps(rays)});
            if (option === undefined) return false;
            list.value = option.value;
            list.dispatchEvent(new Event('change', {{ bubbles: true }}));
            return !label.hidden;
        }})()"""
    )
    assert found is True


@pytest.mark.parametrize("opened", ["cache", "wasm"], indirect=True)
def test_the_panel_chooses_what_rays_are_traced_against(opened):
    backend, page = opened
    few = {"relativeError": 0, "samplesPerPixel": 64, "denoise": False}
    page.open("boxes", f"{VIEW}&refine=1", backend="mesh", **few)
    assert page.wait("done", "failed")["backend"] == "mesh"
    assert "tracing the mesh" in shown_text(page)
    mesh = page.refined()
    before = len(page.statuses())
    choose(page, "trained cache (ONNX)")
    page.page.wait(f"statuses.slice({before}).some((each) => ['done', 'failed'].includes(each.phase))", 240.0)
    done = page.statuses()[-1]
    assert (done["phase"], done["backend"]) == ("done", "wasm"), done
    assert "the trained cache in WebAssembly (slow)" in shown_text(page)
    # Why it is not graphics hardware is said, and not only done without.
    why = SOFT if backend == "cache" else "this browser has no WebGPU"
    assert why in done["note"]
    assert why in shown_text(page)
    cache = page.refined()
    # The untrained network is fog: darker than what the mesh lets through.
    covered = mesh["coverage"][..., 0] > 0.99
    assert cache["directRgb"][covered].mean() < 0.95 * mesh["directRgb"][covered].mean()
    # A script chooses as the panel does, which follows it.
    before = len(page.statuses())
    page.page.evaluate("void (viewer.refineOptions = { ...viewer.refineOptions, backend: 'mesh' })")
    page.page.wait(f"statuses.slice({before}).some((each) => each.phase === 'done')", 240.0)
    assert page.statuses()[-1]["backend"] == "mesh"
    assert (
        page.page.evaluate(
            "[...document.querySelector('lambent-viewer').shadowRoot.querySelectorAll('select')]"
            ".find((each) => [...each.options].some((one) => one.value === 'cache')).value"
        )
        == "mesh"
    )


@pytest.mark.parametrize("opened", ["mesh"], indirect=True)
def test_what_is_shown_is_smoother_than_what_is_measured(opened):
    _, page = opened
    shown = []
    for denoise in (False, True):
        page.open(
            "boxes", f"{VIEW}&refine=1", relativeError=0, samplesPerPixel=32, denoise=denoise, workers=1
        )
        page.wait("done", "failed")
        shown.append(page.picture().astype(float))
        measured = page.refined()
        assert (measured["standardErrorRgb"] > 0.0).any()
        shown.append(measured["directRgb"] + measured["indirectRgb"])
    # The noise of measurements is the same, that of pictures is not.
    np.testing.assert_array_equal(shown[1], shown[3])
    page.open("boxes", f"{VIEW}&refine=1", relativeError=0, samplesPerPixel=2048, denoise=False)
    page.wait("done", "failed")
    truth = page.picture().astype(float)
    errors = [np.sqrt(((picture - truth)[..., :3] ** 2).mean()) for picture in (shown[0], shown[2])]
    assert errors[1] < 0.75 * errors[0], errors
