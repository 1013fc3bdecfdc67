"""Limits above which a figure of photographs without cameras becomes a finding."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True, slots=True)
class PhotographLimits:
    """Limits of the findings, and the sizes at which photographs are looked at.

    "The bananas" are 16 hand-held photographs of a single-lens camera (3008 x 2000).
    """

    detail_side: int = 1024
    """Longer side at which photographs are looked at, pixels."""
    thumbnail_side: int = 160
    """Longer side of the thumbnails, pixels."""
    min_side: int = 64
    """Shorter side below which nothing can be matched, pixels."""
    min_photographs: int = 3
    few_photographs: int = 20
    """Below this the shape between the views is guesswork; 40 and more are recommended."""
    folder_photographs: int = 8
    """Photographs in each of several folders from which on these may be captures of their own."""
    sharpness: float = 0.5
    """Sharpness relative to the sharpest quarter. The bananas: 0.69 to 1.08, and one of 0.48; each of them
    after a Gaussian blur of one pixel at `detail_side`: at most 0.41."""
    same_levels: float = 4.0
    """Greatest difference of any of 32 x 32 means, in 8-bit levels, up to which two photographs show the same
    view of the same thing. An object that turns in front of a camera that stands still differs by more."""
    alike_bits: int = 3
    """Bits of 64 that the perceptual hashes of nearly equal photographs differ by."""
    alike_share: float = 0.2
    """Share of the photographs that may be nearly equal to another before it is worth a word."""
    exposure_ev: float = 2.0
    """Range of the median brightness between the 5th and 95th percentile, EV."""
    clipped_share: float = 0.15
    """Share of the frame at the end of the scale; a window behind the object may be, the object should
    not."""
    clipped_level: int = 252
    blank_levels: float = 3.0
    """Standard deviation of brightness, in levels, below which a photograph shows nothing."""
    panorama_aspect: float = 2.2
    fisheye_35mm: float = 14.0
    """Focal length in 35 mm terms below which a lens is likely to be a fisheye."""
    flat_share: float = 0.2
    """Share of exactly flat tiles above which a PNG of a screen's shape is a screenshot."""
    cropped_aspect: float = 0.02
    """Relative difference of the aspect ratio from what the camera wrote, above which a photograph was
    cropped."""
    max_named: int = 5
