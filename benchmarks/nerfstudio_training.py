"""Train a model of nerfstudio on the CPU; runs in nerfstudio's own environment, without ours.

    PEER_PYTHON benchmarks/nerfstudio_training.py JOB.json

`peer_nerfstudio.py` writes the job. Model, losses, cameras, optimisers and their schedules are nerfstudio's
own; the loop around them does what its `Trainer` does in a step, because `Trainer` imports torchvision, whose
wheel on PyPI needs the CUDA build of torch. Pixels are drawn uniformly from all photographs, with alpha.
LPIPS is left out: it is only a metric, needs torchvision, and would fetch weights. Prints one line of JSON
per mark and writes the pictures of the test views to the job's folder.
"""

import functools
import json
import sys
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import torch
import torchmetrics.image.lpip

torchmetrics.image.lpip.LearnedPerceptualImagePatchSimilarity = lambda **_: torch.nn.Identity()

from nerfstudio.cameras.camera_optimizers import CameraOptimizerConfig  # noqa: E402
from nerfstudio.cameras.cameras import Cameras  # noqa: E402
from nerfstudio.data.scene_box import SceneBox  # noqa: E402
from nerfstudio.engine.callbacks import (  # noqa: E402
    TrainingCallbackAttributes,
    TrainingCallbackLocation,
)
from nerfstudio.engine.optimizers import AdamOptimizerConfig, Optimizers, RAdamOptimizerConfig  # noqa: E402
from nerfstudio.engine.schedulers import ExponentialDecaySchedulerConfig  # noqa: E402
from nerfstudio.models.instant_ngp import InstantNGPModelConfig  # noqa: E402
from nerfstudio.models.nerfacto import NerfactoModelConfig  # noqa: E402
from nerfstudio.models.tensorf import TensoRFModelConfig  # noqa: E402
from nerfstudio.models.vanilla_nerf import NeRFModel, VanillaModelConfig  # noqa: E402

FIXED = CameraOptimizerConfig(mode="off")


def adam(rate: float, final: float, steps: int, eps: float = 1e-8) -> dict[str, Any]:
    """Return an optimiser and its schedule as nerfstudio's method configurations hold them."""
    schedule = ExponentialDecaySchedulerConfig(lr_final=final, max_steps=steps)
    return {"optimizer": AdamOptimizerConfig(lr=rate, eps=eps), "scheduler": schedule}


def method(name: str, near: float, far: float) -> tuple[Any, dict[str, Any]]:
    """Return model and optimisers of a method of nerfstudio 1.1.5 set for an object with a mask.

    Rates are those of `nerfstudio.configs.method_configs`, which cannot be imported without the packages of
    every data set. Known cameras, masks and the scene's near and far need the other changes. Over white alone
    `nerfacto` painted everything black and made it translucent; a random background prevents that.
    """
    if name == "nerfacto":
        model = NerfactoModelConfig(
            implementation="torch",
            eval_num_rays_per_chunk=1 << 13,
            average_init_density=0.01,
            camera_optimizer=FIXED,
            background_color="random",
            proposal_initial_sampler="uniform",
            use_average_appearance_embedding=False,
            distortion_loss_mult=0.0,
            disable_scene_contraction=True,
            near_plane=near,
            far_plane=far,
        )
        grid = adam(1e-2, 1e-4, 200_000, 1e-15)
        return model, {"proposal_networks": grid, "fields": grid}
    if name == "tensorf":
        model = TensoRFModelConfig(
            regularization="tv", camera_optimizer=FIXED, eval_num_rays_per_chunk=1 << 12
        )
        return model, {"fields": adam(1e-3, 1e-4, 30_000), "encodings": adam(2e-2, 2e-3, 30_000)}
    if name == "vanilla-nerf":
        model = VanillaModelConfig(_target=NeRFModel, eval_num_rays_per_chunk=1 << 10)
        return model, {"fields": {"optimizer": RAdamOptimizerConfig(lr=5e-4, eps=1e-8), "scheduler": None}}
    if name == "instant-ngp":
        model = InstantNGPModelConfig(eval_num_rays_per_chunk=1 << 12)
        return model, {"fields": adam(1e-2, 1e-4, 200_000, 1e-15)}
    raise SystemExit(f"nerfstudio_training.py knows no method {name!r}")


class Training:
    """A model of nerfstudio and what a step of it needs."""

    def __init__(self, job: dict[str, Any], arrays: dict[str, np.ndarray]) -> None:
        config, optimisers = method(job["method"], *job["primary"])
        self.config = replace(config, **job["model"])
        self.images = torch.from_numpy(arrays["images"])
        self.cameras = self.cameras_of(arrays["train_poses"], arrays["intrinsics"])
        half = job["half_extent"]
        box = SceneBox(aabb=torch.tensor([[-half] * 3, [half] * 3], dtype=torch.float32))
        self.model = self.config.setup(scene_box=box, num_train_data=len(self.images), metadata={})
        self.rays, self.final_rate, self.steps = job["rays"], job["final_rate"], 0
        if job["rate"]:
            for group in optimisers.values():
                group["optimizer"] = replace(group["optimizer"], lr=job["rate"])
        if self.final_rate:
            # The budget is time, so the schedule is a function of it, not of steps.
            optimisers = {key: {**group, "scheduler": None} for key, group in optimisers.items()}
        groups = self.model.get_param_groups()
        self.optimisers = Optimizers(optimisers, {key: groups[key] for key in optimisers})
        self.first_rates = {
            key: optimiser.param_groups[0]["lr"] for key, optimiser in self.optimisers.optimizers.items()
        }
        pipeline = SimpleNamespace(model=self.model, get_param_groups=self.model.get_param_groups)
        self.callbacks = self.model.get_training_callbacks(
            TrainingCallbackAttributes(
                optimizers=self.optimisers, grad_scaler=None, pipeline=pipeline, trainer=None
            )
        )

    @staticmethod
    def cameras_of(poses: np.ndarray, intrinsics: np.ndarray, scale: int = 1) -> Cameras:
        """Return cameras with `scale` times as many pixels along a side."""
        fx, fy, cx, cy, width, height = (scale * float(value) for value in intrinsics)
        pose = torch.from_numpy(poses[:, :3].astype(np.float32))
        return Cameras(pose, fx, fy, cx, cy, width=int(width), height=int(height))

    def _call_back(self, where: TrainingCallbackLocation) -> None:
        for callback in self.callbacks:
            callback.run_callback_at_location(self.steps, location=where)

    def step(self, share: float) -> None:
        """Take a step when `share` of the time is used."""
        self.model.train()
        if self.final_rate:
            for key, optimiser in self.optimisers.optimizers.items():
                optimiser.param_groups[0]["lr"] = self.first_rates[key] * self.final_rate**share
        self._call_back(TrainingCallbackLocation.BEFORE_TRAIN_ITERATION)
        self.optimisers.zero_grad_all()
        count, height, width, _ = self.images.shape
        draw = torch.rand(self.rays, 3) * torch.tensor([count, height, width])
        image, row, column = draw.long().unbind(-1)
        bundle = self.cameras.generate_rays(image[:, None], torch.stack([row, column], dim=-1) + 0.5)
        batch = {"image": self.images[image, row, column]}
        outputs = self.model(bundle)
        metrics = self.model.get_metrics_dict(outputs, batch)
        losses = self.model.get_loss_dict(outputs, batch, metrics)
        functools.reduce(torch.add, losses.values()).backward()
        self.optimisers.optimizer_step_all()
        if not self.final_rate:
            self.optimisers.scheduler_step_all(self.steps)
        self._call_back(TrainingCallbackLocation.AFTER_TRAIN_ITERATION)
        self.steps += 1

    @torch.no_grad()
    def pictures(self, poses: np.ndarray, intrinsics: np.ndarray, antialias: int) -> np.ndarray:
        """Return pictures over white, the mean of `antialias` rays along each side of a pixel."""
        self.model.eval()
        cameras = self.cameras_of(poses, intrinsics, antialias)
        found = []
        for index in range(len(poses)):
            outputs = self.model.get_outputs_for_camera_ray_bundle(cameras.generate_rays(index))
            rgb = outputs["rgb" if "rgb" in outputs else "rgb_fine"].clamp(0.0, 1.0)
            height, width = (side // antialias for side in rgb.shape[:2])
            if getattr(self.config, "background_color", "white") == "random":
                # Evaluated without a background: what is not covered is left black.
                rgb = rgb + (1.0 - outputs["accumulation"])
            found.append(rgb.reshape(height, antialias, width, antialias, 3).mean(dim=(1, 3)).numpy())
        return np.stack(found)


def main(job: dict[str, Any]) -> None:
    """Train for the job's seconds, with marks evenly spaced in them."""
    torch.manual_seed(job["seed"])
    torch.set_num_threads(job["threads"])
    arrays = dict(np.load(job["data"]))
    began = time.perf_counter(), time.process_time()
    training = Training(job, arrays)
    used = {"wall": time.perf_counter() - began[0], "processor": time.process_time() - began[1]}
    for mark in range(1, job["marks"] + 1):
        while used[job["clock"]] < mark * job["seconds"] / job["marks"]:
            began = time.perf_counter(), time.process_time()
            training.step(min(used[job["clock"]] / job["seconds"], 1.0))
            used["wall"] += time.perf_counter() - began[0]
            used["processor"] += time.process_time() - began[1]
        pictures = training.pictures(arrays["test_poses"], arrays["intrinsics"], job["antialias"])
        np.save(Path(job["folder"]) / f"{mark}.npy", pictures)
        print(json.dumps({"step": training.steps, **used}), flush=True)


if __name__ == "__main__":
    main(json.loads(Path(sys.argv[1]).read_text(encoding="utf-8")))
