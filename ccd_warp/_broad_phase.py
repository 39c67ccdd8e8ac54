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
from ccd_warp.kernels import broad_phase as kernels

_EDGE_EDGE = int(kernels.EDGE_EDGE)
_FACE_TO_VERTEX = int(kernels.FACE_TO_VERTEX)
_VERTEX_TO_FACE = int(kernels.VERTEX_TO_FACE)
_FACE_HEADROOM = int(kernels.FACE_HEADROOM)
_LARGEST_COUNT = 2**31 - 1


@dataclass(frozen=True)
class Candidates:
    """Pairs that may collide in the step.

    Attributes:
        vertex_face: Vertex and face indices, each pair once, in lexicographic order, int32, shape [m, 2].
        edge_edge: Edge indices, first < second, each pair once, in lexicographic order, int32, shape [k, 2].
    """

    vertex_face: NDArray[np.int32]
    edge_edge: NDArray[np.int32]


@dataclass(frozen=True)
class DeviceCandidates:
    """The same pairs on the device: arrays of ``wp.vec2i``, shapes [m] and [k]."""

    vertex_face: wp.array
    edge_edge: wp.array


def find_candidates(
    mesh: CollisionMesh,
    vertices_t0: ArrayLike,
    vertices_t1: ArrayLike,
    inflation: float = 0.0,
    *,
    device: Any = None,
    num_threads: int | None = None,
) -> Candidates:
    """Find the vertex-face and edge-edge pairs whose swept axis-aligned boxes overlap.

    The box of a primitive encloses its vertices at both ends of the step, grows by ``inflation`` on every side, rounded
    outward, and is closed: boxes that only touch overlap. Left out are pairs that share a vertex, pairs of two static
    bodies and pairs within a body whose self-collision is off.

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
    return Candidates(found.vertex_face.numpy().reshape(-1, 2), found.edge_edge.numpy().reshape(-1, 2))


def find_candidates_on_device(
    mesh: CollisionMesh, vertices_t0: wp.array, vertices_t1: wp.array, inflation: float, execution: Execution
) -> DeviceCandidates:
    """Like :func:`find_candidates`, for validated frames on the device; leaves the pairs there.

    The frames are ``wp.vec3d``, shape [V]. Static rows of the two frames must be equal.
    """
    arrays = mesh_arrays(mesh, execution.device)
    boxes = {}
    for kind in ("vertex", "edge", "face"):
        corners, body, is_static = arrays[kind]
        if corners.shape[0]:
            boxes[kind] = swept_boxes(corners, body, is_static, vertices_t0, vertices_t1, inflation, execution)
    moving = ~mesh.static
    search = _Search(
        execution,
        arrays["self_collision"],
        filter_bodies=int(not mesh.self_collision.all()),
        # Boxes that move all belong to one body that ignores itself: moving layers need not meet.
        skip_moving=int(moving.sum() == 1 and not mesh.self_collision[moving].any()),
    )
    vertex_face = edge_edge = wp.empty(0, dtype=wp.vec2i, device=execution.device)
    if moving.any() and "face" in boxes and "vertex" in boxes:
        ladder = choose_ladder([boxes["face"], boxes["vertex"]], execution, cell_factor=0.5)
        faces = build_grid(boxes["face"], ladder, execution)
        vertices = build_grid(boxes["vertex"], ladder, execution)
        parts = search.pairs(_FACE_TO_VERTEX, boxes["face"], faces, boxes["vertex"], vertices, ladder.origin)
        if max(faces.layers.numpy()) >> 1 > (min(vertices.layers.numpy()) >> 1) + _FACE_HEADROOM:
            parts += search.pairs(_VERTEX_TO_FACE, boxes["vertex"], vertices, boxes["face"], faces, ladder.origin)
        vertex_face = search.sorted_pairs(parts, "vertex-face")
    if moving.any() and "edge" in boxes:
        ladder = choose_ladder([boxes["edge"]], execution)
        edges = build_grid(boxes["edge"], ladder, execution)
        parts = search.pairs(_EDGE_EDGE, boxes["edge"], edges, boxes["edge"], edges, ladder.origin)
        edge_edge = search.sorted_pairs(parts, "edge-edge")
    return DeviceCandidates(vertex_face, edge_edge)


@dataclass(frozen=True)
class _Search:
    """Runs the pair kernel and gathers its keys."""

    execution: Execution
    self_collision: wp.array
    filter_bodies: int
    skip_moving: int

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

    def sorted_pairs(self, parts: list[wp.array], name: str) -> wp.array:
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
        self.execution.launch(kernels.unpack_pairs, total, inputs=[keys], outputs=[pairs])
        return pairs


def mesh_arrays(mesh: CollisionMesh, device: Any) -> dict[str, Any]:
    """Corners, bodies and static flags of each kind on the device; made once per mesh and device."""
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
            name: (
                wp.array(corners, dtype=wp.vec3i, device=device),
                wp.array(body, dtype=wp.int32, device=device),
                wp.array(mesh.static[body].astype(np.int32), dtype=wp.int32, device=device),
            )
            for name, (corners, body) in kinds.items()
        }
        arrays["self_collision"] = wp.array(mesh.self_collision.astype(np.int32), dtype=wp.int32, device=device)
        cache[key] = arrays
    return cache[key]


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
