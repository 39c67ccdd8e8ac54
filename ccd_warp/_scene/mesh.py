"""Triangle meshes, cables and particles of one or several bodies, joined into one set of vertices, edges and faces."""

from __future__ import annotations  # ArrayLike, written out, would fill a screen of help()

import weakref
from bisect import bisect_right
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ccd_warp._runtime.display import counted, html_table, listed, shown_range
from ccd_warp._runtime.lazy import lazy_property
from ccd_warp._runtime.read_only import ReadOnly
from ccd_warp._runtime.texts import text_completed_by
from ccd_warp._scene.half_space import HalfSpace, Planes
from ccd_warp._scene.input.arguments import check_count, check_items
from ccd_warp._scene.input.arrays import (
    are_few_and_finite,
    as_positions,
    check_finite,
    is_float64,
    validated_positions,
)
from ccd_warp._scene.input.body_arrays import check_bodies, joined_bodies
from ccd_warp._scene.input.body_options import BodyOptions
from ccd_warp._scene.input.cells import Cells, cells_by_type, with_surfaces
from ccd_warp._scene.input.edges import unique_edges
from ccd_warp._scene.input.excluded_pairs import ExcludedPairs, PairsFound, joined_pairs, validated_excluded_pairs
from ccd_warp._scene.input.half_spaces import planes_of, points_of
from ccd_warp._scene.input.mesh_checks import (
    listed_bodies,
    validated_body_pairs,
    validated_flags,
    validated_radius,
    validated_rigid,
    validated_rings,
    validated_static,
    validated_worlds,
    vertices_without_primitive,
)
from ccd_warp._scene.input.names import body_label, is_default_name, of_body, validated_names
from ccd_warp._scene.input.trimesh_bodies import check_single_body, objects_of, trimesh_bodies
from ccd_warp._scene.input.worlds import aligned_forms, move_alone, worlds_of_bodies
from ccd_warp._scene.replicate import replicated

if TYPE_CHECKING:
    from trimesh.parent import Geometry

    from ccd_warp._scene.input.trimesh_bodies import TrimeshObject

# Ranges of rows up to which each is a slice.
_MOST_SLICES = 16

# Vertices of a mesh with half-spaces: a bit of their index tells contacts with these from others (`contact_key`).
MOST_WITH_PLANES = 1 << 30


@dataclass(frozen=True, eq=False, repr=False, init=False)
class CollisionMesh(ReadOnly):
    """The vertices, unique edges and faces of all bodies that may collide, concatenated body by body.

    Build a mesh with :meth:`from_trimesh`, :meth:`from_arrays` or :meth:`from_volume`. It is immutable and its arrays
    are read-only. Duplicate faces, faces with a repeated vertex, non-manifold edges, vertices in no face and bodies
    without faces are valid.

    Besides faces, a body may have **codimensional edges**, for cables, and **codimensional points**, for particles. A
    given edge that belongs to a face counts as an edge of that face. A vertex that belongs to no face and no edge is a
    codimensional point only in bodies whose ``codimensional_points`` flag is set. A body of vertices alone is one of
    particles in any case; without the flag they are tested against faces and half-spaces, not against each other.

    In all other bodies such a vertex takes **no part** (``unused_vertices``): files often have some, and bodies may
    share one list of nodes. It keeps its rows in positions and results, collides with nothing, and no box, length scale
    or world depends on where it is; its coordinates need not be finite. Its toi and its bound of displacement are inf.
    A line search moves it by the fraction of its body, world or scene, and with ``per="vertex"`` all the way.

    A body may be given by **volume cells**. It collides by their boundary surface, its faces. The nodes inside take no
    part.

    A mesh **in the plane** has positions with two coordinates and no faces. Every vertex that takes part is tested
    against every edge, and codimensional points against each other. Wherever positions are taken or given, by NumPy or
    on a device, they have shape [V, 2] in place of [V, 3]; so have points and normals of contacts on the host.

    A body may also be a **half-space** (:class:`ccd_warp.HalfSpace`), such as the ground: static, without vertices, and
    met by the vertices of all bodies that move.

    A **kinematic** body moves as it is told, by its rows in the positions: a scripted wall, a gripper, an animated
    character. No line search shortens its motion. It is tested against bodies that are free, over the whole step, and
    not against itself, another kinematic body or a static one. A kinematic half-space has one vertex, the point of its
    plane, with a row in the positions as every vertex; its normal stays.

    A **rigid** body keeps its shape, and does not collide with itself. Where a call takes a ``motion``
    (:class:`ccd_warp.RigidMotion`), it turns as its poses say, and its vertices stand in its own frame. In a call
    without one they move straight, which a ``RuntimeWarning`` says once.

    Attributes:
        vertices: Positions as given, float64, in the caller's length unit, shape [V, 3], or [V, 2] in the plane.
        faces: Vertex indices into the joined vertices, int32, shape [F, 3].
        edges: The unique pairs (min, max) of vertices that are consecutive in a face or joined by a codimensional edge,
            sorted by (max, min), int32, shape [E, 2]. A pair (a, a), which a face with a repeated vertex contains, is
            not an edge.
        codimensional_edges: Indices into ``edges`` of the edges that belong to no face, ascending, int32, shape
            [E_codim].
        codimensional_points: Indices of the vertices that collide as points, ascending, int32, shape [V_codim].
        unused_vertices: Indices of the vertices that take no part, ascending, int32, shape [V_unused].
        inner_vertices: Those of them that belong to bodies of volume cells, ascending, int32, shape [V_inner].
        vertex_body: Body of each vertex, int32, shape [V].
        edge_body: Body of each edge, int32, shape [E].
        face_body: Body of each face, int32, shape [F].
        body_vertex_range: Body b consists of the vertices body_vertex_range[b] … body_vertex_range[b + 1] - 1, int32,
            shape [B + 1].
        static: Bodies that do not move, bool, shape [B].
        kinematic: Bodies that move as they are told, bool, shape [B]; none of them is static.
        rigid: Bodies that keep their shape, bool, shape [B].
        self_collision: Bodies whose primitives may collide with each other, bool, shape [B].
        moving_vertices: Indices of the vertices of bodies that move, ascending, int32, shape [V_moving].
        body_pairs: Which pairs of different bodies may collide, symmetric, bool, shape [B, B]; None if all may.
        exclusion_rings: Pairs of primitives with vertices fewer than this many edges apart are excluded: with 1 the
            pairs that share a vertex, with 2 also those with two vertices joined by an edge, and so on.
        vertex_world: World of each vertex, int32, shape [V]. Worlds are independent scenes: their primitives never
            collide with those of another world.
        names: Name of each body, B texts; "body 0", "body 1" and so on where none were given.
        exclude_pairs: The excluded pairs of :meth:`excluding`, by what is paired, int32, shapes [k, 2]; each pair once,
            in lexicographic order, the lower index first where both are of one kind.
        radius: Radius of each vertex: half the thickness of a sheet, the radius of a cable or a particle. A primitive
            has the largest of its vertices', and a pair counts as touching once its Euclidean distance is
            ``minimum_distance`` plus the radii of its primitives. In the unit of the positions, float64, shape [V];
            None if none was given.
        planes: The planes of half-spaces in the order of their bodies: ``planes.points`` and ``planes.normals`` as
            given, float64, shape [H, 3], or [H, 2] in the plane; ``planes.bodies``, int32, shape [H];
            ``planes.vertices``, the vertex that is the point of a kinematic one, -1 of a static one, int32, shape [H].

    A mesh can be copied and pickled at any time. What earlier calls have left on a device stays behind.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    edges: NDArray[np.int32]
    codimensional_edges: NDArray[np.int32]
    codimensional_points: NDArray[np.int32]
    unused_vertices: NDArray[np.int32]
    inner_vertices: NDArray[np.int32]
    vertex_body: NDArray[np.int32]
    edge_body: NDArray[np.int32]
    face_body: NDArray[np.int32]
    body_vertex_range: NDArray[np.int32]
    static: NDArray[np.bool_]
    kinematic: NDArray[np.bool_]
    rigid: NDArray[np.bool_]
    self_collision: NDArray[np.bool_]
    moving_vertices: NDArray[np.int32]
    body_pairs: NDArray[np.bool_] | None
    exclusion_rings: int
    vertex_world: NDArray[np.int32]
    names: tuple[str, ...]
    exclude_pairs: Mapping[str, NDArray[np.int32]]
    radius: NDArray[np.float64] | None
    planes: Planes
    _is_of_instances = False

    def __init__(self, *_: Any, **__: Any) -> None:
        """Refuse what looks like the constructor of another library, and ``dataclasses.replace``: neither validates."""
        raise TypeError(
            "CollisionMesh() does not take arrays; use CollisionMesh.from_arrays([(vertices, faces)]), with a "
            "tuple for each body and its edges only where they belong to no face, or CollisionMesh.from_trimesh"
        )

    @classmethod
    def _of_fields(cls, fields: Mapping[str, Any], **properties: Any) -> CollisionMesh:
        """A mesh of all its fields, already validated, and of lazy properties that are known."""
        mesh = object.__new__(cls)
        mesh.__setstate__({**fields, **properties})
        return mesh

    @classmethod
    def _of_parts(
        cls,
        listed_edges: NDArray[np.int32],
        with_codimensional_points: NDArray[np.bool_],
        with_inner_vertices: NDArray[np.bool_],
        **fields: Any,
    ) -> CollisionMesh:
        """A mesh of validated fields and flags of bodies, from which the remaining fields are derived."""
        faces, static = fields["faces"], fields["static"]
        vertex_body = np.repeat(np.arange(len(static), dtype=np.int32), np.diff(fields["body_vertex_range"]))
        edges, codimensional_edges = unique_edges(faces, listed_edges)
        lone = vertices_without_primitive(len(fields["vertices"]), faces, edges[codimensional_edges])
        of_lone, is_of_points = vertex_body[lone], np.ones(len(static), dtype=bool)
        is_of_points[vertex_body[faces[:, 0]]] = is_of_points[vertex_body[edges[codimensional_edges, 0]]] = False
        is_of_points |= with_codimensional_points
        derived = {
            "edges": edges,
            "codimensional_edges": codimensional_edges,
            "codimensional_points": lone[(with_codimensional_points & ~with_inner_vertices)[of_lone]],
            "unused_vertices": lone[(~is_of_points | with_inner_vertices)[of_lone]],
            "inner_vertices": lone[with_inner_vertices[of_lone]],
            "vertex_body": vertex_body,
            "edge_body": vertex_body[edges[:, 0]],
            "face_body": vertex_body[faces[:, 0]],
            "moving_vertices": np.flatnonzero(~static[vertex_body]).astype(np.int32),
        }
        return cls._of_fields(fields, **derived)

    def __getstate__(self) -> dict[str, Any]:
        """The state for a copy or a pickle: the fields, without the cache that calls attach to the mesh."""
        return {f.name: getattr(self, f.name) for f in fields(self)}

    def __repr__(self) -> str:
        parts = [counted(self.num_bodies, "body", "bodies") + (f" ({listed(self.names)})" if self._has_names else "")]
        parts += [f"{count} {name}" for name, count in self._sizes() if count]
        num_unused = len(self.unused_vertices) - len(self.inner_vertices)
        parts += [counted(num_unused, "vertex takes no part", "vertices take no part")] if num_unused else []
        parts += [counted(len(self.planes), "half-space", "half-spaces")] if len(self.planes) else []
        parts += ["in the plane"] if self.dimension == 2 else []
        parts += [f"{self.num_worlds} worlds"] if self.num_worlds > 1 else []
        parts += [f"{sum(map(len, self.exclude_pairs.values()))} excluded pairs"] if self.exclude_pairs else []
        parts += [shown_range("radius", self.radius)] if self.radius is not None and self.num_vertices else []
        return f"CollisionMesh({', '.join(parts)})"

    def _repr_html_(self) -> str:
        counts = [np.bincount(body, minlength=self.num_bodies) for body in (self.vertex_body, self.face_body)]
        rows = [
            (name, self._kind_of_body(b), *(f"{of_body[b]:,}" for of_body in counts))
            for b, name in enumerate(self.names)
        ]
        return html_table(repr(self), ("body", "", "vertices", "faces"), rows)

    def _kind_of_body(self, body: int) -> str:
        return "static" if self.static[body] else "kinematic" if self.kinematic[body] else "moving"

    def _sizes(self) -> list[tuple[str, int]]:
        """What the mesh is made of: the numbers that its text shows, codimensional primitives where there are any."""
        return [
            ("vertices", self.num_vertices),
            ("edges", self.num_edges),
            ("faces", self.num_faces),
            ("codimensional edges", len(self.codimensional_edges)),
            ("codimensional points", len(self.codimensional_points)),
            ("vertices inside", len(self.inner_vertices)),
        ]

    @classmethod
    def from_arrays(
        cls,
        bodies: Sequence[tuple[ArrayLike | Mapping[str, ArrayLike], ...] | HalfSpace],
        static: Iterable[int | str] | None = (),
        self_collision: bool | Sequence[bool] = True,
        codimensional_points: bool | Sequence[bool] = False,
        *,
        kinematic: Iterable[int | str] | None = (),
        rigid: Iterable[int | str] | None = (),
        names: Sequence[str] | None = None,
        body_pairs: ArrayLike | Iterable[Any] | None = None,
        exclusion_rings: int = 1,
        exclude_pairs: Mapping[str, Any] | None = None,
        vertex_world: ArrayLike | None = None,
        radius: ArrayLike | None = None,
    ) -> CollisionMesh:
        """Build a mesh from the arrays of each body.

        Args:
            bodies: One tuple for each body, (vertices, faces) or (vertices, faces, edges): vertices, float, shape
                [V_b, 3]; faces, integer indices into these vertices, shape [F_b, 3]; codimensional edges, also indices
                into these vertices, shape [E_b, 2]. In place of faces a mapping of cells by type, as of
                :meth:`from_volume`. Or (vertices, edges) for each body of a mesh in the plane, with
                vertices of shape [V_b, 2]; the vertices of a body without edges are codimensional points. In place of
                a tuple a :class:`ccd_warp.HalfSpace`; at least one body has vertices. Bodies may be given one list of
                nodes: of each the vertices that its faces and edges use take part.
            static: Indices or names of the bodies that do not move; their end positions are their start positions. Of
                this and of the other lists of bodies None is an empty one.
            self_collision: Whether a body may collide with itself: one flag for all bodies or one for each.
            codimensional_points: Whether the vertices of a body that no face and no edge uses are codimensional points:
                one flag for all bodies or one for each. Without it they take no part, unless the body has neither.
            kinematic: Indices or names of the bodies that move as they are told: no line search shortens their motion,
                and they are tested against bodies that are neither static nor kinematic, alone. A half-space among them
                has one vertex, the point of its plane.
            rigid: Indices or names of the bodies that keep their shape, and do not collide with themselves. Calls with
                a ``motion`` take their vertices in their own frames.
            names: Names of the bodies, by which messages, reports and contacts call them, each a printable text of its
                own. By default "body 0", "body 1" and so on.
            body_pairs: Which pairs of different bodies may collide: the pairs, of indices or names of bodies, as
                ``[("tool", "clamp"), ("holder", "clamp")]``, shape [k, 2]; or a flag for each, symmetric, bool or 0 and
                1, shape [B, B], whose diagonal is ignored (see ``self_collision``). By default all pairs may.
            exclusion_rings: 1 excludes pairs that share a vertex; n also excludes pairs with two vertices that fewer
                than n edges connect. For n of 2 or more, the first call that needs them lists the vertices this near to
                each vertex, 4 bytes each, and raises a ValueError if there are more than 2²⁷ of them. A value above the
                diameter of the mesh as a graph costs no more than the diameter itself.
            exclude_pairs: Single pairs that are excluded, as in :meth:`excluding`.
            vertex_world: World of each vertex of all bodies, integer from 0 on and below V, as there are no more worlds
                than vertices, shape [V]. Primitives of different worlds never collide, wherever they are, and each
                world has its own toi. By default there is one world.
            radius: Half the thickness of sheets, the radius of cables and particles: a length in the unit of the
                positions, at least 0; one number, or one for each body, shape [B], 0 for a half-space, or for each
                vertex, shape [V]. A pair counts as touching once its Euclidean distance is ``minimum_distance`` plus
                the radii of its two primitives, each the largest of its vertices'. Where one is given, even 0,
                distances are Euclidean, and :attr:`CollisionPipeline.radius` can change it on the device. An array that
                could be either, with as many bodies as vertices, is refused unless both mean the same. By default there
                is none.

        Returns:
            The mesh.

        Raises:
            ValueError: If there is no body, or an argument is not as described.
        """
        expected = (
            "a list of (vertices, faces) or (vertices, faces, edges), or (vertices, edges) in the plane, one a body"
        )
        bodies = check_items("bodies", bodies, expected)
        if len(bodies) == 0:
            raise ValueError("bodies is empty; expected at least one body")
        check_bodies(bodies)
        names = validated_names(names, len(bodies))
        with_points = validated_flags(codimensional_points, len(bodies), "codimensional_points")
        bodies, is_of_cells = with_surfaces(bodies, names)
        half_spaces = [(b, body_label(b, names), body) for b, body in enumerate(bodies) if isinstance(body, HalfSpace)]
        is_half_space = np.isin(np.arange(len(bodies)), [b for b, _, _ in half_spaces])
        if is_half_space.all():
            raise ValueError("bodies holds half-spaces alone; expected at least one body with vertices")
        static_bodies, kinematic_bodies = validated_static(static, kinematic, names)
        rigid_bodies = validated_rigid(rigid, names, is_half_space)
        joined = joined_bodies(
            bodies,
            names,
            lambda b, columns: points_of(bodies[b], body_label(b, names), columns, is_kinematic=kinematic_bodies[b]),
        )
        offsets = joined.offsets
        if half_spaces and offsets[-1] > MOST_WITH_PLANES:
            raise ValueError(
                f"bodies hold {offsets[-1]} vertices; expected at most {MOST_WITH_PLANES} with half-spaces"
            )
        mesh = cls._of_parts(
            vertices=np.ascontiguousarray(joined.vertices),  # of points, joined by columns
            faces=joined.faces,
            body_vertex_range=np.array(offsets, dtype=np.int32),
            static=static_bodies | (is_half_space & ~kinematic_bodies),
            kinematic=kinematic_bodies,
            rigid=rigid_bodies,
            self_collision=validated_flags(self_collision, len(bodies), "self_collision") & ~rigid_bodies,
            listed_edges=joined.edges,
            with_codimensional_points=(with_points | joined.consists_of_points) & ~is_half_space,
            with_inner_vertices=is_of_cells,
            body_pairs=validated_body_pairs(body_pairs, names),
            exclusion_rings=validated_rings(exclusion_rings),
            vertex_world=validated_worlds(
                vertex_world,
                offsets[-1],
                {"face": joined.faces, "codimensional edge": joined.edges},
                lambda vertex: of_body(bisect_right(offsets, vertex) - 1, names),
            ),
            names=names,
            exclude_pairs=ExcludedPairs(),
            radius=validated_radius(
                radius,
                offsets,
                lambda vertex: of_body(bisect_right(offsets, vertex) - 1, names),
                {b: label for b, label, _ in half_spaces},
            ),
            planes=planes_of(half_spaces, joined.dimension, joined.offsets),
        )
        for b, (begin, end) in enumerate(pairwise(offsets)):
            low, high = np.searchsorted(mesh.unused_vertices, (begin, end))
            unused = mesh.unused_vertices[low:high] - begin
            check_finite(mesh.vertices[begin:end], f"vertices of {body_label(b, names)}", but=unused)
        return mesh if exclude_pairs is None else mesh.excluding(exclude_pairs)

    @classmethod
    @text_completed_by(from_arrays)
    def from_trimesh(
        cls,
        bodies: TrimeshObject | Iterable[TrimeshObject],
        static: Iterable[int | str] | None = (),
        self_collision: bool | Sequence[bool] = True,
        codimensional_points: bool | Sequence[bool] = False,
        *,
        kinematic: Iterable[int | str] | None = (),
        rigid: Iterable[int | str] | None = (),
        names: Sequence[str] | None = None,
        body_pairs: ArrayLike | Iterable[Any] | None = None,
        exclusion_rings: int = 1,
        exclude_pairs: Mapping[str, Any] | None = None,
        vertex_world: ArrayLike | None = None,
        radius: ArrayLike | None = None,
    ) -> CollisionMesh:
        """Build a mesh from objects of trimesh.

        Args:
            bodies: One object, or a list with one object for each body: a mesh (``trimesh.Trimesh``); a path of
                straight lines (``trimesh.path.Path3D``), whose segments become codimensional edges; points
                (``trimesh.PointCloud``), which become codimensional points; a scene (``trimesh.Scene``), which is
                one body for each node that has a geometry, placed by the node's transformation and called by its name;
                or a :class:`ccd_warp.HalfSpace`.
            codimensional_points: Whether the vertices of a body that no face and no edge uses are codimensional points:
                one flag for all bodies or one for each. The points of a point cloud always are; others without it take
                no part.
            names: Names of the bodies, by which messages, reports and contacts call them, each a printable text of its
                own. By default those of a scene's nodes, and "body 0", "body 1" and so on.

        Raises:
            TypeError: If ``bodies`` is no object of trimesh and no list of these.
        """
        parts = trimesh_bodies(bodies)
        flags = validated_flags(codimensional_points, len(parts), "codimensional_points")
        with_points = (flags | np.array([part.is_cloud for part in parts], dtype=bool)).tolist()
        if names is None and any(part.name for part in parts):
            names = [str(part.name) for part in parts]
        return cls.from_arrays(
            [part.arrays for part in parts],
            static,
            self_collision,
            with_points,
            kinematic=kinematic,
            rigid=rigid,
            names=names,
            body_pairs=body_pairs,
            exclusion_rings=exclusion_rings,
            exclude_pairs=exclude_pairs,
            vertex_world=vertex_world,
            radius=radius,
        )

    @classmethod
    def from_volume(
        cls,
        vertices: ArrayLike,
        cells: Cells,
        others: Sequence[tuple[ArrayLike | Mapping[str, ArrayLike], ...] | HalfSpace] = (),
        **options: Unpack[BodyOptions],
    ) -> CollisionMesh:
        """Build a mesh from a volume mesh, which collides by its boundary surface, and other bodies.

        Wherever positions are taken or given there is a row for every node, and so of results for each vertex. Nodes
        inside, and those of no cell, take no part.

        Args:
            vertices: Positions of all nodes, float, shape [V_0, 3].
            cells: Indices into these nodes, integer: an array of shape [n, 4] for tetrahedra, [n, 5] for pyramids,
                [n, 6] for wedges, or [n, 8] for hexahedra; a list of such arrays; or ``cells`` or ``cells_dict`` of
                meshio, a mapping from the types "tetra", "pyramid", "wedge", "hexahedron" to arrays. By type there may
                be shells, too: "triangle" and "quad"; those that are sides of a volume add nothing. The order of
                corners is that of VTK, also mirrored. A side with four corners becomes two triangles. A hexahedron
                with repeated corners stands for what it has shrunk to. Quadratic cells, "tetra10" (or an array of shape
                [n, 10]), "hexahedron20" ([n, 20]), "wedge15", "pyramid13", "triangle6" and "quad8", collide by their
                corners; where a node in the middle of an edge of the surface is off this, a ``RuntimeWarning`` says how
                far.
            others: Further bodies, as of :meth:`from_arrays`: (vertices, faces), (vertices, cells by type), or a
                :class:`ccd_warp.HalfSpace`. The volume is body 0, and its vertices come first.
            options: Those of :class:`BodyOptions`, as of :meth:`from_arrays`.

        Returns:
            The mesh; its ``faces`` are the surface, turned outward, and ``inner_vertices`` the nodes that it leaves
            out.

        Raises:
            ValueError: If there is no cell, two cells have the same corners, more than two the same side, or an
                argument is not as described.
        """
        further = check_items("others", others, "a list of bodies")
        return cls.from_arrays([(vertices, cells_by_type(cells)), *further], **options)

    def excluding(self, exclude_pairs: Mapping[str, Any] | PairsFound) -> CollisionMesh:
        """A copy of the mesh that excludes further pairs, as given or as found in an earlier result.

        Args:
            exclude_pairs: Contacts or what is near, as :func:`ccd_warp.mesh_ccd` and :func:`ccd_warp.find_proximity`
                give them for this mesh: their pairs of primitives. Or the pairs by what is paired, each an integer
                array of shape [k, 2]. ``"bodies"``: indices or names; all pairs of their primitives are excluded, and a
                pair of a body with itself is the same as ``self_collision=False`` for it. ``"vertices"``: all pairs of
                primitives with one of the vertices on either side. ``"vertex_face"``, ``"edge_edge"``,
                ``"point_segment"``, ``"point_point"``, ``"vertex_plane"``: the pair of primitives alone, with the
                indices of ``contacts.primitives`` and of :class:`ccd_warp.Candidates`, which are those of ``vertices``,
                ``edges``, ``faces`` and ``planes``. Where both are of one kind, their order means nothing. Pairs that
                are not tested anyway may be among them, and so may duplicates. The first call on such a mesh compiles a
                search of its own.

        Returns:
            A mesh with the same bodies and primitives, which excludes these pairs besides those of this mesh.

        Raises:
            ValueError: If ``exclude_pairs`` is neither, belongs to another mesh, or has another key, or an index that
                is not one of such a part of the mesh.
        """
        excluded = validated_excluded_pairs(exclude_pairs, self)
        bodies = excluded.get("bodies", np.zeros((0, 2), dtype=np.int32))
        is_self = bodies[:, 0] == bodies[:, 1]
        self_collision = self.self_collision.copy()
        self_collision[bodies[is_self, 0]] = False
        excluded = ExcludedPairs({**excluded, "bodies": bodies[~is_self]})
        changed = {"self_collision": self_collision, "exclude_pairs": joined_pairs(self.exclude_pairs, excluded)}
        return self._of_fields(self.__getstate__() | changed)

    def _largest_around(self, radius: NDArray[np.float64]) -> NDArray[np.float64]:
        """For each vertex the largest radius of the primitives with it: of it and of those that share an edge."""
        largest = radius.copy()
        for a, b in (self.edges.T, self.edges.T[::-1]):
            np.maximum.at(largest, a, radius[b])
        return largest

    @classmethod
    def from_instances(
        cls,
        shape: Geometry,
        count: int,
        others: TrimeshObject | Iterable[TrimeshObject] = (),
        static: Iterable[int | str] | None = (),
        *,
        rigid: Iterable[int | str] | None = (),
        names: Sequence[str] | None = None,
        body_pairs: ArrayLike | Iterable[Any] | None = None,
        exclude_pairs: Mapping[str, Any] | None = None,
        radius: ArrayLike | None = None,
    ) -> CollisionMesh:
        """Build a mesh of many rigid bodies of one shape, such as dice or nuts, in a scene with others.

        Args:
            shape: An object of trimesh that is one body, in the frame of the bodies.
            count: Number of bodies of this shape, which come first.
            others: Further bodies, a table, say, as :meth:`from_trimesh` takes them; none collides with itself.
            static: Those of them that stand, by their numbers among all bodies or their names.
            rigid: Those of them that are rigid, too.
            names: Names of all bodies, as of :meth:`from_trimesh`.
            body_pairs: Which pairs of different bodies may collide, as of :meth:`from_arrays`.
            exclude_pairs: Pairs of bodies or primitives that are never tested, as of :meth:`from_arrays`.
            radius: Radius of each vertex of all bodies, as of :meth:`from_arrays`.

        Returns:
            The mesh, as of :meth:`from_trimesh` with all of these bodies. Where all that moves is rigid, and few parts
            of the bodies may touch, steps with a ``motion`` compute and keep boxes of those parts alone; the shape is
            divided into them once.

        Raises:
            ValueError: If ``count`` is not a positive integer, ``shape`` is several bodies, or as :meth:`from_trimesh`.
            TypeError: If ``shape`` is no object of trimesh.
        """
        count = check_count("count", count, np.iinfo(np.int32).max)
        check_single_body("shape", shape)
        mesh = cls.from_trimesh(
            [*[shape] * count, *objects_of(others)],
            static,
            self_collision=False,
            rigid=[*range(count), *listed_bodies("rigid", rigid)],
            names=names,
            body_pairs=body_pairs,
            exclude_pairs=exclude_pairs,
            radius=radius,
        )
        return cls._of_fields(mesh.__getstate__(), _is_of_instances=True)

    def replicate(self, count: int) -> CollisionMesh:
        """Copies of all bodies in worlds of their own, for many simulations of one scene at once.

        Args:
            count: Number of copies.

        Returns:
            A mesh with ``count`` times as many bodies, vertices and worlds, copy after copy. The bodies of copy w are
            called ``name[w]``. Wherever positions are taken, those of all copies may be given as one array of shape
            [count, V, 3], with the vertices of this mesh in each copy, also where it has several worlds. Static
            half-spaces are not copied: each stays one body, after those of all copies, with its own name, and all
            worlds share it.

        Raises:
            ValueError: If ``count`` is not a positive integer, or the copies have more primitives than int32 can index.
        """
        return self._of_parts(**replicated(self, count))

    def _copies(self, least: int, most: int) -> CollisionMesh:
        """This mesh in so many worlds or some more; the last two made stay, with what calls attach to them."""
        kept: list[CollisionMesh] = vars(self).setdefault("_last_copies", [])
        for copies in kept:
            if least <= copies.num_worlds <= min(4 * least, most):
                return copies
        copies = self.replicate(min(least + least // 8, most))
        vars(copies)["_copied"] = weakref.ref(self)
        kept[:] = [copies, *kept[:1]]
        return copies

    @property
    def _as_given(self) -> CollisionMesh:
        """The mesh that a caller has: that of which this one is the copies of :meth:`_copies`, or this one."""
        copied: weakref.ref[CollisionMesh] | None = vars(self).get("_copied")
        return (copied and copied()) or self

    @lazy_property
    def _all_rigid(self) -> CollisionMesh:
        """This mesh with all bodies rigid that have vertices of their own."""
        rigid = ~np.isin(np.arange(self.num_bodies), self.planes.bodies)
        changed = {"rigid": rigid, "self_collision": self.self_collision & ~rigid}
        return self._of_fields(self.__getstate__() | changed)

    @lazy_property
    def _surface_vertices(self) -> NDArray[np.int32]:
        """The vertices that may collide with a face or a half-space: all that take part, ascending."""
        return np.delete(np.arange(self.num_vertices, dtype=np.int32), self.unused_vertices)

    @property
    def _free_surface_vertices(self) -> NDArray[np.int32]:
        """Those of them whose motion is not prescribed, which meet half-spaces."""
        return self._surface_vertices[self._is_free[self.vertex_body[self._surface_vertices]]]

    @lazy_property
    def _copies_of_faces(self) -> NDArray[np.int32]:
        """For each face the first one with the same vertices, -1 where it is alone; empty where all are, shape [F]."""
        corners = np.sort(self.faces, axis=1)
        order = np.lexsort(corners.T)
        is_new = np.append(True, (np.diff(corners[order], axis=0) != 0).any(axis=1))[: len(order)]
        if is_new.all():
            return np.empty(0, dtype=np.int32)
        number = np.cumsum(is_new) - 1
        first, is_alone = order[is_new], np.bincount(number) == 1
        copies = np.empty(len(order), dtype=np.int32)
        copies[order] = np.where(is_alone[number], -1, first[number])
        return copies

    @lazy_property
    def _stand_ins(self) -> NDArray[np.intp]:
        """For each vertex itself, and for one that takes no part another of its body that does, shape [V]."""
        stand_ins, used, unused = np.arange(self.num_vertices), self._surface_vertices, self.unused_vertices
        after = np.searchsorted(used, unused)  # one of the body is the nearest before or the nearest after
        before = used[np.maximum(after - 1, 0)]
        is_of_body = self.vertex_body[before] == self.vertex_body[unused]
        stand_ins[unused] = np.where(is_of_body, before, used[np.minimum(after, len(used) - 1)])
        return stand_ins

    def _placed(self, positions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Positions in which vertices that take no part stand where others of their body do, so nothing sees them."""
        return positions.take(self._stand_ins, axis=0) if len(self.unused_vertices) else positions

    def _both_placed(
        self, start: NDArray[np.float64], end: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The positions at both ends of a step so; they stay one array where they are one."""
        placed = self._placed(start)
        return placed, placed if end is start else self._placed(end)

    def _both_in_space(
        self, start: NDArray[np.float64], end: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Validated positions at both ends of a step as the engine takes them."""
        if self.dimension == 3 and not len(self.unused_vertices):
            return start, end
        start, end = self._both_placed(start, end)
        return self._in_space(start), self._in_space(end)

    @lazy_property
    def is_thick(self) -> bool:
        """Whether vertices have radii, even if all are 0, as launches may read others in their place."""
        return self.radius is not None

    @lazy_property
    def _largest_radius(self) -> float:
        """The largest radius of a vertex that takes part, 0 where there is none."""
        return 0.0 if self.radius is None else float(self.radius[self._surface_vertices].max(initial=0.0))

    @lazy_property
    def _excludes_by_vertices(self) -> bool:
        """Whether pairs that share no vertex are excluded by their vertices: by rings, or by pairs of vertices."""
        return self.exclusion_rings > 1 or "vertices" in self.exclude_pairs

    @property
    def dimension(self) -> int:
        """Number of coordinates of a position, 3 in space and 2 of a mesh in the plane."""
        return self.vertices.shape[1]

    @property
    def num_bodies(self) -> int:
        """Number of bodies."""
        return len(self.static)

    @lazy_property
    def num_worlds(self) -> int:
        """Number of worlds, at least one; some may be empty."""
        return int(self.vertex_world.max(initial=0)) + 1

    @lazy_property
    def _moves_alone(self) -> bool:
        """Whether at most one body moves in each world, and none of them collides with itself."""
        return move_alone(
            ~self.static, self.self_collision, *worlds_of_bodies(self.vertex_body, self.vertex_world, self.num_bodies)
        )

    @lazy_property
    def _is_free_alone(self) -> bool:
        """Whether at most one body moves freely in each world, and none of them collides with itself."""
        return move_alone(
            self._is_free, self.self_collision, *worlds_of_bodies(self.vertex_body, self.vertex_world, self.num_bodies)
        )

    @lazy_property
    def length_scale(self) -> float:
        """Longest side of the box around the ``vertices`` that take part, 1 if it has none.

        It is the default unit of tolerance and separation in every step. Points of half-spaces are not in the box.
        """
        others = np.append(self.planes.vertices[self.planes.vertices >= 0], self.unused_vertices)
        vertices = np.delete(self.vertices, others, axis=0) if len(others) else self.vertices
        with np.errstate(over="ignore"):
            side = float(np.ptp(vertices, axis=0).max()) if len(vertices) else 0.0
        return min(side, float(np.finfo(np.float64).max)) or 1.0

    @property
    def num_vertices(self) -> int:
        """Number of vertices of all bodies."""
        return len(self.vertices)

    @property
    def num_edges(self) -> int:
        """Number of unique edges."""
        return len(self.edges)

    @property
    def num_faces(self) -> int:
        """Number of faces of all bodies."""
        return len(self.faces)

    @lazy_property
    def rows_by_world(self) -> tuple[tuple[int, int], ...]:
        """Numbers of blocks and of rows in each, as positions may be given with an axis of worlds.

        A block is a world, or several that follow one another, as those of a copy are where a mesh with worlds was
        replicated. The first forms are for all vertices, the others for the vertices of bodies that move.
        """
        moving = self.vertex_world[self.moving_vertices]
        return tuple(dict.fromkeys([*aligned_forms(self.vertex_world), *aligned_forms(moving)]))

    @lazy_property
    def _vertices_in_space(self) -> NDArray[np.float64]:
        return self._in_space(self._placed(self.vertices))

    def _in_space(self, positions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Validated positions as the engine takes them: those in the plane have z = 0."""
        if self.dimension == 3:
            return positions
        in_space = np.zeros((len(positions), 3))
        in_space[:, 0], in_space[:, 1] = positions[:, 0], positions[:, 1]  # faster than both columns at once
        return in_space

    @lazy_property
    def _has_names(self) -> bool:
        """Whether a body was given a name."""
        return not all(is_default_name(name, b) for b, name in enumerate(self.names))

    def _where(self, vertex: int) -> str:
        """What a message adds to the number of a vertex, where bodies have names."""
        if not self._has_names:
            return ""
        body = int(self.vertex_body[vertex])
        return f" (vertex {vertex - int(self.body_vertex_range[body])} of {self.names[body]})"

    def _where_moving(self, row: int) -> str:
        return self._where(int(self.moving_vertices[row]))

    @lazy_property
    def static_vertex_ranges(self) -> list[tuple[int, int]]:
        """Vertex range [begin, end) of each run of consecutive static bodies; bodies without vertices are skipped."""
        ranges: list[tuple[int, int]] = []
        for body in np.flatnonzero(self.static & (np.diff(self.body_vertex_range) > 0)):
            begin, end = map(int, self.body_vertex_range[body : body + 2])
            if ranges and ranges[-1][1] == begin:
                ranges[-1] = (ranges[-1][0], end)
            else:
                ranges.append((begin, end))
        return ranges

    @lazy_property
    def _static_rows(self) -> list[Any]:
        return blocks_of(self.static_vertex_ranges)

    def frame(self, vertices: ArrayLike, name: str = "vertices_t0") -> NDArray[np.float64]:
        """Validate the positions of all vertices at one time.

        Args:
            vertices: Positions, float, same length unit as the mesh, shape [V, 3]; or [W, V / W, 3] of a mesh whose W
                worlds have equally many vertices, as those of :meth:`replicate` have, or are the copies of several
                worlds.
            name: Name of the argument, for the messages.

        Returns:
            The positions, float64, C order, shape [V, 3]; an array that already has this form is returned as it is.

        Raises:
            ValueError: If the shape differs, or a value of a vertex that takes part is not finite.
        """
        rows, but = (self.dimension, self.num_vertices, self._all_rows), self.unused_vertices
        return validated_positions(vertices, name, *rows, self.rows_by_world, self._where, but)

    @lazy_property
    def _all_rows(self) -> str:
        """What a message says of the rows of positions."""
        return "one row a vertex of the mesh" + self._or_by_world(self.num_vertices)

    def _or_by_world(self, count: int) -> str:
        """What a message adds where positions may have an axis of worlds."""
        shapes = [form for form in self.rows_by_world if form[0] > 1 and form[0] * form[1] == count]
        return f", or {(*shapes[0], self.dimension)}, with an axis of worlds" if shapes else ""

    def frames(self, vertices_t0: ArrayLike, vertices_t1: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Validate the positions at both ends of a step, and keep static bodies at their start positions.

        Args:
            vertices_t0: Start positions, float, same length unit as the mesh, shape [V, 3].
            vertices_t1: End positions, shape [V, 3], in which static bodies are where they start; or those of the
                moving vertices only, in the order of ``moving_vertices``, shape [V_moving, 3]. Of a mesh whose worlds
                have equally many of them, either may have an axis of worlds before the others.

        Returns:
            Start and end positions, float64, C order, shape [V, 3]; rows of static vertices are the same in both. An
            array that already has this form is returned as it is; otherwise the returned array is new, or a view.

        Raises:
            ValueError: If a shape does not match, or, of vertices that take part, a value is not finite or a row of a
                static body differs from that in ``vertices_t0``; the sign of a zero is no difference.
        """
        if self._are_plain(vertices_t0, vertices_t1):
            return vertices_t0, vertices_t1  # type: ignore[return-value]
        start = self.frame(vertices_t0, "vertices_t0")
        by_world = self.rows_by_world
        if len(self.moving_vertices) == self.num_vertices:
            rows, but = (self.dimension, self.num_vertices, "like vertices_t0"), self.unused_vertices
            return start, validated_positions(vertices_t1, "vertices_t1", *rows, by_world, self._where, but)
        end = as_positions(vertices_t1, "vertices_t1", self.dimension, by_world=by_world)
        moving = self.moving_vertices
        if len(end) == self.num_vertices:
            if end is not start:
                check_finite(end, "vertices_t1", where=self._where, but=self.unused_vertices)
                self._check_static_stay(start, end)
            return start, end  # nothing to copy
        if len(end) != len(moving):
            raise ValueError(
                f"vertices_t1 has shape {end.shape}; expected {start.shape} like vertices_t0 "
                f"or {(len(moving), self.dimension)}, the moving vertices alone"
            )
        unused = np.flatnonzero(np.isin(moving, self.unused_vertices)) if len(self.unused_vertices) else None
        check_finite(end, "vertices_t1", where=self._where_moving, but=unused)
        full = start.copy()
        full[moving] = end
        return start, full

    def _are_plain(self, start: ArrayLike, end: ArrayLike) -> bool:
        """Whether these are few positions of all vertices, which all move, that need no more checks: as most are."""
        return (
            type(start) is np.ndarray
            and type(end) is np.ndarray
            and start.shape == end.shape == self.vertices.shape
            and len(self.moving_vertices) == len(start)
            and is_float64(start)
            and is_float64(end)
            and are_few_and_finite(start, end)
        )

    def _check_static_stay(self, start: NDArray[np.float64], end: NDArray[np.float64]) -> None:
        """Check that the rows of static bodies, which are finite where they take part, are the same at both ends."""
        if all(np.array_equal(start[rows], end[rows]) for rows in self._static_rows):
            return
        start, end = self._both_placed(start, end)
        for rows in self._static_rows:
            if not np.array_equal(start[rows], end[rows]):
                vertices = np.arange(self.num_vertices)[rows]
                raise ValueError(static_moves(self, vertices, start[rows], end[rows]))

    @lazy_property
    def _is_free(self) -> NDArray[np.bool_]:
        """Bodies whose motion is not prescribed: neither static nor kinematic, shape [B]."""
        free: NDArray[np.bool_] = ~(self.static | self.kinematic)
        return free

    @lazy_property
    def _moving_rigid(self) -> NDArray[np.intp]:
        """Rigid bodies that are not static."""
        return np.flatnonzero(self.rigid & ~self.static)

    @lazy_property
    def _moves_planes(self) -> bool:
        """Whether a half-space is kinematic."""
        return bool((self.planes.vertices >= 0).any())


def blocks_of(ranges: Sequence[tuple[int, int]]) -> list[Any]:
    """What selects the rows of ranges: a slice for each; of many, the rows of which may be few, all at once."""
    if len(ranges) <= _MOST_SLICES:
        return [slice(begin, end) for begin, end in ranges]
    return [np.concatenate([np.arange(begin, end) for begin, end in ranges])]


def static_moves(
    mesh: CollisionMesh, vertices: NDArray[np.intp], start: NDArray[np.float64], end: NDArray[np.float64]
) -> str:
    """What the error says where rows of static bodies differ at both ends of a step: which vertex moves the most."""
    with np.errstate(over="ignore"):
        length = np.linalg.norm(end - start, axis=1)
    row = int(np.argmax(length))
    vertex = int(vertices[row])
    body = int(mesh.vertex_body[vertex])
    number = vertex - int(mesh.body_vertex_range[body])
    name = repr(mesh.names[body])
    return (
        f"vertices_t1 moves vertex {number} of {body_label(body, mesh.names)}, which is static, by {length[row]:.6g} "
        f"(row {vertex}); expected its position in vertices_t0, or kinematic=[{name}] in place of static=[{name}] for "
        f"a body that moves as it is told"
    )
