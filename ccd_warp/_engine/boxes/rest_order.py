"""The order of a mesh's primitives in the rest configuration, or at other positions, by repeated halving."""

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._engine.boxes.box_sets import Order, level_sizes
from ccd_warp._engine.host.buffers import Buffers
from ccd_warp._engine.mesh.topology import (
    BLOCK_CORNERS,
    VERTEX_AABB_FLOATS,
    WIDTH,
    PrimitiveSet,
    Quantization,
    Topology,
    choose_quantization,
    sorted_keys,
)
from ccd_warp._runtime.launch import Execution
from ccd_warp.kernels.boxes import box_groups, box_tree, half_warp_tree
from ccd_warp.kernels.boxes import rest_order as kernels

# Bits of a coordinate within a segment: those of a float32.
_MOST_BITS = 24


def rest_order(topology: Topology, primitives: PrimitiveSet, execution: Execution) -> Order:
    """The order of a set in a tree, made for the undeformed mesh.

    A surface bends but neighbours stay neighbours, so this order is made once and used as long as the blocks stay
    small, which every step checks.
    """
    if primitives.name not in topology.orders:
        if topology.vertex_rank is None:
            order = order_at(topology, topology.mesh._vertices_in_space, primitives, execution)
        else:
            order = _order_by_rank(topology, topology.vertex_rank, primitives, execution)
        topology.orders.setdefault(primitives.name, order)
    return topology.orders[primitives.name]


def _order_by_rank(
    topology: Topology, rank: NDArray[np.integer], primitives: PrimitiveSet, execution: Execution
) -> Order:
    """The order of a set by the least rank of the vertices of each primitive."""
    corners = primitives.corners.numpy()[:, : primitives.num_corners]
    order = np.argsort(rank[corners].min(axis=1), kind="stable")
    return _applied(topology, wp.array(order, dtype=wp.int64, device=execution.device), -1, primitives, execution)


def order_at(
    topology: Topology, vertices: NDArray[np.float64], primitives: PrimitiveSet, execution: Execution
) -> Order:
    """The order of a set at other positions of the mesh, computed anew."""
    mesh, device = topology.mesh, topology.device
    positions: wp.array = wp.array(vertices, dtype=wp.vec3d, device=device)
    quantization = choose_quantization(topology, (vertices, vertices), 1)
    vertex_aabbs = wp.empty(mesh.num_vertices * VERTEX_AABB_FLOATS, dtype=wp.float32, device=device)
    every = topology.array(np.arange(mesh.num_vertices, dtype=np.int32))
    active = wp.ones(mesh.num_bodies, dtype=wp.int32, device=device)
    execution.launch(
        box_tree.fill_vertex_aabbs,
        mesh.num_vertices,
        inputs=[
            every,
            *topology.of_vertices(active),
            positions,
            positions,
            1.0,
            0.0,
            topology.box_radius,
            quantization.packed,
            1,
        ],
        outputs=[vertex_aabbs],
    )
    order, mask = _halved_order(topology, primitives, vertex_aabbs, quantization, execution)
    return _applied(topology, order, mask, primitives, execution)


def _applied(topology: Topology, order: wp.array, mask: int, primitives: PrimitiveSet, execution: Execution) -> Order:
    """The order of a set in new arrays, given as that of its indices."""
    return apply_order(topology, order, mask, primitives, lambda _, n, dtype: topology.empty(n, dtype), execution)


def _halved_order(
    topology: Topology,
    primitives: PrimitiveSet,
    vertex_aabbs: wp.array,
    quantization: Quantization,
    execution: Execution,
) -> tuple[wp.array, int]:
    """The indices of the primitives in their order, int64, in those bits of each number that the mask selects.

    On the CPU by selection, which takes 0.8 of the time of sorted keys on one thread and 0.45 on two. Where groups of
    bodies come first, only segments of one group are halved; the others stay in the order of the Morton curve.
    """
    count, device = primitives.count, execution.device
    centres = wp.empty(count, dtype=wp.vec4f, device=device)
    # the radix sort needs twice the size
    order = wp.empty(2 * count if execution.is_cuda else count, dtype=wp.int64, device=device)
    inputs: list[Any] = [primitives.corners, topology.vertex_body, vertex_aabbs]
    execution.launch(kernels.fill_centres, count, inputs, [centres, order])
    body_group, mask = topology.sorted_groups, (1 << primitives.index_bits) - 1
    if len(body_group):
        extent, buffers = quantization.typical_extent, Buffers(device)
        order = sorted_keys(topology, primitives, vertex_aabbs, 1, extent, buffers, execution)
    size = WIDTH << (primitives.num_blocks - 1).bit_length()
    if execution.is_cuda:
        _sort_halves(primitives, centres, body_group, size, order, execution)
        return order, mask
    if len(body_group):
        np.bitwise_and(order.numpy(), mask, out=order.numpy())
    while size > WIDTH:
        inputs = [centres, body_group, size]
        execution.launch(kernels.split_segments, -(-count // size), inputs, [order], grain=1)
        size //= 2
    return order, -1


def _sort_halves(
    primitives: PrimitiveSet,
    centres: wp.array,
    body_group: wp.array,
    size: int,
    order: wp.array,
    execution: Execution,
) -> None:
    """Halve all segments of a size at once, by a sort of all primitives; then those of half the size."""
    count, device = primitives.count, execution.device
    unused: wp.array = wp.empty(2 * count, dtype=wp.int32, device=device)
    bounds: wp.array = wp.empty(8 * primitives.num_blocks, dtype=wp.int32, device=device)
    mask = (1 << primitives.index_bits) - 1
    while size > WIDTH:
        num_segments = -(-count // size)
        bits = min(_MOST_BITS, 63 - primitives.index_bits - (num_segments - 1).bit_length())
        bounds.fill_(kernels.UNBOUNDED)
        execution.launch(kernels.bound_segments, primitives.num_blocks, [centres, count, size, mask, order], [bounds])
        inputs = [centres, bounds, body_group, size, mask, primitives.index_bits, bits]
        execution.launch(kernels.fill_keys, count, inputs, [order])
        wp.utils.radix_sort_pairs(order, unused, count)
        size //= 2


def apply_order(
    topology: Topology,
    order: wp.array,
    mask: int,
    primitives: PrimitiveSet,
    allocate: Callable[[str, int, Any], wp.array],
    execution: Execution,
) -> Order:
    """The order of a set in arrays of a name, a length and a type, given as that of its indices."""
    kernel, count = box_tree.apply_order, primitives.num_blocks
    if execution.is_cuda:
        kernel, count = half_warp_tree.order_places, WIDTH * primitives.num_blocks
    primitive = allocate(f"{primitives.name} order", primitives.count, wp.int32)
    corners = allocate(f"{primitives.name} corners", primitives.num_blocks * BLOCK_CORNERS, wp.int32)
    inputs = [order, mask, primitives.ids, primitives.corners]
    execution.launch(kernel, count, inputs, [primitive, corners], grain=64)
    if topology.groups is None:
        return primitive, corners, None
    levels = level_sizes(primitives.count)
    groups = allocate(f"{primitives.name} groups", sum(levels[1:]) * WIDTH, wp.vec2i)
    groups.fill_(wp.vec2i(0, -1))
    below, at = -1, 0
    for boxes, blocks in itertools.pairwise(levels):
        execution.launch(box_groups.unite_groups, boxes, [corners, topology.vertex_group, below, at], [groups])
        below, at = at, at + blocks * WIDTH
    return primitive, corners, groups
