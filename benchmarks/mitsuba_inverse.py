"""Compare with Mitsuba 3, which recovers materials and light on our mesh in equal time.

    python -m benchmarks mitsuba_inverse RUN_DIR SCENE --environments DIR --report REPORT -o OUT

RUN_DIR is a finished run of `lambent train`, REPORT what `lambent evaluate RUN_DIR SCENE --environments DIR
-o REPORT` wrote. Mitsuba gets the mesh of the run's bundle, the same training photographs and `--seconds` of
processor time, and optimises base colour, roughness and metalness at every vertex of its `principled`
material together with the environment, by path replay with one bounce and Adam. Both are scored by
`tests/references/evaluate.py`. Needs the extra `dev` and an LLVM library; see `make_sample_scene.py`.
"""

import argparse
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from jaxtyping import Float, Int
from lambent_capture.layouts.detect import describe_scene
from lambent_capture.loading.load import load_scene
from lambent_core.scene import Camera, Scene, View
from lambent_relight.environment.maps import load_environment
from lambent_run.report.predictions import encoded, save_array
from lambent_run.report.request import evenly_spaced
from make_sample_scene import emitter, load_renderer, straight
from numpy import ndarray

from benchmarks.oracle_geometry import pixel_rays
from benchmarks.reference_scores import reference_report, reference_scores

QUICK = "{run} {sample} --environments {maps} --seconds 2 --views 2 --samples 4"

ATTRIBUTES = {"base_color": (3, 0.27), "roughness": (1, 0.52), "metallic": (1, 0.12)}
"""Material attributes of a vertex: channels, and the values with which ours start as well."""
LIGHT = "light.data"
GRID = 4
"""Rays along the side of a pixel for the surface maps."""
ROWS = {
    "novel views [dB]": "nvs/psnr",
    "albedo [dB]": "albedo_rgb_ratio/psnr_gamma",
    "albedo, interior [dB]": "albedo_interior/psnr_gamma",
    "relit [dB]": "relight/psnr",
    "relit [SSIM]": "relight/ssim",
    "normals, inside mask [deg]": "normal/mae_mask",
    "perceptual roughness [rmse]": "roughness/rmse",
    "metalness [rmse]": "metallic/rmse",
}


@dataclass(frozen=True, kw_only=True, slots=True)
class Settings:
    """Mitsuba's optimisation settings, found by a few short trials on cowcrate."""

    rate: float = 0.02
    """Of base colour, an Adam step."""
    lobe_rate: float = 0.005
    """Of roughness and metalness, which photographs determine less well."""
    light_rate: float = 0.03
    """Of the logarithm of radiance."""
    final_rate: float = 0.1
    """Final rates as a share of the initial ones, reached log-linearly."""
    smoothness: float = 0.05
    """Weight of the mean absolute difference along the mesh's edges."""
    samples: int = 16
    """Paths per pixel, in the picture and again in its derivative."""
    bounces: int = 1
    light_rows: int = 33


def read_mesh(path: Path) -> trimesh.Trimesh:
    """Return the mesh of a bundle turned back to z up."""
    found = trimesh.load_scene(path).to_mesh()
    turn = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    return found.apply_transform(turn)


def neighbours(mesh: trimesh.Trimesh) -> Int[ndarray, "pairs 2"]:
    """Return pairs of vertices that an edge joins, or that lie on one another where a texture has a seam."""
    _, place = np.unique(np.round(mesh.vertices, 5), axis=0, return_inverse=True)
    order = np.argsort(place.ravel(), kind="stable")
    same = place.ravel()[order[1:]] == place.ravel()[order[:-1]]
    return np.concatenate([mesh.edges_unique, np.stack([order[:-1], order[1:]], axis=-1)[same]])


class Asset:
    """The mesh under an environment, as a Mitsuba scene with attributes that can be optimised."""

    def __init__(self, mesh: trimesh.Trimesh, light: Float[ndarray, "rows columns 3"]) -> None:
        import mitsuba as mi

        properties = mi.Properties()
        texture = {name: {"type": "mesh_attribute", "name": f"vertex_{name}"} for name in ATTRIBUTES}
        properties["bsdf"] = mi.load_dict({"type": "principled", **texture})
        count = len(mesh.vertices)
        shape = mi.Mesh("asset", count, len(mesh.faces), has_vertex_normals=True, props=properties)
        for name, (channels, value) in ATTRIBUTES.items():
            shape.add_attribute(f"vertex_{name}", channels, np.full(channels * count, value, np.float32))
        buffers = mi.traverse(shape)
        buffers["vertex_positions"] = mesh.vertices.astype(np.float32).ravel()
        buffers["vertex_normals"] = mesh.vertex_normals.astype(np.float32).ravel()
        buffers["faces"] = mesh.faces.astype(np.uint32).ravel()
        buffers.update()
        self.shape, self.edges = shape, neighbours(mesh)
        self.scene = self.under(light)

    def under(self, light: Float[ndarray, "rows columns 3"]) -> Any:
        """Return a scene with the same mesh and materials under another environment."""
        import mitsuba as mi

        return mi.load_dict({"type": "scene", "asset": self.shape, "light": emitter(light)})


def sensor(camera: Camera) -> Any:
    """Return a Mitsuba camera; its optical axis must meet the middle of the picture."""
    middle = (camera.centre_x - camera.width / 2, camera.centre_y - camera.height / 2)
    if max(map(abs, middle)) > 0.01 or abs(camera.focal_x / camera.focal_y - 1.0) > 1e-3:
        raise SystemExit("only cameras with square pixels and a centred optical axis are compared")
    import mitsuba as mi

    pose = camera.camera_to_world @ np.diag([-1.0, 1.0, -1.0, 1.0])
    film = {"type": "hdrfilm", "width": camera.width, "height": camera.height, "pixel_format": "rgba"}
    return mi.load_dict(
        {
            "type": "perspective",
            "fov": float(np.degrees(2.0 * np.arctan(0.5 * camera.width / camera.focal_x))),
            "fov_axis": "x",
            "near_clip": 0.1,
            "to_world": mi.ScalarTransform4f(pose),
            "film": {**film, "component_format": "float32", "rfilter": {"type": "box"}},
        }
    )


class Inversion:
    """Materials and environment during the optimisation."""

    def __init__(self, asset: Asset, views: tuple[View, ...], light: str, settings: Settings) -> None:
        import drjit as dr
        import mitsuba as mi

        self.asset, self.settings, self.steps = asset, settings, 0
        self.parameters = mi.traverse(asset.scene)
        self.optimiser = mi.ad.Adam(lr=settings.rate)
        for name in ATTRIBUTES:
            self.optimiser[name] = self.parameters[f"asset.vertex_{name}"]
        # Radiance spans decades, so its logarithm is optimised with steps of one size.
        self.optimiser["light"] = dr.log(self.parameters[LIGHT])
        rates = {"roughness": settings.lobe_rate, "metallic": settings.lobe_rate}
        self._rates = {"base_color": settings.rate, "light": settings.light_rate, **rates}
        self._integrator = mi.load_dict(
            {"type": "prb", "max_depth": settings.bounces + 2, "hide_emitters": True}
        )
        self._ends = [mi.UInt32(asset.edges[:, side].astype(np.uint32)) for side in (0, 1)]
        self._views = []
        for view in views:
            picture = np.ascontiguousarray(view.images[light], dtype=np.float32)
            opaque = mi.TensorXf((picture[..., 3:] > 0.99).astype(np.float32))
            self._views.append((sensor(view.camera), mi.TensorXf(picture[..., :3].copy()), opaque))
        self._order, self._queue = np.random.default_rng(0), []

    def run(self, seconds: float) -> None:
        """Take steps for `seconds` of processor time, with rates that fall over them."""
        began = time.process_time()
        while (share := (time.process_time() - began) / seconds) < 1.0:
            factor = self.settings.final_rate**share
            self.optimiser.set_learning_rate({name: factor * rate for name, rate in self._rates.items()})
            self._queue = self._queue or self._order.permutation(len(self._views)).tolist()
            self._step(*self._views[self._queue.pop()])
        self._use()

    def _step(self, camera: Any, wanted: Any, opaque: Any) -> None:
        import drjit as dr
        import mitsuba as mi

        self._use()
        samples = self.settings.samples
        options = {"spp": samples, "spp_grad": samples, "seed": self.steps, "integrator": self._integrator}
        seen = mi.render(self.asset.scene, self.parameters, sensor=camera, **options)
        # Pixels that the mesh covers in part, or not at all, are not used for materials.
        counted = opaque * dr.select(seen[..., 3:] > 0.99, 1.0, 0.0)
        loss = dr.mean(counted * dr.abs(_srgb(seen[..., :3]) - _srgb(wanted)), axis=None)
        for name, (channels, _) in ATTRIBUTES.items():
            kind = mi.Vector3f if channels == 3 else mi.Float
            first, second = (dr.gather(kind, self.optimiser[name], end) for end in self._ends)
            loss += self.settings.smoothness * dr.mean(dr.abs(first - second), axis=None)
        dr.backward(loss)
        self.optimiser.step()
        self.steps += 1

    def _use(self) -> None:
        """Give the scene the current values, within their ranges."""
        import drjit as dr

        for name in ATTRIBUTES:
            low = 0.05 if name == "roughness" else 0.001
            self.optimiser[name] = dr.clip(self.optimiser[name], low, 0.999)
            self.parameters[f"asset.vertex_{name}"] = self.optimiser[name]
        self.parameters[LIGHT] = dr.exp(self.optimiser["light"])
        self.parameters.update()


def _srgb(linear: Any) -> Any:
    import drjit as dr

    value = dr.clip(linear, 0.0, 1.0)
    # The square root has an infinite slope at zero, as has the curve's power without its linear part.
    power = 1.055 * dr.power(dr.maximum(value, 0.0031308), 1.0 / 2.4) - 0.055
    return dr.select(value <= 0.0031308, 12.92 * value, power)


def surface_maps(asset: Asset, camera: Camera) -> dict[str, Float[ndarray, "height width _"]]:
    """Return albedo with opacity, normal, perceptual roughness and metalness as means over the pixels."""
    import mitsuba as mi

    directions = pixel_rays(camera.resized(GRID * camera.width, GRID * camera.height)).reshape(-1, 3)
    eye = np.broadcast_to(camera.position, directions.shape)
    ray = mi.Ray3f(mi.Point3f(eye.T.astype(np.float32)), mi.Vector3f(directions.T.astype(np.float32)))
    hit = asset.scene.ray_intersect(ray)
    valid = hit.is_valid()
    values = [np.array(hit.sh_frame.n).T]
    for name, (channels, _) in ATTRIBUTES.items():
        ask = asset.shape.eval_attribute_3 if channels == 3 else asset.shape.eval_attribute_1
        values.append(np.array(ask(f"vertex_{name}", hit, valid)).reshape(channels, -1).T)
    mask = np.array(valid)[:, None]

    def pixels(per_ray: ndarray) -> ndarray:
        return per_ray.reshape(camera.height, GRID, camera.width, GRID, -1).mean(axis=(1, 3))

    coverage = pixels(mask.astype(np.float32))[..., 0]
    normal, albedo, width, metallic = (straight(pixels(np.where(mask, v, 0.0)), coverage) for v in values)
    alpha = coverage[..., None]
    up = normal[..., :3] * alpha + (1.0 - alpha) * np.array([0.0, 0.0, 1.0])
    return {
        "albedo": albedo,
        "normal": up / np.maximum(np.linalg.norm(up, axis=-1, keepdims=True), 1e-9),
        "roughness": width[..., :1],
        "metallic": metallic[..., :1],
    }


def picture(scene: Any, camera: Camera, samples: int, seed: int) -> Float[ndarray, "height width 4"]:
    """Return a path-traced picture as the evaluation wants it, sRGB-encoded with straight alpha."""
    import mitsuba as mi

    integrator = mi.load_dict({"type": "path", "max_depth": 8, "hide_emitters": True})
    seen = np.array(mi.render(scene, sensor=sensor(camera), integrator=integrator, spp=samples, seed=seed))
    rgba = straight(seen[..., :3], seen[..., 3])
    return encoded(rgba[..., :3], rgba[..., 3:])


def predict(asset: Asset, scene: Scene, environments: Path, folder: Path, out: Path, samples: int) -> None:
    """Write surface maps, novel views, and pictures relit with the albedo ratio of the reference."""
    import mitsuba as mi

    for number, view in enumerate(scene.test):
        for name, values in surface_maps(asset, view.camera).items():
            save_array(out / view.name / f"{name}.npy", values)
        rgba = picture(asset.scene, view.camera, samples, number)
        save_array(out / view.name / f"rgba_{scene.lights[0]}.npy", rgba)
    ratio = np.array(reference_report(folder, out, len(scene.test))["albedo_ratio"])
    parameters = mi.traverse(asset.scene)
    learned = np.array(parameters["asset.vertex_base_color"])
    scaled = (learned.reshape(-1, 3) * ratio).clip(0.0, 1.0).astype(np.float32)
    parameters["asset.vertex_base_color"] = scaled.ravel()
    parameters.update()
    for light in scene.relight_lights:
        lit = asset.under(np.asarray(load_environment(environments / f"{light}.hdr").radiance))
        for number, view in enumerate(scene.test):
            save_array(out / view.name / f"rgba_{light}.npy", picture(lit, view.camera, samples, number))
    parameters["asset.vertex_base_color"] = learned
    parameters.update()


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the benchmark."""
    parser.add_argument("run_dir", type=Path)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--environments", type=Path, required=True)
    parser.add_argument("--report", type=Path, help="output of lambent evaluate for the same run")
    parser.add_argument(
        "--seconds",
        type=float,
        nargs="+",
        default=[120.0],
        help="processor time, by default about that of stage two of `fast`; several are runs of their own",
    )
    parser.add_argument(
        "--samples", type=int, default=64, help="paths per pixel of the pictures that are scored"
    )
    parser.add_argument("--views", type=int, default=0, help="test views, evenly spaced; 0 for all")


def main(arguments: argparse.Namespace) -> dict[str, dict[str, float]]:
    """Return all figures by column; prints the table."""
    load_renderer()
    manifest = describe_scene(arguments.scene)
    whole = load_scene(arguments.scene, manifest, max_side=1 << 30, lights=(manifest.lights[0],))
    scene = replace(whole, test=evenly_spaced(whole.test, arguments.views))
    mesh = read_mesh(arguments.run_dir / "bundle" / "mesh" / "asset.glb")
    settings = Settings()
    grey = np.full((settings.light_rows, 2 * settings.light_rows, 3), 0.5, np.float32)
    columns: dict[str, dict[str, float]] = {}
    for seconds in arguments.seconds:
        asset = Asset(mesh, grey)
        inversion = Inversion(asset, scene.train, scene.lights[0], settings)
        inversion.run(seconds)
        out = arguments.out / f"pred_{seconds:.0f}s"
        predict(asset, scene, arguments.environments, arguments.scene, out, arguments.samples)
        columns[f"Mitsuba 3, {seconds:.0f} s, {inversion.steps} steps"] = reference_scores(
            arguments.scene, out, len(scene.test)
        )
    if arguments.report:
        columns["ours"] = reference_scores(arguments.scene, arguments.report / "pred", len(scene.test))
    print("| figure | " + " | ".join(columns) + " |\n" + "| --- " * (len(columns) + 1) + "|")
    for title, key in ROWS.items():
        cells = [f"{scores[key]:.3f}" if key in scores else "" for scores in columns.values()]
        print(f"| {title} | " + " | ".join(cells) + " |")
    return columns
