"""The segmenter `rembg`: salient object networks through the package rembg, with a model file the user has
fetched.

    lambent masks my_object -o cut --segmenter rembg                    a model in rembg's own folders
    lambent masks my_object -o cut --segmenter rembg=birefnet-general   this one of them
    lambent masks my_object -o cut --segmenter rembg=/models/u2net.onnx this file

rembg fetches a model that it does not find. This never happens here: without a file there is only the advice
how to fetch it. Networks that send pictures to a service, or want points and words, are refused.
"""

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec, module_from_spec
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from lambent_core.errors import UsageError, WorkerError, pip_install
from PIL import Image

from lambent_capture.arrays import Grey, Grey32, Rgb
from lambent_capture.masks.consensus import MaskView

GENERAL = "u2net_custom"
"""The session of rembg that runs any network of U^2-Net's shape: 3 x 320 x 320 in, 1 x 320 x 320 out."""
PREFERRED = (
    *("birefnet-general", "birefnet-general-lite", "bria-rmbg", "isnet-general-use", "dis-general-use"),
    *("u2net", "silueta", "u2netp"),
)
_UNFIT = frozenset({"sam", "u2net_cloth_seg", "u2net_human_seg", "birefnet-portrait"})
_MIN_SHARE, _MAX_SHARE = 1e-4, 0.999
"""Share of a picture that the object takes; beyond, the network has found nothing."""


@dataclass(frozen=True, kw_only=True, slots=True)
class RembgSegmenter:
    """A segmenter that runs one of rembg's networks on each picture, without looking at the other views."""

    option: str = ""
    """Name of a model, path of an .onnx file, or "" for the best of the models on this machine."""

    def configured(self, option: str) -> "RembgSegmenter":
        """Return the segmenter for `--segmenter rembg=OPTION`."""
        return RembgSegmenter(option=option)

    def __call__(self, views: Sequence[MaskView]) -> Sequence[Grey]:
        """Return the coverage of each view, 0..1.

        Raises `UsageError` where rembg or the model is missing, and `WorkerError` with `scene.mask_missing`
        where the network finds nothing in any picture.
        """
        session = _session(*find_model(self.option))
        coverages = [_coverage(session, view.image_srgb) for view in views]
        if not any(_MIN_SHARE < float((each > 0.5).mean()) < _MAX_SHARE for each in coverages):
            raise WorkerError(
                "scene.mask_missing",
                "rembg finds no object in any of the pictures; try another of its models, or give masks "
                "with --masks",
            )
        return coverages


segment = RembgSegmenter()


def find_model(option: str) -> tuple[str, Path]:
    """Return the name of rembg's session and the model file for it; raises `UsageError` where there is
    none."""
    if option.endswith(".onnx") or "/" in option:
        path = Path(option).expanduser()
        if not path.is_file():
            raise UsageError(
                "config.segmenter_model",
                f'--segmenter "rembg={option}": there is no such file; give an .onnx file',
            )
        return path.stem, path
    wanted = (option,) if option else PREFERRED
    for name in wanted:
        for place in _places(name):
            if place.is_file():
                return name, place
    name = option or "u2net"
    if name in _UNFIT:
        raise _unfit(name)
    raise UsageError(
        "config.segmenter_model",
        f"rembg has no model {' or '.join(wanted) if option else 'yet'}, and none is fetched here; fetch "
        f"{name}.onnx yourself from the releases of github.com/danielgatis/rembg (mind the licence of its "
        f'weights) and put it at {_places(name)[0]}, or give the file: --segmenter "rembg=PATH/{name}.onnx"',
    )


def _places(name: str) -> list[Path]:
    """Return where rembg keeps a model: in its folder of now, then in that of versions before 2.0.80."""
    data = os.environ.get("XDG_DATA_HOME")
    old = Path(os.environ.get("U2NET_HOME") or Path(data or "~") / ".u2net").expanduser()
    own = Path(
        os.environ.get("REMBG_HOME") or (Path(data) / "rembg" if data else Path("~/.rembg"))
    ).expanduser()
    home = old if os.environ.get("U2NET_HOME") else own
    return [home / "models" / name / f"{name}.onnx", old / f"{name}.onnx"]


def _session(name: str, model: Path) -> Any:
    """Return rembg's session for a model file, without any chance that it fetches another."""
    try:
        sessions = _sessions()
        onnxruntime = import_module("onnxruntime")
    except ImportError as error:
        raise UsageError(
            "config.segmenter_missing", f"rembg is not installed; run {pip_install('rembg')}"
        ) from error
    known = {each.name(): each for each in sessions.sessions_class}
    if name in _UNFIT or not getattr(known.get(name), "is_local", lambda: True)():
        raise _unfit(name)
    base = known.get(name) or known[GENERAL]

    class Local(base):  # type: ignore[misc, valid-type]  # known when it runs
        @classmethod
        def download_models(cls, *_args: object, **_options: object) -> str:
            return str(model)

    options = onnxruntime.SessionOptions()
    try:
        return Local(name, options, providers=["CPUExecutionProvider"], model_path=str(model))
    except Exception as error:  # onnxruntime raises many kinds
        reason = str(error).splitlines()[0][:160] if str(error) else type(error).__name__
        raise UsageError(
            "config.segmenter_model",
            f'"{model}" is not a network that rembg can run ({reason}); fetch it again',
        ) from error


def _sessions() -> ModuleType:
    """Return rembg's sessions without running the rest of the package; raises `ImportError`.

    `import rembg` also imports PyMatting, which compiles itself for a minute or more, for a matting that is
    not used here.
    """
    spec = find_spec("rembg")
    if spec is None:
        raise ImportError("rembg")
    loaded = "rembg" in sys.modules
    if not loaded:
        sys.modules["rembg"] = module_from_spec(spec)
    try:
        return import_module("rembg.sessions")
    finally:
        if not loaded:  # whoever imports it later gets all of it
            del sys.modules["rembg"]


def _coverage(session: Any, image_srgb: Rgb) -> Grey32:
    with np.errstate(
        invalid="ignore", divide="ignore"
    ):  # of a picture in which the network sees nothing at all
        masks = session.predict(Image.fromarray(image_srgb))
    coverage = np.zeros(image_srgb.shape[:2], dtype=np.float32)
    for mask in masks:
        coverage = np.maximum(coverage, np.asarray(mask, dtype=np.float32) / 255.0)
    return coverage


def _unfit(name: str) -> UsageError:
    return UsageError(
        "config.segmenter_model",
        f'rembg\'s "{name}" does not find an object of any kind on this machine; use {PREFERRED[0]} or '
        "another of "
        f"{', '.join(PREFERRED[1:])}",
    )
