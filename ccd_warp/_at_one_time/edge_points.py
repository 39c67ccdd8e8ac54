"""A mesh with one more point for each edge, with which the search of a step finds what intersects at one time.

An edge meets a face where a point that moves along the edge meets the face. So the search for vertices and faces, with
its trees and its cull, finds edges and faces, too: every edge gets a point that is at its first vertex at the start of
the step and at its second one at the end, and everything else stays where it is.
"""

from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._engine.mesh.mesh_cache import MeshCache
from ccd_warp._engine.mesh.topology import PrimitiveSet, Role, Topology
from ccd_warp._runtime.lazy import lazy_property
from ccd_warp._runtime.status import PairKind

if TYPE_CHECKING:
    from ccd_warp._scene.mesh import CollisionMesh

# The two primitives of a pair, in space and in the plane.
_IN_SPACE = {
    PairKind.VERTEX_FACE: ("edge_or_vertex", "face"),
    PairKind.EDGE_EDGE: ("edge_without_face", "edge_without_face"),
    PairKind.POINT_SEGMENT: ("codimensional_point", "codimensional_edge"),
    PairKind.POINT_POINT: ("codimensional_point", "codimensional_point"),
}
_IN_PLANE = _IN_SPACE | {PairKind.EDGE_EDGE: ("edge", "edge"), PairKind.POINT_SEGMENT: ("vertex", "edge")}
# The arrays that hold the vertices of a primitive; others have one of their own.
_ARRAYS = {"edge_without_face": "edge", "codimensional_edge": "edge", "codimensional_point": "vertex"}
_NUM_CORNERS = {"edge_or_vertex": 3, "face": 3, "edge": 2, "vertex": 1}
# A face holds at most so many neighbours of a vertex.
_MOST_NEIGHBOURS = 3


class MeshWithEdgePoints:
    """What the engine asks of a mesh; the points of the edges come after the vertices.

    Which edges and vertices have to be tested follows from what the tests of edges and faces cover. A vertex in a face
    is the end of each of its edges, and one of these shares no vertex with the face if the vertex has more neighbours
    than the face can hold. Two edges of faces meet where one meets a face of the other, and one of these faces shares
    no vertex with the other edge, but for few pairs that the mesh itself determines (`close_edges`). Where the mesh
    excludes pairs that share no vertex by their vertices, a face may be excluded whose side is not: there all vertices
    and edges are tested.

    Attributes:
        original: The mesh.
        covers_less: Whether all vertices and edges are tested.
    """

    def __init__(self, original: "CollisionMesh") -> None:
        self.original = original
        self.covers_less = original._excludes_by_vertices
        self.dimension = 3
        self.radius, self.is_thick = None, False  # what intersects is found exactly, whatever the thickness
        self.num_vertices = original.num_vertices + original.num_edges
        self.vertex_body = np.concatenate([original.vertex_body, original.edge_body])
        self.vertex_world = np.concatenate([original.vertex_world, original.vertex_world[original.edges[:, 0]]])
        # lists of pairs of primitives are looked up where the pairs are known
        self.exclude_pairs = {k: v for k, v in original.exclude_pairs.items() if k in ("bodies", "vertices")}

    def __getattr__(self, name: str) -> Any:
        if name == "original":
            raise AttributeError(name)
        return getattr(self.original, name)

    @property
    def _vertices_in_space(self) -> NDArray[np.float64]:
        start: NDArray[np.float64] = np.empty((self.num_vertices, 3))
        self.fill_positions(self.original._vertices_in_space, start, 0)
        return start

    def fill_positions(self, x: NDArray[np.float64], positions: NDArray[np.float64], end: int) -> None:
        """Positions of all vertices and points at an end of the step, 0 or 1, given those of the vertices."""
        positions[: len(x)] = x
        np.take(x, self._ends[end], axis=0, out=positions[len(x) :], mode="clip")

    @lazy_property
    def _ends(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        first, second = self.original.edges.T.astype(np.intp, order="C")
        return first, second

    @lazy_property
    def static_vertex_ranges(self) -> list[tuple[int, int]]:
        """Vertex ranges of static bodies, and those of the points of their edges, which follow body by body."""
        mesh = self.original
        ranges = list(mesh.static_vertex_ranges)
        begins = mesh.num_vertices + np.searchsorted(mesh.edge_body, np.arange(mesh.num_bodies + 1))
        for body in np.flatnonzero(mesh.static & (np.diff(begins) > 0)):
            ranges.append((int(begins[body]), int(begins[body + 1])))
        return ranges

    @lazy_property
    def tested_vertices(self) -> NDArray[np.int32]:
        """The vertices that have to be tested against faces."""
        mesh = self.original
        num_neighbours = np.bincount(mesh.edges.ravel(), minlength=mesh.num_vertices)
        is_tested = self.covers_less | (num_neighbours <= _MOST_NEIGHBOURS)
        is_tested[mesh.unused_vertices] = False
        return np.flatnonzero(is_tested).astype(np.int32) if mesh.num_faces else np.zeros(0, dtype=np.int32)

    @lazy_property
    def tested_edges(self) -> NDArray[np.int32]:
        """The edges that have to be tested against each other."""
        mesh = self.original
        return np.arange(mesh.num_edges, dtype=np.int32) if self.covers_less else mesh.codimensional_edges

    @lazy_property
    def edge_keys(self) -> NDArray[np.int64]:
        """The edges as ascending numbers, (max << 32) | min."""
        a, b = self.original.edges.T.astype(np.int64)
        return b << 32 | a

    @lazy_property
    def face_edges(self) -> NDArray[np.int32]:
        """The edges of each face, which repeat where it has less than three, and -1 of a face that has none."""
        a, b, c = self.original.faces.T.astype(np.int64)
        sides = np.stack([self._edge_of(a, b), self._edge_of(b, c), self._edge_of(c, a)], axis=1)
        most = sides.max(axis=1, initial=-1)[:, None]
        return np.where(sides < 0, most, sides).astype(np.int32)

    def _edge_of(self, a: NDArray[np.int64], b: NDArray[np.int64]) -> NDArray[np.int64]:
        """The edges between vertices, -1 where there is none."""
        keys = np.maximum(a, b) << 32 | np.minimum(a, b)
        if len(self.edge_keys) == 0:
            return np.full(len(keys), -1)
        places = np.minimum(np.searchsorted(self.edge_keys, keys), len(self.edge_keys) - 1)
        return np.where(self.edge_keys[places] == keys, places, -1)

    @lazy_property
    def close_edges(self) -> NDArray[np.int32]:
        """Pairs of edges without a common vertex of which each face of one shares a vertex with the other.

        Two edges without a face are not among them, nor pairs that the bodies exclude; shape [k, 2], the lower index
        first. Each face at the edge (r, s) has its third vertex, its apex, in the other edge, and the other way round.
        An edge with two different apexes leaves one other edge, between these; an edge with a single apex those at this
        vertex; and of two edges one has a face.
        """
        mesh = self.original
        none = np.zeros((0, 2), dtype=np.int32)
        if mesh.num_faces == 0 or self.covers_less:
            return none
        edge, apex = self._apexes
        count = np.bincount(edge, minlength=mesh.num_edges)
        begin = np.append(0, np.cumsum(count))
        twos, ones = np.flatnonzero(count == 2), np.flatnonzero(count == 1)
        across = self._edge_of(apex[begin[twos]], apex[begin[twos] + 1])
        # all edges at the apex of each edge that has one
        ends = mesh.edges.T.ravel().astype(np.int64)
        order = np.argsort(ends, kind="stable")
        at_vertex = np.append(0, np.cumsum(np.bincount(ends, minlength=mesh.num_vertices)))
        tip = apex[begin[ones]]
        degree = at_vertex[tip + 1] - at_vertex[tip]
        within = np.arange(degree.sum()) - np.repeat(np.cumsum(degree) - degree, degree)
        around = order[np.repeat(at_vertex[tip], degree) + within] % max(mesh.num_edges, 1)
        first = np.concatenate([twos[across >= 0], np.repeat(ones, degree)])
        second = np.concatenate([across[across >= 0], around])
        # of the other edge, too, each apex is a vertex of the first
        lengths = count[second]
        within = np.arange(lengths.sum()) - np.repeat(np.cumsum(lengths) - lengths, lengths)
        apexes = apex[np.repeat(begin[second], lengths) + within]
        owners = np.repeat(np.arange(len(second)), lengths)
        is_other = (mesh.edges[first[owners]] != apexes[:, None]).all(axis=1)
        is_close = np.bincount(owners[is_other], minlength=len(second)) == 0
        is_close &= (mesh.edges[first][:, :, None] != mesh.edges[second][:, None, :]).all(axis=(1, 2))
        body = mesh.edge_body[first]
        is_close &= mesh.self_collision[body] & mesh._is_free[body]
        pairs = np.sort(np.stack([first, second], axis=1)[is_close], axis=1)
        return np.unique(pairs, axis=0).astype(np.int32) if len(pairs) else none

    @lazy_property
    def _apexes(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Edges of faces and the third vertices of these faces, each pair once, in lexicographic order."""
        mesh = self.original
        faces = mesh.faces.astype(np.int64)
        keys = []
        for k in range(3):
            edge = self._edge_of(faces[:, k - 2], faces[:, k - 1])
            keys.append((edge << 32 | faces[:, k])[edge >= 0])
        unique = np.unique(np.concatenate(keys))
        return unique >> 32, unique & 0xFFFFFFFF


class EdgePointTopology(Topology):
    """The topology of a mesh with edge points."""

    mesh: Any
    fewer_query = True  # with the faces as queries a search takes a tenth less time

    @staticmethod
    def of(mesh: "CollisionMesh", device: wp.Device) -> "EdgePointTopology":
        """The topology for a mesh on a device."""
        cache = MeshCache.of(mesh).topologies
        key = f"{device} edge points"
        if key not in cache:
            cache.setdefault(key, EdgePointTopology(MeshWithEdgePoints(mesh), device))  # type: ignore[arg-type]
        topology: EdgePointTopology = cache[key]
        return topology

    @property
    def slender(self) -> None:
        """None: edge points are no vertices of a body of long thin parts."""

    @property
    def kinds(self) -> tuple[PairKind, ...]:
        """Kinds of pairs to search for."""
        mesh = self.mesh.original
        possible = {
            PairKind.VERTEX_FACE: mesh.num_faces > 0,
            PairKind.EDGE_EDGE: mesh.dimension == 2 or len(self.mesh.tested_edges) > 0,
            PairKind.POINT_SEGMENT: mesh.dimension == 2 or len(mesh.codimensional_points) > 0,
            PairKind.POINT_POINT: len(mesh.codimensional_points) > 0,
        }
        return tuple(kind for kind in PairKind if possible.get(kind))

    def primitives_of(self, kind: PairKind) -> tuple[str, str]:
        """The kinds of the two primitives of a pair."""
        return (_IN_SPACE if self.mesh.original.dimension == 3 else _IN_PLANE)[kind]

    def corner_arrays(self, kind: PairKind) -> tuple[str, str]:
        """The arrays with the vertices of the two primitives of a pair."""
        first, second = (_ARRAYS.get(name, name) for name in self.primitives_of(kind))
        return first, second

    def _corners_host(self, name: str) -> NDArray[np.int32]:
        mesh = self.mesh
        if name == "vertex":
            return np.repeat(np.arange(mesh.original.num_vertices, dtype=np.int32)[:, None], 3, axis=1)
        if name == "edge_or_vertex":
            points = np.arange(mesh.original.num_vertices, mesh.num_vertices, dtype=np.int32)[:, None]
            vertices = np.repeat(mesh.tested_vertices[:, None], 3, axis=1)
            return np.concatenate([np.hstack([points, mesh.edges]), vertices])
        return super()._corners_host(name)

    @lazy_property
    def corners(self) -> dict[str, wp.array]:
        """Vertices of every primitive, by kind and index."""
        names = ("vertex", "edge", "face", "edge_or_vertex")
        return {name: self.array(self._corners_host(name), wp.vec3i) for name in names}

    def _make_set(self, kind: str, role: Role) -> PrimitiveSet:
        mesh, array = self.mesh, _ARRAYS.get(kind, kind)
        corners = self._corners_host(array)
        primitives = {
            "codimensional_point": mesh.codimensional_points,
            "codimensional_edge": mesh.codimensional_edges,
            "edge_without_face": mesh.tested_edges,
            "vertex": mesh._surface_vertices,
        }.get(kind, np.arange(len(corners), dtype=np.int32))
        body = mesh.vertex_body[corners[primitives, 0]] if len(primitives) else np.zeros(0, dtype=np.int32)
        ids = primitives[self.bodies_of(role)[body]].astype(np.int32)
        of_set = self.corners[array] if len(ids) == len(corners) else self.array(corners[ids], wp.vec3i)
        return PrimitiveSet(f"{role} {kind}", role, _NUM_CORNERS[array], self.array(ids), of_set)
