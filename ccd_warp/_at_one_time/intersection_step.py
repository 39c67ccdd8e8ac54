"""What intersects at one time: candidates of the search, tests in float64, exact tests of what these leave open."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._at_one_time import exact_intersections as exact
from ccd_warp._at_one_time import intersection_points as points
from ccd_warp._at_one_time.edge_points import EdgePointTopology, MeshWithEdgePoints
from ccd_warp._engine.boxes.body_boxes import bodies_near
from ccd_warp._engine.host.plan import Batch, HostPlan
from ccd_warp._engine.host.step import HostStep
from ccd_warp._engine.host.workspace import Workspace
from ccd_warp._engine.mesh.planes import vertices_in_half_spaces
from ccd_warp._engine.mesh.topology import Positions
from ccd_warp._results.intersections import Intersections, located
from ccd_warp._runtime.status import IntersectionKind, PairKind, primitives_of
from ccd_warp.kernels.at_one_time import intersections as kernels

_APART, _FOUND, _OPEN = int(kernels.APART), int(kernels.FOUND), int(kernels.OPEN)
# Pairs of an edge and a face whose vertices and sides are tested at a time.
_CHUNK = 1 << 18
_INDEX = 0xFFFFFFFF
Keys = NDArray[np.int64]
_NO_KEYS = np.zeros(0, dtype=np.int64)


@dataclass(frozen=True)
class _Tests:
    """How a kind of pair is decided exactly, and where its common points are in float64."""

    exact: Callable[..., exact.Parameters | None]
    approximate: Callable[..., points.Approximate]


_TESTS = {
    IntersectionKind.VERTEX_FACE: _Tests(exact.vertex_in_face, points.in_face),
    IntersectionKind.EDGE_EDGE: _Tests(exact.edges_meet, points.of_edges),
    IntersectionKind.POINT_SEGMENT: _Tests(exact.point_on_segment, points.on_segment),
    IntersectionKind.POINT_POINT: _Tests(exact.points_equal, points.of_points),
    IntersectionKind.EDGE_FACE: _Tests(exact.edge_through_face, points.through_face),
}
_CROSSING_IN_PLANE = _Tests(exact.edges_cross_in_plane, points.of_edges)


class IntersectionStep(HostStep):
    """The search at one time, as a step in which only the points of the edges move (`edge_points`)."""

    goal = "intersections"
    result_bytes = 4  # of a code
    topology: EdgePointTopology

    def __init__(self, workspace: Workspace, positions: Positions, *arguments: Any) -> None:
        """Begin at the first of these positions; the other arguments are those of every step."""
        of_edges = workspace.at_one_time(
            "intersections", lambda topology: EdgePointTopology.of(topology.mesh, topology.device)
        )
        topology = of_edges.topology
        assert isinstance(topology, EdgePointTopology)
        self.mesh_topology = workspace.topology
        self.points: MeshWithEdgePoints = topology.mesh
        self.original = self.points.original
        self.x = positions[0]
        super().__init__(of_edges, of_edges.own_positions, *arguments)
        self._decided: dict[IntersectionKind, list[Keys]] = {kind: [] for kind in IntersectionKind}
        self._open: dict[IntersectionKind, list[Keys]] = {kind: [] for kind in IntersectionKind}

    def _bodies_near(self) -> NDArray[np.bool_] | None:
        """Bodies that may intersect, or None for all."""
        topology = self.mesh_topology
        if not topology.may_have_inactive_bodies:
            return None
        near = bodies_near(topology, (self.x, self.x), 0.0, self.execution)
        self._num_active_bodies = int((near | self.original.static).sum())
        return near

    @property
    def fixed_bytes(self) -> int:
        """Bytes of the topology and the boxes, and of the positions with those of the points of the edges."""
        return super().fixed_bytes + sum(array.nbytes for array in self.positions)

    def intersections(self) -> Intersections:
        """All pairs that touch or pass through each other."""
        with self.timed("input"):
            execution = HostPlan.of(self.workspace, self.options, self.goal, self.norm(), self.motion).execution
            fill = self.points.fill_positions
            execution.run([lambda k=k, at=at: fill(self.x, at, k) for k, at in enumerate(self.positions)])  # type: ignore[misc]
        whole = self.played_whole()
        for batch in self._searched() if whole is None else (whole,):
            with self.timed("tests"):
                for kind, count in batch.num_pairs.items():
                    if count:
                        keys = self.plan.memory.keys(kind, count)
                        self._take(kind, keys, self.topology.corner_arrays(kind))
        with self.timed("tests"):
            self._take_more(PairKind.EDGE_EDGE, _keys_of(self.points.close_edges))
        with self.timed("exact"):
            parts = [self._of_kind(kind) for kind in IntersectionKind]
            kinds, pairs, parameters = (np.concatenate(part) for part in zip(*parts, strict=True))
        self.finish(num_vertices=self.original.num_vertices)
        return located(self.original, self.x[:, : self.original.dimension], kinds, pairs, parameters)

    def _searched(self) -> Iterator[Batch]:
        """The batches of a search that is played section by section."""
        plan = self.begin()
        with self.timed("pairs"):
            plan.set_search(self.t_end, self.inflation, self.separation)
            batches = plan.batches(self.capacity())
        return self.batches(batches)

    def _take(self, kind: PairKind, keys: wp.array, corner_arrays: tuple[str, str]) -> None:
        """Test pairs, given by keys on the device, and keep those that are not apart."""
        pair_codes = self.workspace.buffers.get("pair codes", len(keys), wp.int32)
        self.execution.launch(
            kernels.test_pairs,
            len(keys),
            inputs=[
                int(kind),
                int(self.original.dimension == 2),
                keys,
                *(self.topology.corners[name] for name in corner_arrays),
                self.original.num_vertices,
                self.vertices_t0,
            ],
            outputs=[pair_codes],
        )
        codes = pair_codes[: len(keys)].numpy()
        kept = np.flatnonzero(codes != _APART)
        host_keys, codes = keys.numpy()[kept], codes[kept]
        if kind != PairKind.VERTEX_FACE or corner_arrays[0] == "vertex":
            self._keep(IntersectionKind(int(kind)), host_keys, codes)
            return
        is_edge = host_keys >> 32 < self.original.num_edges
        self._keep(IntersectionKind.EDGE_FACE, host_keys[is_edge], codes[is_edge])
        vertices = self.points.tested_vertices[(host_keys[~is_edge] >> 32) - self.original.num_edges].astype(np.int64)
        self._keep(IntersectionKind.VERTEX_FACE, vertices << 32 | host_keys[~is_edge] & _INDEX, codes[~is_edge])
        if not self.points.covers_less:
            self._take_parts(host_keys[is_edge & (codes != _FOUND)])

    def _keep(self, kind: IntersectionKind, keys: Keys, codes: NDArray[np.int32]) -> None:
        self._decided[kind].append(keys[codes == _FOUND])
        self._open[kind].append(keys[codes == _OPEN])

    def _take_parts(self, keys: Keys) -> None:
        """Test the ends of edges, and the sides of faces, that are not apart, though the edge is not seen to pass."""
        mesh = self.original
        for k in range(0, len(keys), _CHUNK):
            edge, face = keys[k : k + _CHUNK] >> 32, keys[k : k + _CHUNK] & _INDEX
            ends = mesh.edges[edge].astype(np.int64)
            self._take_more(PairKind.VERTEX_FACE, (ends << 32 | face[:, None]).ravel())
            sides = self.points.face_edges[face].astype(np.int64)
            sides, edges = sides[sides >= 0], np.broadcast_to(edge[:, None], sides.shape)[sides >= 0]
            self._take_more(PairKind.EDGE_EDGE, np.minimum(edges, sides) << 32 | np.maximum(edges, sides))

    def _take_more(self, kind: PairKind, keys: Keys) -> None:
        """Test pairs that the search has not given."""
        if len(keys) == 0:
            return
        on_device: wp.array = wp.array(_distinct(keys), dtype=wp.int64, device=self.topology.device)
        self._take(kind, on_device, ("vertex", "face") if kind == PairKind.VERTEX_FACE else ("edge", "edge"))

    def _of_kind(self, kind: IntersectionKind) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.float64]]:
        """The kind, the primitives and the parameters of all intersections of a kind, in lexicographic order."""
        if kind == IntersectionKind.VERTEX_PLANE and len(self.original.planes):
            pairs = _pairs_of(_keys_of(vertices_in_half_spaces(self.original, self.x)))
            return np.full(len(pairs), int(kind), dtype=np.int32), pairs, np.zeros((len(pairs), 3))
        decided, is_open = (_distinct(keys) for keys in (self._decided[kind], self._open[kind]))
        if len(decided) + len(is_open) == 0:
            return np.zeros(0, dtype=np.int32), np.zeros((0, 2), dtype=np.int32), np.zeros((0, 3))
        listed = _keys_of(self.original.exclude_pairs.get(kind.name.lower(), np.zeros((0, 2), dtype=np.int32)))
        if len(listed):
            decided, is_open = (keys[~np.isin(keys, listed)] for keys in (decided, is_open))
        tests = _TESTS[kind]
        if kind == IntersectionKind.EDGE_EDGE and self.original.dimension == 2:
            tests = _CROSSING_IN_PLANE
        parameters, is_accurate = points.approximate(tests.approximate, self.x, self._corners(kind, decided))
        is_open = np.concatenate([is_open, decided[~is_accurate]])
        passes, exactly = exact.decide(tests.exact, self.x, self._corners(kind, is_open))
        keys = np.concatenate([decided[is_accurate], is_open[passes]])
        parameters = np.concatenate([parameters[is_accurate], exactly[passes]])
        order = np.argsort(keys)
        keys = keys[order]
        return np.full(len(keys), int(kind), dtype=np.int32), _pairs_of(keys), parameters[order]

    def _corners(self, kind: IntersectionKind, keys: Keys) -> NDArray[np.int32]:
        """The vertices of both primitives of each pair, side by side."""
        tables = {"edge": self.original.edges, "face": self.original.faces}
        sides = []
        for name, ids in zip(primitives_of(kind), (keys >> 32, keys & _INDEX), strict=True):
            sides.append(ids[:, None].astype(np.int32) if name == "vertex" else tables[name][ids])
        return np.hstack(sides)


def _keys_of(pairs: NDArray[np.int32]) -> Keys:
    """Pairs as numbers, in the order of the pairs."""
    first, second = pairs.T.astype(np.int64)
    return first << 32 | second


def _pairs_of(keys: Keys) -> NDArray[np.int32]:
    """The pairs that numbers stand for, shape [n, 2]."""
    return np.stack([keys >> 32, keys & _INDEX], axis=1).astype(np.int32)


def _distinct(keys: Keys | list[Keys]) -> Keys:
    """Each of some numbers once, ascending."""
    joined: Any = np.concatenate(keys or [_NO_KEYS]) if isinstance(keys, list) else keys
    distinct: Keys = np.unique(joined) if len(joined) else joined
    return distinct
