"""Bodies that another may touch: a search among the swept boxes of whole bodies, of few of them all with all."""

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._engine.mesh.topology import WIDTH, Positions, Topology
from ccd_warp._runtime.launch import Execution
from ccd_warp.kernels.boxes import body_boxes as kernels

_MORTON_BITS = 10  # of each axis
# Shifts and masks that move the bits of a number three places apart.
_SPREAD = ((16, 0x030000FF), (8, 0x0300F00F), (4, 0x030C30C3), (2, 0x09249249))
_LARGEST = np.finfo(np.float64).max
# Bodies up to which all boxes are compared at once, which costs less than a tree.
_FEW_BODIES = 32
# Pairs of bodies above which a search may take long in the worst case: all boxes overlap, and no pair is allowed.
_LONG_SEARCH = 1 << 24


def bodies_near(
    topology: Topology,
    positions: Positions,
    inflation: float,
    execution: Execution,
    vertex_radius: NDArray[np.float64] | None = None,
) -> NDArray[np.bool_]:
    """Which bodies that move may collide: with themselves, or with another whose swept box meets theirs.

    Those that are kinematic always may.

    Args:
        topology: The bodies.
        positions: Start and end positions.
        inflation: Growth of every box on every side, a length.
        execution: Where to search.
        vertex_radius: Radii of the vertices in place of those of the mesh.

    Returns:
        Flags, shape [B].

    Guarantee: if two bodies may collide, one of them moves, and their inflated boxes intersect, each of them that moves
    is marked.
    """
    mesh = topology.mesh
    near = (mesh.self_collision | mesh.kinematic) & ~mesh.static
    filled = np.flatnonzero(np.diff(mesh.body_vertex_range))
    is_query = ~mesh.static[filled] & ~near[filled]
    if not is_query.any():
        return near
    first = mesh.body_vertex_range[filled]
    vertex_radius = mesh.radius if vertex_radius is None else vertex_radius
    radius = None if vertex_radius is None else np.maximum.reduceat(vertex_radius, first)
    boxes = (
        np.minimum.reduceat(np.minimum(*positions), first, axis=0),
        np.maximum.reduceat(np.maximum(*positions), first, axis=0),
    )
    device = execution.device
    with np.errstate(over="ignore", under="ignore"):
        lower, upper = _inflated(*boxes, radius, inflation)
        if mesh.num_bodies <= _FEW_BODIES:
            overlaps = ((lower[:, None] <= upper) & (lower <= upper[:, None])).all(axis=2)
            meets = overlaps & topology.bodies_that_may_meet[np.ix_(filled, filled)]
            near[filled[is_query & meets.any(axis=1)]] = True
            return near
        tree, order = _tree(lower, upper, filled, device)
    queries = np.flatnonzero(is_query[order]).astype(np.int32)
    marks: wp.array = wp.zeros(mesh.num_bodies, dtype=wp.int32, device=device)
    assert execution.flag
    execution.launch(
        kernels.mark_bodies_near,
        len(queries),
        inputs=[
            wp.array(queries, dtype=wp.int32, device=device, copy=False),
            tree,
            topology.collision_filter,
            execution.flag.array,
        ],
        outputs=[marks],
        grain=256,
        is_long=lambda: len(queries) * len(filled) > _LONG_SEARCH,
    )
    return near | (marks.numpy() != 0)


def _inflated(
    lower: NDArray[np.float64], upper: NDArray[np.float64], radius: NDArray[np.float64] | None, inflation: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Boxes inflated, also by the radius of each, and rounded outward."""
    if inflation > 0.0:
        lower = np.nextafter(lower - inflation, -np.inf)
        upper = np.nextafter(upper + inflation, np.inf)
    if radius is not None:
        largest = radius[:, None]
        lower = np.nextafter(lower - largest, -np.inf)
        upper = np.nextafter(upper + largest, np.inf)
    return lower, upper


def _mapped(lower: NDArray[np.float64], upper: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Corners by a monotone map to [0, 1]."""
    lower, upper = (0.25 * np.clip(corners, -_LARGEST, _LARGEST) for corners in (lower, upper))
    least = lower.min(axis=0)
    lower, upper = lower - least, upper - least
    exponent = -np.frexp(upper.max())[1]
    return np.ldexp(lower, exponent), np.ldexp(upper, exponent)


def _along_curve(corners: NDArray[np.float64]) -> NDArray[np.intp]:
    """An order of points in [0, 1] along the Morton curve; any order is right, and this one is fast."""
    cell = (corners * (2**_MORTON_BITS - 1)).astype(np.int64)
    for shift, mask in _SPREAD:
        cell = (cell | cell << shift) & mask
    return np.argsort(cell[:, 0] | cell[:, 1] << 1 | cell[:, 2] << 2)


def _levels(lower: NDArray[np.float32], upper: NDArray[np.float32]) -> list[NDArray[np.float32]]:
    """Blocks of each level over boxes in their order, from level 0 on; shapes [blocks, 6, 16]."""
    levels: list[NDArray[np.float32]] = []
    while not levels or len(levels[-1]) > 1:
        num_blocks = -(-len(lower) // WIDTH)
        boxes = np.empty((num_blocks * WIDTH, 6), dtype=np.float32)
        boxes[: len(lower), :3], boxes[: len(lower), 3:] = lower, upper
        boxes[len(lower) :, :3], boxes[len(lower) :, 3:] = np.inf, -np.inf
        levels.append(boxes.reshape(num_blocks, WIDTH, 6).transpose(0, 2, 1))
        lower, upper = levels[-1][:, :3].min(axis=2), levels[-1][:, 3:].max(axis=2)
    return levels


def _tree(
    lower: NDArray[np.float64], upper: NDArray[np.float64], body: NDArray[np.intp], device: wp.Device
) -> tuple[Any, NDArray[np.intp]]:
    """The tree over the boxes of bodies, and its order."""
    low, high = _mapped(lower, upper)
    order = _along_curve(0.5 * low + 0.5 * high)
    levels = _levels(low[order].astype(np.float32), high[order].astype(np.float32))
    tree = kernels.BodyTree()
    tree.num_levels = len(levels)
    begin = 0
    for k, level in enumerate(levels):
        tree.block_begin[k] = begin
        begin += len(level)
    nodes = np.concatenate([level.reshape(-1) for level in levels])
    tree.nodes = wp.array(nodes, dtype=wp.float32, device=device, copy=False)
    tree.lower = wp.array(lower[order], dtype=wp.vec3d, device=device, copy=False)
    tree.upper = wp.array(upper[order], dtype=wp.vec3d, device=device, copy=False)
    tree.body = wp.array(body[order].astype(np.int32), dtype=wp.int32, device=device, copy=False)
    return tree, order
