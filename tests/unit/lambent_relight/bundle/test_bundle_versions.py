"""Bundles with the fields of earlier versions of the format, which readers must open and relight as ever.

`tests/golden/bundles` holds one each, and the pictures it gave when it was put there. They are never written
again: a minor version that changes what a reader needs adds one (docs/reference/bundle-format.md, Versions).
"""

import json
from pathlib import Path

import numpy as np
import pytest
from lambent_relight import Renderer, environment_from_array, load_bundle

FOLDER = Path(__file__).parents[3] / "golden" / "bundles"
PICTURES = [
    (path.name.removesuffix(".json"), quality)
    for path in sorted(FOLDER.glob("*.json"))
    for quality in json.loads(path.read_text())["rgb"]
]
LARGEST_RMS = {"preview": 2e-3, "baked": 2e-3, "refined": 0.03}
"""Linear radiance, of a light of about 0.7; refined pictures have noise."""


def light():
    """Return a map that is red in the east and blue above."""
    row, column = np.mgrid[0:8, 0:16]
    east = np.cos(2.0 * np.pi * (column - 7.5) / 16.0)
    return environment_from_array(np.stack([0.6 + 0.5 * east, 0.5 + 0.0 * east, 1.0 - row / 8.0], axis=-1))


@pytest.mark.parametrize(("name", "quality"), PICTURES)
def test_a_bundle_of_an_earlier_version_gives_the_pictures_it_gave(name, quality):
    golden = json.loads((FOLDER / f"{name}.json").read_text())
    bundle = load_bundle(FOLDER / f"{name}.relight.zip")
    assert bundle.manifest.schema_version == golden["schema_version"]
    (camera,) = bundle.cameras()
    renderer = Renderer(bundle, num_threads=1, reader="onnx")
    picture = renderer.render(camera, light(), quality=quality, spp=256, antialias=1)
    expected = np.array(golden["rgb"][quality])
    assert 0.05 < expected.mean() < 1.0
    difference = picture.rgb * picture.opacity - expected
    assert np.sqrt(np.mean(difference**2)) < LARGEST_RMS[quality]
    np.testing.assert_allclose(picture.opacity[..., 0], golden["opacity"], atol=1e-3)


def test_there_is_a_bundle_of_every_version_that_changed_what_a_reader_needs():
    versions = {json.loads(path.read_text())["schema_version"] for path in FOLDER.glob("*.json")}
    assert {"1.0", "1.1"} <= versions
