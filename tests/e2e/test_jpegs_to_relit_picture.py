"""Twenty JPEGs of a toy on a carpet, and nothing else, become a relit object on a server.

The capture is path traced, so its cameras, masks and looks in other lights are known: it is the small one of
`examples/make_tabletop_capture.py`. Preset `tiny`; the figures of other presets are in
docs/benchmarks/photographs.md.
"""

import io
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from lambent import Client, Job
from lambent.truth import psnr
from lambent_relight import Bundle, Renderer, load_bundle
from PIL import Image
from support.live_server import LiveServer

from benchmarks.photographs import brought_into, median_ratio, over_white, turned_light
from benchmarks.pose_errors import Similarity
from benchmarks.tabletop_truth import held_out_views, pose, read_coverage, true_cameras, unseen_lights

pytest.importorskip("pycolmap", reason="cameras are found with it")
# The first test waits for the training, beside whatever else the machine does.
pytestmark = [pytest.mark.slow, pytest.mark.timeout(1500)]

CAPTURE = Path(__file__).parents[1] / "data" / "tabletop" / "carpet"


def to_truth(bundle: Bundle) -> Similarity:
    """Return the similarity from the bundle's world to the truth's, by its cameras."""
    found = np.array([camera.camera_to_world for camera in bundle.cameras()])
    true = np.array([pose(true_cameras(CAPTURE)[camera.name]) for camera in bundle.cameras()])
    left, _, right = np.linalg.svd(np.einsum("cij,ckj->ik", true[:, :3, :3], found[:, :3, :3]))
    rotation = left @ right
    spread = [centres - centres.mean(axis=0) for centres in (true[:, :3, 3], found[:, :3, 3])]
    scale = float(np.linalg.norm(spread[0]) / np.linalg.norm(spread[1]))
    shift = true[:, :3, 3].mean(axis=0) - scale * rotation @ found[:, :3, 3].mean(axis=0)
    return Similarity(scale=scale, rotation=rotation, shift=shift)


def relit_db(bundle: Bundle, light: str) -> float:
    """Return the mean PSNR over white of the held-out views, relit."""
    moved = to_truth(bundle)
    views = held_out_views(CAPTURE, [light], 1)
    cameras = [brought_into(view.camera, moved) for view in views]
    renderer = Renderer(bundle)
    ratio = median_ratio(renderer, views, cameras)
    sky = turned_light(unseen_lights(CAPTURE)[light], moved.rotation)
    relit = []
    for view, camera in zip(views, cameras, strict=True):
        true = over_white(view.relit[light][..., :3], view.relit[light][..., 3:])
        picture = renderer.render(camera, sky, spp=32, albedo_ratio=ratio, seed=0)
        relit.append(psnr(over_white(picture.rgb * picture.opacity, picture.opacity), true))
    return float(np.mean(relit))


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> tuple[Job, dict[str, bytes], Bundle]:
    """Return the job that trained on the photographs, its previews of masks, and its bundle."""
    command = [sys.executable, "-m", "lambent_run", "run"]
    with (
        LiveServer(tmp_path_factory.mktemp("server") / "data", run_command=command) as server,
        Client(server.url, server.key) as client,
    ):
        scene = client.push(CAPTURE / "photographs")
        job = client.wait(client.submit(scene.id, preset="tiny").id)
        assert job.state == "succeeded", f"{job.error}\n{client.logs(job.id)[-3000:]}"
        looked = client.wait(client.submit(scene.id, kind="prepare").id)
        masks = {
            Path(each.name).stem: client.read_artifact(each)
            for each in client.artifacts(looked.id)
            if each.name.startswith("preparation/masks/")
        }
        bundle = client.fetch(job.id, tmp_path_factory.mktemp("fetched") / "bundle").path
        found = [event.message for event in client.events(job.id) if event.type == "finding"]
        print(json.dumps(found, indent=1))
    return job, masks, load_bundle(bundle)


def test_every_photograph_gets_a_camera_and_a_mask(done):
    _, masks, _ = done
    overlaps = []
    for path in sorted((CAPTURE / "truth" / "masks").glob("*.png")):
        with Image.open(io.BytesIO(masks[path.stem])) as image:
            found = np.asarray(image.convert("L")) >= 128
        true = read_coverage(path) >= 0.5
        assert found.shape == true.shape  # Previews are as large as photographs that are this small.
        overlaps.append((found & true).sum() / (found | true).sum())
    print(json.dumps({"mean": np.mean(overlaps), "worst": min(overlaps)}))
    # 0.943 and 0.929; whole photographs, without a mask, would be 0.05.
    assert np.mean(overlaps) > 0.92
    assert min(overlaps) > 0.88


@pytest.mark.parametrize("light", ["terrace", "lamps"])
def test_the_object_looks_like_the_true_one_in_light_it_was_never_in(done, light):
    *_, bundle = done
    found = relit_db(bundle, light)
    print(json.dumps({"light": light, "relit": found}))
    # 25.0 and 24.7; a white picture has 14.
    assert found > 23.0
