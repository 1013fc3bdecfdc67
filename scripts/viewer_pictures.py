"""Make the pictures of docs/howto/look-and-film.md from a bundle.

    python scripts/viewer_pictures.py BUNDLE --env A.hdr --env B.hdr --photographs SCENE --photograph NAME

Writes viewer.jpg, viewer-photograph.jpg, viewer-help.jpg and viewer-channels.jpg into docs/images, as the
desktop viewer shows them.
Needs the extra [viewer] and OpenGL.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from check_functions import ROOT
from lambent.desktop import opengl
from lambent.desktop.painter import Painter
from lambent.desktop.viewer import DesktopOptions, open_model
from lambent_relight import Renderer, load_bundle
from numpy.typing import NDArray
from PIL import Image

CHANNELS = (
    "direct",
    "indirect",
    "visibility",
    "albedo",
    "normal",
    "roughness",
    "depth",
    "uncertainty: albedo",
)


def shot(renderer: Renderer, options: DesktopOptions) -> NDArray[np.uint8]:
    """Return the window's pixels."""
    from lambent.desktop.window import Window

    model = open_model(renderer.bundle, options)
    painted = Painter(renderer, model.lights, model.photographs).paint(model.state)
    window = Window(model, off_screen=True, overlays=options.overlays)
    try:
        window.show_picture(painted)
        window.show_model(model.status(legend=painted.legend))
        return window.screenshot()
    finally:
        window.close()


def save(pixels: NDArray[np.uint8], path: Path) -> None:
    """Write a small file for a page."""
    Image.fromarray(np.ascontiguousarray(pixels)).save(path, quality=85, optimize=True)
    print(path, path.stat().st_size)


def main() -> None:
    """Make the pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("bundle", type=Path)
    parser.add_argument("--env", type=Path, action="append", required=True)
    parser.add_argument("--photographs", type=Path, required=True)
    parser.add_argument("--photograph", required=True)
    parser.add_argument("-o", type=Path, default=ROOT / "docs" / "images")
    given = parser.parse_args()
    opengl.draw_without_display()
    renderer = Renderer(load_bundle(given.bundle))
    maps = tuple(given.env)
    plain = DesktopOptions(environments=maps, size=(600, 400))
    sides = {"compare": True, "backdrop": "environment", "tone_mapping": "neutral", "overlays": True}
    save(shot(renderer, replace(plain, **sides)), given.o / "viewer.jpg")
    photograph = replace(plain, photographs=given.photographs, photograph=given.photograph)
    save(shot(renderer, photograph), given.o / "viewer-photograph.jpg")
    save(shot(renderer, replace(plain, overlays=True, help=True)), given.o / "viewer-help.jpg")
    tiles = [
        shot(renderer, DesktopOptions(environments=maps, size=(220, 180), channel=name)) for name in CHANNELS
    ]
    rows = [np.concatenate(tiles[start : start + 4], axis=1) for start in (0, 4)]
    save(np.concatenate(rows), given.o / "viewer-channels.jpg")


if __name__ == "__main__":
    main()
