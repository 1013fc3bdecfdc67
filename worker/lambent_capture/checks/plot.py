"""Draws the sphere of views as SVG, seen from above and from below."""

import math
from collections.abc import Set
from xml.sax.saxutils import escape, quoteattr

import numpy as np
from lambent_proto.v1 import capture_pb2, scene_pb2
from scipy.spatial.transform import Rotation

from lambent_capture.checks.sphere import angles_deg

_RADIUS = 130.0
_MARGIN = 24.0


def plot_views(figures: capture_pb2.CaptureFigures, flagged: Set[str]) -> str:
    """Return two discs as SVG: directions above the horizon (left) and below it (right).

    The middle is straight above or below the object, the rim the horizon, +x to the right. Training views are
    filled, test views hollow, those in `flagged` red; the shaded cap above the horizon is the largest without
    a training view.
    """
    size = 2.0 * (_RADIUS + _MARGIN)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {2 * size:.0f} {size:.0f}" role="img" '
        'aria-label="directions from which the object was photographed">'
    ]
    for place, title in ((0, "from above"), (1, "from below")):
        parts.append(f'<g transform="translate({place * size + size / 2:.0f} {size / 2:.0f})">')
        parts += [f'<circle class="grid" r="{_RADIUS * (90 - each) / 90:.1f}"/>' for each in (0, 30, 60)]
        parts.append(f'<text y="{_RADIUS + 18:.0f}">{title}</text>')
        if place == 0:
            parts.append(_cap(figures))
        parts += [_dot(view, flagged) for view in figures.views if (view.elevation_deg < 0.0) == bool(place)]
        parts.append("</g>")
    return "".join([*parts, "</svg>"])


def on_disc(azimuth_deg: float, elevation_deg: float) -> tuple[float, float]:
    """Return where a direction lies on its disc; the distance from the middle grows with the angle."""
    radius = _RADIUS * (90.0 - abs(elevation_deg)) / 90.0
    azimuth = math.radians(azimuth_deg)
    return radius * math.cos(azimuth), -radius * math.sin(azimuth)


def _dot(view: capture_pb2.ViewFigures, flagged: Set[str]) -> str:
    x, y = on_disc(view.azimuth_deg, view.elevation_deg)
    kind = "train" if view.split == scene_pb2.SPLIT_TRAIN else "test"
    bad = " bad" if view.name in flagged else ""
    title = f"<title>{escape(view.name)}</title>"
    return f'<circle class="{kind}{bad}" cx="{x:.1f}" cy="{y:.1f}" r="4">{title}</circle>'


def _cap(figures: capture_pb2.CaptureFigures) -> str:
    """Return the outline of the largest gap, cut off at the horizon."""
    if figures.upper_gap_deg <= 0.0:
        return ""
    opening = math.radians(min(figures.upper_gap_deg, 179.0))
    turn = np.linspace(0.0, 2.0 * math.pi, 72, endpoint=False)
    # The rim of a cap around +z, tilted and turned to where the gap is.
    radius, height = math.sin(opening), math.cos(opening)
    rim = np.stack([radius * np.cos(turn), radius * np.sin(turn), np.full(72, height)], axis=-1)
    angles = [90.0 - figures.upper_gap_elevation_deg, figures.upper_gap_azimuth_deg]
    rim = Rotation.from_euler("yz", angles, degrees=True).apply(rim)
    azimuth, elevation = angles_deg(rim)
    places = [on_disc(a, max(e, 0.0)) for a, e in zip(azimuth, elevation, strict=True)]
    corners = [f"{column:.1f},{row:.1f}" for column, row in places]
    return f'<polygon class="gap" points={quoteattr(" ".join(corners))}/>'
