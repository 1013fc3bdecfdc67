"""Writes a golden bundle, and the pictures that it gives.

    python -m support.golden_bundle FOLDER NAME [lite]

A finished one goes into `tests/golden/bundles` and is never written again.

    python -m support.golden_bundle redraw FOLDER

draws the pictures `preview` and `baked` of all bundles in FOLDER again, after a deliberate change of how
baked transport is drawn; the bundles, and their refined pictures, stay.
"""

from __future__ import annotations

import json
import sys
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from flashcache.physical.model import InverseModel
from lambent_asset.bundle.manifest import write_manifest
from lambent_relight import Renderer, load_bundle
from lambent_relight.cameras import Camera, cameras_json, look_at
from lambent_run.run.tasks import export
from support.golden_light import SPP, golden_light
from support.small_export import LIGHTS, small_context
from support.sphere_model import sphere_model

CAMERA = Camera(
    name="golden",
    width=16,
    height=12,
    focal_x=20.0,
    focal_y=20.0,
    centre_x=8.0,
    centre_y=6.0,
    camera_to_world=look_at((2.0, 1.2, 0.9), (0.0, 0.0, 0.0)),
)


def _lit_ball() -> InverseModel:
    """Return a ball that little stands around: most light arrives."""
    model = sphere_model(lights=LIGHTS)
    with torch.no_grad():
        # The last output is the logit of a secondary ray's opacity.
        model.fast.distance_head.bias[-1] -= 4.5
    return model


def write_golden(folder: Path, name: str, *, lite: bool) -> None:
    """Export a small ball into `folder`/NAME.relight.zip and draw NAME.json from it."""
    with pytest.MonkeyPatch.context() as patched:
        (folder / "made").mkdir(parents=True)
        context = small_context(folder / "made", _lit_ball(), patched)
        tier = {"transport_tier": "lite", "weights": "none"} if lite else {}
        config = context.spec.config
        config = replace(config, export=replace(config.export, judge_samples=0, **tier))
        export.run(replace(context, spec=replace(context.spec, config=config)))
    made = load_bundle(context.folder)
    for picture in (context.folder / "preview").iterdir():
        picture.unlink()
    (context.folder / "cameras.json").write_text(cameras_json([CAMERA]))
    write_manifest(context.folder, made.manifest)
    with zipfile.ZipFile(folder / f"{name}.relight.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        for path in sorted(path for path in context.folder.rglob("*") if path.is_file()):
            entry = zipfile.ZipInfo(path.relative_to(context.folder).as_posix())
            archive.writestr(entry, path.read_bytes(), zipfile.ZIP_DEFLATED)
    renderer = Renderer(load_bundle(folder / f"{name}.relight.zip"), num_threads=1, reader="onnx")
    pictures = {}
    for quality in ("preview", "baked") if lite else ("preview", "baked", "refined"):
        # Noise of the stored picture adds to that of a test, so that it has less.
        samples = 64 * SPP if quality == "refined" else SPP
        pictures[quality] = renderer.render(CAMERA, golden_light(), quality=quality, spp=samples, antialias=1)
    stored = {
        "schema_version": made.manifest.schema_version,
        "rgb": {
            key: np.round(picture.rgb * picture.opacity, 5).tolist() for key, picture in pictures.items()
        },
        "opacity": {key: np.round(picture.opacity[..., 0], 4).tolist() for key, picture in pictures.items()},
    }
    (folder / f"{name}.json").write_text(json.dumps(stored, separators=(",", ":")) + "\n")


def redraw(folder: Path) -> None:
    """Draw the pictures without noise of the bundles in `folder` again, each stored as it was."""
    for path in sorted(folder.glob("*.json")):
        stored = json.loads(path.read_text())
        bundle = load_bundle(path.with_suffix(".relight.zip"))
        renderer, (camera,) = Renderer(bundle, num_threads=1, reader="onnx"), bundle.cameras()
        for quality in {"preview", "baked"} & stored["rgb"].keys():
            picture = renderer.render(camera, golden_light(), quality=quality, spp=SPP, antialias=1)
            stored["rgb"][quality] = np.round(picture.rgb * picture.opacity, 5).tolist()
        path.write_text(json.dumps(stored, separators=(",", ":")) + "\n")


if __name__ == "__main__" and sys.argv[1] == "redraw":
    redraw(Path(sys.argv[2]))
elif __name__ == "__main__":
    write_golden(Path(sys.argv[1]), sys.argv[2], lite=sys.argv[3:] == ["lite"])
