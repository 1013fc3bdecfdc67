"""Things below and around an object: carpet, sheet, table, paper, cloth, turntable."""

from typing import Any

import mitsuba as mi
import numpy as np

from tabletop.patterns import linear, mixed, plane_noise, printed

Shapes = dict[str, Any]
GRAIN = 320
"""Length of a fibre of wood in its picture's pixels."""


def matter(colour: np.ndarray | str, roughness: float, metallic: float = 0.0) -> dict[str, Any]:
    """Return a material of closed shapes; `colour` is linear [H, W, 3] over texture coordinates, or hex."""
    if isinstance(colour, str):
        base = {"type": "rgb", "value": linear(colour).tolist()}
    else:
        base = {"type": "bitmap", "bitmap": mi.Bitmap(np.ascontiguousarray(colour, np.float32)), "raw": True}
    return {"type": "principled", "base_color": base, "roughness": roughness, "metallic": metallic}


def slab(
    x: float, y: float, top: float, wide: float, deep: float, thick: float, bsdf: dict, turn_deg: float = 0.0
) -> dict[str, Any]:
    """Return a box whose upper face is at `top`; all its faces carry the same picture."""
    at = mi.ScalarTransform4f().translate([x, y, top - thick / 2]).rotate([0, 0, 1], turn_deg)
    return {"type": "cube", "to_world": at.scale([wide / 2, deep / 2, thick / 2]), "bsdf": bsdf}


def wood(height: int, width: int, planks: int, seed: int, dark: str, light: str) -> np.ndarray:
    """Return planks along the width: grain, knots, seams."""
    rng = np.random.default_rng(seed)
    picture = np.empty((height, width, 3), np.float32)
    edges = np.linspace(0, height, planks + 1).astype(int)
    for k in range(planks):
        rows = edges[k + 1] - edges[k]
        y, x = np.meshgrid(np.linspace(-1, 1, rows), np.linspace(0, width / rows, width), indexing="ij")
        bend = 0.35 * plane_noise(rows, width, rows / 3, seed * 100 + k)
        rings = np.sin(14.0 * (y + 0.35 * bend) + 5.0 * rng.uniform() + 0.4 * x)
        streaks = plane_noise(rows, width + GRAIN, 1.2, seed * 100 + 50 + k)
        streaks = np.cumsum(streaks, axis=1)
        streaks = (streaks[:, GRAIN:] - streaks[:, :-GRAIN]) / (1.2 * GRAIN**0.5)
        share = 0.45 + 0.18 * rings + 0.13 * streaks + rng.uniform(-0.18, 0.18)
        picture[edges[k] : edges[k + 1]] = mixed(linear(dark), linear(light), share)
        picture[edges[k] : edges[k] + max(2, rows // 90)] *= 0.35
    return picture


def woven(height: int, width: int, seed: int) -> np.ndarray:
    """Return an oriental-looking carpet [height, width, 3]: borders, a medallion, scattered motifs, pile."""
    y, x = np.meshgrid(np.linspace(-1, 1, height), np.linspace(-1.5, 1.5, width), indexing="ij")
    edge = np.minimum(1.0 - np.abs(y), 1.5 - np.abs(x))
    radius, turn = np.hypot(x, y), np.arctan2(y, x)
    inks = [linear(c) for c in ("7d1f22", "1f2f57", "c79b52", "2f5a4a", "e3d3ab", "a14a2b", "3a1a20")]
    picture = np.broadcast_to(inks[0], (height, width, 3)).copy()
    picture[radius < 0.62 + 0.09 * np.cos(12 * turn)] = inks[1]
    picture[radius < 0.44 + 0.06 * np.cos(8 * turn)] = inks[4]
    picture[radius < 0.36 + 0.05 * np.cos(8 * turn)] = inks[5]
    rng = np.random.default_rng(seed)
    for _ in range(420):
        cx, cy = rng.uniform(-1.35, 1.35), rng.uniform(-0.85, 0.85)
        size, petals, phase = rng.uniform(0.02, 0.075), int(rng.integers(3, 8)), rng.uniform(0, 6.3)
        half = int(size * height)
        column, row = int((cx + 1.5) / 3 * width), int((cy + 1) / 2 * height)
        part = np.s_[max(row - half, 0) : row + half, max(column - half, 0) : column + half]
        dx, dy = x[part] - cx, y[part] - cy
        far, angle = np.hypot(dx, dy), np.arctan2(dy, dx)
        flower = far < size * (0.7 + 0.3 * np.cos(petals * angle + phase))
        picture[part][flower] = inks[int(rng.integers(len(inks)))]
        picture[part][far < 0.3 * size] = inks[int(rng.integers(len(inks)))]
    for low, high, ink in ((0.0, 0.04, 6), (0.04, 0.17, 1), (0.17, 0.2, 2), (0.2, 0.24, 6)):
        picture[(edge >= low) & (edge < high)] = inks[ink]
    along = np.where(1.0 - np.abs(y) < 1.5 - np.abs(x), x, y)
    zigzag = (np.abs(edge - 0.105) < 0.045) & (
        np.abs(np.mod(along / 0.09, 1.0) - 0.5) * 0.09 < np.abs(edge - 0.105) + 0.012
    )
    picture[zigzag] = inks[2]
    pile = 0.16 * plane_noise(height, width, 0.8, seed + 1) + 0.08 * plane_noise(height, width, 4, seed + 2)
    worn = 0.10 * plane_noise(height, width, 60, seed + 3)
    return np.clip(picture * (1.0 + pile + worn)[..., None], 0.004, 0.9).astype(np.float32)


def _floor(seed: int, level: float) -> dict[str, Any]:
    return slab(0, 0, level, 70, 70, 0.2, matter(wood(2048, 2048, 22, seed, "5a3a22", "9a6d44"), 0.5))


def _books(seed: int, places: list[tuple[float, float, float, float]]) -> Shapes:
    """Return closed books and boxes with printed covers at (x, y, turn, height)."""
    rng = np.random.default_rng(seed)
    covers = ["c9b28a", "8fa9bd", "d9d2c0", "b5564a", "5e7f62"]
    made = {}
    for k, (x, y, turn, high) in enumerate(places):
        cover = printed(700, 900, seed + k, paper=covers[k % len(covers)], picture_share=3.0)
        made[f"book{k}"] = slab(x, y, high, *rng.uniform(1.2, 2.0, 2), high, matter(cover, 0.4), turn)
    return made


def carpet() -> Shapes:
    """Return a carpet on a wooden floor, with boxes of furniture around."""
    fabric = printed(900, 900, 77, paper="6f7f78", picture_share=4.0)
    return {
        "support": slab(0.4, -0.3, 0.0, 21.0, 14.0, 0.12, matter(woven(2800, 4200, 3), 0.95), 17.0),
        "floor": _floor(4, -0.12),
        "sofa": slab(3, 16, 4.0, 18, 6, 4.2, matter(fabric, 0.9)),
        "chest": slab(-17, -4, 6.0, 5, 10, 6.2, matter(wood(800, 1400, 4, 6, "6b3f22", "a8713f"), 0.4), 8.0),
    }


def sheet() -> Shapes:
    """Return a printed sheet (A3) on a light table."""
    page = printed(2970, 2100, 12)
    table = wood(1800, 3000, 6, 7, "b08a5e", "d9b98a")
    return {
        "support": slab(0.1, -0.1, 0.0, 4.2, 2.97, 0.012, matter(page, 0.7), 12.0),
        "table": slab(0.5, 0.3, -0.012, 15, 9, 0.3, matter(table, 0.4)),
        "floor": _floor(5, -7.4),
        **_books(30, [(-5.2, 2.2, 20.0, 0.3), (5.3, -2.4, -35.0, 0.2)]),
    }


def table() -> Shapes:
    """Return a wooden table by a wall, with things around that reach into the pictures."""
    top = wood(2200, 3600, 7, 8, "4c2c17", "8a5a30")
    wall = mixed(linear("c9c2b2"), linear("b3aa98"), 0.5 + 0.3 * plane_noise(1024, 2048, 6, 9))
    poster = printed(1400, 1000, 41, paper="27415e", picture_share=5.0)
    bottle = {"type": "cylinder", "p0": [-4.2, 2.6, 0.0], "p1": [-4.2, 2.6, 2.0], "radius": 0.36}
    neck = {"type": "cylinder", "p0": [-4.2, 2.6, 1.9], "p1": [-4.2, 2.6, 2.7], "radius": 0.14}
    apple = {"type": "sphere", "center": [3.6, 3.0, 0.38], "radius": 0.38}
    return {
        "support": slab(0, 0, 0.0, 16, 10, 0.35, matter(top, 0.35)),
        "floor": _floor(5, -7.4),
        "wall": slab(0, 13, 16, 60, 0.4, 30, matter(wall, 0.9)),
        "poster": slab(2, 12.75, 9, 8, 0.1, 6, matter(poster, 0.5)),
        "bottle": bottle | {"bsdf": matter("3c5f3a", 0.15)},
        "neck": neck | {"bsdf": matter("3c5f3a", 0.15)},
        "apple": apple | {"bsdf": matter("a8281e", 0.25)},
        "orange": {
            "type": "sphere",
            "center": [4.4, 2.6, 0.42],
            "radius": 0.42,
            "bsdf": matter("e07b1a", 0.4),
        },
        **_books(
            42,
            [
                (-4.6, -2.2, 25.0, 0.35),
                (4.9, -2.0, -20.0, 0.5),
                (-1.6, 3.9, 8.0, 0.3),
                (-4.4, -2.3, 50.0, 0.6),
            ],
        ),
    }


def white() -> Shapes:
    """Return a large white sheet on a desk, with tools beside it."""
    paper = mixed(linear("f0efec"), linear("e6e4df"), 0.5 + 0.25 * plane_noise(1600, 2200, 2.5, 13))
    desk = wood(1800, 3000, 5, 14, "7d5a3c", "b08a5c")
    pencil = {"type": "cylinder", "p0": [3.6, -1.6, 0.05], "p1": [4.4, 0.2, 0.05], "radius": 0.045}
    return {
        "support": slab(0.1, 0.05, 0.0, 6.4, 4.6, 0.01, matter(paper, 0.8), -9.0),
        "desk": slab(0.3, 0.2, -0.01, 17, 10, 0.3, matter(desk, 0.45)),
        "floor": _floor(15, -7.4),
        "pencil": pencil | {"bsdf": matter("d8a21c", 0.4)},
        "ruler": slab(
            -0.4, -3.3, 0.02, 3.2, 0.34, 0.03, matter(printed(1200, 130, 16, paper="e8d9a0"), 0.4), 4.0
        ),
        "card": slab(
            -4.4, 1.6, 0.02, 1.6, 1.1, 0.03, matter(printed(800, 560, 17, paper="d6e4ea"), 0.5), 30.0
        ),
        **_books(18, [(0.8, 4.1, -6.0, 0.3), (5.6, 2.4, 40.0, 0.25)]),
    }


def cloth() -> Shapes:
    """Return a dark cloth with folds on a table."""
    side = 420
    y, x = np.meshgrid(np.linspace(-6, 6, side), np.linspace(-7, 7, side), indexing="ij")
    flat = np.clip((np.hypot(x, y) - 1.2) / 3.0, 0.0, 1.0) ** 2
    folds = 0.14 * np.sin(1.4 * x + 1.8 * np.sin(0.6 * y)) + 0.09 * np.sin(2.6 * y - 1.1 * x)
    z = np.maximum(flat * (folds + 0.06 * plane_noise(side, side, 14, 19)), -0.34) - 0.001
    weave = linear("1a1d26") * (1.0 + 0.35 * plane_noise(2048, 2048, 0.9, 20))[..., None]
    weave = mixed(weave, linear("3d3440"), (plane_noise(2048, 2048, 7, 21) > 1.7) * 0.6)
    k = np.arange(side * side).reshape(side, side)
    a, b, c, d = k[:-1, :-1].ravel(), k[:-1, 1:].ravel(), k[1:, :-1].ravel(), k[1:, 1:].ravel()
    faces = np.concatenate([np.stack([a, b, d], -1), np.stack([a, d, c], -1)])
    uv = np.stack([(x + 7) / 14, (y + 6) / 12], axis=-1).reshape(-1, 2)
    points = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    top = wood(1800, 3000, 6, 22, "6a4a30", "a1774d")
    return {
        "support": triangles("cloth", points, faces, matter(np.clip(weave, 0.003, 0.9), 0.95), uv=uv),
        "table": slab(0, 0, -0.36, 19, 12, 0.3, matter(top, 0.4)),
        "floor": _floor(23, -7.4),
        **_books(24, [(-7.6, 2.6, 10.0, 0.25), (7.4, -3.0, -30.0, 0.3)]),
    }


def room() -> Shapes:
    """Return the room that stands still around a turntable: desk, wall, shelf, the turntable's base."""
    wall = mixed(linear("a9b0a6"), linear("8f978d"), 0.5 + 0.3 * plane_noise(1024, 2048, 8, 25))
    desk = wood(1800, 3000, 6, 26, "8a6a48", "bb9668")
    poster = printed(1600, 1100, 27, paper="7a3b33", picture_share=5.0)
    return {
        "desk": slab(0, 0, -0.3, 18, 11, 0.3, matter(desk, 0.4)),
        "floor": _floor(28, -7.4),
        "wall": slab(-8.5, 0, 16, 0.4, 60, 30, matter(wall, 0.9)),
        "poster": slab(-8.25, 1.5, 7, 0.1, 8, 5, matter(poster, 0.5)),
        "base": {
            "type": "cylinder",
            "p0": [0, 0, -0.3],
            "p1": [0, 0, -0.12],
            "radius": 1.3,
            "bsdf": matter("2b2b2e", 0.4),
        },
        **_books(29, [(-3.4, 3.2, 14.0, 1.4), (-4.0, -3.3, -20.0, 0.5), (-3.9, -3.2, 10.0, 0.9)]),
    }


def disc(turn_deg: float) -> Shapes:
    """Return the plate of the turntable, turned with the object."""
    side = 1400
    y, x = np.meshgrid(np.linspace(-1, 1, side), np.linspace(-1, 1, side), indexing="ij")
    radius, turn = np.hypot(x, y), np.arctan2(y, x)
    face = mixed(linear("d9d4c8"), linear("c4bdae"), 0.5 + 0.3 * plane_noise(side, side, 3, 31))
    ticks = (np.mod(turn / (2 * np.pi) * 72, 1.0) < 0.18) & (radius > 0.88) & (radius < 0.97)
    long = (np.mod(turn / (2 * np.pi) * 12, 1.0) < 0.05) & (radius > 0.76) & (radius < 0.97)
    face[ticks | long] = linear("2a2a2c")
    at = mi.ScalarTransform4f().rotate([0, 0, 1], turn_deg)
    square = triangles(
        "plate",
        np.stack([1.6 * np.cos(_RIM), 1.6 * np.sin(_RIM), 0.0 * _RIM - 0.001], axis=-1),
        np.stack([0 * _FAN, _FAN, _FAN + 1], axis=-1),
        matter(face, 0.5),
        uv=np.stack([0.5 + 0.5 * np.cos(_RIM), 0.5 + 0.5 * np.sin(_RIM)], axis=-1),
        turn_deg=turn_deg,
    )
    side_wall = {"type": "cylinder", "p0": [0, 0, -0.12], "p1": [0, 0, -0.001], "radius": 1.6, "to_world": at}
    return {"support": square, "rim": side_wall | {"bsdf": matter("77736a", 0.5)}}


_RIM = np.linspace(0.0, 2.0 * np.pi, 181)[:-1]
_FAN = np.arange(1, 179)


def triangles(
    name: str,
    positions: np.ndarray,
    faces: np.ndarray,
    bsdf: dict,
    *,
    normals: np.ndarray | None = None,
    uv: np.ndarray | None = None,
    paints: dict[str, np.ndarray] | None = None,
    turn_deg: float = 0.0,
) -> "mi.Mesh":
    """Return a mesh turned about z, with values per vertex by attribute name (`vertex_...`)."""
    cos, sin = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(bsdf)
    mesh = mi.Mesh(
        name,
        len(positions),
        len(faces),
        props=properties,
        has_vertex_normals=normals is not None,
        has_vertex_texcoords=uv is not None,
    )
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = (positions @ turn.T).astype(np.float32).ravel()
    parameters["faces"] = faces.astype(np.uint32).ravel()
    if normals is not None:
        parameters["vertex_normals"] = (normals @ turn.T).astype(np.float32).ravel()
    if uv is not None:
        parameters["vertex_texcoords"] = uv.astype(np.float32).ravel()
    parameters.update()
    for key, values in (paints or {}).items():
        flat = np.asarray(values, np.float32)
        mesh.add_attribute(key, 1 if flat.ndim == 1 else flat.shape[1], flat.ravel())
    return mesh
