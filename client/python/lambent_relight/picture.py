"""The result of relighting: a linear picture and its passes."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from lambent_relight.arguments import number

Image = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class RelitPicture:
    """A relit view. Colours are linear Rec. 709 radiance with straight alpha; rows from the top."""

    rgb: Image
    """[height, width, 3], not multiplied by `opacity`; zero where `opacity` is zero."""
    opacity: Image
    """Coverage in [0, 1], [height, width, 1]; one everywhere if a background was requested."""
    standard_error: Image
    """Monte Carlo standard error of `rgb`, per channel, from independent passes, [height, width, 3]."""
    direct: Image
    """Part of `rgb` that comes directly from the environment; without background, straight alpha."""
    indirect: Image
    """Part of `rgb` from indirect light, [height, width, 3]; without background."""
    diffuse: Image
    """Part of `rgb` that the diffuse lobe reflects; `diffuse` + `specular` = `direct` + `indirect`."""
    specular: Image
    visibility: Image
    """Share of the cosine-weighted hemisphere that nothing blocks, in [0, 1], [height, width, 1]."""
    albedo: Image
    """Base colour used, after edits, [height, width, 3]."""
    normal: Image
    """Unit world normals, [height, width, 3]; zero on the background."""
    perceptual_roughness: Image
    metalness: Image
    distance: Image
    """Distance from the camera along the ray, scene units, [height, width, 1]; zero on the background."""
    depth: Image
    """Distance from the camera along its axis, scene units, [height, width, 1]; zero on the background."""
    coverage: Image
    """Coverage by the object in [0, 1], [height, width, 1], independent of the background."""
    num_samples: int
    """Light directions behind a fully covered pixel, a mean over pixels; 0 where the light is not sampled."""
    bounces: str = ""
    """Source of indirect light: `adapted:<light>`, `baked` (in part as it was baked at the surface itself),
    `transport` (of what rays hit), `one`, a number of bounces, or empty without indirect light."""
    camera_attributes: Mapping[str, NDArray[np.float32]] = field(default_factory=dict)
    """The camera as attributes of EXR files: worldToCamera and worldToNDC, [4, 4]."""

    def __repr__(self) -> str:
        """Return size, samples and source of bounced light in one line."""
        height, width = self.rgb.shape[:2]
        light = f"{self.num_samples} light directions" if self.num_samples else "baked light"
        bounced = f", bounces {self.bounces!r}" if self.bounces else ""
        return f"RelitPicture({width} x {height} pixels, {light}{bounced})"

    def exposed(self, exposure_ev: float) -> "RelitPicture":
        """Return the picture with its radiance multiplied by 2^`exposure_ev`."""
        factor = np.float32(2.0 ** number(exposure_ev, "exposure_ev", above=-64.0, below=64.0))
        names = ("rgb", "standard_error", "direct", "indirect", "diffuse", "specular")
        return replace(self, **{name: getattr(self, name) * factor for name in names})
