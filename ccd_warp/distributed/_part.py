"""The engine on one rank: the primitives that a plan has sent there, and the steps that ranks make together."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._engine.body_boxes import bodies_near_boxes, swept_boxes
from ccd_warp._engine.host_plan import Goal, HostPlan
from ccd_warp._engine.host_step import Step
from ccd_warp._engine.line_search import OneProcess
from ccd_warp._engine.topology import Positions, PrimitiveSet, Topology
from ccd_warp._input.half_spaces import planes_of
from ccd_warp._mesh import CollisionMesh
from ccd_warp._runtime.lazy import lazy_property
from ccd_warp._status import PairKind
from ccd_warp.distributed._exchange import Exchange
from ccd_warp.distributed._mesh import DistributedMesh
from ccd_warp.distributed._ranks import Ranks
from ccd_warp.kernels.minima import FOUND


@dataclass(frozen=True)
class Part:
    """The primitives of a rank's region, and what leads back to the whole mesh.

    Attributes:
        mesh: They, with the vertices that they use; all bodies and worlds of the whole mesh, many without vertices.
        vertex_numbers: Index of each vertex in the whole mesh, ascending, int64, shape [n].
        vertex_ids: Its id, int64, shape [n].
        edge_numbers: Index of each edge in the whole mesh, ascending.
        face_numbers: Index of each face, likewise.
        tested_vertices: The vertices whose own box meets the region; the others are there for edges and faces.
        box_radius: The largest radius of the primitives around each vertex in the whole mesh, float64, shape [n].
        everything: The exchange of all vertices with their owners.
        moving: That of the vertices of bodies that move.
    """

    mesh: CollisionMesh
    vertex_numbers: NDArray[np.int64]
    vertex_ids: NDArray[np.int64]
    edge_numbers: NDArray[np.int64]
    face_numbers: NDArray[np.int64]
    tested_vertices: NDArray[np.int32]
    box_radius: NDArray[np.float64]
    everything: Exchange
    moving: Exchange


def part_mesh(
    whole: DistributedMesh,
    vertices: NDArray[np.float64],
    bodies: NDArray[np.int64],
    worlds: NDArray[np.int64],
    radius: NDArray[np.float64] | None,
    faces: NDArray[np.int32],
    edges: NDArray[np.int32],
    codimensional_edges: NDArray[np.int32],
    codimensional_points: NDArray[np.int32],
) -> CollisionMesh:
    """A mesh of given primitives alone: no edge is derived from a face, whose edges may belong to other ranks."""
    begin = np.searchsorted(bodies, np.arange(whole.num_bodies + 1)).astype(np.int32)
    vertex_body = bodies.astype(np.int32)
    state: dict[str, Any] = dict(
        vertices=vertices,
        faces=faces,
        edges=edges,
        codimensional_edges=codimensional_edges,
        codimensional_points=codimensional_points,
        vertex_body=vertex_body,
        edge_body=vertex_body[edges[:, 0]],
        face_body=vertex_body[faces[:, 0]],
        body_vertex_range=begin,
        static=whole.static,
        self_collision=whole.self_collision,
        moving_vertices=np.flatnonzero(~whole.static[vertex_body]).astype(np.int32),
        body_pairs=whole.body_pairs,
        exclusion_rings=whole.exclusion_rings,
        vertex_world=worlds.astype(np.int32),
        names=whole.names,
        exclude_pairs=whole.exclude_pairs,
        radius=radius,
        planes=planes_of([], 3),
    )
    assert state.keys() == {f.name for f in fields(CollisionMesh)}
    mesh = object.__new__(CollisionMesh)
    mesh.__setstate__(state)
    # lazy properties of the whole mesh, which a part cannot tell
    vars(mesh).update(num_worlds=whole.num_worlds, length_scale=whole.length_scale, is_thick=whole.is_thick)
    return mesh


class PartTopology(Topology):
    """The data of a part on a device; its collision filter leaves out pairs that belong to other ranks."""

    def __init__(
        self,
        part: Part,
        device: Any,
        vertex_lower: NDArray[np.float64],
        region: tuple[NDArray[np.float64], NDArray[np.float64]],
        rings: tuple[NDArray[np.int32], NDArray[np.int32]] | None,
        is_whole: bool,
    ) -> None:
        """The data of a part.

        Args:
            part: The part.
            device: The device.
            vertex_lower: Lower corner of the box of each vertex in the plan, shape [n, 4].
            region: Lower and upper corner of the region.
            rings: The vertices that must not meet each vertex, as of `rings.excluded_vertices`.
            is_whole: Whether this is all of the mesh, so that no pair belongs elsewhere.
        """
        super().__init__(part.mesh, device)
        self._part = part
        self._vertex_lower, self._region, self._rings, self._is_whole = vertex_lower, region, rings, is_whole
        # positions of the samples of the whole mesh in this step, as `sampled` gives them
        self.samples_of_all: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None

    def sampled(self, positions: Positions) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Positions of the samples of the whole mesh, so that all ranks and one process choose one quantization."""
        if self.samples_of_all is None:
            return super().sampled(positions)
        vertices, primitives = self.samples_of_all
        return vertices.copy(), primitives.copy()

    @lazy_property
    def box_radius(self) -> wp.array:
        """For each vertex the largest radius of the primitives around it, some of which may be on other ranks."""
        return self.array(self._part.box_radius if self.mesh.radius is not None else np.zeros(0), wp.float64)

    def _make_set(self, kind: str, is_static: bool) -> PrimitiveSet:
        if kind != "vertex":
            return super()._make_set(kind, is_static)
        mesh, tested = self.mesh, self._part.tested_vertices
        ids = tested[mesh.static[mesh.vertex_body[tested]] == is_static]
        corners = self.array(np.repeat(ids[:, None], 3, axis=1), wp.vec3i)
        return PrimitiveSet(f"{'static' if is_static else 'moving'} vertex", is_static, 1, self.array(ids), corners)

    def _excluded_vertices(self) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        assert self._rings
        return self._rings

    def _make_filter(self) -> Any:
        collision_filter = super()._make_filter()
        if self._rings is not None and not collision_filter.by_ring:
            collision_filter.by_ring, collision_filter.applies = 1, 1
            collision_filter.ring_begin, collision_filter.ring = (self.array(array) for array in self._rings)
        if not self._is_whole:
            collision_filter.by_region, collision_filter.applies = 1, 1
            lower, upper = self._region
            collision_filter.region_lower, collision_filter.region_upper = wp.vec4d(*lower), wp.vec4d(*upper)
            collision_filter.vertex_lower = self.array(self._vertex_lower, wp.vec4d)
        return collision_filter

    @property
    def has_lists(self) -> bool:
        """Whether the search of meshes with lists is needed, which asks for the region, too."""
        return not self._is_whole or super().has_lists


class TogetherIn:
    """What the ranks reduce while they make a step together; ``home`` are the vertices that lie in the region."""

    def __init__(self, whole: DistributedMesh, part: Part, topology: PartTopology, is_home: NDArray[np.bool_]) -> None:
        self.whole, self.part, self.topology = whole, part, topology
        self.ranks = whole.ranks
        wanted = np.concatenate([whole.sample_vertices, whole.sample_primitives.ravel()])
        numbers = part.vertex_numbers
        place = np.minimum(np.searchsorted(numbers, wanted), max(len(numbers) - 1, 0))
        self._rows = np.zeros(0, dtype=np.intp)
        self._samples = np.zeros(0, dtype=np.intp)
        if len(numbers):
            self._samples = np.flatnonzero((numbers[place] == wanted) & is_home[place])
            self._rows = place[self._samples]
        self._num_samples = len(wanted)

    def collect_samples(self, positions: Positions) -> None:
        """Bring the positions of the samples to all ranks: each comes from the one rank whose region it lies in."""
        if self.ranks.size == 1:
            self.topology.samples_of_all = self._split(np.stack([x[self._rows] for x in positions]))
            return
        mine = np.zeros((2, self._num_samples, 3))
        mine[:, self._samples] = [x[self._rows] for x in positions]
        # as integers, so that the sum with zeros keeps every bit
        self.topology.samples_of_all = self._split(self.ranks.total(mine.view(np.int64)).view(np.float64))

    def _split(self, all_of_them: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        num = len(self.whole.sample_vertices)
        corners = len(self.whole.sample_primitives)
        return all_of_them[:, :num], all_of_them[:, num:].reshape(2, corners, -1, 3)

    def body_boxes(self, positions: Positions) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Boxes around the motion of every body, wherever its vertices are; those without vertices are inverted."""
        num_bodies = self.whole.num_bodies
        both = np.full((2, num_bodies, 3), np.inf)
        here = np.flatnonzero(np.diff(self.part.mesh.body_vertex_range))
        if len(here):
            lower, upper = swept_boxes(positions, self.part.mesh.body_vertex_range[here])
            both[0, here], both[1, here] = lower, -upper
        both = self.ranks.least(both)
        return both[0], -both[1]


class PartStep(Step):
    """A step on one rank, which shares with the others what one process knows of all pairs."""

    def __init__(self, together: TogetherIn, *arguments: Any, **options: Any) -> None:
        """Begin a step; the other arguments are those of `Step`."""
        super().__init__(*arguments, **options)
        self.together = together
        self.ranks: Ranks = together.ranks

    def begin(self, goal: Goal, t_end: float, inflation: float | None = None) -> HostPlan:
        """Compute the boxes, in the quantized coordinates of the whole mesh."""
        with self.timed("reductions"):
            self.together.collect_samples(self.positions)
        return super().begin(goal, t_end, inflation)

    def _bodies_near(self) -> NDArray[np.bool_] | None:
        if not self.topology.may_have_inactive_bodies:
            return None
        lower, upper = self.together.body_boxes(self.positions)
        filled = np.flatnonzero((lower <= upper).all(axis=1))
        radius = self.together.whole.body_radius
        of_filled = None if radius is None else radius[filled]
        boxes = lower[filled], upper[filled]
        near = bodies_near_boxes(self.topology, filled, boxes, of_filled, self.inflation, self.execution)
        self._num_active_bodies = int((near | self.mesh.static).sum())
        return near

    @property
    def num_vertices_in_all(self) -> int:
        """Number of vertices of the whole mesh."""
        return self.together.whole.num_vertices

    def least_of_all(self, toi: float) -> float:
        """The least toi of all ranks."""
        with self.timed("reductions"):
            return self.ranks.agree(toi)[0]

    def open_in_all(self, num_open: dict[PairKind, int]) -> dict[PairKind, int]:
        """How many pairs of each kind are open on all ranks."""
        mine = np.array([num_open.get(kind, 0) for kind in PairKind], dtype=np.int64)
        with self.timed("reductions"):
            return dict(zip(PairKind, self.ranks.total(mine).tolist(), strict=True))

    def share_work(self, plan: HostPlan) -> bool:
        """Let the open pairs of a batch share the work with those of the other ranks."""
        own = plan.num_open()
        of_all = self.open_in_all(own)
        plan.set_number_open({kind: of_all[kind] for kind in own})
        return True

    def work_by_vertex(self, of_candidate: float, of_pair: float) -> NDArray[np.float64]:
        """Work of the last search: that of a pair at a vertex of its first primitive, that of candidates spread evenly.

        Which candidates there were is not known any more, and pairs neither if they came in parts.
        """
        count = self.mesh.num_vertices
        result = np.full(count, of_candidate * sum(self.counts.num_candidates.values()) / max(count, 1))
        if self.plan.num_batches != 1:
            return result
        for kind, found in enumerate(self.plan.counts()[:, FOUND].tolist()):
            if found == 0:
                continue
            keys = self.plan.found_keys(PairKind(kind), found).numpy()
            first = np.where(keys < 0, ~keys, keys) >> 32
            vertices = self.mesh.edges[first, 0] if kind == PairKind.EDGE_EDGE else first
            result += of_pair * np.bincount(vertices, minlength=count)
        return result


class AcrossRanks(OneProcess):
    """What a line search asks of all ranks, about the vertices of a part, copies of which are on several."""

    def __init__(self, together: TogetherIn) -> None:
        self._ranks, self._part = together.ranks, together.part
        self._num_rows = len(together.whole.vertex_ids)

    def all(self, flag: bool) -> bool:
        """Whether a flag is set on all ranks."""
        return self._ranks.agree(float(flag))[0] > 0.0

    def least(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """The least of each number over all ranks."""
        return self._ranks.least(values)

    def least_of_vertices(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """The least value of each vertex over all ranks that have a copy."""
        owned = np.full(self._num_rows, np.inf)
        self._part.everything.back(values, owned, np.minimum)
        result = np.empty_like(values)
        self._part.everything.forward([(owned, result)])
        return result
