"""Render the still life as a turntable shows it: camera and light stand still, the object turns.

    python benchmarks/turntable_scene.py -o FOLDER [--spp 256]

Views, truth and unseen lights are those of the still life (tests/data/still_life), so that a run on either
folder differs by nothing but the light of its photographs. In the coordinates of the object, the environment
of a view is the still life's, turned about +z by the camera's azimuth: `--light-fixed-to room`.
"""

import argparse
import json
import shutil
import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "examples"))
import make_sample_scene as sample  # noqa: E402
from sample_environments import directions, lookup  # noqa: E402

STILL_LIFE = ROOT / "tests/data/still_life"


def azimuth(pose: np.ndarray) -> float:
    """Return the azimuth from which a camera looks, radians."""
    return float(np.arctan2(pose[1, 2], pose[0, 2]))


def turned(image: np.ndarray, angle: float) -> np.ndarray:
    """Return the environment whose radiance from d is that of `image` from d turned by `angle` about +z."""
    world = directions(*image.shape[:2])
    cosine, sine = np.cos(angle), np.sin(angle)
    x, y, z = np.moveaxis(world, -1, 0)
    return lookup(image, np.stack([cosine * x - sine * y, sine * x + cosine * y, z], axis=-1))


def main() -> None:
    """Copy the still life and render the photographs of its training light anew."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--spp", type=int, default=256)
    options = parser.parse_args()
    sample.load_renderer()
    from sample_scenes.catalogue import SCENES

    still_life = SCENES["still_life"]
    shutil.copytree(STILL_LIFE, options.output, dirs_exist_ok=True)
    image = still_life.light(still_life.train_light)
    shapes, poses = still_life.objects(), sample.cameras(still_life)
    reference = azimuth(poses["train_000"])
    for seed, (name, pose) in enumerate(poses.items()):
        light = turned(image, reference - azimuth(pose)).astype(np.float32)
        scene = sample.build(shapes, light)
        picture = sample.render(scene, pose, still_life.resolution, options.spp, seed)
        encoded = np.dstack([sample.encode_srgb(picture[..., :3]), picture[..., 3]])
        sample.write_png(options.output / name / f"rgba_{still_life.train_light}_000.png", encoded)
    about = json.loads((options.output / "scene.json").read_text(encoding="utf-8"))
    about |= {"scene": "still_life_turntable", "spp": {"train": options.spp, "test": options.spp}}
    (options.output / "scene.json").write_text(json.dumps(about, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
