"""Triangle meshes, cables and particles of one or several bodies, joined into one set of vertices, edges and faces."""

from collections.abc import Iterable, Sequence
from functools import cached_property
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

# Device types of DLPack: the CPU, and host memory that CUDA has pinned or manages.
_HOST_MEMORY = (1, 3, 13)


class CollisionMesh:
    """What may collide: vertices, unique edges and faces of all bodies, one after the other.

    Build one with :meth:`from_trimesh` or :meth:`from_arrays`; it does not change afterwards and its arrays are
    read-only. Duplicate faces, faces with a repeated vertex, non-manifold edges, vertices in no face and bodies without
    faces are valid.

    Beside faces a body may have **loose edges**, as cables do, and **loose points**, as particles are. An edge that is
    given as loose but belongs to a face is an edge of that face. A vertex in no face and no edge is a loose point only
    in bodies whose ``loose_points`` is on, because meshes from files often hold vertices that nothing uses; elsewhere
    it meets faces alone.

    Attributes:
        vertices: Positions as given, float64, in the caller's length unit, shape [V, 3].
        faces: Vertex indices into the joined vertices, int32, shape [F, 3].
        edges: The unique pairs (min, max) of vertices that follow each other in a face or that a loose edge joins,
            sorted by (max, min), int32, shape [E, 2]. A pair (a, a), as a face with a repeated vertex holds it, is not
            an edge.
        loose_edges: Indices into ``edges`` of those that belong to no face, ascending, int32, shape [E_loose].
        loose_points: Indices of the vertices that collide as points, ascending, int32, shape [V_loose].
        vertex_body, edge_body, face_body: Body of each primitive, int32, shapes [V], [E], [F].
        body_vertex_range: Body b owns the vertices body_vertex_range[b] … body_vertex_range[b + 1] - 1, int32,
            shape [B + 1].
        static: Bodies that do not move, bool, shape [B].
        self_collision: Bodies whose primitives may collide with each other, bool, shape [B].
        moving_vertices: Indices of the vertices of bodies that move, ascending, int32, shape [V_moving].
        body_pairs: Which two different bodies may collide, symmetric, bool, shape [B, B], or None: all.
        exclusion_rings: Pairs of primitives this many edges apart or less, less one, are left out: 1, those that share
            a vertex; 2, also those with vertices that an edge joins; and so on.
        vertex_world: World of each vertex: scenes that know nothing of each other, int32, shape [V].
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    edges: NDArray[np.int32]
    loose_edges: NDArray[np.int32]
    loose_points: NDArray[np.int32]
    vertex_body: NDArray[np.int32]
    edge_body: NDArray[np.int32]
    face_body: NDArray[np.int32]
    body_vertex_range: NDArray[np.int32]
    static: NDArray[np.bool_]
    self_collision: NDArray[np.bool_]
    moving_vertices: NDArray[np.int32]
    body_pairs: NDArray[np.bool_] | None
    exclusion_rings: int
    vertex_world: NDArray[np.int32]

    def __init__(
        self,
        vertices: NDArray[np.float64],
        faces: NDArray[np.int32],
        body_vertex_range: NDArray[np.int32],
        static: NDArray[np.bool_],
        self_collision: NDArray[np.bool_],
        given_edges: NDArray[np.int32],
        with_loose_points: NDArray[np.bool_],
        body_pairs: NDArray[np.bool_] | None,
        exclusion_rings: int,
        vertex_world: NDArray[np.int32],
    ) -> None:
        """Join already validated arrays; use :meth:`from_trimesh` or :meth:`from_arrays` instead."""
        num_bodies = len(static)
        vertex_body = np.repeat(np.arange(num_bodies, dtype=np.int32), np.diff(body_vertex_range))
        edges, loose_edges = _unique_edges(faces, given_edges)
        values: dict[str, Any] = {
            "vertices": vertices,
            "faces": faces,
            "edges": edges,
            "loose_edges": loose_edges,
            "loose_points": _loose_points(faces, edges, with_loose_points, vertex_body),
            "vertex_body": vertex_body,
            "edge_body": vertex_body[edges[:, 0]],
            "face_body": vertex_body[faces[:, 0]],
            "body_vertex_range": body_vertex_range,
            "static": static,
            "self_collision": self_collision,
            "moving_vertices": np.flatnonzero(~static[vertex_body]).astype(np.int32),
            "vertex_world": vertex_world,
        }
        for name, value in values.items():
            value.flags.writeable = False
            object.__setattr__(self, name, value)
        if body_pairs is not None:
            body_pairs.flags.writeable = False
        object.__setattr__(self, "body_pairs", body_pairs)
        object.__setattr__(self, "exclusion_rings", exclusion_rings)
        object.__setattr__(self, "_device_cache", {})
        object.__setattr__(self, "_idle_steps", {})

    def __setattr__(self, name: str, value: Any) -> None:
        raise AttributeError(f"CollisionMesh does not change after construction; cannot set {name}")

    def __delattr__(self, name: str) -> None:
        raise AttributeError(f"CollisionMesh does not change after construction; cannot delete {name}")

    def __repr__(self) -> str:
        parts = [f"{self.num_bodies} bodies", f"{self.num_vertices} vertices", f"{self.num_edges} edges"]
        parts += [f"{self.num_faces} faces"]
        parts += [f"{len(self.loose_edges)} loose edges"] if len(self.loose_edges) else []
        parts += [f"{len(self.loose_points)} loose points"] if len(self.loose_points) else []
        parts += [f"{self.num_worlds} worlds"] if self.num_worlds > 1 else []
        return f"CollisionMesh({', '.join(parts)})"

    @classmethod
    def from_trimesh(
        cls,
        bodies: Sequence[Any],
        static: Iterable[int] = (),
        self_collision: bool | Sequence[bool] = True,
        loose_points: bool | Sequence[bool] = False,
        *,
        body_pairs: ArrayLike | None = None,
        exclusion_rings: int = 1,
        vertex_world: ArrayLike | None = None,
    ) -> "CollisionMesh":
        """Join trimesh objects.

        Args:
            bodies: One a body: a mesh (``trimesh.Trimesh``); a path of straight lines (``trimesh.path.Path3D``), whose
                segments become loose edges; or points (``trimesh.PointCloud``), which become loose points.
            static: Indices of the bodies that do not move.
            self_collision: Whether a body may collide with itself: one answer for all bodies or one for each.
            loose_points: Whether the vertices of a body that no face and no edge uses are loose points: one answer for
                all bodies or one for each. Those of a point cloud always are.
            body_pairs: Which two different bodies may collide, symmetric, bool, shape [B, B]; the diagonal is not read
                (``self_collision`` has it). By default all may.
            exclusion_rings: 1 leaves out pairs that share a vertex; n leaves out pairs with vertices that fewer than n
                edges join, too.
            vertex_world: World of each vertex of all bodies, from 0 on, integer, shape [V]. Primitives of different
                worlds never meet, wherever they are, and each world has a toi of its own. By default all are of one.

        Returns:
            The joined mesh.

        Raises:
            ValueError: If there is no body, or an argument is not as described.
        """
        given = _validated_flags(loose_points, len(bodies), "loose_points")
        arrays = [_arrays_of_trimesh(body, b) for b, body in enumerate(bodies)]
        is_cloud = [not hasattr(body, "faces") and not hasattr(body, "entities") for body in bodies]
        loose = (given | np.array(is_cloud, dtype=bool)).tolist()
        return cls.from_arrays(
            arrays,
            static,
            self_collision,
            loose,
            body_pairs=body_pairs,
            exclusion_rings=exclusion_rings,
            vertex_world=vertex_world,
        )

    @classmethod
    def from_arrays(
        cls,
        bodies: Sequence[tuple[ArrayLike, ...]],
        static: Iterable[int] = (),
        self_collision: bool | Sequence[bool] = True,
        loose_points: bool | Sequence[bool] = False,
        *,
        body_pairs: ArrayLike | None = None,
        exclusion_rings: int = 1,
        vertex_world: ArrayLike | None = None,
    ) -> "CollisionMesh":
        """Join bodies given by arrays.

        Args:
            bodies: One tuple a body, (vertices, faces) or (vertices, faces, edges): vertices, float, shape [V_b, 3];
                faces, integer indices into these vertices, shape [F_b, 3]; and loose edges, likewise, shape [E_b, 2].
            static: Indices of the bodies that do not move.
            self_collision: Whether a body may collide with itself: one answer for all bodies or one for each.
            loose_points: Whether the vertices of a body that no face and no edge uses are loose points: one answer for
                all bodies or one for each.
            body_pairs: Which two different bodies may collide, symmetric, bool, shape [B, B]; the diagonal is not read
                (``self_collision`` has it). By default all may.
            exclusion_rings: 1 leaves out pairs that share a vertex; n leaves out pairs with vertices that fewer than n
                edges join, too.
            vertex_world: World of each vertex of all bodies, from 0 on, integer, shape [V]. Primitives of different
                worlds never meet, wherever they are, and each world has a toi of its own. By default all are of one.

        Returns:
            The joined mesh.

        Raises:
            ValueError: If there is no body, or an argument is not as described.
        """
        if len(bodies) == 0:
            raise ValueError("bodies is empty; expected at least one body")
        all_vertices, all_faces, all_edges, offsets = [], [], [], [0]
        for b, body in enumerate(bodies):
            if not isinstance(body, (tuple, list)) or len(body) not in (2, 3):
                raise ValueError(
                    f"body {b} is a {type(body).__name__}; "
                    f"expected a pair (vertices, faces) or a triple (vertices, faces, edges)"
                )
            vertices = _validated_positions(body[0], f"vertices of body {b}")
            all_vertices.append(vertices)
            all_faces.append(_validated_indices(body[1], 3, len(vertices), f"faces of body {b}") + offsets[-1])
            if len(body) == 3:
                all_edges.append(_validated_indices(body[2], 2, len(vertices), f"edges of body {b}") + offsets[-1])
            offsets.append(offsets[-1] + len(vertices))
        num_faces, num_edges = sum(map(len, all_faces)), sum(map(len, all_edges))
        if max(offsets[-1], 3 * num_faces + num_edges) > np.iinfo(np.int32).max:
            raise ValueError(
                f"bodies hold {offsets[-1]} vertices, {num_faces} faces and {num_edges} loose edges; "
                f"expected counts whose edges int32 can index"
            )
        faces = np.concatenate(all_faces).astype(np.int32)
        edges = np.concatenate([np.zeros((0, 2), dtype=np.int32), *all_edges]).astype(np.int32)
        return cls(
            np.concatenate(all_vertices),
            faces,
            np.array(offsets, dtype=np.int32),
            _validated_static(static, len(bodies)),
            _validated_flags(self_collision, len(bodies), "self_collision"),
            edges,
            _validated_flags(loose_points, len(bodies), "loose_points"),
            _validated_body_pairs(body_pairs, len(bodies)),
            _validated_rings(exclusion_rings),
            _validated_worlds(vertex_world, offsets[-1], {"face": faces, "loose edge": edges}),
        )

    @property
    def num_bodies(self) -> int:
        """Number of bodies."""
        return len(self.static)

    @cached_property
    def num_worlds(self) -> int:
        """Number of worlds, at least one; some may be empty."""
        return int(self.vertex_world.max(initial=0)) + 1

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

    @property
    def static_vertex_ranges(self) -> list[tuple[int, int]]:
        """First vertex and the one after the last of each run of static bodies that own vertices."""
        ranges: list[tuple[int, int]] = []
        for body in np.flatnonzero(self.static & (np.diff(self.body_vertex_range) > 0)):
            begin, end = map(int, self.body_vertex_range[body : body + 2])
            if ranges and ranges[-1][1] == begin:
                ranges[-1] = (ranges[-1][0], end)
            else:
                ranges.append((begin, end))
        return ranges

    def frame(self, vertices: ArrayLike, name: str = "vertices_t0") -> NDArray[np.float64]:
        """Validate the positions of all vertices at one time.

        Args:
            vertices: Positions, float, same length unit as the mesh, shape [V, 3].
            name: Name of the argument, for the messages.

        Returns:
            The positions, float64, C order, shape [V, 3]; the array itself where it is that already.

        Raises:
            ValueError: If the shape differs or a value is not finite.
        """
        return _validated_positions(vertices, name, self.num_vertices, "one row a vertex of the mesh")

    def frames(self, vertices_t0: ArrayLike, vertices_t1: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Validate the positions at both ends of a step and let static bodies rest.

        Args:
            vertices_t0: Start positions, float, same length unit as the mesh, shape [V, 3].
            vertices_t1: End positions, shape [V, 3], where rows of static bodies are not read; or of the moving
                vertices only, in the order of ``moving_vertices``, shape [V_moving, 3].

        Returns:
            Start and end positions, float64, C order, shape [V, 3]; static rows are the same in both.

        Raises:
            ValueError: If a shape does not match or a value that is read is not finite.
        """
        start = self.frame(vertices_t0, "vertices_t0")
        if not self.static.any():
            return start, _validated_positions(vertices_t1, "vertices_t1", self.num_vertices, "like vertices_t0")
        end = _as_positions(_on_host(vertices_t1, "vertices_t1"), "vertices_t1")
        moving = self.moving_vertices
        ranges = self.static_vertex_ranges
        if len(end) == len(start) and all(np.array_equal(start[low:high], end[low:high]) for low, high in ranges):
            _check_finite(end, "vertices_t1")
            return start, end  # nothing to copy
        if len(end) == self.num_vertices:
            end = end[moving]
        elif len(end) != len(moving):
            raise ValueError(
                f"vertices_t1 has shape {end.shape}; expected {start.shape} like vertices_t0 "
                f"or {(len(moving), 3)}, the moving vertices alone"
            )
        _check_finite(end, "vertices_t1")
        full = start.copy()
        full[moving] = end
        return start, full


def _unique_edges(
    faces: NDArray[np.int32], given_edges: NDArray[np.int32]
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Unique (min, max) pairs sorted by (max, min), and the indices of those in no face.

    One sort of 64-bit keys, and NumPy sorts those with SIMD.
    """
    a, b, c = (faces[:, k] for k in range(3))
    keys = _unique_edge_keys([(a, b), (b, c), (c, a)])
    loose = np.zeros(0, dtype=np.int64)
    if len(given_edges):
        loose = _unique_edge_keys([(given_edges[:, 0], given_edges[:, 1])])
        loose = np.setdiff1d(loose, keys, assume_unique=True)
        keys = np.sort(np.concatenate([keys, loose]))
    edges = np.stack([keys & 0xFFFFFFFF, keys >> 32], axis=1).astype(np.int32)
    return edges, np.searchsorted(keys, loose).astype(np.int32)


def _unique_edge_keys(pairs: Sequence[tuple[NDArray[np.int32], NDArray[np.int32]]]) -> NDArray[np.int64]:
    """Ascending keys (max << 32) | min of the edges among pairs of vertices; (a, a) is none."""
    wide = [(p.astype(np.int64), q.astype(np.int64)) for p, q in pairs]
    keys = np.concatenate([(np.maximum(p, q) << 32) | np.minimum(p, q) for p, q in wide])
    keys.sort()
    first = np.ones(len(keys), dtype=bool)
    first[1:] = keys[1:] != keys[:-1]
    keys = keys[first]
    return keys[(keys >> 32) != (keys & 0xFFFFFFFF)]


def _loose_points(
    faces: NDArray[np.int32],
    edges: NDArray[np.int32],
    with_loose_points: NDArray[np.bool_],
    vertex_body: NDArray[np.int32],
) -> NDArray[np.int32]:
    """Vertices in no face and no edge, of the bodies that ask for them."""
    if not with_loose_points.any():
        return np.zeros(0, dtype=np.int32)
    is_loose = with_loose_points[vertex_body]
    is_loose[faces] = False
    is_loose[edges] = False
    return np.flatnonzero(is_loose).astype(np.int32)


def _arrays_of_trimesh(body: Any, index: int) -> tuple[ArrayLike, ...]:
    """The arrays of a mesh, a path or a point cloud."""
    no_faces = np.zeros((0, 3), dtype=np.int64)
    if not hasattr(body, "vertices"):
        raise ValueError(f"body {index} is a {type(body).__name__}; expected a trimesh.Trimesh, Path3D or PointCloud")
    if hasattr(body, "faces"):
        return body.vertices, body.faces
    if not hasattr(body, "entities"):
        return body.vertices, no_faces
    for entity in body.entities:
        # The points of an arc or a spline are not on a polyline along it.
        if type(entity).__name__ != "Line":
            raise ValueError(f"body {index} holds a {type(entity).__name__}; expected a path of straight lines")
    segments = [np.asarray(entity.nodes) for entity in body.entities]
    return body.vertices, no_faces, np.concatenate([np.zeros((0, 2), dtype=np.int64), *segments])


def _as_positions(values: ArrayLike, name: str) -> NDArray[np.float64]:
    """Float64 array of shape [n, 3], or a ValueError."""
    try:
        array = np.asarray(values)
    except ValueError as error:  # ragged nested lists
        raise ValueError(f"{name} is not an array; expected shape (n, 3)") from error
    if array.ndim != 2 or array.shape[1] != 3:
        if array.size == 0 and array.ndim <= 2:
            return np.zeros((0, 3))
        raise ValueError(f"{name} has shape {array.shape}; expected (n, 3)")
    if array.dtype.kind not in "fiu":
        raise ValueError(f"{name} has dtype {array.dtype}; expected real numbers")
    return np.ascontiguousarray(array, dtype=np.float64)


def _on_host(values: Any, name: str) -> Any:
    """What NumPy reads where it is: arrays of other libraries too, unless they are on a GPU."""
    place = getattr(values, "__dlpack_device__", None)
    if callable(place) and not isinstance(values, np.ndarray) and place()[0] not in _HOST_MEMORY:
        raise ValueError(
            f"{name} is a {type(values).__name__} on a GPU; expected an array on the host, "
            f"or CollisionPipeline.launch, which takes arrays on its device"
        )
    return values.numpy() if isinstance(values, wp.array) else values


def _check_finite(array: NDArray[np.float64], name: str) -> None:
    with np.errstate(over="ignore", invalid="ignore"):
        if np.isfinite(array.sum()):
            return  # no infinity and no NaN could leave it finite; a sum that overflows proves nothing
    finite = np.isfinite(array)
    if not finite.all():
        row, column = np.argwhere(~finite)[0]
        raise ValueError(f"{name} holds {array[row, column]} in row {row}; expected finite values")


def _validated_positions(
    values: ArrayLike, name: str, count: int | None = None, reason: str = ""
) -> NDArray[np.float64]:
    values = _on_host(values, name)
    if count is not None and np.shape(values) != (count, 3):
        raise ValueError(f"{name} has shape {np.shape(values)}; expected {(count, 3)} {reason}")
    array = _as_positions(values, name)
    _check_finite(array, name)
    return array


def _validated_indices(values: ArrayLike, columns: int, num_vertices: int, name: str) -> NDArray[np.int64]:
    try:
        array = np.asarray(values)
    except ValueError as error:
        raise ValueError(f"{name} is not an array; expected shape (n, {columns})") from error
    if array.size == 0 and array.ndim <= 2 and array.shape[-1:] in ((0,), (columns,)):
        return np.zeros((0, columns), dtype=np.int64)
    if array.ndim != 2 or array.shape[1] != columns:
        raise ValueError(f"{name} has shape {array.shape}; expected (n, {columns})")
    if array.dtype.kind not in "iu":
        raise ValueError(f"{name} has dtype {array.dtype}; expected integers")
    for index in (array.min(), array.max()):
        if not 0 <= index < num_vertices:
            raise ValueError(f"{name} holds index {index}; expected indices in [0, {num_vertices})")
    return array.astype(np.int64)


def _validated_static(values: Iterable[int], num_bodies: int) -> NDArray[np.bool_]:
    static = np.zeros(num_bodies, dtype=bool)
    if isinstance(values, (bool, int, str)):
        raise ValueError(f"static is {values!r}; expected a list of body indices")
    for body in values:
        if isinstance(body, (bool, np.bool_)) or not isinstance(body, (int, np.integer)):
            raise ValueError(f"static holds {body!r}; expected body indices in [0, {num_bodies})")
        if not 0 <= body < num_bodies:
            raise ValueError(f"static holds {body}; expected body indices in [0, {num_bodies})")
        static[body] = True
    return static


def _validated_flags(values: bool | Sequence[bool], num_bodies: int, name: str) -> NDArray[np.bool_]:
    array = np.asarray(values)
    if array.dtype != bool:
        raise ValueError(f"{name} is {values!r}; expected a bool or one bool a body")
    if array.shape not in ((), (num_bodies,)):
        raise ValueError(f"{name} has shape {array.shape}; expected a bool or {(num_bodies,)}, one a body")
    return np.array(np.broadcast_to(array, (num_bodies,)))


def _validated_body_pairs(values: ArrayLike | None, num_bodies: int) -> NDArray[np.bool_] | None:
    if values is None:
        return None
    array = np.asarray(values)
    if array.dtype != bool or array.shape != (num_bodies, num_bodies):
        raise ValueError(
            f"body_pairs has dtype {array.dtype} and shape {array.shape}; expected bool and {(num_bodies, num_bodies)}"
        )
    if not np.array_equal(array, array.T):
        a, b = np.argwhere(array != array.T)[0]
        raise ValueError(f"body_pairs differs at ({a}, {b}) and ({b}, {a}); expected a symmetric array")
    return array.copy()


def _validated_rings(value: int) -> int:
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, np.integer)) or value < 1:
        raise ValueError(f"exclusion_rings is {value!r}; expected a positive integer")
    return int(value)


def _validated_worlds(
    values: ArrayLike | None, num_vertices: int, primitives: dict[str, NDArray[np.int32]]
) -> NDArray[np.int32]:
    if values is None:
        return np.zeros(num_vertices, dtype=np.int32)
    array = np.asarray(values)
    if array.shape != (num_vertices,) or array.dtype.kind not in "iu":
        raise ValueError(
            f"vertex_world has dtype {array.dtype} and shape {array.shape}; expected integers and {(num_vertices,)}"
        )
    for world in (array.min(initial=0), array.max(initial=0)):
        if not 0 <= world < max(num_vertices, 1):
            raise ValueError(f"vertex_world holds {world}; expected worlds in [0, {num_vertices})")
    for name, corners in primitives.items():
        worlds = array[corners]
        is_torn = (worlds != worlds[:, :1]).any(axis=1)
        if is_torn.any():
            at = int(np.argmax(is_torn))
            raise ValueError(f"vertex_world gives {name} {at} worlds {worlds[at].tolist()}; expected one")
    return array.astype(np.int32)
