"""The cells of a benchmark: one per scene, lights, seed and ablation, named by a hash of its inputs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path

from flashcache.ablations import ABLATIONS, ablation_settings
from flashcache.config import Config, with_overrides
from flashcache.presets_paper import SCENES
from lambent_core.errors import UsageError
from lambent_core.files import digest, file_sha256
from pydantic import TypeAdapter
from pydantic_core import to_jsonable_python

from lambent_run.benchmark.suite import Setting, SuiteScene
from lambent_run.report import protocol
from lambent_run.report.published import published_rows, published_scene
from lambent_run.report.request import EvaluationRequest
from lambent_run.run.hashes import input_hashes, last_training_task, task_inputs
from lambent_run.run.settings import config_for
from lambent_run.run.spec import RunSpec

FULL = "full"
GROUPS = {
    "paper": tuple(row.method for row in published_rows("ablations")),
    "all": tuple(ABLATIONS),
}
"""Names that stand for several ablations."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Variant:
    """An ablation of the catalogue, or named settings of the user."""

    name: str
    label: str
    settings: Mapping[str, str] = field(default_factory=dict)
    """Settings changed in addition to the catalogue's entry."""

    def overrides(self, config: Config) -> dict[str, str]:
        """Return the differences from `config`, for `with_overrides`."""
        known = ablation_settings(config, self.name) if self.name in ABLATIONS else {}
        return {**known, **self.settings}


@dataclass(frozen=True, kw_only=True, slots=True)
class Cell:
    """One run: everything a process needs to know, as JSON-compatible values."""

    scene: str
    scene_dir: str
    layout: str
    group: str
    setting: Setting
    lights: tuple[str, ...]
    seed: int
    ablation: str
    label: str
    preset: str
    base_overrides: Mapping[str, str]
    """Settings of stage one, and of stage two where the ablation does not change them."""
    overrides: Mapping[str, str]
    """All settings, those of the ablation included."""
    evaluation: EvaluationRequest
    stage_one: str
    """Hash of everything that stage one depends on."""
    inputs: str
    """Hash of everything that the result depends on."""
    keep_predictions: bool = True
    """Whether to keep the float maps with the report; those of a large suite can fill a disk."""

    @property
    def name(self) -> str:
        """Return the name of the cell's folder."""
        return f"{self.scene}-{self.setting}-s{self.seed}-{self.ablation}-{self.inputs[:10]}"

    @property
    def stage_one_name(self) -> str:
        """Return the name of the folder of the stage one that it starts from."""
        return f"{self.scene}-{self.setting}-s{self.seed}-{self.stage_one[:10]}"


CELL_FILE = TypeAdapter(Cell)
"""Writes and reads a cell as JSON."""


def parse_variants(items: Sequence[str]) -> tuple[Variant, ...]:
    """Return the requested ablations without duplicates, the full method first.

    An item is a name of `flashcache.ablations`, "paper", "all", several with commas, or
    `NAME:KEY=VALUE;KEY=VALUE` for custom settings. Raises `UsageError` for anything else.
    """
    variants = {FULL: Variant(name=FULL, label=ABLATIONS[FULL].label)}
    for item in items:
        if ":" in item:
            own = _own_variant(item)
            variants[own.name] = own
            continue
        for name in item.split(","):
            members = GROUPS.get(name, (name,))
            unknown = [member for member in members if member not in ABLATIONS]
            if unknown:
                raise UsageError(
                    "benchmark.ablation_unknown",
                    f'--ablations "{name}" is none of {", ".join((*GROUPS, *ABLATIONS))}, and no '
                    "NAME:KEY=VALUE;KEY=VALUE either",
                )
            variants |= {member: Variant(name=member, label=ABLATIONS[member].label) for member in members}
    return tuple(variants.values())


def _own_variant(item: str) -> Variant:
    name, _, rest = item.partition(":")
    settings = dict(part.partition("=")[::2] for part in rest.split(";") if part)
    plain = name.replace("_", "").replace("-", "").isalnum()
    if not plain or name in ABLATIONS or not settings or not all(settings.values()):
        raise UsageError(
            "benchmark.ablation_syntax",
            f'--ablations "{item}" must look like NAME:stage_two.num_rays=512;stage_two.points=depth, with '
            "a name that is not taken",
        )
    return Variant(name=name, label=f"{name} ({rest})", settings=settings)


def plan(
    scenes: Sequence[SuiteScene],
    variants: Sequence[Variant],
    seeds: Sequence[int],
    settings: Sequence[Setting] | None,
    *,
    preset: str,
    overrides: Mapping[str, str],
    evaluation: EvaluationRequest,
    keep_predictions: bool = True,
) -> list[Cell]:
    """Return all cells; `settings` None means those of the protocol.

    Raises `UsageError` and `ConfigError` for settings that do not exist.
    """
    maps = folder_hash(evaluation.environments) if evaluation.environments else ""
    looked_at = to_jsonable_python(evaluation, exclude={"environments", "exr"})
    cells = []
    for scene in scenes:
        own_preset = _preset_for(preset, scene)
        for setting in settings or scene.settings:
            lights = scene.lights_of(setting)
            base = dict(overrides)
            if setting == "multi" and lights == scene.turned:
                base = {"model.environment.lights": "rotated", **base}
            config = config_for(own_preset, base)
            spec = RunSpec(scene=scene.folder, config=config, lights=lights, layout=scene.layout)
            ingest = input_hashes(spec)["ingest"]
            for variant in variants:
                changed = variant.overrides(config)
                ablated = with_overrides(config, changed)
                for seed in seeds:
                    stage_one = task_inputs("cache", ingest, ablated, seed)
                    trained = task_inputs("joint", stage_one, ablated, seed)
                    if last_training_task(ablated) == "polish":
                        trained = task_inputs("polish", trained, ablated, seed)
                    # Stage one of an ablation is the full method's unless it changes that, too.
                    shared = task_inputs("cache", ingest, config, seed) == stage_one
                    cells.append(
                        Cell(
                            scene=scene.name,
                            scene_dir=str(scene.folder.resolve()),
                            layout=scene.layout,
                            group=scene.group,
                            setting=setting,
                            lights=lights,
                            seed=seed,
                            ablation=variant.name,
                            label=variant.label,
                            preset=own_preset,
                            base_overrides=base if shared else {**base, **changed},
                            overrides={**base, **changed},
                            evaluation=evaluation,
                            stage_one=stage_one,
                            inputs=digest(trained, looked_at, maps, protocol.VERSION, version("lambent")),
                            keep_predictions=keep_predictions,
                        )
                    )
    return cells


def _preset_for(preset: str, scene: SuiteScene) -> str:
    """Return the preset, with the paper's settings of the scene where it has some."""
    known = SCENES.get(preset, {})
    name = next((row.scene for row in published_scene(scene.layout, scene.name)), "")
    return f"{preset}:{name}" if name in known else preset


def folder_hash(folder: Path) -> str:
    """Return a hash of the names and contents of the files directly in a folder."""
    files = sorted(path for path in folder.iterdir() if path.is_file())
    return digest([[path.name, file_sha256(path)] for path in files])
