"""A small batch: one grey ball, two maps, and what lambent batch made of them."""

import csv

import numpy as np
import OpenEXR
from lambent.cli import app
from lambent_relight import write_environment
from lambent_relight.batch.journal import MadeFile, Record
from PIL import Image
from support.analytic_bundle import write_analytic_bundle
from support.analytic_scene import AnalyticScene, Sphere

HEAD = "schema: lambent-batch/1\nassets: [ball]\nenvironments: [sky.exr]\n"
ONE_PICTURE = {
    "schema": "lambent-batch/1",
    "assets": ["ball"],
    "environments": ["sky.exr"],
    "cameras": [{"turntable": 1, "size": 8}],
    "settings": {"spp": 2, "antialias": 1},
}
SMALL = HEAD + "cameras: [{turntable: 2, size: 8}]\nsettings: {spp: 2, antialias: 1}\n"


def write_inputs(folder):
    """Write a bundle of one grey ball and two maps into a folder; return the folder."""
    write_analytic_bundle(folder / "ball", AnalyticScene([Sphere((0.0, 0.0, 0.0), 1.0)]))
    radiance = np.zeros((8, 16, 3), np.float32)
    radiance[:4] = (0.2, 0.4, 0.6)
    write_environment(folder / "sky.exr", radiance)
    lamp = np.full((8, 16, 3), 0.1, np.float32)
    lamp[3:5, 7:9] = 4.0
    write_environment(folder / "lamp.exr", lamp)
    return folder


def batch(folder, text, *words):
    """Run a manifest and return the exit code."""
    (folder / "m.yaml").write_text(text)
    return app.run(["batch", str(folder / "m.yaml"), "-o", str(folder / "out"), *words])


def pixels(path):
    """Return the pixels of a PNG."""
    with Image.open(path) as image:
        return np.asarray(image)


def rgb_of(path):
    """Return the pixels of a PNG, or the radiance of an EXR."""
    if path.suffix == ".png":
        return pixels(path)
    return OpenEXR.File(str(path)).parts[0].channels["RGBA"].pixels


def table(folder):
    """Return pictures.csv by picture."""
    with (folder / "out" / "pictures.csv").open(newline="") as file:
        return {line["picture"]: line for line in csv.DictReader(file)}


def states(folder):
    """Return the states of all pictures by name."""
    return {name: line["state"] for name, line in table(folder).items()}


def record(path: str, files: dict[str, MadeFile], size: tuple[int, int] = (8, 6)) -> Record:
    """Return the record of a picture with these files."""
    return Record(
        path=path,
        asset="a",
        environment="e",
        quality="q",
        camera="c",
        files=files,
        width=size[0],
        height=size[1],
        seconds=1.25,
        num_samples=8,
        mean_standard_error=0.01,
        relative_standard_error=0.05,
    )
