"""Test on a trained run whether the control variate is unbiased, pixel by pixel, and draw the scores.

    OMP_NUM_THREADS=1 python -m benchmarks unbiasedness RUN_DIR [--pixels 256] [-o FOLDER]

Random opaque training pixels are estimated many times the way training does it, once with the control
variate and once from the fast cache only. Each mean is compared with a reference that asks the NeRF cache
alone, along directions that no learned part chooses. The difference over its standard error is a pixel's
z-score. Without bias the scores are standard normal: `chi-square` and `Kolm.-Smirn.` are the probabilities of
scores at least as odd. Writes OUT/unbiasedness.png.
"""

import argparse
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import torch
from flashcache.caches.nerf_cache import Geometry
from flashcache.config import StageTwoConfig
from flashcache.data.ray_batches import RayBatch, TrainingPixels
from flashcache.physical.estimator import DirectionCounts
from flashcache.physical.model import InverseModel
from flashcache.presets import tiny
from flashcache.randomness import generator_for
from flashcache.training.passes import shade
from jaxtyping import Float
from lambent_core.scene import Scene
from lambent_run.console_reporter import ConsoleReporter
from lambent_run.run.prepare import open_task
from lambent_run.run.tasks.training import load_final, read_scene
from numpy import ndarray
from scipy import stats

QUICK = "{run} --pixels 64 --estimates 256 --reference-samples 2048"

POINTS_AT_ONCE = 4
"""Points per ray in one call; their mean is one estimate."""
REFERENCE_DIRECTIONS = 32


@dataclass(frozen=True, slots=True)
class Means:
    """Mean radiance of every pixel over the channels, with its variance."""

    mean: Float[ndarray, " pixels"]
    variance: Float[ndarray, " pixels"]
    """Of the mean."""
    seconds: float
    """Processor time."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Verdict:
    """The distribution of the scores of one estimator."""

    z: list[float]
    chi_square: float
    """Probability of a sum of squared scores at least as far from that of the normal distribution."""
    kolmogorov_smirnov: float
    """Probability of a distribution of scores at least as far from the normal one."""
    bias: float
    """Mean difference over mean radiance."""
    bias_error: float
    """Standard error of `bias`."""
    precision: float
    """Median standard error of a pixel's difference, relative to its radiance."""
    seconds: float


@torch.no_grad()
def means(
    model: InverseModel, config: StageTwoConfig, batch: RayBatch, geometry: Geometry, calls: int, purpose: str
) -> Means:
    """Return the mean over independent estimates of the pixels of `batch`."""
    total, squares = np.zeros(len(batch)), np.zeros(len(batch))
    began = time.process_time()
    for call in range(calls):
        generator = generator_for(0, "benchmark", call, purpose, batch.rays.origins.device)
        (picture,) = shade(model, config, batch, geometry, generator, supervise=False).pictures
        value = picture.mean(dim=-1).double().cpu().numpy()
        total += value
        squares += value**2
    mean = total / calls
    variance = (squares / calls - mean**2).clip(0.0) / (calls - 1)
    return Means(mean, variance, time.process_time() - began)


def verdict(estimate: Means, reference: Means) -> Verdict:
    """Return the verdict on the differences between two independent sets of means."""
    difference = estimate.mean - reference.mean
    variance = estimate.variance + reference.variance
    z = difference / np.sqrt(variance)
    above = stats.chi2.sf(np.sum(z**2), len(z))
    level = float(reference.mean.mean())
    return Verdict(
        z=z.tolist(),
        chi_square=float(2.0 * min(above, 1.0 - above)),
        kolmogorov_smirnov=float(stats.kstest(z, "norm").pvalue),
        bias=float(difference.mean()) / level,
        bias_error=float(np.sqrt(variance.sum())) / len(z) / level,
        precision=float(np.median(np.sqrt(variance) / np.maximum(reference.mean, 1e-6))),
        seconds=estimate.seconds,
    )


def trained(run_dir: Path) -> tuple[InverseModel, Scene, StageTwoConfig]:
    """Return a run's model, its scene, and the settings it was trained with."""
    context = open_task(run_dir, "joint", ConsoleReporter(), "cpu")
    scene = read_scene(context)
    return load_final(context, scene), scene, context.spec.config.stage_two


@torch.no_grad()
def compare(
    model: InverseModel, scene: Scene, own: StageTwoConfig, *, pixels: int, estimates: int, samples: int
) -> dict[str, Verdict]:
    """Return the verdicts on the run's own estimator, and on the same without the correction.

    `estimates` counts shaded points per pixel and estimator, `samples` directions per pixel of the reference.
    """
    photographs = TrainingPixels(scene, replace(tiny().pixels, inside_share=1.0), torch.device("cpu"))
    generator = generator_for(0, "benchmark", 0, "pixels", photographs.device)
    opaque = (photographs.pixels[:, 3] > 0.99).nonzero()[:, 0]
    batch = photographs.at(opaque[torch.randperm(len(opaque), generator=generator)[:pixels]])
    geometry = model.nerf.trace(batch.rays, exponent=own.proposal_exponent, generator=None)
    base = replace(own, points="categorical", points_per_ray=POINTS_AT_ONCE)

    def variant(**changes: object) -> StageTwoConfig:
        return replace(base, estimator=replace(base.estimator, **changes))

    exact = DirectionCounts.split(REFERENCE_DIRECTIONS)
    plain = variant(control_variate="off", sampler="none", exact=exact, stratified=False)
    calls = max(2, -(-samples // (POINTS_AT_ONCE * REFERENCE_DIRECTIONS)))
    reference = means(model, plain, batch, geometry, calls, "reference")
    directions = calls * POINTS_AT_ONCE * REFERENCE_DIRECTIONS
    print(f"reference: {directions} directions per pixel, {reference.seconds:.0f} s")
    calls = max(2, estimates // POINTS_AT_ONCE)
    return {
        name: verdict(means(model, variant(control_variate=kind), batch, geometry, calls, name), reference)
        for name, kind in (("control variate", "on"), ("fast cache only", "fast_only"))
    }


def plot(verdicts: dict[str, Verdict], path: Path) -> None:
    """Write the scores as histograms and as quantiles against those of the normal distribution."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    edges = np.linspace(-8.0, 8.0, 33)
    middle = np.linspace(-8.0, 8.0, 400)
    for (name, verdict), colour in zip(verdicts.items(), ("tab:blue", "tab:orange"), strict=True):
        z = np.sort(verdict.z)
        left.hist(z.clip(-8.0, 8.0), edges, density=True, alpha=0.55, color=colour, label=name)
        right.plot(stats.norm.ppf((np.arange(len(z)) + 0.5) / len(z)), z, ".", color=colour, label=name)
    left.plot(middle, stats.norm.pdf(middle), color="black", label="standard normal")
    right.plot([-3, 3], [-3, 3], color="black", linewidth=1)
    left.set(xlabel="z-score of a pixel (beyond 8 counted at 8)", ylabel="density")
    right.set(xlabel="quantile of the standard normal", ylabel="z-score of a pixel (logarithmic beyond 4)")
    right.set_yscale("symlog", linthresh=4.0)
    left.legend()
    right.legend()
    figure.savefig(path, dpi=110)
    plt.close(figure)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the benchmark."""
    parser.add_argument("run_dir", type=Path)
    parser.add_argument("--pixels", type=int, default=256)
    parser.add_argument("--estimates", type=int, default=2048, help="shaded points per pixel and estimator")
    parser.add_argument("--reference-samples", type=int, default=100_000, help="directions per pixel")


def main(arguments: argparse.Namespace) -> dict[str, dict]:
    """Return the verdicts; prints and plots them."""
    model, scene, own = trained(arguments.run_dir)
    verdicts = compare(
        model,
        scene,
        own,
        pixels=arguments.pixels,
        estimates=arguments.estimates,
        samples=arguments.reference_samples,
    )
    heads = ("chi-square", "Kolm.-Smirn.", "bias", "per pixel", "time [s]")
    print(f"{'estimator':18}{heads[0]:>12}{heads[1]:>14}{heads[2]:>20}{heads[3]:>11}{heads[4]:>10}")
    for name, verdict in verdicts.items():
        bias = f"{100 * verdict.bias:+.2f} % +- {100 * verdict.bias_error:.2f}"
        print(
            f"{name:18}{verdict.chi_square:12.2g}{verdict.kolmogorov_smirnov:14.2g}{bias:>20}"
            f"{100 * verdict.precision:9.2f} %{verdict.seconds:10.0f}"
        )
    plot(verdicts, arguments.out / "unbiasedness.png")
    return {name: asdict(verdict) for name, verdict in verdicts.items()}
