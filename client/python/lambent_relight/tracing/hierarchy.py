"""A hierarchy of boxes over triangles, from which rays find the ones in their way.

Faces are split by the surface area heuristic over 16 bins along the longest side of their centres, down to
leaves of four. A node holds the boxes of its two children. Source: Wald 2007 (On fast Construction of
SAH-based Bounding Volume Hierarchies).
"""

from typing import NamedTuple

import numpy as np
from lambent_compute.compiling import compiled, inlined
from numpy.typing import NDArray

LEAF_FACES = 4
NUM_BINS = 16
MAX_DEPTH = 48
"""Below it groups are halved by number, so that no hierarchy is deeper than this and 31 more."""
_GROWN = np.float32(1e-6)
"""By this share of the mesh's size boxes are larger than their faces, so that rounding loses none."""


class Hierarchy(NamedTuple):
    """Faces in the order of the leaves, and the inner nodes; node 0 is the root."""

    boxes: NDArray[np.float32]
    """Lowest and highest corner of either child, [node, 2, 6]."""
    children: NDArray[np.int32]
    """Number of the node, or of a leaf's first face, as -1 - number, [node, 2]."""
    counts: NDArray[np.int32]
    """Faces of a leaf, 0 for nodes, [node, 2]."""
    corners: NDArray[np.float32]
    """First corner and both edges from it, [face, 9], in the order of the leaves."""
    face: NDArray[np.int32]
    """Number of the face in the mesh, [face]."""


def build_hierarchy(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> Hierarchy:
    """Return the hierarchy of `faces` [face, 3] over `vertices` [vertex, 3]; at least one face."""
    corners = np.ascontiguousarray(vertices, np.float32)[faces]
    low, high = corners.min(axis=1), corners.max(axis=1)
    margin = _GROWN * max(float(np.ptp(vertices, axis=0).max()), 1e-30)
    boxes = np.concatenate([low - margin, high + margin], axis=1).astype(np.float32)
    order = np.arange(len(faces), dtype=np.int32)
    most = max(len(faces), 2)
    node_boxes = np.empty((most, 2, 6), np.float32)
    children, counts = np.zeros((most, 2), np.int32), np.zeros((most, 2), np.int32)
    used = _build(boxes, 0.5 * (boxes[:, :3] + boxes[:, 3:]), order, node_boxes, children, counts)
    first = corners[order, 0]
    edges = np.concatenate([first, corners[order, 1] - first, corners[order, 2] - first], axis=1)
    return Hierarchy(
        node_boxes[:used].copy(),
        children[:used].copy(),
        counts[:used].copy(),
        np.ascontiguousarray(edges),
        order,
    )


@inlined(fastmath=False)
def _bound(boxes, order, start, end, out):
    for k in range(3):
        out[k], out[3 + k] = np.float32(np.inf), np.float32(-np.inf)
    for i in range(start, end):
        for k in range(3):
            out[k] = min(out[k], boxes[order[i], k])
            out[3 + k] = max(out[3 + k], boxes[order[i], 3 + k])


@inlined(fastmath=False)
def _half_area(box):
    x, y, z = box[3] - box[0], box[4] - box[1], box[5] - box[2]
    return x * y + y * z + z * x


@inlined(fastmath=False)
def _split(boxes, centres, order, start, end):
    """Sort the faces from `start` to `end` into two groups and return where the second begins."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for i in range(start, end):
        for k in range(3):
            low[k] = min(low[k], centres[order[i], k])
            high[k] = max(high[k], centres[order[i], k])
    axis = 0
    for k in range(1, 3):
        if high[k] - low[k] > high[axis] - low[axis]:
            axis = k
    middle = (start + end) // 2
    width = high[axis] - low[axis]
    if width <= 0.0:
        return middle
    counts = np.zeros(NUM_BINS, np.int64)
    bounds = np.empty((NUM_BINS, 6), np.float32)
    for b in range(NUM_BINS):
        for k in range(3):
            bounds[b, k], bounds[b, 3 + k] = np.float32(np.inf), np.float32(-np.inf)
    scale = NUM_BINS / width
    for i in range(start, end):
        b = min(int((centres[order[i], axis] - low[axis]) * scale), NUM_BINS - 1)
        counts[b] += 1
        for k in range(3):
            bounds[b, k] = min(bounds[b, k], boxes[order[i], k])
            bounds[b, 3 + k] = max(bounds[b, 3 + k], boxes[order[i], 3 + k])
    # Cost of the faces above each border, from the top down; then those below, upwards.
    above = np.full(NUM_BINS, np.inf)
    box, total = np.empty(6, np.float32), 0
    for k in range(3):
        box[k], box[3 + k] = np.float32(np.inf), np.float32(-np.inf)
    for b in range(NUM_BINS - 1, 0, -1):
        total += counts[b]
        for k in range(3):
            box[k], box[3 + k] = min(box[k], bounds[b, k]), max(box[3 + k], bounds[b, 3 + k])
        if total:
            above[b] = total * _half_area(box)
    best, border, total = np.inf, 0, 0
    for k in range(3):
        box[k], box[3 + k] = np.float32(np.inf), np.float32(-np.inf)
    for b in range(NUM_BINS - 1):
        total += counts[b]
        for k in range(3):
            box[k], box[3 + k] = min(box[k], bounds[b, k]), max(box[3 + k], bounds[b, 3 + k])
        if total and total < end - start:
            cost = total * _half_area(box) + above[b + 1]
            if cost < best:
                best, border = cost, b + 1
    if border == 0:
        return middle
    left, right = start, end - 1
    while left <= right:
        if min(int((centres[order[left], axis] - low[axis]) * scale), NUM_BINS - 1) < border:
            left += 1
        else:
            order[left], order[right] = order[right], order[left]
            right -= 1
    return left


@compiled(fastmath=False)
def _build(boxes, centres, order, node_boxes, children, counts):
    """Fill the nodes, sort `order` into leaves, and return the number of nodes."""
    used = 1
    # Ranges of faces that still need a node: start, end, node, depth.
    waiting = np.zeros((len(order) + 1, 4), np.int64)
    waiting[0, 1] = len(order)
    num_waiting = 1
    while num_waiting:
        num_waiting -= 1
        start, end, node = waiting[num_waiting, 0], waiting[num_waiting, 1], waiting[num_waiting, 2]
        depth = waiting[num_waiting, 3] + 1
        middle = end
        if end - start > 1:
            middle = (start + end) // 2 if depth > MAX_DEPTH else _split(boxes, centres, order, start, end)
        for side in range(2):
            first, last = (start, middle) if side == 0 else (middle, end)
            _bound(boxes, order, first, last, node_boxes[node, side])
            if last - first <= LEAF_FACES:
                children[node, side], counts[node, side] = -1 - first, last - first
            else:
                children[node, side] = used
                waiting[num_waiting, 0], waiting[num_waiting, 1] = first, last
                waiting[num_waiting, 2], waiting[num_waiting, 3] = used, depth
                num_waiting += 1
                used += 1
    return used
