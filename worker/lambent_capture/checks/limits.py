"""Limits above which a figure becomes a finding."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True, slots=True)
class CaptureLimits:
    """Limits of the findings, and the sizes at which pictures are examined.

    "Clean" are the sample scene and the two benchmark scenes; docs/howto/capture.md has their figures.
    """

    detail_side: int = 1024
    """Longer side at which sharpness and clipping are measured, pixels. No preset but one trains above 1000
    pixels, and blur that is gone at this size costs nothing."""
    silhouette_side: int = 128
    """Longer side at which silhouettes and brightness are compared between views, pixels."""
    thumbnail_side: int = 160
    """Longer side of the thumbnails, pixels."""
    hull_cells: int = 64
    """Cells of the visual hull along the longest side of the object. With `silhouette_side` one cell is about
    one and a half pixels of an object that fills the picture."""
    box_margin: float = 1.5
    """The hull is searched in the scene's box scaled by this, so that an off-centre object is found."""
    min_views_for_hull: int = 6
    """Fewer silhouettes leave so large a hull that none of them contradicts it."""
    tolerated_share: float = 0.08
    """Share of the views that may be wrong without spoiling the hull the others are judged by."""

    few_views: int = 20
    """Below this the shape between the views is guesswork; 40 and more are recommended."""
    gap_deg: float = 45.0
    """Radius of an empty cap of the upper half of the sphere of views. Beyond 45 degrees a surface that faces
    the middle of the gap is seen at a grazing angle only. Clean: at most 25."""
    clipped_share: float = 0.05
    """Share of the object's pixels at the end of the scale; sun and highlights of clean scenes take 1 %."""
    clipped_level: int = 252
    """Encoded level of any channel from which a pixel counts as clipped; below 255 for JPEG's rounding."""
    sharpness: float = 0.5
    """Sharpness relative to the sharpest quarter of the views. Clean: at least 0.64; a Gaussian blur of one
    pixel at `detail_side` brings it to 0.46 or less."""
    unexplained_share: float = 0.02
    """Share of a silhouette that the other views' hull does not explain. Clean: at most 0.003. A camera that
    is turned by two degrees leaves 0.03 to 0.09."""
    missing_share: float = 0.02
    """Share of another view's silhouette that a mask alone cuts away, or of its own area in holes that no
    other view looks through. Clean: at most 0.005."""
    max_holed_share: float = 0.1
    """Share of the views beyond which holes in masks are taken for holes in the object."""
    misplaced_share: float = 0.5
    """A silhouette of which the others explain less than this is misplaced, whatever its shape."""
    mismatch_ev: float = 0.35
    """Median difference of the brightness of points from what other pictures show, in EV; twice the median
    over all views is needed as well. Points that are not where the pose says differ by as much as the texture
    does."""
    border_share: float = 0.02
    """Share of the picture's border that a silhouette covers; touching it in a point is harmless."""
    speck_share: float = 0.002
    """Share of a silhouette in islands of a few pixels that the other views contradict."""
    min_specks: int = 3
    """One or two of them are as likely a thin part of the object."""
    exposure_ev: float = 0.33
    """Deviation of a picture's brightness from its neighbours, in EV: a third of a stop is the step of a
    camera. Clean: at most 0.12 on the sample scene."""
    exposure_spread: float = 5.0
    """The same deviation in standard deviations of all pictures (from the median absolute deviation), so that
    an object whose own look depends on the view, such as polished metal (0.1 EV), raises its own limit."""
    drift_ev: float = 0.8
    """Range of the brightness over the whole capture, in EV, between the 5th and 95th percentile. Clean: 0.13
    to 0.16, polished metal 0.58."""
    outside_box_share: float = 0.02
    """Share of a silhouette that lies outside of the scene's box, where nothing is reconstructed in detail;
    median over the views. Clean: 0."""
    moved_share: float = 0.6
    """Disagreement left by the best shift and scale of a silhouette, relative to now. Below it the camera is
    blamed: a turned camera leaves 0.1 to 0.3, a leak or a hole 0.77 to 1."""
    max_named_views: int = 5
    """A problem of more views than this becomes one finding that names the worst."""
