"""The primitives that a plan has sent to a rank, as the engine takes them, and what ranks reduce in a step."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._engine.mesh.topology import ARRAYS, Positions, PrimitiveSet, Role, Topology
from ccd_warp._engine.mesh.worlds import WorldPlaces, plain_places
from ccd_warp._runtime.lazy import lazy_property
from ccd_warp._runtime.status import PairKind
from ccd_warp._scene.mesh import MOST_WITH_PLANES, CollisionMesh
from ccd_warp.distributed._exchange import Exchange
from ccd_warp.distributed._mesh import DistributedMesh


@dataclass(frozen=True)
class Part:
    """The primitives of a rank's region, and what leads back to the whole mesh.

    Attributes:
        mesh: They, with the vertices that they use; all bodies and worlds of the whole mesh, many without vertices.
        vertex_numbers: Index of each vertex in the whole mesh, ascending, int64, shape [n].
        vertex_ids: Its id, int64, shape [n].
        edge_numbers: Index of each edge in the whole mesh, ascending.
        face_numbers: Index of each face in the whole mesh, ascending.
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

    @lazy_property
    def is_tested(self) -> NDArray[np.bool_]:
        """Which vertices are `tested_vertices`, bool, shape [n]."""
        result = np.zeros(self.mesh.num_vertices, dtype=bool)
        result[self.tested_vertices] = True
        return result


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
    if len(whole.planes) and len(vertices) > MOST_WITH_PLANES:
        raise ValueError(
            f"the region of a rank holds {len(vertices)} vertices; expected at most {MOST_WITH_PLANES} with "
            f"half-spaces, so more ranks"
        )
    begin = np.searchsorted(bodies, np.arange(whole.num_bodies + 1)).astype(np.int32)
    vertex_body = bodies.astype(np.int32)
    state: dict[str, Any] = dict(
        vertices=vertices,
        faces=faces,
        edges=edges,
        codimensional_edges=codimensional_edges,
        codimensional_points=codimensional_points,
        unused_vertices=np.zeros(0, dtype=np.int32),  # which no rank is sent
        inner_vertices=np.zeros(0, dtype=np.int32),
        vertex_body=vertex_body,
        edge_body=vertex_body[edges[:, 0]],
        face_body=vertex_body[faces[:, 0]],
        body_vertex_range=begin,
        static=whole.static,
        kinematic=whole.kinematic,
        rigid=whole.rigid,
        self_collision=whole.self_collision,
        moving_vertices=np.flatnonzero(~whole.static[vertex_body]).astype(np.int32),
        body_pairs=whole.body_pairs,
        exclusion_rings=whole.exclusion_rings,
        vertex_world=worlds.astype(np.int32),
        names=whole.names,
        exclude_pairs=whole.exclude_pairs,
        radius=radius,
        planes=whole.planes,
    )
    assert state.keys() == {f.name for f in fields(CollisionMesh)}
    return CollisionMesh._of_fields(
        state,  # and properties of the whole mesh, which a part cannot tell
        num_worlds=whole.num_worlds,
        length_scale=whole.length_scale,
        is_thick=whole.is_thick,
        _moves_alone=whole.moves_alone,
        _is_free_alone=whole.moves_alone,
        _excludes_by_vertices=whole.rings is not None,
    )


class PartTopology(Topology):
    """The data of a part on a device, and which of the pairs found there belong to this rank."""

    is_whole = False

    def __init__(
        self,
        part: Part,
        device: Any,
        vertex_below: NDArray[np.uint8],
        rings: tuple[NDArray[np.int32], NDArray[np.int32]] | None,
        num_vertices_in_all: int,
    ) -> None:
        """The data of a part.

        Args:
            part: The part.
            device: The device.
            vertex_below: The axes along which the box of each vertex in the plan begins below the region, a bit each,
                shape [n].
            rings: The vertices that must not meet each vertex, as of `rings.excluded_vertices`.
            num_vertices_in_all: Number of vertices of the whole mesh.
        """
        super().__init__(part.mesh, device)
        self.num_vertices_in_all = num_vertices_in_all
        self._part = part
        self._vertex_below, self._rings = vertex_below, rings
        self._axes_below: dict[str, NDArray[np.uint8]] = {}
        # positions of the samples of the whole mesh in this step, as `sampled` gives them
        self.samples_of_all: NDArray[np.float64] | None = None

    def place_worlds(self) -> WorldPlaces:
        """Worlds as they are, since a world may lie on several ranks, each of which sees a part of it."""
        return plain_places(self.mesh.num_worlds)

    def sampled(self, positions: Positions) -> NDArray[np.float64]:
        """Positions of the samples of the whole mesh, so that all ranks and one process choose one quantization."""
        if self.samples_of_all is None:
            return super().sampled(positions)
        return self.samples_of_all.copy()

    @lazy_property
    def box_radius(self) -> wp.array:
        """For each vertex the largest radius of the primitives around it, some of which may be on other ranks."""
        return self.array(self._part.box_radius if self.mesh.radius is not None else np.zeros(0), wp.float64)

    @lazy_property
    def plane_vertices(self) -> wp.array:
        """The vertices whose pairs with planes belong to this rank: they move, and their boxes begin in its region.

        The box of a vertex that is tested meets the region, so it begins there unless it begins below it.
        """
        mesh, tested = self.mesh, self._part.tested_vertices
        is_here = mesh._is_free[mesh.vertex_body[tested]] & (self._vertex_below[tested] == 0)
        return self.array(tested[is_here])

    @property
    def slender(self) -> None:
        """None: which bodies are slender is found in a whole mesh alone."""

    def numbers(self, kind: str) -> NDArray[np.integer]:
        """The index of each primitive of a kind in the whole mesh."""
        part = self._part
        of_kind = {"edge": part.edge_numbers, "face": part.face_numbers}
        return of_kind.get(ARRAYS.get(kind, kind), part.vertex_numbers)

    def _make_set(self, kind: str, role: Role) -> PrimitiveSet:
        if kind != "vertex":
            return super()._make_set(kind, role)
        mesh, tested = self.mesh, self._part.tested_vertices
        ids = tested[self.bodies_of(role)[mesh.vertex_body[tested]]]
        corners = self.array(np.repeat(ids[:, None], 3, axis=1), wp.vec3i)
        return PrimitiveSet(f"{role} vertex", role, 1, self.array(ids), corners)

    def _excluded_vertices(self) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        assert self._rings
        return self._rings

    def own_pairs(self, kind: PairKind, first: NDArray[np.integer], second: NDArray[np.integer]) -> Any:
        """Which pairs of primitives belong to this rank: a slice of all, or flags.

        Both boxes meet the region, so the larger of their lower corners is below its upper corner. It is below its
        lower corner, and the pair another rank's, if both begin below along one axis.
        """
        return self.own_pairs_of(self.corner_arrays(kind), first, second)

    def own_pairs_of(
        self, arrays: tuple[str, str], first: NDArray[np.integer], second: NDArray[np.integer]
    ) -> NDArray[np.bool_] | slice:
        """Which pairs of primitives of these arrays belong to this rank, where all boxes meet the region."""
        below = [self._below(name) for name in arrays]
        if not all(flags.any() for flags in below):
            return slice(None)
        may_differ = np.flatnonzero(below[0].take(first))
        both = below[0].take(first[may_differ]) & below[1].take(second[may_differ])
        if not both.any():
            return slice(None)
        belongs_here = np.ones(len(first), dtype=bool)
        belongs_here[may_differ[both != 0]] = False
        return belongs_here

    def _below(self, name: str) -> NDArray[np.uint8]:
        """The axes along which the box of each primitive begins below the region, a bit each."""
        if name not in self._axes_below:
            vertices = np.arange(self.mesh.num_vertices)[:, None]
            corners: dict[str, NDArray[Any]] = {"vertex": vertices, "edge": self.mesh.edges, "face": self.mesh.faces}
            if name == "plane":  # the box of a half-space is all of space
                self._axes_below[name] = np.full(len(self.mesh.planes), 0xFF, dtype=np.uint8)
            else:
                self._axes_below[name] = np.bitwise_or.reduce(self._vertex_below[corners[name]], axis=1)
        return self._axes_below[name]
