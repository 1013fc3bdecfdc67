"""The layouts in which captures arrive.

A layout is a line here and a module of its name in `lambent_capture.layouts`, which has `is_layout` and
`read_capture`. Server, worker and pages take everything else that they know of a layout from here.
"""

import re
from dataclasses import dataclass
from types import MappingProxyType

RAW_SUFFIXES = (
    *(".dng", ".cr2", ".cr3", ".crw", ".nef", ".nrw", ".arw", ".srf", ".sr2", ".raf", ".orf", ".rw2"),
    *(".pef", ".srw", ".x3f", ".3fr", ".fff", ".iiq", ".erf", ".mrw", ".rwl", ".raw"),
)
"""Files of cameras' sensors, which a worker with the extra `raw` reads."""
ENCODED_SUFFIXES = (
    *(".avif", ".bmp", ".exr", ".hdr", ".heic", ".heif", ".jpeg", ".jpg", ".png", ".tif", ".tiff", ".webp"),
)
PICTURE_SUFFIXES = frozenset({*ENCODED_SUFFIXES, *RAW_SUFFIXES})
TABLE_SUFFIXES = frozenset({".bin", ".csv", ".json", ".npy", ".txt"})
"""Poses and tables. Files of other kinds are never stored, let alone loaded."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Layout:
    """One layout of a capture."""

    name: str
    title: str
    """For people, in English."""
    looks_like: str
    """What a folder of this layout has, for the message of one that has nothing known."""
    nested: bool = False
    """Cameras may lie in a folder of the capture, and links inside the capture are followed."""
    finds_cameras: bool = False
    """Photographs only: their cameras are found here."""
    is_benchmark: bool = False
    """A published data set: exposed alike and scored on whole frames, and nothing of it may be missing."""
    fixed_world: bool = False
    """The coordinates of the data set are kept, so that poses and truth mean what they mean elsewhere."""
    own_files: re.Pattern[str] | None = None
    """Names of files that only this layout has, beside pictures and tables."""

    @property
    def tolerant(self) -> bool:
        """Whether a few pictures may be missing or broken."""
        return not self.is_benchmark


# A folder may satisfy two readers; the richer layout comes first.
_ALL = (
    Layout(
        name="tensoir_synthetic",
        title="TensoIR-synthetic",
        looks_like="train_*/metadata.json",
        is_benchmark=True,
    ),
    Layout(
        name="openillumination",
        title="OpenIllumination",
        looks_like="Lights/<light>/raw_undistorted with output/transforms_train.json",
        is_benchmark=True,
        fixed_world=True,
    ),
    Layout(
        name="glossy_synthetic",
        title="Glossy Synthetic",
        looks_like="0-camera.pkl",
        is_benchmark=True,
        fixed_world=True,
        # Cameras are pickles; the reader takes numbers out of them and runs nothing.
        own_files=re.compile(r"(\d{1,6}-camera|synthetic_split_\d{1,6})\.pkl"),
    ),
    Layout(
        name="nerf_blender",
        title="NeRF-Blender (transforms_*.json)",
        looks_like="transforms_train.json",
        nested=True,
    ),
    Layout(
        name="nerfstudio",
        title="nerfstudio or instant-ngp (transforms.json)",
        looks_like="transforms.json",
        nested=True,
    ),
    Layout(name="colmap", title="COLMAP", looks_like="sparse/0/images.bin or .txt", nested=True),
    Layout(name="polycam", title="Polycam", looks_like="keyframes/cameras/*.json", nested=True),
    Layout(
        name="photographs",
        title="photographs, whose cameras are found first",
        looks_like="pictures, from which cameras can be found",
        finds_cameras=True,
    ),
)
LAYOUTS = MappingProxyType({layout.name: layout for layout in _ALL})
PHOTOGRAPHS = "photographs"
BENCHMARKS = frozenset(layout.name for layout in _ALL if layout.is_benchmark)
FIXED_WORLDS = frozenset(layout.name for layout in _ALL if layout.fixed_world)
OWN_FILES = tuple(layout.own_files for layout in _ALL if layout.own_files is not None)
