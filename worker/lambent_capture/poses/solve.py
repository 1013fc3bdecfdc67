"""Finds the cameras of photographs: points, pairs, cameras, each kept in case the search is interrupted.

work/features/KEY.npz        points of a photograph, by the content of its file and mask
work/solve-KEY/database.db   COLMAP's database with the matches; removed once all is done
work/solve-KEY/attempt-N/    models that the mapper found
work/solve-KEY/sparse/0/     the result: cameras of the original files at full size
work/solve-KEY/solution.json
"""

import shutil
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np
import pycolmap
from lambent_core.files import digest

from lambent_capture.poses import database as db
from lambent_capture.poses.features import SURVEY_SIDE, Features, work_scale
from lambent_capture.poses.looking import Looked, Sight, look
from lambent_capture.poses.mapping import Model, place_cameras
from lambent_capture.poses.model import camera_poses, full_size_model, turn, widest_field_deg, write_model
from lambent_capture.poses.photographs import Photographs
from lambent_capture.poses.solution import MODEL, Solution, mean_error_px
from lambent_capture.poses.survey import Survey, choose_pairs, survey
from lambent_capture.poses.upright import up_direction
from lambent_capture.scenes.world import shortest_turn

FORMAT = 2
"""Raised when cameras are found differently, so that none of an earlier version are taken up."""
ENOUGH = 0.95
"""Share of the photographs from which on no further attempt is made."""
STILL = 0.5
"""`Survey.still_share` from which on the background stands still."""
MIN_CLEAR, MAX_CLEAR, CLEAR_IN_ALL = 256, 768, 40_000
"""Points per photograph, and of all photographs, that the survey compares."""


@dataclass(frozen=True, kw_only=True, slots=True)
class PoseSettings:
    """Settings of the search for cameras."""

    seed: int = 0
    max_side: int = 1600
    """Longer side at which points are looked for, pixels; larger photographs are reduced for that."""
    max_features: int = 8192
    """Points per photograph."""
    pairs_per_photograph: int = 10
    """Photographs most like it that each is matched with at least."""


class PoseProgress(Protocol):
    """Receives how far the search is; may raise `Stopped` to end it."""

    def __call__(self, phase: str, done: int, total: int) -> None:
        """Hear that `done` of `total` are done.

        Phases in order: "features" (photographs looked at), "survey" (pairs compared roughly), "pairs"
        (pairs matched), "cameras" (photographs placed). The last two may come again with further attempts.
        """


def solve_cameras(
    photographs: Photographs,
    work: Path,
    settings: PoseSettings,
    progress: PoseProgress = lambda phase, done, total: None,
) -> Solution:
    """Return the cameras of `photographs`, with the model in `work`.

    `work` is kept by the caller. A search that was ended continues there and gives the same cameras; one that
    was finished is answered at once. Points are found again only in photographs (or masks) that changed.
    Photographs that cannot be read are left out and named in `Solution.faults`. Raises what `progress`
    raises.
    """
    looked = look(
        photographs,
        work / "features",
        settings.max_side,
        settings.max_features,
        lambda done, total: progress("features", done, total),
    )
    folder = work / f"solve-{digest(looked.key, asdict(settings), pycolmap.__version__, FORMAT)[:24]}"
    known = Solution.load(folder)
    if known is not None:
        return known
    folder.mkdir(parents=True, exist_ok=True)
    solution = _solve(photographs.names, looked, folder, settings, progress)
    solution.save(folder)
    for leftover in (*folder.glob("attempt-*"), *folder.glob("*.db*")):
        shutil.rmtree(leftover) if leftover.is_dir() else leftover.unlink()
    return solution


def _solve(
    names: tuple[str, ...], looked: Looked, folder: Path, settings: PoseSettings, progress: PoseProgress
) -> Solution:
    """Return the solution for all `names`; `looked` has those that could be read."""
    sights = looked.sights
    whole = {name: sight.whole for name, sight in sights.items() if sight.whole is not None}
    seen = _survey(sights, {n: sight.features for n, sight in sights.items()}, settings.max_side, progress)
    around = _survey(sights, whole, SURVEY_SIDE, progress) if whole else seen
    database = folder / "database.db"
    models = _place(sights, seen, database, settings, progress) if len(sights) > 1 else []
    common = db.verified_pairs(database) if database.is_file() else {}
    read = tuple(sights)
    partners = {read[a]: (read[b], points) for a, (b, points) in db.partners(common).items()}
    stands = around.still_share >= STILL
    moves = len(partners) >= STILL * len(read)
    solution = Solution(
        names=names,
        features=tuple(len(sights[name].features) if name in sights else 0 for name in names),
        partners=partners,
        camera_to_world={},
        faults=looked.faults,
        up_turns=tuple(sights[name].shot.up_turns if name in sights else 0 for name in names),
        still_share=around.still_share,
        static_background=stands and moves,
        nothing_moved=stands and not moves,
        flat_share=db.flat_share(database) if common else 0.0,
    )
    return _with_model(solution, models, sights, folder, settings.max_side) if models else solution


def _with_model(
    solution: Solution, models: list[Model], sights: dict[str, Sight], folder: Path, max_side: int
) -> Solution:
    """Write the first of `models` at full size, upright if possible, and return the solution with it."""
    names, shots = tuple(sights), [sight.shot for sight in sights.values()]
    full = full_size_model(models[0], names, shots, max_side)
    poses = camera_poses(full)
    up = up_direction(np.array(list(poses.values())), [sights[name].shot.up_turns for name in poses])
    if up is not None:
        turn(full, shortest_turn(up))
    write_model(full, folder / MODEL)
    others = [sorted(names[number] for number in _numbers([model])) for model in models[1:]]
    return replace(
        solution,
        camera_to_world=camera_poses(full),
        other_models=tuple(tuple(other) for other in others),
        num_points=full.num_points3D(),
        reprojection_error_px=mean_error_px(models[0]),
        field_deg=widest_field_deg(full),
        up=None if up is None else (0.0, 0.0, 1.0),
        model=folder / MODEL,
    )


def _survey(
    sights: dict[str, Sight], features: dict[str, Features], max_side: int, progress: PoseProgress
) -> Survey:
    sizes = [(sight.shot.width, sight.shot.height) for sight in sights.values()]
    sides = [max(size) * work_scale(*size, max_side) for size in sizes]
    number = min(MAX_CLEAR, max(MIN_CLEAR, CLEAR_IN_ALL // max(1, len(sizes))))
    return survey(list(features.values()), sides, number, lambda done, total: progress("survey", done, total))


def _place(
    sights: dict[str, Sight], seen: Survey, database: Path, settings: PoseSettings, progress: PoseProgress
) -> list[Model]:
    """Return models, the largest first, after as many attempts as it takes.

    First the pairs that look alike; then, where photographs are missing, all pairs of these; then without
    trust in the focal lengths that EXIF states. The attempt that places most photographs counts.
    """
    shots, count = [sight.shot for sight in sights.values()], len(sights)
    if not database.is_file():
        features = [sight.features for sight in sights.values()]
        db.create_database(database, shots, features, settings.max_side)

    def matched(pairs: list[tuple[int, int]]) -> None:
        db.match_pairs(database, pairs, settings.seed, lambda done, total: progress("pairs", done, total))

    def placed(number: int, source: Path) -> list[Model]:
        return _attempt(database.with_name(f"attempt-{number}"), source, settings.seed, count, progress)

    pairs = choose_pairs(seen.moved, tuple(sights), settings.pairs_per_photograph)
    matched(pairs)
    best = placed(1, database)
    missing = set(range(count)) - _numbers(best)
    further = [
        (a, b) for a in range(count) for b in range(a + 1, count) if missing & {a, b} and (a, b) not in pairs
    ]
    if missing and further:
        matched(further)
        best = _better(best, placed(2, database))
    if len(_numbers(best)) < ENOUGH * count and any(shot.focal_px for shot in shots):
        doubting = database.with_name("doubting.db")
        if not doubting.is_file():
            partial = database.with_name("doubting.db.tmp")
            shutil.copyfile(database, partial)
            db.verify_again(partial, settings.seed)
            partial.replace(doubting)
        best = _better(best, placed(3, doubting))
    return best


def _attempt(folder: Path, database: Path, seed: int, count: int, progress: PoseProgress) -> list[Model]:
    """Return the models of one run of the mapper, from `folder` where it was finished before."""
    if not folder.is_dir():
        scratch = folder.with_name("mapping")
        models = place_cameras(
            database, scratch, seed, count, lambda done, total: progress("cameras", done, total)
        )
        partial = folder.with_name(folder.name + ".tmp")
        shutil.rmtree(partial, ignore_errors=True)
        partial.mkdir()
        for number, model in enumerate(models):
            write_model(model, partial / f"{number:03d}")
        partial.rename(folder)
    return [pycolmap.Reconstruction(path) for path in sorted(folder.iterdir())]


def _better(one: list[Model], other: list[Model]) -> list[Model]:
    return other if len(_numbers(other)) > len(_numbers(one)) else one


def _numbers(models: list[Model]) -> set[int]:
    """Return the numbers of the photographs in the largest model."""
    return {int(name) for name in camera_poses(models[0])} if models else set()
