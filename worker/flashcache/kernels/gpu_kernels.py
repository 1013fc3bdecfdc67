"""The encoder as Triton kernels: float32, one program per block of points and level.

The formula is in `flashcache.kernels.layout`; `flashcache.kernels.gpu` starts the kernels. In all of them:

- A pointer has the name of the contiguous array that it points to. `counts` and `scales` are those of
  `layout.level_constants`. `counts` are 32-bit integers where every offset into the table fits, else 64-bit
  ones, and offsets into the table are of the same type. Numbers of points are 64-bit.
- Tensors have the axes [BLOCK, WIDTH], points and features; one of them is 1 where nothing depends on it.
  WIDTH is F, the number of features, rounded up to a power of two. Where the two are equal, rows are read as
  vectors of up to four values.
- Kernels are compiled with `enable_fp_fusion=False`, so that positions between voxels are the reference's,
  bit for bit. A fused multiply-add is written out where it is welcome.
"""

import subprocess
from functools import lru_cache

import triton
import triton.language as tl
from triton.runtime import driver

from flashcache.errors import ConfigError

# Other values of these would be compiled anew, in the middle of a training.
_VARYING = ("num_points", "num_levels")


@lru_cache
def require_launcher() -> None:
    """Raise ConfigError where Triton cannot start kernels: it compiles a few lines of C on first use."""
    try:
        driver.active.get_current_device()
    except (RuntimeError, OSError, ImportError, subprocess.CalledProcessError) as error:
        raise ConfigError(
            f"Triton cannot start kernels on this machine ({error}); it needs a C compiler, Python's header "
            f"files (on Debian: gcc and python3-dev), and a folder that it may write to (TRITON_CACHE_DIR); "
            f"provide them, or set LAMBENT_KERNELS=reference, which is slower"
        ) from error


@triton.jit
def _mix(a, b, t):
    """Return a where t is 0 and b where t is 1."""
    return tl.fma(t, b - a, a)


@triton.jit
def block_of(num_points, BLOCK: tl.constexpr):
    """Return the numbers of this program's points and which of them exist."""
    point = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)[:, None]
    return point, point < num_points


@triton.jit
def _axis(coordinate, scale, centre, largest):
    """Return the position u along one axis and its derivative by the coordinate."""
    u = coordinate * scale + centre
    rate = tl.where((u >= 0.0) & (u <= largest), scale, 0.0)
    # A NaN fails the comparison and becomes 0, before it could become an address.
    u = tl.where(u > 0.0, u, 0.0)
    return tl.where(u < largest, u, largest), rate


@triton.jit
def load_vector(vectors, place, exists):
    """Return x, y and z of each vector; 0 where it does not exist."""
    x = tl.load(vectors + place * 3, exists, 0.0)
    y = tl.load(vectors + place * 3 + 1, exists, 0.0)
    return x, y, tl.load(vectors + place * 3 + 2, exists, 0.0)


@triton.jit
def locate(coordinates, counts, scales, level):
    """Return the 8 rows around each point, x fastest, its position between them, and d position / d z."""
    scale = tl.load(scales + level * 3)
    centre = tl.load(scales + level * 3 + 1)
    largest = tl.load(scales + level * 3 + 2)
    first = tl.load(counts + level * 6)
    mask = tl.load(counts + level * 6 + 1)
    step_y = tl.load(counts + level * 6 + 2)
    step_z = tl.load(counts + level * 6 + 3)
    top = tl.load(counts + level * 6 + 4)
    x, rate_x = _axis(coordinates[0], scale, centre, largest)
    y, rate_y = _axis(coordinates[1], scale, centre, largest)
    w, rate_z = _axis(coordinates[2], scale, centre, largest)
    cell_x = tl.minimum(x.to(top.dtype), top)
    cell_y = tl.minimum(y.to(top.dtype), top)
    cell_z = tl.minimum(w.to(top.dtype), top)
    near = cell_x + cell_y * step_y + cell_z * step_z
    far = near + step_z
    rows = (
        first + (near & mask),
        first + ((near + 1) & mask),
        first + ((near + step_y) & mask),
        first + ((near + step_y + 1) & mask),
        first + (far & mask),
        first + ((far + 1) & mask),
        first + ((far + step_y) & mask),
        first + ((far + step_y + 1) & mask),
    )
    position = (x - cell_x.to(tl.float32), y - cell_y.to(tl.float32), w - cell_z.to(tl.float32))
    return rows, position, (rate_x, rate_y, rate_z)


@triton.jit
def interpolate(table, rows, position, feature, exists, F: tl.constexpr):
    """Return the features of each point and their derivatives by its position along x, y and z."""
    x, y, w = position
    wanted = exists & (feature < F)
    v0 = tl.load(table + rows[0] * F + feature, wanted, 0.0)
    v1 = tl.load(table + rows[1] * F + feature, wanted, 0.0)
    v2 = tl.load(table + rows[2] * F + feature, wanted, 0.0)
    v3 = tl.load(table + rows[3] * F + feature, wanted, 0.0)
    v4 = tl.load(table + rows[4] * F + feature, wanted, 0.0)
    v5 = tl.load(table + rows[5] * F + feature, wanted, 0.0)
    v6 = tl.load(table + rows[6] * F + feature, wanted, 0.0)
    v7 = tl.load(table + rows[7] * F + feature, wanted, 0.0)
    d0, d1, d2, d3 = v1 - v0, v3 - v2, v5 - v4, v7 - v6
    c0, c1, c2, c3 = tl.fma(x, d0, v0), tl.fma(x, d1, v2), tl.fma(x, d2, v4), tl.fma(x, d3, v6)
    near, far = _mix(c0, c1, y), _mix(c2, c3, y)
    by_x = _mix(_mix(d0, d1, y), _mix(d2, d3, y), w)
    by_y = _mix(c1 - c0, c3 - c2, w)
    return _mix(near, far, w), (by_x, by_y, far - near)


@triton.jit
def spread(g, position):
    """Return the gradients by the sums c and by the far values b along x of `interpolate`, given its own."""
    x, y, w = position
    far = g * w
    near = g - far
    c3, c1 = far * y, near * y
    c2, c0 = far - c3, near - c1
    return (c0, c1, c2, c3), (c0 * x, c1 * x, c2 * x, c3 * x)


@triton.jit
def add_to_rows(result, rows, feature, c, b, wanted, F: tl.constexpr):
    """Add the gradients by the values of the 8 rows to `result`; see `spread`."""
    tl.atomic_add(result + rows[0] * F + feature, c[0] - b[0], wanted, sem="relaxed")
    tl.atomic_add(result + rows[1] * F + feature, b[0], wanted, sem="relaxed")
    tl.atomic_add(result + rows[2] * F + feature, c[1] - b[1], wanted, sem="relaxed")
    tl.atomic_add(result + rows[3] * F + feature, b[1], wanted, sem="relaxed")
    tl.atomic_add(result + rows[4] * F + feature, c[2] - b[2], wanted, sem="relaxed")
    tl.atomic_add(result + rows[5] * F + feature, b[2], wanted, sem="relaxed")
    tl.atomic_add(result + rows[6] * F + feature, c[3] - b[3], wanted, sem="relaxed")
    tl.atomic_add(result + rows[7] * F + feature, b[3], wanted, sem="relaxed")


@triton.jit(do_not_specialize=_VARYING)
def forward(
    z, table, counts, scales, features, jacobian, num_points, num_levels,
    F: tl.constexpr, WIDTH: tl.constexpr, JACOBIAN: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Write the features [points, levels, F] and, with JACOBIAN, their derivative [points, levels, F, 3]."""
    level = tl.program_id(1)
    point, exists = block_of(num_points, BLOCK)
    feature = tl.arange(0, WIDTH)[None, :]
    rows, position, rates = locate(load_vector(z, point, exists), counts, scales, level)
    value, slopes = interpolate(table, rows, position, feature, exists, F)
    wanted = exists & (feature < F)
    column = (point * num_levels + level) * F + feature
    tl.store(features + column, value, wanted)
    if JACOBIAN:
        for axis in tl.static_range(3):
            tl.store(jacobian + column * 3 + axis, rates[axis] * slopes[axis], wanted)


@triton.jit(do_not_specialize=_VARYING)
def position_gradient(
    z, table, counts, scales, by_features, result, num_points, num_levels,
    F: tl.constexpr, WIDTH: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Write the gradient by z [points, 3]; a program sums over all levels of its points."""
    point, exists = block_of(num_points, BLOCK)
    feature = tl.arange(0, WIDTH)[None, :]
    wanted = exists & (feature < F)
    sum_x = tl.zeros((BLOCK, WIDTH), tl.float32)
    sum_y = tl.zeros((BLOCK, WIDTH), tl.float32)
    sum_z = tl.zeros((BLOCK, WIDTH), tl.float32)
    for level in range(num_levels):
        rows, position, rates = locate(load_vector(z, point, exists), counts, scales, level)
        _, slopes = interpolate(table, rows, position, feature, exists, F)
        g = tl.load(by_features + (point * num_levels + level) * F + feature, wanted, 0.0)
        sum_x = tl.fma(rates[0] * slopes[0], g, sum_x)
        sum_y = tl.fma(rates[1] * slopes[1], g, sum_y)
        sum_z = tl.fma(rates[2] * slopes[2], g, sum_z)
    tl.store(result + point * 3, tl.sum(sum_x, 1, keep_dims=True), exists)
    tl.store(result + point * 3 + 1, tl.sum(sum_y, 1, keep_dims=True), exists)
    tl.store(result + point * 3 + 2, tl.sum(sum_z, 1, keep_dims=True), exists)


@triton.jit(do_not_specialize=_VARYING)
def table_gradient(
    z, counts, scales, by_features, by_jacobian, result, num_points, num_levels,
    F: tl.constexpr, WIDTH: tl.constexpr, JACOBIAN: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Add the gradient by the table to `result` [rows, F]; the order of the additions is left open."""
    level = tl.program_id(1)
    point, exists = block_of(num_points, BLOCK)
    feature = tl.arange(0, WIDTH)[None, :]
    wanted = exists & (feature < F)
    rows, position, rates = locate(load_vector(z, point, exists), counts, scales, level)
    column = (point * num_levels + level) * F + feature
    g = tl.load(by_features + column, wanted, 0.0)
    # `forward` read backwards: each line gives the gradient of what that line read.
    if JACOBIAN:
        x, y, w = position
        gx = rates[0] * tl.load(by_jacobian + column * 3, wanted, 0.0)
        gy = rates[1] * tl.load(by_jacobian + column * 3 + 1, wanted, 0.0)
        gz = rates[2] * tl.load(by_jacobian + column * 3 + 2, wanted, 0.0)
        far = tl.fma(g, w, gz)
        near = g - far
        dy_far = gy * w
        dy_near = gy - dy_far
        c3, c1 = tl.fma(far, y, dy_far), tl.fma(near, y, dy_near)
        c2, c0 = far - c3, near - c1
        dx_far = gx * w
        dx_near = gx - dx_far
        d3, d1 = dx_far * y, dx_near * y
        d2, d0 = dx_far - d3, dx_near - d1
        c = c0, c1, c2, c3
        b = tl.fma(c0, x, d0), tl.fma(c1, x, d1), tl.fma(c2, x, d2), tl.fma(c3, x, d3)
    else:
        c, b = spread(g, position)
    add_to_rows(result, rows, feature, c, b, wanted, F)
