"""Places cameras and points from verified pairs: COLMAP's incremental mapper, then a robust refinement.

A photograph whose own matches contradict its camera is taken out and placed again among all points, and left
out if that ends the same way.

Random numbers are seeded and the mapper has one thread: the same database and seed give the same cameras but
for the order of sums.
"""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pycolmap

from lambent_capture.poses.agreement import contradicted
from lambent_capture.poses.database import quiet
from lambent_capture.poses.sanity import MIN_ANGLE_DEG, drop_unusable, outlier_limit_px

MIN_MODEL = 3
"""Photographs that a model must have to count."""
ROBUST_PX = 0.5
"""Work pixels from which on an error counts less than its square."""

Model = Any
"""A `pycolmap.Reconstruction`."""


def place_cameras(
    database: Path,
    scratch: Path,
    seed: int,
    total: int,
    told: Callable[[int, int], None] = lambda done, total: None,
) -> list[Model]:
    """Return all models that COLMAP finds, that of the most photographs first; the largest one is refined.

    `scratch` is a folder that is emptied. `told` is called with the number of photographs of the present
    model, of `total`, and may raise to stop.
    """
    watch = _Watch(total, told)
    large = _run(database, scratch, seed, watch)
    if large:
        _place_again(large, database, scratch, seed, watch)
        refine(large[0])
        if large[0].num_reg_images() < MIN_MODEL:
            return large[1:]
    return large


def refine(model: Model) -> None:
    """Leave out what fits badly and adjust all cameras and points together, with a robust loss.

    What cannot be afterwards is taken out as well, cameras among it (`sanity.drop_unusable`).
    """
    for _ in range(2):
        pycolmap.ObservationManager(model).filter_all_points3D(outlier_limit_px(model), MIN_ANGLE_DEG)
        options = pycolmap.BundleAdjustmentOptions()
        options.print_summary = False
        options.ceres.loss_function_type = pycolmap.LossFunctionType.SOFT_L1
        options.ceres.loss_function_scale = ROBUST_PX
        options.ceres.solver_options.num_threads = 1
        everything = pycolmap.BundleAdjustmentConfig()
        for image in model.reg_image_ids():
            everything.add_image(image)
        everything.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
        # Not pycolmap.bundle_adjustment, which turns COLMAP's log on again.
        with quiet():
            pycolmap.create_default_bundle_adjuster(options, everything, model).solve()
    # The last adjustment may have pushed points behind cameras.
    drop_unusable(model)


def _run(database: Path, scratch: Path, seed: int, watch: "_Watch", start: Path | None = None) -> list[Model]:
    """Return the models of one run of the mapper, the largest first; it begins with the model in `start`."""
    shutil.rmtree(scratch, ignore_errors=True)
    scratch.mkdir(parents=True)
    try:
        with quiet():
            models = pycolmap.incremental_mapping(
                database,
                scratch,
                scratch,
                _options(seed),
                input_path="" if start is None else start,
                initial_image_pair_callback=watch.begun,
                next_image_callback=watch.placed,
                cancellation_token=watch.token,
            )
    except InterruptedError:  # how COLMAP says that it was told to end
        watch.check()
        raise
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    watch.check()
    large = [model for _, model in sorted(models.items()) if model.num_reg_images() >= MIN_MODEL]
    return sorted(large, key=lambda model: (-model.num_reg_images(), -model.num_points3D()))


def _place_again(models: list[Model], database: Path, scratch: Path, seed: int, watch: "_Watch") -> None:
    """Place the contradicted photographs of the first model among all its points, or leave them out."""
    wrong = contradicted(models[0], database)
    if not wrong or models[0].num_reg_images() - len(wrong) < MIN_MODEL:
        return
    _take_out(models[0], wrong)
    start = scratch.with_name(scratch.name + "-start")
    shutil.rmtree(start, ignore_errors=True)
    start.mkdir(parents=True)
    models[0].write_binary(start)
    watch.go_on(models[0].num_reg_images())
    again = _run(database, scratch, seed, watch, start)
    shutil.rmtree(start)
    if again and again[0].num_reg_images() >= models[0].num_reg_images():
        models[0] = again[0]
        _take_out(models[0], contradicted(models[0], database))


def _take_out(model: Model, images: list[int]) -> None:
    for image in images:
        model.deregister_frame(model.image(image).frame_id)


class _Watch:
    """Counts the photographs that the mapper places, and stops it where `told` raises.

    An exception must not pass through COLMAP: it is kept, the mapper is told to end, and `check` raises it.
    """

    def __init__(self, total: int, told: Callable[[int, int], None]) -> None:
        self.token = pycolmap.CancellationToken()
        self._told, self._total, self._count = told, total, 0
        self._error: BaseException | None = None

    def begun(self) -> None:
        """Note that a model has its first two photographs."""
        self._count = 1
        self.placed()

    def go_on(self, count: int) -> None:
        """Note that a model of so many photographs is taken up again."""
        self._count = count

    def placed(self) -> None:
        """Note that a model has one more photograph."""
        self._count = min(self._count + 1, self._total)
        try:
            self._told(self._count, self._total)
        except BaseException as error:
            self._error = error
            self.token.cancel()

    def check(self) -> None:
        """Raise what `told` raised, if anything."""
        if self._error is not None:
            raise self._error


def _options(seed: int) -> Any:
    options = pycolmap.IncrementalPipelineOptions()
    options.random_seed = seed
    options.mapper.random_seed = seed
    options.triangulation.random_seed = seed
    options.num_threads = 1
    options.mapper.num_threads = 1
    options.min_model_size = MIN_MODEL
    options.extract_colors = False
    return options
