"""The specification of a run, from the command line, a server's order, or `run.json`."""

import json
import shutil
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict, Unpack

from flashcache.errors import ConfigError
from lambent_capture.layouts.detect import detect_layout
from lambent_capture.loading.light_turns import LightFixedTo, as_light_fixed_to
from lambent_capture.masks.corrections import (
    NAME,
    Correction,
    read_corrections,
    record_of,
)
from lambent_core.errors import UsageError
from lambent_core.files import digest, write_json
from lambent_core.layouts import PHOTOGRAPHS
from lambent_proto.v1 import worker_pb2

from lambent_run.run.card_option import GreyCard, look_for_photograph, parse_grey_card, refused
from lambent_run.run.folder import begun_inputs, done_inputs
from lambent_run.run.known_lights import kept_lights, parse_known_lights
from lambent_run.run.masks import AUTOMATIC, KEPT_FOLDER, WHOLE_VIEW, kept_masks, masks_setting
from lambent_run.run.parameters import JobParameters
from lambent_run.run.settings import adjust, config_for, config_of, config_record

if TYPE_CHECKING:
    from flashcache.config import Config

SCHEMA_VERSION = "1.0"
# What may change between two starts of a run.
_MAY_CHANGE = frozenset({"device", "scene"})
# And what may at any time, for a later task does its work again then.
_MAY_ALWAYS_CHANGE = frozenset({"grey_card"})
# And what may until the training begins: nothing before it reads the settings of the method.
_MAY_CHANGE_BEFORE_TRAINING = frozenset({"preset", "config", "corrections"})


class RunOptions(TypedDict, total=False):
    """Options of the command line that a run depends on."""

    overrides: Mapping[str, str]
    """Settings of the method that differ from the preset."""
    lights: tuple[str, ...]
    layout: str
    known_lights: Sequence[str]
    """`[LIGHT=]FILE`."""
    masks: Path | None
    """A folder of masks."""
    whole_view: bool
    """Whether everything in view is the object where there are no masks."""
    light_fixed_to: str
    """One of `LightFixedTo`."""
    corrections: Path | None
    """A file of what a person says about estimated masks."""
    grey_card: str
    """As `parse_grey_card` reads it."""
    seed: int


@dataclass(frozen=True, kw_only=True, slots=True)
class RunSpec:
    """Settings of a run. Equal ones train the same; fields that do not matter for that are not compared."""

    scene: Path = field(compare=False)
    """Folder of the capture, which may be moved between two starts."""
    config: "Config | None"
    """Settings of the method; None until training is asked for, since nothing before it reads them."""
    preset: str = field(default="", compare=False)
    """Name that the preset was asked for by; `config` has what came of it."""
    seed: int = 0
    lights: tuple[str, ...] = ()
    """Training lights by name; empty for the scene's first."""
    layout: str = ""
    """Layout to read the scene as; empty to detect it."""
    known_lights: Mapping[str, str] = field(default_factory=dict)
    """Names of the kept files of given environments by light; see `known_lights`."""
    masks: str = AUTOMATIC
    """Where masks come from: the capture or an estimate (""), nowhere ("none"), or given ones by content."""
    light_fixed_to: LightFixedTo = "auto"
    """What the light stands still with."""
    corrections: tuple[Correction, ...] = ()
    """What a person says about the masks that are estimated, the latest last."""
    grey_card: GreyCard | None = None
    """Where a photograph shows a grey card, which tells albedo and light apart."""
    given: Mapping[str, Path] = field(default_factory=dict, compare=False)
    """Files that the run keeps a copy of, by their path in the run folder."""

    def __post_init__(self) -> None:
        if self.corrections and self.masks != AUTOMATIC:
            raise unused_corrections("masks were given, or none are wanted")
        if self.grey_card is not None and self.config is not None and self.config.polish == "off":
            raise refused(
                "polish_off",
                "albedo and light are brought to the card when materials are fitted once more after stage "
                "two; add --set polish=on",
            )
        if self.grey_card is not None and self.known_lights:
            raise refused(
                "known_light",
                "under a known light albedo is absolute already, and the card could only contradict it; "
                "leave out the card or --known-light",
            )

    @property
    def lacks_cameras(self) -> bool:
        """Return whether the scene holds photographs whose cameras have to be found."""
        return (self.layout or detect_layout(self.scene)) == PHOTOGRAPHS

    @classmethod
    def from_options(cls, scene: Path, *, preset: str, **options: Unpack[RunOptions]) -> "RunSpec":
        """Return the specification for options of the command line.

        Raises `UsageError` for an unknown preset and files that cannot be used, `ConfigError` for a wrong
        setting.
        """
        corrections, card = options.get("corrections"), options.get("grey_card")
        return cls(
            scene=scene,
            config=config_for(preset, options.get("overrides", {})),
            preset=preset,
            seed=options.get("seed", 0),
            lights=options.get("lights", ()),
            layout=options.get("layout", ""),
            light_fixed_to=as_light_fixed_to(options.get("light_fixed_to", "auto")),
            corrections=() if corrections is None else tuple(read_corrections(corrections)),
            grey_card=_found_card(scene, parse_grey_card(card) if card else None),
            **_given(
                options.get("known_lights", ()),
                options.get("masks"),
                whole_view=options.get("whole_view", False),
            ),
        )

    @classmethod
    def from_job(cls, start: worker_pb2.StartResponse, parameters: JobParameters, scene: Path) -> "RunSpec":
        """Return the specification for an order, with the changes that its failures so far have caused.

        Raises `ConfigError` for an unknown preset or setting and for files outside the capture, `UsageError`
        for what cannot be used.
        """
        from flashcache.config import with_overrides
        from flashcache.presets import preset as preset_of

        items = []
        for item in parameters.known_lights:
            light, equals, name = item.rpartition("=")
            path = _inside(scene, "known_lights", name, "name a file of the capture")
            items.append(f"{light}{equals}{path}")
        masks, folder = parameters.masks, None
        if masks not in (AUTOMATIC, WHOLE_VIEW):
            folder = _inside(scene, "masks", masks, f'name a folder of the capture, or "{WHOLE_VIEW}"')
        return cls(
            scene=scene,
            config=adjust(with_overrides(preset_of(start.preset), parameters.settings), start.adjustments),
            preset=start.preset,
            seed=start.seed,
            lights=parameters.lights,
            layout=parameters.layout,
            light_fixed_to=parameters.light_fixed_to,
            corrections=parameters.corrections,
            grey_card=_found_card(scene, parameters.grey_card),
            **_given(items, folder, whole_view=masks == WHOLE_VIEW),
        )


def keep_run(run_dir: Path, spec: RunSpec, device: str) -> None:
    """Make `run_dir` the folder of this run: `run.json` and the given files; one that it is already stays.

    Raises `UsageError` where it is the folder of a run with other settings. Masks may be others as long as
    the ones before were refused; preset, settings and corrections until the training begins; the grey card at
    any time.
    """
    wanted = _recorded(spec, device)
    if (run_dir / "run.json").exists():
        kept = run_record(run_dir)
        if config_record(config_of(kept["config"])) != kept["config"]:
            raise UsageError(
                "run.version",
                f'"{run_dir}" has settings of another release, so it cannot be trained further; train again '
                "in another folder, or use this one with lambent evaluate and lambent export",
            )
        differing = {name for name, value in wanted.items() if kept[name] != value} - _MAY_CHANGE
        if not differing:
            return
        fixed = differing - _changeable(run_dir)
        if fixed:
            named = ", ".join(name for name in wanted if name in fixed)
            held = "was trained with other corrections of its masks"
            raise UsageError(
                "run.other_settings",
                f'"{run_dir}" {held if fixed == {"corrections"} else f"holds a run with another {named}"}; '
                "choose another folder with -o, or give --resume to continue with the settings it has",
            )
        if "masks" in differing:
            shutil.rmtree(run_dir / KEPT_FOLDER, ignore_errors=True)
    for place, source in spec.given.items():
        (run_dir / place).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source, run_dir / place)
    run_dir.mkdir(parents=True, exist_ok=True)
    if spec.corrections:
        write_json(run_dir / NAME, record_of(spec.corrections))
    record = {
        "schema_version": SCHEMA_VERSION,
        **wanted,
        "created_at": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": _versions(),
    }
    write_json(run_dir / "run.json", record)
    if not spec.corrections:
        (run_dir / NAME).unlink(missing_ok=True)


def _recorded(spec: RunSpec, device: str) -> dict[str, Any]:
    """Return what `run.json` says of a run, besides when and with what it was made."""
    return {
        "preset": spec.preset,
        "config": config_record(spec.config),
        "seed": spec.seed,
        "device": device,
        "lights": list(spec.lights),
        "layout": spec.layout,
        "known_lights": dict(spec.known_lights),
        "masks": spec.masks,
        "light_fixed_to": spec.light_fixed_to,
        "corrections": corrections_hash(spec),
        "grey_card": card_text(spec),
        "scene": str(spec.scene.resolve()),
    }


def read_run(run_dir: Path) -> tuple[RunSpec, str]:
    """Return the specification and the device of the run in `run_dir`; `UsageError` where there is none."""
    record = run_record(run_dir)
    spec = RunSpec(
        scene=Path(record["scene"]),
        config=config_of(record["config"]),
        preset=record["preset"],
        seed=record["seed"],
        lights=tuple(record["lights"]),
        layout=record["layout"],
        known_lights=record["known_lights"],
        masks=record["masks"],
        light_fixed_to=as_light_fixed_to(record["light_fixed_to"]),
        corrections=tuple(read_corrections(run_dir / NAME)) if record["corrections"] else (),
        grey_card=parse_grey_card(record["grey_card"]) if record["grey_card"] else None,
    )
    return spec, record["device"]


def _versions() -> dict[str, str]:
    """Return the versions of what computes, of packages that are installed."""
    versions = {}
    for name in ("lambent", "torch", "numpy"):
        with suppress(PackageNotFoundError):
            versions[name] = version(name)
    return versions


def with_kept_corrections(spec: RunSpec, run_dir: Path) -> RunSpec:
    """Return the specification with the corrections that the run in `run_dir` keeps, if there is one."""
    if spec.masks != AUTOMATIC or not (run_dir / "run.json").exists():
        return spec
    return replace(spec, corrections=read_run(run_dir)[0].corrections)


def run_record(run_dir: Path) -> dict[str, Any]:
    """Return the contents of `run.json`; raises `UsageError` where there is no run of this version."""
    try:
        record: dict[str, Any] = json.loads((run_dir / "run.json").read_text(encoding="utf-8"))
        major = record["schema_version"].split(".")[0]
        if missing := _recorded(RunSpec(scene=run_dir, config=None), "").keys() - record.keys():
            raise KeyError(*missing)
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise UsageError(
            "run.not_found", f'"{run_dir}" holds no readable run.json; give a folder made by lambent train'
        ) from error
    if major != SCHEMA_VERSION.split(".")[0]:
        raise UsageError(
            "run.version", f'"{run_dir}" was written by another version; train again with this one'
        )
    return record


def corrections_hash(spec: RunSpec) -> str:
    """Return the hash of a run's corrections; empty where it has none."""
    return digest(record_of(spec.corrections)) if spec.corrections else ""


def card_text(spec: RunSpec) -> str:
    """Return the grey card of a run as it is written down; empty where it has none."""
    return "" if spec.grey_card is None else str(spec.grey_card)


def unused_corrections(why: str) -> UsageError:
    """Return the error for corrections in a run that estimates no masks."""
    return UsageError(
        "config.corrections_unused",
        f"corrections are about masks that are estimated, but {why}; leave the corrections out",
    )


def training_has_begun(run_dir: Path) -> bool:
    """Return whether the run's training has begun."""
    return begun_inputs(run_dir, "cache") is not None


def _changeable(run_dir: Path) -> frozenset[str]:
    """Return what another start of the run may change besides device and place."""
    masks = frozenset() if done_inputs(run_dir, "masks") is not None else frozenset({"masks"})
    always = masks | _MAY_ALWAYS_CHANGE
    return always if training_has_begun(run_dir) else always | _MAY_CHANGE_BEFORE_TRAINING


def _found_card(scene: Path, card: GreyCard | None) -> GreyCard | None:
    if card is not None:
        look_for_photograph(scene, card)
    return card


def _given(known_lights: Sequence[str], masks: Path | None, *, whole_view: bool) -> dict[str, Any]:
    """Return the members of a specification that say which files of the user a run keeps."""
    names, files = kept_lights(parse_known_lights(known_lights))
    setting = masks_setting(masks, whole_view=whole_view)
    return {"known_lights": names, "masks": setting, "given": {**files, **kept_masks(masks)}}


def _inside(scene: Path, parameter: str, name: str, advice: str) -> Path:
    path = (scene / name).resolve()
    if not path.is_relative_to(scene.resolve()):
        raise ConfigError(f'{parameter} "{name}" lies outside the capture; {advice}')
    return path
