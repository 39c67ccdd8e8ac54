"""Candidate pairs: primitives whose swept boxes overlap."""

import sys
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from ccd_warp._box_grid import (
    Boxes,
    Execution,
    build_grid,
    choose_ladder,
    key_array,
    sort_keys,
    swept_boxes,
)
from ccd_warp._launch import default_num_threads
from ccd_warp._mesh import CollisionMesh
from ccd_warp._status import PairKind
from ccd_warp.kernels import broad_phase as kernels

_WITHIN_SET = int(kernels.WITHIN_SET)
_SECOND_TO_FIRST = int(kernels.SECOND_TO_FIRST)
_FIRST_TO_SECOND = int(kernels.FIRST_TO_SECOND)
_SECOND_HEADROOM = int(kernels.SECOND_HEADROOM)
_LARGEST_COUNT = 2**31 - 1


@dataclass(frozen=True)
class Candidates:
    """Pairs that may collide in the step, each once, in lexicographic order.

    Attributes:
        vertex_face: Vertex and face indices, int32, shape [m, 2].
        edge_edge: Edge indices, first < second, int32, shape [k, 2].
        point_segment: Indices of loose points among the vertices and of loose edges among the edges, int32,
            shape [n, 2]; empty where the mesh has none.
        point_point: Indices of loose points among the vertices, first < second, int32, shape [l, 2]; likewise.
    """

    vertex_face: NDArray[np.int32]
    edge_edge: NDArray[np.int32]
    point_segment: NDArray[np.int32]
    point_point: NDArray[np.int32]


@dataclass(frozen=True)
class DeviceCandidates:
    """The same pairs on the device: arrays of ``wp.vec2i``, one-dimensional."""

    vertex_face: wp.array
    edge_edge: wp.array

    point_segment: wp.array
    point_point: wp.array

    def by_kind(self) -> list[tuple[PairKind, wp.array]]:
        """The kinds that occur, with their pairs."""
        kinds = [(kind, getattr(self, kind.name.lower())) for kind in PairKind]
        return [(kind, pairs) for kind, pairs in kinds if len(pairs)]


def find_candidates(
    mesh: CollisionMesh,
    vertices_t0: ArrayLike,
    vertices_t1: ArrayLike,
    inflation: float = 0.0,
    *,
    device: Any = None,
    num_threads: int | None = None,
) -> Candidates:
    """Find the pairs of primitives whose swept axis-aligned boxes overlap.

    The box of a primitive encloses its vertices at both ends of the step, grows by ``inflation`` on every side, rounded
    outward, and is closed: boxes that only touch overlap. Left out are pairs that share a vertex, pairs of two static
    bodies and pairs within a body whose self-collision is off.

    Four kinds of pair are enough: vertices with faces, edges with edges, loose points with loose edges, and loose
    points with each other. What collides are faces, loose edges and loose points: convex sets, two of which, A and B,
    are as far apart in any norm as the origin is from the polytope A - B, which is at its boundary while they do not
    touch. For two faces, or a face and a loose edge, that boundary consists of differences (vertex) - (face) and
    (edge) - (edge), and where A - B is flat these cover all of it. Two loose edges are an edge-edge pair as they stand,
    a loose point and a face a vertex-face pair. So a loose point and an edge of a face need no pair: the edge is part
    of the face and no nearer. Nor do a vertex of an edge and a loose edge: the vertex is part of its own edge. Loose
    points with loose edges, and with each other, are all that is left, and are looked for only where they exist.
    Because pairs that share a vertex are left out, a cable that folds back on itself at a joint is not noticed by the
    two segments of that joint, as two faces with a common edge meet only through their other vertices.

    Args:
        mesh: The bodies.
        vertices_t0: Start positions, float, same length unit as the mesh, shape [V, 3].
        vertices_t1: End positions, shape [V, 3], where rows of static bodies are not read; or of the moving vertices
            only, shape [V_moving, 3].
        inflation: Growth of every box on every side, a length in the unit of the mesh, finite and not negative.
        device: Warp device; by default Warp's current one.
        num_threads: Threads on the CPU; by default one a core. The result does not depend on it.

    Returns:
        The pairs, sorted.

    Raises:
        ValueError: If the frames do not match the mesh, a value that is read is not finite, ``inflation`` is negative
            or not finite, or ``num_threads`` is less than one.
        OverflowError: If there are more pairs of a kind than int32 can index.

    References:
        Teschner et al. 2003, "Optimized spatial hashing for collision detection of deformable objects" (hashed cells);
        Mirtich 1997, "Efficient algorithms for two-phase collision detection" (one level per box size).

    Guarantee: every pair whose boxes overlap is found, exactly once, and no other pair. The boxes of two primitives
    that come within ``inflation`` of each other (L∞) during the step overlap.
    """
    inflation = validated_inflation(inflation)
    execution = Execution(wp.get_device(device), validated_num_threads(num_threads))
    start, end = mesh.frames(vertices_t0, vertices_t1)
    found = find_candidates_on_device(
        mesh,
        wp.array(start, dtype=wp.vec3d, device=execution.device, copy=False),
        wp.array(end, dtype=wp.vec3d, device=execution.device, copy=False),
        inflation,
        execution,
    )
    kinds = (found.vertex_face, found.edge_edge, found.point_segment, found.point_point)
    return Candidates(*(pairs.numpy().reshape(-1, 2) for pairs in kinds))


def find_candidates_on_device(
    mesh: CollisionMesh, vertices_t0: wp.array, vertices_t1: wp.array, inflation: float, execution: Execution
) -> DeviceCandidates:
    """Like :func:`find_candidates`, for validated frames on the device; leaves the pairs there.

    The frames are ``wp.vec3d``, shape [V]. Static rows of the two frames must be equal.
    """
    arrays = mesh_arrays(mesh, execution.device)

    def boxes(name: str) -> Boxes:
        corners, body, is_static = arrays[name][:3]
        return swept_boxes(corners, body, is_static, vertices_t0, vertices_t1, inflation, execution)

    moving = ~mesh.static
    search = _Search(
        execution,
        arrays["self_collision"],
        filter_bodies=int(not mesh.self_collision.all()),
        # Boxes that move all belong to one body that ignores itself: moving layers need not meet.
        skip_moving=int(moving.sum() == 1 and not mesh.self_collision[moving].any()),
    )
    none = wp.empty(0, dtype=wp.vec2i, device=execution.device)
    vertex_face = edge_edge = point_segment = point_point = none
    if moving.any() and mesh.num_faces:
        vertex_face = search.between(boxes("vertex"), boxes("face"), "vertex-face", cell_factor=0.5)
    if moving.any() and mesh.num_edges:
        edge_edge = search.within(boxes("edge"), "edge-edge")
    if moving.any() and len(mesh.loose_points):
        points, point_ids = boxes("loose_point"), arrays["loose_point"][3]
        if len(mesh.loose_edges):
            segment_ids = arrays["loose_edge"][3]
            point_segment = search.between(points, boxes("loose_edge"), "point-segment", ids=(point_ids, segment_ids))
        point_point = search.within(points, "point-point", ids=(point_ids, point_ids))
    return DeviceCandidates(vertex_face, edge_edge, point_segment, point_point)


@dataclass(frozen=True)
class _Search:
    """Runs the pair kernel and gathers its keys.

    Where the boxes are those of a subset of the mesh's primitives, ``ids`` tells which.
    """

    execution: Execution
    self_collision: wp.array
    filter_bodies: int
    skip_moving: int

    def between(
        self,
        first: Boxes,
        second: Boxes,
        name: str,
        cell_factor: float = 1.0,
        ids: tuple[wp.array, wp.array] | None = None,
    ) -> wp.array:
        """Pairs of a small primitive with a large one, sorted."""
        ladder = choose_ladder([second, first], self.execution, cell_factor)
        large = build_grid(second, ladder, self.execution)
        small = build_grid(first, ladder, self.execution)
        parts = self.pairs(_SECOND_TO_FIRST, second, large, first, small, ladder.origin)
        if max(large.layers.numpy()) >> 1 > (min(small.layers.numpy()) >> 1) + _SECOND_HEADROOM:
            parts += self.pairs(_FIRST_TO_SECOND, first, small, second, large, ladder.origin)
        return self.sorted_pairs(parts, name, ids)

    def within(self, boxes: Boxes, name: str, ids: tuple[wp.array, wp.array] | None = None) -> wp.array:
        """Pairs of primitives of one set, first < second, sorted."""
        ladder = choose_ladder([boxes], self.execution)
        grid = build_grid(boxes, ladder, self.execution)
        return self.sorted_pairs(self.pairs(_WITHIN_SET, boxes, grid, boxes, grid, ladder.origin), name, ids)

    def pairs(
        self, kind: int, query: Boxes, query_grid: Any, target: Boxes, target_grid: Any, origin: Any
    ) -> list[wp.array]:
        """Unsorted keys of all pairs, in parts."""
        device = self.execution.device
        common = [
            kind,
            query_grid,
            target_grid,
            target_grid.words,
            target_grid.entry_begin,
            query.corners,
            target.corners,
            query.body,
            target.body,
            self.self_collision,
            self.filter_bodies,
            self.skip_moving,
            origin,
            query.count,
        ]

        def run(first: int, stride: int, block: int, room: NDArray[np.int64]) -> tuple[NDArray[np.int64], wp.array]:
            begin = np.concatenate([[0], np.cumsum(room)])
            if begin[-1] > _LARGEST_COUNT:
                raise OverflowError(f"{begin[-1]} candidate pairs of one kind; expected at most {_LARGEST_COUNT}")
            count = wp.empty(len(room), dtype=wp.int64, device=device)
            keys = wp.empty(int(begin[-1]), dtype=wp.int64, device=device)
            scratch_size = 16 if self.execution.is_cuda else 1024
            scratch = wp.empty(len(room) * scratch_size, dtype=wp.int32, device=device)
            pair_begin: wp.array = wp.array(begin, dtype=wp.int64, device=device)
            self.execution.launch(
                kernels.find_pairs,
                len(room),
                inputs=[*common, block, first, stride, pair_begin, scratch, scratch_size],
                outputs=[count, keys],
                grain=1,
            )
            return count.numpy(), keys

        if self.execution.is_cuda:
            items = query.count
            count, _ = run(0, items, 1, np.zeros(items, dtype=np.int64))
            return [run(0, items, 1, count)[1]]

        # On the CPU a launch is serial, so few items with much work each: a first share of the blocks, spread over
        # the scene, foretells how much room the others need. An item that lacked room runs again.
        parts: list[wp.array] = []

        def collect(first: int, stride: int, block: int, room: NDArray[np.int64]) -> int:
            count, keys = run(first, stride, block, room)
            begin = np.concatenate([[0], np.cumsum(room)])
            for t in range(len(room)):
                if count[t] <= room[t]:
                    parts.append(keys[int(begin[t]) : int(begin[t] + count[t])] if count[t] else keys[:0])
                else:
                    parts.append(run(first + t, stride, block, count[t : t + 1])[1])
            return int(count.max())

        block = 64
        threads = self.execution.num_threads
        items = 16 * threads
        most = collect(0, items, block, np.full(threads, 8 * (-(-query.count // items)) + 1024, dtype=np.int64))
        if query.count > threads * block:
            collect(threads, items, block, np.full(items - threads, most + most // 4 + 1024, dtype=np.int64))
        return parts

    def sorted_pairs(self, parts: list[wp.array], name: str, ids: tuple[wp.array, wp.array] | None = None) -> wp.array:
        """The pairs of all parts in lexicographic order."""
        total = sum(part.shape[0] for part in parts)
        if total > _LARGEST_COUNT:
            raise OverflowError(f"{total} {name} candidate pairs; expected at most {_LARGEST_COUNT}")
        keys = key_array(total, self.execution)
        if self.execution.is_cuda:
            position = 0
            for part in parts:
                wp.copy(keys, part, dest_offset=position, count=part.shape[0])
                position += part.shape[0]
        elif total:
            np.concatenate([part.numpy() for part in parts], out=keys.numpy())
        sort_keys(keys, total, self.execution)
        pairs = wp.empty(total, dtype=wp.vec2i, device=self.execution.device)
        if ids is None:
            self.execution.launch(kernels.unpack_pairs, total, inputs=[keys], outputs=[pairs])
        else:
            self.execution.launch(kernels.unpack_subset_pairs, total, inputs=[keys, *ids], outputs=[pairs])
        return pairs


def mesh_arrays(mesh: CollisionMesh, device: Any) -> dict[str, Any]:
    """Corners, bodies and static flags of each kind on the device; made once per mesh and device.

    Loose points and loose edges have a fourth array, their indices among all vertices or edges.
    """
    cache: dict[str, dict[str, Any]] = mesh._device_cache  # type: ignore[attr-defined]
    key = str(device)
    if key not in cache:
        vertex = np.arange(mesh.num_vertices, dtype=np.int32)
        kinds = {
            "vertex": (np.stack([vertex] * 3, axis=1), mesh.vertex_body),
            "edge": (mesh.edges[:, [0, 1, 1]], mesh.edge_body),
            "face": (mesh.faces, mesh.face_body),
        }
        arrays: dict[str, Any] = {
            name: _on_device(corners, body, mesh, device) for name, (corners, body) in kinds.items()
        }
        for name, kind, ids in (("loose_point", "vertex", mesh.loose_points), ("loose_edge", "edge", mesh.loose_edges)):
            if len(ids):
                corners, body = (array[ids] for array in kinds[kind])
                arrays[name] = (*_on_device(corners, body, mesh, device), wp.array(ids, dtype=wp.int32, device=device))
        arrays["self_collision"] = wp.array(mesh.self_collision.astype(np.int32), dtype=wp.int32, device=device)
        cache[key] = arrays
    return cache[key]


def _on_device(
    corners: NDArray[np.int32], body: NDArray[np.int32], mesh: CollisionMesh, device: Any
) -> tuple[wp.array, wp.array, wp.array]:
    return (
        wp.array(corners, dtype=wp.vec3i, device=device),
        wp.array(body, dtype=wp.int32, device=device),
        wp.array(mesh.static[body].astype(np.int32), dtype=wp.int32, device=device),
    )


def validated_inflation(value: float) -> float:
    """The inflation as a float, or a ValueError."""
    real = isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)
    if not real or not 0 <= value <= sys.float_info.max:
        raise ValueError(f"inflation is {value!r}; expected a finite length that is not negative")
    return float(value)


def validated_num_threads(value: int | None) -> int:
    """The number of threads, one a core by default, or a ValueError."""
    if value is None:
        return default_num_threads()
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < 1:
        raise ValueError(f"num_threads is {value!r}; expected a positive integer or None")
    return int(value)
