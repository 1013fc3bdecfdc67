"""The contents of a suite: captures with their lights, and environments for relighting."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from lambent_capture.layouts.detect import describe_scene, detect_layout
from lambent_capture.layouts.openillumination import PAPER_LIGHTS
from lambent_core.errors import UsageError
from lambent_core.layouts import PHOTOGRAPHS
from lambent_proto.v1 import scene_pb2

from lambent_run.report.published import dataset_of, object_group

Setting = Literal["single", "multi"]
ENVIRONMENT_FOLDERS = ("envmaps/high_res", "envmaps", "environments")
_TURNED = re.compile(r"^(.*)_\d{1,3}$")


@dataclass(frozen=True, kw_only=True, slots=True)
class SuiteScene:
    """One capture of a suite."""

    name: str
    folder: Path
    layout: str
    lights: tuple[str, ...]
    group: str
    """"diffuse" or "specular" in OpenIllumination, else ""."""

    @property
    def settings(self) -> tuple[Setting, ...]:
        """Return the numbers of lights required by the protocol."""
        return ("single", "multi") if dataset_of(self.layout) == "openillumination" else ("single",)

    def lights_of(self, setting: Setting) -> tuple[str, ...]:
        """Return the lights to train in: the first, or those of the data set's multi-light training.

        Lights that are rotations of one environment, such as `sunset_000` and `sunset_120`, belong together.
        Raises `UsageError` where there is only one light.
        """
        if setting == "single":
            return self.lights[:1]
        if dataset_of(self.layout) == "openillumination":
            lights = tuple(light for light in PAPER_LIGHTS if light in self.lights)
        else:
            lights = self.turned or self.lights
        if len(lights) < 2:
            raise UsageError(
                "benchmark.one_light",
                f'scene "{self.name}" was photographed in one light ({", ".join(self.lights)}); leave it '
                "out, or ask for --lights single",
            )
        return lights

    @property
    def turned(self) -> tuple[str, ...]:
        """Return the lights that are rotations of one environment about +z; empty if there are none."""
        stems = {light: match[1] for light in self.lights if (match := _TURNED.match(light))}
        first = next(iter(stems.values()), "")
        lights = tuple(light for light, stem in stems.items() if stem == first)
        return lights if len(lights) > 1 else ()


def find_scenes(suite: Path, names: tuple[str, ...]) -> list[SuiteScene]:
    """Return the captures in the folders of `suite` (or `suite` itself), all or those of `names`.

    Raises `UsageError` where there is none, or a name is not among them, and `SceneRefusedError` for a
    capture that cannot be used.
    """
    if not suite.is_dir():
        raise UsageError("benchmark.suite_missing", f'"{suite}" is not a folder; give a folder of scenes')
    if _has_cameras(suite):
        folders = [suite]
    else:
        folders = [path for path in sorted(suite.iterdir()) if path.is_dir() and _has_cameras(path)]
    known = {path.name: path for path in folders}
    missing = [name for name in names if name not in known]
    if missing or not known:
        raise UsageError(
            "benchmark.scenes_missing",
            f'"{suite}" has no scene {", ".join(missing) or "in a known layout"}; '
            f"it has {', '.join(known) or 'none'}",
        )
    return [_scene(known[name]) for name in names or known]


def _scene(folder: Path) -> SuiteScene:
    manifest: scene_pb2.SceneManifest = describe_scene(folder)
    return SuiteScene(
        name=folder.name,
        folder=folder,
        layout=manifest.layout,
        lights=tuple(manifest.lights),
        group=object_group(manifest.layout, folder.name),
    )


def find_environments(suite: Path, given: Path | None) -> Path | None:
    """Return the folder of environment maps: the one given, one at its usual place in the suite, or None.

    Its path is absolute, for processes that start in other folders.
    """
    usual = (suite / name for name in ENVIRONMENT_FOLDERS if (suite / name).is_dir())
    folder = next(usual, None) if given is None else given
    return None if folder is None else folder.resolve()


def _has_cameras(folder: Path) -> bool:
    """Return whether a folder is a capture with cameras, so that it can be compared with its truth."""
    return detect_layout(folder, look_deeper=False) not in (None, PHOTOGRAPHS)
