"""The data of a mesh on a device: its primitives in sets, their spatial order, and its collision filter."""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._engine.host.buffers import Buffers
from ccd_warp._engine.mesh.body_groups import BodyGroups, bodies_that_may_meet
from ccd_warp._engine.mesh.mesh_cache import MeshCache
from ccd_warp._engine.mesh.rings import excluded_vertices
from ccd_warp._engine.mesh.samples import uneven_samples
from ccd_warp._engine.mesh.slender import SlenderBodies, slender_bodies
from ccd_warp._engine.mesh.worlds import (
    in_unit,
    inner_part,
    lattice_bits,
    middle_of,
    place_worlds,
    world_lattice,
)
from ccd_warp._runtime.launch import Execution
from ccd_warp._runtime.lazy import lazy_property
from ccd_warp._runtime.status import PairKind, primitives_of
from ccd_warp._runtime.structs import struct_of
from ccd_warp._scene.input.worlds import move_alone, worlds_of_bodies
from ccd_warp.kernels.boxes import box_tree as kernels
from ccd_warp.kernels.search.collision_filter import CollisionFilter

if TYPE_CHECKING:
    from ccd_warp._scene.mesh import CollisionMesh

WIDTH = int(kernels.WIDTH)
# A sample of a set: of so many runs of primitives that follow one another by number, one. A run is a block of the tree
# where neighbours have neighbouring numbers, as in most meshes.
_SAMPLE_STRIDE, _RUN = 96, 16
WORTH_SAMPLING = 1 << 14  # vertices
VERTEX_AABB_FLOATS = int(kernels.VERTEX_AABB_FLOATS)
BLOCK_CORNERS = int(kernels.BLOCK_CORNERS)
NUM_SAMPLES = 128
_MIDDLE, _MARGIN = NUM_SAMPLES // 2, NUM_SAMPLES // 20
# Of sorted samples those at the ends of the middle nine tenths, and two in the middle.
_RANKS = np.array([_MARGIN, _MIDDLE - 1, _MIDDLE, NUM_SAMPLES - 1 - _MARGIN])
# Vertices of a body from which on some are so near each other and share no edge.
_MANY_VERTICES = 16
# Positions at the start and at the end of a step, each of shape [V, 3].
Positions = tuple[NDArray[np.float64], NDArray[np.float64]]
# Largest number of vertices whose positions are copied, which costs less than to record where they are.
MOST_COPIED = 1 << 15
_CLASS_BITS = int(kernels.CLASS_BITS)
LARGEST_EXPONENT = 1000
LARGEST_ORIGIN = 2.0**1022

# The kinds of the two primitives of a pair, and the arrays that hold their vertices.
PRIMITIVES = {
    PairKind.VERTEX_FACE: ("vertex", "face"),
    PairKind.EDGE_EDGE: ("edge", "edge"),
    PairKind.POINT_SEGMENT: ("codimensional_point", "codimensional_edge"),
    PairKind.POINT_POINT: ("codimensional_point", "codimensional_point"),
}
# The arrays of those kinds of primitives that have none of their own.
ARRAYS = {"codimensional_point": "vertex", "codimensional_edge": "edge"}
# In the plane, where vertices and edges are what vertices and faces are in space.
_PRIMITIVES_IN_PLANE = PRIMITIVES | {PairKind.POINT_SEGMENT: ("vertex", "edge")}
CORNER_ARRAYS = {kind: primitives_of(kind) for kind in PRIMITIVES}
# What the listed pairs of the collision filter are, in the order of the pair kinds, and the bodies.
_LISTED = (*(kind.name.lower() for kind in PRIMITIVES), "bodies")


# What a body is to a step: free to move, moved as it is told, or static. Slender ones are free, too; a set of them is
# searched for pairs within a body (`slender`).
Role = Literal["moving", "kinematic", "static", "slender"]


@dataclass(frozen=True)
class PrimitiveSet:
    """Primitives of one kind, all of bodies with one role.

    Attributes:
        name: Name of its buffers.
        role: The role of their bodies.
        num_corners: Number of vertices of a primitive.
        ids: Indices among all primitives of the kind, int32, shape [n].
        corners: Vertex indices, wp.vec3i, shape [n]; where there are fewer than three, one repeats.
        is_sample: Whether these are some of a set, which are no neighbours of each other.
    """

    name: str
    role: Role
    num_corners: int
    ids: wp.array
    corners: wp.array
    is_sample: bool = False

    @property
    def is_static(self) -> bool:
        """Whether they are static."""
        return self.role == "static"

    @lazy_property
    def count(self) -> int:
        """Number of primitives."""
        return len(self.ids)

    @property
    def num_blocks(self) -> int:
        """Number of blocks of sixteen primitives."""
        return -(-self.count // WIDTH)

    @property
    def index_bits(self) -> int:
        """Number of bits of a key that hold the index."""
        return max(1, (self.count - 1).bit_length())


class Topology:
    """The data of a mesh that no step changes; made once for each mesh and device."""

    fewer_query = False  # whether the queries of two moving sets are those of the smaller one, not of the first

    def __init__(self, mesh: "CollisionMesh", device: wp.Device) -> None:
        self.mesh = mesh
        self.device = device
        self.vertex_body = self.array(mesh.vertex_body)
        has_worlds = mesh.num_worlds > 1
        self.vertex_world = self.array(mesh.vertex_world if has_worlds else mesh.vertex_world[:0])
        is_static = mesh.static[mesh.vertex_body]
        self.world_places = place_worlds(
            mesh._vertices_in_space, mesh.vertex_world, mesh.num_worlds, is_static, mesh.unused_vertices
        )
        self.worlds = self._make_worlds()
        self.radius = self.array(np.zeros(0) if mesh.radius is None else mesh.radius, wp.float64)
        vertex_static, takes_part = mesh.static[mesh.vertex_body], np.ones(mesh.num_vertices, dtype=bool)
        takes_part[mesh.unused_vertices] = False
        moving = np.flatnonzero(~vertex_static).astype(np.int32)
        self.moving_vertices = self.array(moving)
        # those that take part, which have boxes; all of them, in which -1 - v stands for a vertex v that takes none
        self.boxed_vertices = self.checked_vertices = self.moving_vertices
        if len(mesh.unused_vertices):
            self.boxed_vertices = self.array(moving[takes_part[moving]])
            self.checked_vertices = self.array(np.where(takes_part[moving], moving, ~moving))
        self.static_vertices = self.array(np.flatnonzero(vertex_static & takes_part).astype(np.int32))
        self.planes: Any = None  # as the struct of the kernels, once `planes.planes_of` has made it
        self._sets: dict[tuple[str, Role], PrimitiveSet] = {}
        self.orders: dict[str, tuple[wp.array, wp.array, wp.array | None]] = {}  # of `rest_order`, by name of a set
        self.vertex_rank: NDArray[np.integer] | None = None  # by which primitives are in order from the beginning

    @staticmethod
    def of(mesh: "CollisionMesh", device: wp.Device) -> "Topology":
        """The topology of a mesh on a device."""
        cache = MeshCache.of(mesh).topologies
        key = str(device)
        if key not in cache:
            cache.setdefault(key, Topology(mesh, device))  # of two concurrent threads, one wins
        return cache[key]

    @property
    def is_thick(self) -> bool:
        """Whether vertices have radii."""
        return self.mesh.is_thick

    def of_vertices(self, active: wp.array) -> list[wp.array]:
        """The inputs of `fill_vertex_aabbs` for each vertex, besides its positions."""
        return [self.vertex_body, active, self.worlds]

    def _make_worlds(self) -> Any:
        """The places of worlds as the struct of the kernels, without arrays for a single world."""
        places = self.world_places
        num_worlds = len(places.unit)
        cells = np.concatenate([world_lattice(num_worlds), places.unit[:, None].astype(np.float32)], axis=1)
        worlds = kernels.Worlds()
        worlds.of_vertex = self.vertex_world
        worlds.cell = self.array(cells, wp.vec4f)
        worlds.anchor = self.array(places.anchor.ravel())
        worlds.origin = self.array(places.origin.reshape(-1, 3), wp.vec3d)
        worlds.inner = inner_part(num_worlds)
        return worlds

    def empty(self, count: int, dtype: type) -> wp.array:
        """An array on the device with arbitrary contents."""
        return wp.empty(count, dtype=dtype, device=self.device)

    def array(self, values: NDArray[Any], dtype: type = wp.int32) -> wp.array:
        """Values on the device."""
        if self.device.is_capturing:  # the copy would be part of the graph, and not made now
            raise RuntimeError("a graph is being captured; build pipelines, and call reserve(), before the capture")
        return wp.array(np.ascontiguousarray(values), dtype=dtype, device=self.device)

    @lazy_property
    def corners(self) -> dict[str, wp.array]:
        """Vertices of every primitive, by kind and index; arrays of kinds that a mesh lacks are empty."""
        return {name: self.array(self._corners_host(name), wp.vec3i) for name in ("vertex", "edge", "face")}

    @lazy_property
    def face_copies(self) -> wp.array:
        """For each face the first with the same vertices, -1 where it is alone; empty where all are, int32."""
        return self.array(self.mesh._copies_of_faces, wp.int32)

    @lazy_property
    def box_radius(self) -> wp.array:
        """For each vertex the largest radius of the primitives that contain it; empty where no radius was given.

        Boxes of vertices that grow by it hold, united, the thick primitive. Vertices of a primitive are joined by an
        edge, so these are the radii of a vertex and of its neighbours.
        """
        radius = self.mesh.radius
        return self.array(np.zeros(0) if radius is None else self.mesh._largest_around(radius), wp.float64)

    @lazy_property
    def neighbours(self) -> tuple[wp.array, wp.array]:
        """Where the list of each vertex begins, and the vertices with which each shares an edge."""
        mesh = self.mesh
        a, b = np.concatenate([mesh.edges, mesh.edges[:, ::-1]]).T
        begin = np.concatenate([[0], np.cumsum(np.bincount(a, minlength=mesh.num_vertices))])
        return self.array(begin.astype(np.int32)), self.array(b[np.argsort(a, kind="stable")])

    @lazy_property
    def plane_vertices(self) -> wp.array:
        """The vertices that meet the planes of half-spaces: those of free bodies."""
        mesh = self.mesh
        if not mesh.kinematic.any() and not len(mesh.unused_vertices):
            return self.moving_vertices
        return self.array(mesh._free_surface_vertices)

    @lazy_property
    def body_static(self) -> wp.array:
        """Whether each body is static, int32."""
        return self.array(self.mesh.static.astype(np.int32))

    @lazy_property
    def body_kinematic(self) -> wp.array:
        """Whether each body is kinematic, int32; empty where none is."""
        kinematic = self.mesh.kinematic
        return self.array((kinematic if kinematic.any() else kinematic[:0]).astype(np.int32))

    @lazy_property
    def may_have_inactive_bodies(self) -> bool:
        """Whether a body may be without a partner in a step: one that is free and does not collide with itself."""
        mesh = self.mesh
        return mesh.num_bodies > 1 and mesh.num_worlds == 1 and not mesh.self_collision[mesh._is_free].all()

    @lazy_property
    def samples(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Vertices, shape [n], and the vertices of primitives, shape [k, n], from which the quantization is chosen."""
        mesh = self.mesh
        primitives = mesh.edges if len(mesh.edges) else np.arange(mesh.num_vertices)[:, None]
        sampled = primitives[uneven_samples(len(primitives), NUM_SAMPLES)]
        return uneven_samples(mesh.num_vertices, NUM_SAMPLES), sampled.T.astype(np.intp, order="C")

    @lazy_property
    def edges_with_neighbours(self) -> NDArray[np.intp]:
        """Sampled edges of bodies with vertices that are near each other and share none, shape [n, 2]."""
        mesh = self.mesh
        edges = self.samples[1].T
        is_large = np.diff(mesh.body_vertex_range) >= _MANY_VERTICES
        return edges[(mesh.self_collision & ~mesh.static & is_large)[mesh.vertex_body[edges[:, 0]]]]

    @lazy_property
    def median_edge_radius(self) -> float:
        """The upper median of the radii of these edges, 0 without radii."""
        radius = self.mesh.radius
        return 0.0 if radius is None else upper_median(radius[self.edges_with_neighbours].max(axis=1))

    def sampled(self, positions: Positions) -> NDArray[np.float64]:
        """Coordinates of the samples at both ends of a step, in a new array, shape [2, 3, 1 + k, n].

        The third axis holds single vertices, and then the vertices of primitives. With several worlds they are seen
        from the origin of their world, in its unit.
        """
        places = self._sampled_places
        taken = np.empty((2, *places.shape))
        for values, at_end in zip(positions, taken, strict=True):
            values.take(places, out=at_end, mode="clip")  # which NumPy writes in place; there is nothing to clip
        if self.world_places.has_origins:
            anchors, origins, unit = self._sampled_worlds
            with np.errstate(over="ignore", under="ignore"):
                taken -= middle_of(positions[0].take(anchors, mode="clip") + origins)
                in_unit(taken, unit)
        return taken

    @lazy_property
    def _sampled_worlds(self) -> tuple[NDArray[np.intp], NDArray[np.float64], NDArray[np.float64]]:
        """Of the worlds of the samples the places of their anchors in an array of positions, origins and units.

        The first two have the shape [3, 3, 1 + k, n]: anchors, axes, vertices of samples, samples.
        """
        places, world = self.world_places, self.mesh.vertex_world[self._sampled_places[0] // 3]
        anchors = 3 * places.anchor[world].astype(np.intp)[..., None] + np.arange(3)
        anchors, origins = (
            np.ascontiguousarray(np.moveaxis(x, (2, 3), (0, 1))) for x in (anchors, places.origin[world])
        )
        return anchors, origins, places.unit[world]

    @lazy_property
    def _sampled_places(self) -> NDArray[np.intp]:
        """The places of the coordinates of the samples in an array of positions, shape [3, 1 + k, n]."""
        vertices, primitives = self.samples
        places: NDArray[np.intp] = 3 * np.concatenate([vertices[None], primitives]) + np.arange(3)[:, None, None]
        return places

    def seen(self, vertices: NDArray[np.intp], positions: Positions) -> NDArray[np.float64]:
        """Positions of vertices at both ends of a step, as seen from the origin of their world, in its unit."""
        start = positions[0]
        seen = np.stack([x[vertices] for x in positions])
        if self.mesh.num_worlds < 2:
            return seen
        return self.world_places.seen(seen, self.mesh.vertex_world[vertices], start)

    def seen_radius(self, primitives: NDArray[np.intp]) -> NDArray[np.float64]:
        """The largest radius of the vertices of each primitive, given as shape [k, n], in the unit of its world."""
        mesh = self.mesh
        if mesh.radius is None:
            return np.zeros(primitives.shape[1])
        radius: NDArray[np.float64] = mesh.radius[primitives].max(axis=0)
        return radius * self.world_places.unit[mesh.vertex_world[primitives[0]]] if mesh.num_worlds > 1 else radius

    def typical_radius_of(self, primitives: NDArray[np.intp]) -> float:
        """The median of these."""
        if self.mesh.radius is None:
            return 0.0
        with np.errstate(over="ignore"):  # of the mean of two
            return float(np.median(self.seen_radius(primitives)))

    def _corners_host(self, name: str) -> NDArray[np.int32]:
        mesh = self.mesh
        if name == "vertex":
            return np.repeat(np.arange(mesh.num_vertices, dtype=np.int32)[:, None], 3, axis=1)
        return mesh.edges[:, [0, 1, 1]] if name == "edge" else mesh.faces

    @property
    def kinds(self) -> tuple[PairKind, ...] | None:
        """Kinds of pairs to search for; None for those that the mesh can form and the options select."""
        return None

    def primitives_of(self, kind: PairKind) -> tuple[str, str]:
        """The kinds of the two primitives of a pair."""
        return (PRIMITIVES if self.mesh.dimension == 3 else _PRIMITIVES_IN_PLANE)[kind]

    def corner_arrays(self, kind: PairKind) -> tuple[str, str]:
        """The arrays, among ``corners``, with the vertices of the two primitives of a pair."""
        return CORNER_ARRAYS[kind]

    def primitives(self, kind: str, role: Role) -> PrimitiveSet:
        """The primitives of a kind of bodies with one role."""
        key = (kind, role)
        if key not in self._sets:
            self._sets.setdefault(key, self._make_set(kind, role))
        return self._sets[key]

    def bodies_of(self, role: Role) -> NDArray[np.bool_]:
        """The bodies with one role whose primitives are searched, bool, shape [B]."""
        mesh = self.mesh
        if role == "slender":
            has_role = np.zeros(mesh.num_bodies, dtype=bool)
            has_role[[] if self.slender is None else self.slender.bodies] = True
            return has_role
        if role == "kinematic":
            has_role = mesh.kinematic.copy()
            has_role[mesh.planes.bodies] = False  # the vertex of a half-space is no part of a surface
            return has_role
        return mesh.static if role == "static" else mesh._is_free

    @lazy_property
    def slender(self) -> SlenderBodies | None:
        """The bodies whose own pairs have a search of their own, if any."""
        return slender_bodies(self.mesh)

    @lazy_property
    def slender_vertices(self) -> wp.array:
        """The vertices of slender bodies."""
        return self.array(np.flatnonzero(self.bodies_of("slender")[self.mesh.vertex_body]).astype(np.int32))

    @lazy_property
    def body_frames(self) -> Any:
        """The frames of slender bodies, as the struct of the kernels."""
        slender = self.slender
        assert slender is not None
        num = len(slender.bodies)
        of_body = np.zeros(self.mesh.num_bodies, dtype=np.int32)
        of_body[slender.bodies] = np.arange(num)
        cell = np.concatenate([world_lattice(num), np.ones((num, 1), dtype=np.float32)], axis=1)
        # a body maps to half of the inner part of its cell, and the rest is left to its motion
        exponent = np.frexp(slender.size)[1] + lattice_bits(num) + 3
        scale = np.ldexp(4.0, -np.clip(exponent, -LARGEST_EXPONENT, LARGEST_EXPONENT))
        frames = kernels.BodyFrames()
        frames.of_vertex = self.array(of_body[self.mesh.vertex_body])
        frames.edge, frames.cell = self.array(slender.edge, wp.vec2i), self.array(cell, wp.vec4f)
        frames.scale, frames.inner = self.array(scale, wp.float64), inner_part(num)
        return frames

    @lazy_property
    def is_free_alone(self) -> bool:
        """Whether no pair of free bodies is left but those within slender bodies."""
        mesh = self.mesh
        of_bodies = worlds_of_bodies(mesh.vertex_body, mesh.vertex_world, mesh.num_bodies)
        return move_alone(mesh._is_free, mesh.self_collision & ~self.bodies_of("slender"), *of_bodies)

    @lazy_property
    def filters(self) -> dict[Role, Any]:
        """The filters beside the search within slender bodies, by the role of two sets: for that, and without that."""
        by_role: dict[Role, Any] = {}
        for role in ("slender", "moving"):
            base = self.collision_filter
            by_role[role] = changed = struct_of(CollisionFilter, {name: getattr(base, name) for name in base._cls.vars})
            changed.applies = 1
            if role == "slender":
                changed.by_world, changed.vertex_world = 1, self.vertex_body
            else:
                of_self = self.mesh.self_collision & ~self.bodies_of("slender")
                changed.by_body, changed.self_collision = 1, self.array(of_self.astype(np.int32))
        return by_role

    @property
    def samples_queries(self) -> bool:
        """Whether the search for a bound begins with a sample."""
        return self.mesh.num_vertices >= WORTH_SAMPLING

    def sampled_queries(self, primitives: PrimitiveSet, kind: str) -> PrimitiveSet:
        """Some primitives of a set of this kind, by their numbers alone: the same wherever they are, in any order."""
        key: tuple[str, Role] = (f"sampled {kind}", primitives.role)
        if key not in self._sets:
            ids = primitives.ids.numpy()
            rows = np.flatnonzero(ids // _RUN % _SAMPLE_STRIDE == 0)
            corners = self.array(primitives.corners.numpy()[rows], wp.vec3i)
            name, of_ids = f"sampled {primitives.name}", self.array(ids[rows])
            sample = PrimitiveSet(name, primitives.role, primitives.num_corners, of_ids, corners, is_sample=True)
            self._sets.setdefault(key, sample)
        return self._sets[key]

    def _make_set(self, kind: str, role: Role) -> PrimitiveSet:
        mesh, of_role = self.mesh, self.bodies_of(role)
        array = ARRAYS.get(kind, kind)
        body = {"vertex": mesh.vertex_body, "edge": mesh.edge_body, "face": mesh.face_body}[array]
        among = {
            "codimensional_point": mesh.codimensional_points,
            "codimensional_edge": mesh.codimensional_edges,
            "vertex": mesh._surface_vertices if len(mesh.unused_vertices) else None,
        }.get(kind)
        num_corners = {"vertex": 1, "edge": 2, "face": 3}[array]
        name = f"{role} {kind}"
        if among is None and of_role.all():
            ids = np.arange(len(body), dtype=np.int32)
            return PrimitiveSet(name, role, num_corners, self.array(ids), self.corners[array])
        candidates = np.arange(len(body), dtype=np.int32) if among is None else among
        ids = candidates[of_role[body[candidates]]].astype(np.int32)
        corners = self.array(self._corners_host(array)[ids], wp.vec3i)
        return PrimitiveSet(name, role, num_corners, self.array(ids), corners)

    @lazy_property
    def collision_filter(self) -> Any:
        """The collision filter of the mesh, as the struct of the kernels."""
        return self._make_filter()

    def _make_filter(self) -> Any:
        mesh = self.mesh
        collision_filter = CollisionFilter()
        none = wp.empty(0, dtype=wp.int32, device=self.device)
        collision_filter.vertex_body = self.vertex_body
        collision_filter.by_pair = int(mesh.body_pairs is not None)
        collision_filter.by_body = int(not mesh.self_collision.all() or collision_filter.by_pair)
        collision_filter.self_collision = self.array(mesh.self_collision.astype(np.int32))
        pairs = np.zeros((1, 1), dtype=np.uint8) if mesh.body_pairs is None else mesh.body_pairs.astype(np.uint8)
        collision_filter.body_pairs = self.array(pairs, wp.uint8)
        collision_filter.by_world = int(mesh.num_worlds > 1)
        collision_filter.vertex_world = self.vertex_world
        collision_filter.by_ring = int(mesh._excludes_by_vertices)
        collision_filter.ring_begin, collision_filter.ring = none, none
        if collision_filter.by_ring:
            collision_filter.ring_begin, collision_filter.ring = (
                self.array(array) for array in self._excluded_vertices()
            )
        listed = [mesh.exclude_pairs.get(name, np.zeros((0, 2))).astype(np.int64) for name in _LISTED]
        collision_filter.listed_begin = self.array(np.append(0, np.cumsum([len(pairs) for pairs in listed])))
        collision_filter.listed = self.array(np.concatenate([a << 32 | b for a, b in (p.T for p in listed)]), wp.int64)
        collision_filter.by_listed_body = int(len(listed[-1]) > 0)
        collision_filter.by_listed_pair = int(any(len(pairs) for pairs in listed[:-1]))
        collision_filter.applies = int(
            collision_filter.by_body or collision_filter.by_world or collision_filter.by_ring or self.has_lists
        )
        groups = BodyGroups.none() if self.groups is None else self.groups
        collision_filter.group_shift = groups.shift
        collision_filter.vertex_group, collision_filter.groups_below = self.vertex_group, self.array(groups.table)
        collision_filter.meets_itself = self.array(groups.meets_itself.astype(np.int32))
        return collision_filter

    @lazy_property
    def groups(self) -> BodyGroups | None:
        """Groups of bodies that may meet the same bodies; None where all may meet."""
        return BodyGroups.of(self.mesh)

    @lazy_property
    def vertex_group(self) -> wp.array:
        """The group of the body of each vertex, int32; empty where there are no groups."""
        return self.array(np.zeros(0) if self.groups is None else self.groups.of_body[self.mesh.vertex_body])

    @lazy_property
    def sorted_groups(self) -> wp.array:
        """The number of each body by which primitives stand in trees first, int32; empty where these are not sorted.

        Of worlds these are the worlds: blocks of sixteen that are halved across the middle of one reach into two.
        """
        mesh, groups = self.mesh, self.groups
        if groups is not None and groups.is_sparse(mesh):
            return self.array(groups.of_body)
        if mesh.num_worlds == 1:
            return self.array(np.zeros(0))
        world = np.zeros(mesh.num_bodies, dtype=np.int32)
        world[mesh.vertex_body] = mesh.vertex_world
        return self.array(np.unique(world, return_inverse=True)[1])  # no more than bodies

    def meets(self, a: Role, b: Role) -> tuple[bool, bool]:
        """Whether any, and whether all, of the pairs of bodies with two roles may meet."""
        return (True, True) if self.groups is None else self.groups.between(self.bodies_of(a), self.bodies_of(b))

    @lazy_property
    def bodies_that_may_meet(self) -> NDArray[np.bool_]:
        """Which pairs of two different bodies the filter leaves, shape [B, B]."""
        return bodies_that_may_meet(self.mesh)

    def _excluded_vertices(self) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        return excluded_vertices(self.mesh)

    @property
    def has_lists(self) -> bool:
        """Whether excluded pairs of bodies or of primitives are listed; those of vertices are part of the rings."""
        return any(name in self.mesh.exclude_pairs for name in _LISTED)

    @property
    def num_bytes(self) -> int:
        """Bytes on the device that belong to the mesh, not to a step."""
        arrays = [self.vertex_body, self.vertex_world, self.moving_vertices, self.static_vertices]
        arrays += [self.boxed_vertices, self.checked_vertices]
        arrays += [self.worlds.cell, self.worlds.origin, self.worlds.anchor]
        arrays += [self.radius, self.box_radius]
        arrays += [self.plane_vertices] if len(self.mesh.planes) else []
        arrays += self.corners.values()
        arrays += [array for s in self._sets.values() for array in (s.ids, s.corners)]
        arrays += [array for order in self.orders.values() for array in order if array is not None]
        collision_filter = self.collision_filter
        arrays += [
            collision_filter.self_collision,
            collision_filter.body_pairs,
            collision_filter.ring_begin,
            collision_filter.ring,
            collision_filter.listed_begin,
            collision_filter.listed,
            collision_filter.vertex_group,
            collision_filter.groups_below,
            collision_filter.meets_itself,
        ]
        return sum({array.ptr: array.capacity for array in arrays if array.ptr}.values())


def sorted_keys(
    topology: Topology,
    primitives: PrimitiveSet,
    vertex_aabbs: wp.array,
    num_aabbs: int,
    typical_extent: np.float32,
    buffers: Buffers,
    execution: Execution,
) -> wp.array:
    """Ascending keys of the primitives along the Morton curve; the lowest bits hold the index."""
    count, body_group = primitives.count, topology.sorted_groups
    num_bits = 63 - _CLASS_BITS - primitives.index_bits
    if len(body_group):
        num_bits -= topology.mesh.num_bodies.bit_length()
    size = 2 * count if execution.is_cuda else count  # the radix sort needs twice the size
    keys = buffers.get(f"{primitives.name} sort", size, wp.int64)
    morton_bits = min(16, num_bits // 3)
    execution.launch(
        kernels.sort_keys,
        count,
        inputs=[
            primitives.corners,
            topology.vertex_body,
            body_group,
            vertex_aabbs,
            num_aabbs,
            typical_extent,
            morton_bits,
            primitives.index_bits,
        ],
        outputs=[keys],
    )
    sort_in_place(keys, count, execution)
    return keys


def sort_in_place(keys: wp.array, count: int, execution: Execution) -> None:
    """Sort the first ``count`` non-negative int64 keys; on CUDA the array has capacity for twice as many.

    On the CPU NumPy's SIMD sort takes a fraction of the time of the radix sort.
    """
    if count < 2:
        return
    if execution.is_cuda:
        wp.utils.radix_sort_pairs(keys, wp.empty(2 * count, dtype=wp.int32, device=execution.device), count)
    else:
        keys.numpy()[:count].sort()


def upper_median(values: NDArray[np.float64]) -> float:
    """The median of some values, of an even number the upper one; their array is in another order then."""
    values.partition(len(values) // 2)
    return float(values[len(values) // 2])


class Quantization(NamedTuple):
    """The map to float32, and the typical extent of a box.

    Attributes:
        origin: What maps to 0.
        scale: By how much lengths shrink, a power of two.
        typical_extent: The longest side of a typical box, in quantized coordinates.
        centre: The middle of the scene, from which the origin was chosen.
        half: Half its size, from which the scale and the lattice of the origin were chosen.
    """

    origin: tuple[float, float, float]
    scale: float
    typical_extent: np.float32
    centre: list[float]
    half: float

    def slack(self, largest: float) -> float:
        """By how much each coordinate may change, at most, so that a scene of one world surely has the same map.

        Both the centre and the size are order statistics of coordinates that are at most ``largest``: they change by no
        more than these do, but for rounding. Below 0 where that cannot be said.
        """
        exponent = math.frexp(self.half)[1]
        if not (self.half > 0.0 and abs(exponent) < LARGEST_EXPONENT - 100 and largest < 2.0**900):
            return -1.0
        half_lattice = 2.0**exponent
        margins = [half_lattice - abs(c - origin) for c, origin in zip(self.centre, self.origin, strict=True)]
        margin = min(self.half - 0.5 * half_lattice, half_lattice - self.half, *margins)
        return 0.5 * margin - 2.0**-40 * largest

    @property
    def packed(self) -> Any:
        """The map as the struct of the kernels; the same one for the same map, which mostly stays from step to step."""
        return _packed_quantization(self.origin, self.scale)


@lru_cache(maxsize=64)
def _packed_quantization(origin: tuple[float, float, float], scale: float) -> Any:
    packed = kernels.Quantization()
    packed.origin, packed.scale = wp.vec3d(*origin), scale
    return packed


def choose_quantization(topology: Topology, positions: Positions, num_aabbs: int) -> Quantization:
    """The map to float32 and the typical extent of a box, from samples of the step.

    The box of the middle nine tenths of the vertices, enlarged three times, maps into [-1/2, 1/2], so a distant vertex
    costs the others no resolution. The origin lies on a coarse lattice, so that it and the trees of static bodies stay
    the same as long as the scene stays in place. With several worlds the box is that of one of them, and maps into the
    middle of its cell.
    """
    if len(positions[0]) == 0:
        return Quantization((0.0, 0.0, 0.0), 0.0, np.float32(0.0), [0.0, 0.0, 0.0], 0.0)
    sampled, has_origins = topology.sampled(positions), topology.world_places.has_origins
    rows = np.empty((4, NUM_SAMPLES))  # the coordinates of the centres of vertices, and the extents of primitives
    with np.errstate(over="ignore", under="ignore"):
        sampled *= 0.5  # so that no sum or difference overflows
        centres = np.add(sampled[0, :, 0], sampled[1, :, 0], out=rows[:3])
        if has_origins:  # with these `half` is how far from its origin most of a world is
            distances = np.sort(np.abs(centres).max(axis=0))
        _longest_sides(sampled[:, :, 1], sampled[:, :, -1], num_aabbs, out=rows[3])
        rows.sort()
        low, middle, centre, high = rows.take(_RANKS, axis=1).T.tolist()  # of each axis, and of the extents
        half_extent = (middle.pop() + centre.pop()) / 2.0
        half = max(0.5 * high[0] - 0.5 * low[0], 0.5 * high[1] - 0.5 * low[1], 0.5 * high[2] - 0.5 * low[2])
        if has_origins:
            half = float(distances[-1 - 2 * _MARGIN])
        half = max(half, half_extent)
        exponent = min(max(math.frexp(half)[1] + 3, -LARGEST_EXPONENT), LARGEST_EXPONENT)
        lattice = 2.0 ** (exponent - 2)
        x, y, z = [min(max(_rounded(c / lattice) * lattice, -LARGEST_ORIGIN), LARGEST_ORIGIN) for c in centre]
        scale = 2.0 ** -(exponent + topology.world_places.bits)
        half_extent += topology.typical_radius_of(topology.samples[1])
        return Quantization((x, y, z), scale, np.float32(2.0 * half_extent * scale), centre, half)


def _longest_sides(
    a: NDArray[np.float64], b: NDArray[np.float64], num_aabbs: int, out: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The longest side of all boxes of each primitive between two points at both ends of a step, shape [2, 3, n]."""
    sides = np.abs(b - a) if num_aabbs == 2 else np.maximum(*np.maximum(a, b)) - np.minimum(*np.minimum(a, b))
    return np.maximum.reduce(sides.reshape(-1, NUM_SAMPLES), axis=0, out=out)


def _rounded(number: float) -> float:
    """The nearest integer, also of an infinite number; even where two are."""
    return float(round(number)) if abs(number) < 2.0**52 else number


def large_half_side(topology: Topology, positions: Positions, quantile: float) -> float:
    """Half the length that this share of the primitives' boxes over the whole step do not exceed, from samples."""
    if len(positions[0]) == 0:
        return 0.0
    _, primitives = topology.samples
    points = topology.seen(primitives, positions)  # axes: end of the step, vertex, primitive, coordinate
    with np.errstate(under="ignore"):
        points *= 0.5
    sides = (points.max(axis=(0, 1)) - points.min(axis=(0, 1))).max(axis=1)
    if topology.mesh.radius is not None:
        with np.errstate(over="ignore"):
            sides += topology.seen_radius(primitives)
        sides = np.minimum(sides, np.finfo(np.float64).max)
    return float(np.quantile(sides, quantile))


def typical_static_extent(topology: Topology, start: NDArray[np.float64], scale: float) -> np.float32:
    """The typical extent of the primitives of static bodies alone, in the quantized coordinates of a scale."""
    mesh = topology.mesh
    among = mesh.edges[mesh.static[mesh.edge_body]]
    if len(among) == 0:
        return np.float32(0.0)
    with np.errstate(over="ignore", under="ignore"):
        sampled = among[uneven_samples(len(among), NUM_SAMPLES)].T.astype(np.intp, order="C")
        points = topology.seen(sampled, (start, start))[0]
        half_extent = float(np.median((0.5 * points.max(axis=0) - 0.5 * points.min(axis=0)).max(axis=1)))
        half_extent += topology.typical_radius_of(sampled)
        return np.float32(2.0 * half_extent * scale)
