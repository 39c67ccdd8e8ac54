"""The part of a mesh that a rank hands in, and what is known of the whole."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ccd_warp._runtime.display import counted
from ccd_warp._scene.half_space import HalfSpace
from ccd_warp._scene.input.arguments import shown
from ccd_warp._scene.input.arrays import as_any_array, as_array, as_positions, check_finite, validated_indices
from ccd_warp._scene.input.half_spaces import half_spaces_by_body, planes_of
from ccd_warp._scene.input.mesh_checks import (
    validated_body_pairs,
    validated_flags,
    validated_radius,
    validated_static,
)
from ccd_warp._scene.input.worlds import move_alone, worlds_of_bodies
from ccd_warp.distributed._exchange import Exchange
from ccd_warp.distributed._ranks import Ranks, mpi

if TYPE_CHECKING:
    from mpi4py.MPI import Intracomm

_Floats = NDArray[np.float64]


class DistributedMesh:
    """A mesh whose parts lie on the ranks of a communicator; no rank ever has all of it.

    Each rank hands in its own part. A vertex may be on several ranks, as a ghost or on the rim that two parts share; it
    has one **owner**, whose positions count. A face may be handed in by several ranks and counts once. All ranks make
    the mesh together, and every method that takes one is collective, too.

    Results are those of one process with **the whole mesh**: its vertices body by body, in the order of their ids, each
    face once. Where copies of a face give its vertices in different orders, the lexicographically first order counts,
    by id.

    A mesh **in the plane** has positions with two coordinates on all ranks, edges and no faces, as one of
    :class:`ccd_warp.CollisionMesh`; a body without edges on any rank consists of points. Wherever positions are taken
    or given they have two columns, and so have points and normals of contacts.

    Attributes:
        dimension: Number of coordinates of a position, 3, or 2 of a mesh in the plane.
        num_vertices: Vertices of the whole mesh.
        num_bodies: Its bodies, half-spaces among them.
        num_worlds: Its worlds.
        length_scale: Longest side of the box around the whole mesh, the default unit of tolerance and separation.
        vertex_ids: The ids of the vertices on this rank, as given, int64, shape [n].
        owner: Rank that owns each of them, int64, shape [n].
        is_owned: Whether this rank does, bool, shape [n].
        is_unused: Which of them take no part, bool, shape [n].
        planes: The planes of half-spaces in the order of their bodies, as of :class:`ccd_warp.CollisionMesh`.
    """

    def __init__(
        self,
        comm: Intracomm | None,
        vertices: ArrayLike,
        faces: ArrayLike | None = None,
        *,
        vertex_ids: ArrayLike,
        edges: ArrayLike | None = None,
        bodies: ArrayLike | None = None,
        static: Iterable[int] | None = (),
        kinematic: Iterable[int] | None = (),
        self_collision: bool | Sequence[bool] = True,
        codimensional_points: bool | Sequence[bool] = False,
        body_pairs: ArrayLike | Iterable[Any] | None = None,
        exclusion_rings: int = 1,
        exclude_pairs: Mapping[str, Any] | None = None,
        vertex_world: ArrayLike | None = None,
        radius: ArrayLike | None = None,
        owned: ArrayLike | None = None,
        half_spaces: Mapping[int, HalfSpace] | None = None,
    ) -> None:
        """Make the mesh, collectively.

        Args:
            comm: The ranks, an intracommunicator of mpi4py, or None for all ranks of the program.
            vertices: Rest positions of the vertices on this rank, float, shape [n, 3], or [n, 2] in the plane. Those of
                the owners count. All ranks have the same number of columns; an empty list goes by the other ranks.
            faces: Rows of these vertices, integer, shape [f, 3]; by default there are none.
            vertex_ids: Id of each vertex in the whole mesh, integers of at least 0, each once on a rank, shape [n].
                They need not follow one another without gaps.
            edges: Rows of the vertices of codimensional edges, integer, shape [e, 2]. A given edge that belongs to a
                face of any rank counts as an edge of that face.
            bodies: Body of each vertex, integers from 0 on, shape [n]. By default there is one body.
            static: Bodies that do not move; the same on all ranks, as all that follows but ``vertex_world``,
                ``radius`` and ``owned``.
            kinematic: Bodies that move as they are told, as of :class:`ccd_warp.CollisionMesh`; no half-spaces.
            self_collision: Whether a body may collide with itself: one flag for all bodies or one for each.
            codimensional_points: Whether the vertices of a body that no face and no edge of any rank uses are
                codimensional points: one flag for all bodies or one for each. Without it they take no part, unless the
                body has neither, as of :class:`ccd_warp.CollisionMesh`.
            body_pairs: Which pairs of different bodies may collide, symmetric, bool, shape [B, B].
            exclusion_rings: 1, as pairs that share no vertex are excluded in one process alone.
            exclude_pairs: ``"bodies"``, pairs of their numbers, and ``"vertices"``, pairs of ids; each shape [k, 2].
            vertex_world: World of each vertex, integers from 0 on, shape [n]. By default there is one world.
            radius: As of :class:`ccd_warp.CollisionMesh`, one length or one for each vertex on this rank, shape [n];
                given on all ranks or on none. Those of the owners count.
            owned: Which vertices this rank owns, bool, shape [n]; given on all ranks or on none. By default the lowest
                rank that has a vertex owns it.
            half_spaces: Half-spaces (:class:`ccd_warp.HalfSpace`), each by the number of the body that it is. Such a
                body has no vertices, and is static.

        Raises:
            ValueError: On all ranks, if an argument of one is not as described; the message begins with its rank.
            TypeError: If ``comm`` is none.
            ImportError: If mpi4py is not installed.
        """
        self.ranks = ranks = Ranks(mpi().COMM_WORLD if comm is None else comm)
        with ranks.together("DistributedMesh"):
            if exclusion_rings != 1:
                raise ValueError(
                    f"exclusion_rings is {shown(exclusion_rings)}; expected 1, as more are for one process"
                )
            columns = as_any_array(vertices, "vertices", "positions").shape[1:]
            self.dimension = int(ranks.most(np.array(columns[0] if len(columns) == 1 else 0))) or 3
            positions = as_positions(vertices, "vertices", self.dimension)
            count, zeros = len(positions), np.zeros(len(positions), dtype=np.int64)
            self.vertex_ids = _per_vertex("vertex_ids", vertex_ids, count)
            self.bodies = zeros if bodies is None else _per_vertex("bodies", bodies, count)
            self.worlds = zeros if vertex_world is None else _per_vertex("vertex_world", vertex_world, count)
            self.radius = validated_radius(radius, [0, count], self._where, {})
            planes = half_spaces_by_body({} if half_spaces is None else half_spaces)
            self._count_bodies(planes)
            self.primitives = {"face": self._corners("faces", faces, 3), "edge": self._corners("edges", edges, 2)}
            self._agree_on_vertices(owned)
            self._take_tables(planes, static, kinematic, self_collision, body_pairs, exclude_pairs)
            self._find_unused(validated_flags(codimensional_points, self.num_bodies, "codimensional_points"))
            check_finite(positions, "vertices", where=self._where, but=np.flatnonzero(self.is_unused))
            self._measure(positions)

    def __repr__(self) -> str:
        sizes = f"{self.num_bodies} bodies, {self.num_vertices:,} vertices" + ", in the plane" * (self.dimension == 2)
        if self.num_unused:
            sizes += f", {counted(self.num_unused, 'vertex takes no part', 'vertices take no part')}"
        here = f"rank {self.ranks.rank} of {self.ranks.size} has {len(self.vertex_ids):,} vertices"
        return f"DistributedMesh({sizes}; {here})"

    def _where(self, row: int) -> str:
        return f" (vertex id {self.vertex_ids[row]})"

    def _count_bodies(self, half_spaces: Mapping[int, HalfSpace]) -> None:
        """Count bodies and worlds, whose tables are on every rank, so that numbers cannot be much too large."""
        most = int(self.ranks.total(np.array(len(self.vertex_ids)))) + len(half_spaces)
        largest = {"bodies": self.bodies, "half_spaces": np.array(list(half_spaces)), "vertex_world": self.worlds}
        of_all = self.ranks.most(np.array([values.max(initial=0) for values in largest.values()], dtype=np.int64))
        for name, value in zip(largest, of_all.tolist(), strict=True):
            if value >= max(most, 1 + len(half_spaces)):
                raise ValueError(f"{name} holds {value}; expected numbers below {most}, that of what the ranks hold")
        self.num_bodies, self.num_worlds = int(of_all[:2].max()) + 1, int(of_all[2]) + 1
        for row in np.flatnonzero(np.isin(self.bodies, list(half_spaces)))[:1].tolist():
            raise ValueError(
                f"bodies gives vertex id {self.vertex_ids[row]} body {self.bodies[row]}, which is a half-space; "
                f"expected the number of another body"
            )
        if len(half_spaces) == self.num_bodies:
            raise ValueError("half_spaces holds all bodies; expected at least one body with vertices")

    def _corners(self, name: str, given: ArrayLike | None, columns: int) -> NDArray[np.int64]:
        """The rows of the vertices of faces or of codimensional edges."""
        corners = validated_indices(() if given is None else given, columns, len(self.vertex_ids), name)
        if self.dimension == 2 and columns == 3 and len(corners):
            raise ValueError(f"faces has shape {corners.shape}; expected none of a mesh in the plane")
        for what, values in (("bodies", self.bodies), ("vertex_world", self.worlds)):
            is_torn = (values[corners] != values[corners[:, :1]]).any(axis=1)
            if is_torn.any():
                at = int(np.argmax(is_torn))
                raise ValueError(f"{what} gives {name}[{at}] the values {values[corners[at]].tolist()}; expected one")
        return corners if columns == 3 else corners[corners[:, 0] != corners[:, 1]]

    def _agree_on_vertices(self, owned: ArrayLike | None) -> None:
        """Find the owner of each vertex, and whether any uses it: what all say of it meets on one rank."""
        ranks, ids, count = self.ranks, self.vertex_ids, len(self.vertex_ids)
        flags = np.full(count, -1) if owned is None else as_array(owned, "owned", f"bool and shape {(count,)}")
        if owned is not None and (flags.shape != (count,) or (count and flags.dtype != bool)):
            raise ValueError(f"owned has dtype {flags.dtype} and shape {flags.shape}; expected bool and {(count,)}")
        given = owned is not None, owned is None, self.radius is not None, self.radius is None
        some = ranks.most(np.array([count and flag for flag in given], dtype=np.int64))
        for name, of_ranks in (("owned", some[:2]), ("radius", some[2:])):
            if of_ranks.all():
                raise ValueError(f"{name} is given on some ranks and not on others; expected it on all or on none")
        self.is_thick = bool(some[2])
        if self.is_thick and count == 0:
            self.radius = np.zeros(0)
        self._order = np.argsort(ids, kind="stable")
        for k in np.flatnonzero(np.diff(ids[self._order]) == 0)[:1]:
            raise ValueError(f"vertex_ids holds {ids[self._order[k]]} more than once; expected each id once on a rank")
        is_used, to_home = np.zeros(count, dtype=np.int64), _by_rank(ids % ranks.size, ranks.size)
        for corners in self.primitives.values():
            is_used[corners] = 1
        said = np.stack([ids, flags.astype(np.int64), self.bodies, self.worlds, is_used], axis=1)
        received = ranks.swap([said[rows] for rows in to_home])
        lengths = [len(rows) for rows in received]
        answers = _at_home(np.concatenate(received), np.repeat(np.arange(ranks.size), lengths))
        result = np.empty((count, 2), dtype=np.int64)
        for rows, answer in zip(to_home, ranks.swap(np.split(answers, np.cumsum(lengths)[:-1])), strict=True):
            result[rows] = answer
        self.owner, self._is_used = result[:, 0].copy(), result[:, 1] > 0
        self.is_owned = self.owner == ranks.rank
        self.num_vertices = int(ranks.total(np.array(self.is_owned.sum())))
        self.copies = self._exchange_to(ids, self.owner)
        none = np.zeros(0, dtype=np.intp)
        self.copies.sources[ranks.rank] = self.copies.targets[ranks.rank] = none  # owners have their own rows
        radius = np.zeros(count) if self.radius is None else self.radius
        self.copies.forward([radius], [radius])
        # of each vertex, as it is sent with a plan
        self.table = np.stack([ids, self.owner, self.bodies, self.worlds, radius.view(np.int64)], axis=1)

    def _exchange_to(self, ids: NDArray[np.int64], owner: NDArray[np.int64]) -> Exchange:
        """The exchange that brings rows of the owners to an array of vertices with these ids; collective."""
        targets = _by_rank(owner, self.ranks.size)
        requested, ordered = self.ranks.swap([ids[rows] for rows in targets]), self.vertex_ids[self._order]
        sources = [self._order[np.searchsorted(ordered, wanted)] for wanted in requested]
        return Exchange(self.ranks, sources, targets)

    def _take_tables(self, half_spaces: Mapping[int, HalfSpace], *tables: Any) -> None:
        """Check what is the same on all ranks."""
        static, kinematic, self_collision, body_pairs, exclude_pairs = tables
        self.names = names = tuple(f"body {b}" for b in range(self.num_bodies))
        self.static, self.kinematic = validated_static(static, kinematic, names)
        for body in filter(half_spaces.__contains__, np.flatnonzero(self.kinematic).tolist()):
            raise ValueError(f"kinematic holds body {body}, a half-space; expected none, as here they are static")
        self.planes = planes_of(((b, f"body {b}", half_space) for b, half_space in half_spaces.items()), self.dimension)
        self.static[self.planes.bodies] = True
        self.self_collision = validated_flags(self_collision, self.num_bodies, "self_collision")
        self.body_pairs = validated_body_pairs(body_pairs, names)
        given = {} if exclude_pairs is None else exclude_pairs
        if not isinstance(given, Mapping) or not set(given) <= {"bodies", "vertices"}:
            raise ValueError(f"exclude_pairs is {shown(given)}; expected a mapping with 'bodies' and 'vertices'")
        self.excluded_ids = validated_indices(given.get("vertices", ()), 2, 1 << 63, "exclude_pairs['vertices']")
        of_bodies = validated_indices(given.get("bodies", ()), 2, self.num_bodies, "exclude_pairs['bodies']")
        is_self = of_bodies[:, 0] == of_bodies[:, 1]
        self.self_collision[of_bodies[is_self, 0]] = False
        self.excluded_bodies = of_bodies[~is_self]
        same: list[NDArray[Any]] = [self.static, self.kinematic, self.self_collision, of_bodies, self.excluded_ids]
        same += [np.zeros(0) if self.body_pairs is None else self.body_pairs, *vars(self.planes).values()]
        text = b"".join(bytes(str(array.shape), "ascii") + array.tobytes() for array in same)
        digest = int.from_bytes(hashlib.sha256(text).digest()[:6], "big")
        least, negative = self.ranks.agree(digest, -digest)
        if least != -negative:
            raise ValueError(
                "static, kinematic, self_collision, body_pairs, exclude_pairs or half_spaces differs by rank"
            )
        is_known = self.ranks.most(np.isin(self.excluded_ids, self.vertex_ids).astype(np.int64)) == 1
        for unknown in self.excluded_ids[~is_known][:1]:
            raise ValueError(f"exclude_pairs['vertices'] holds id {unknown}; expected ids of the whole mesh")

    def _find_unused(self, with_points: NDArray[np.bool_]) -> None:
        """Find which vertices are points, and which take no part."""
        has_primitives = np.zeros(self.num_bodies, dtype=np.int64)
        has_primitives[self.bodies[self._is_used]] = 1
        consists_of_points = self.ranks.most(has_primitives) == 0
        self.with_points = with_points | (consists_of_points & (self.dimension == 2))
        self.with_points[self.planes.bodies] = False
        self.is_unused = ~self._is_used & ~(self.with_points | consists_of_points)[self.bodies]
        self.num_unused = int(self.ranks.total(np.array((self.is_unused & self.is_owned).sum())))
        self.primitives["point"] = np.flatnonzero(self.is_owned & ~self._is_used & ~self.is_unused)[:, None]
        radius = np.zeros(0) if self.radius is None else self.radius[~self.is_unused]
        self.largest_radius = float(self.ranks.most(radius.max(initial=0.0)))
        first, last = worlds_of_bodies(self.bodies, self.worlds, self.num_bodies)
        first, last = self.ranks.least(first), self.ranks.most(last)
        self.moves_alone = move_alone(~self.static, self.self_collision, first, last)

    def _measure(self, vertices: NDArray[np.float64]) -> None:
        """The longest side of the whole mesh, and the mean extent of a primitive, or of points their mean distance."""
        positions, extents = vertices[self.is_owned & ~self.is_unused], np.zeros(2)
        with np.errstate(over="ignore"):
            lower = self.ranks.least(positions.min(axis=0, initial=np.inf))
            upper = self.ranks.most(positions.max(axis=0, initial=-np.inf))
            side = max(float((upper - lower).max()), 0.0)
            for corners in (self.primitives["face"], self.primitives["edge"]):
                extents += np.ptp(vertices[corners], axis=1).max(axis=1, initial=0.0).sum(), len(corners)
            total, count = self.ranks.total(extents)
        self.length_scale = min(side, float(np.finfo(np.float64).max)) or 1.0
        of_points = self.length_scale / max(self.num_vertices, 1) ** (1.0 / 3.0)
        self.mean_extent = float(total / count) if count else of_points

    def _frames(self, vertices_t0: ArrayLike, vertices_t1: ArrayLike | None) -> tuple[_Floats, _Floats]:
        """The positions on this rank as float64, one array at one time, or an error; ghosts may hold anything."""
        start = self._frame(vertices_t0, "positions" if vertices_t1 is None else "vertices_t0")
        if vertices_t1 is None:
            return start, start
        end = self._frame(vertices_t1, "vertices_t1")
        is_moved = self.static[self.bodies] & self.is_owned & ~self.is_unused & (start != end).any(axis=1)
        for row in np.flatnonzero(is_moved)[:1]:
            body = int(self.bodies[row])
            moved = f"vertices_t1 moves vertex id {self.vertex_ids[row]} of body {body}, which is static"
            raise ValueError(f"{moved}; expected its position in vertices_t0, or kinematic=[{body}]")
        return start, end

    def _frame(self, vertices: ArrayLike, name: str) -> NDArray[np.float64]:
        """Positions at one end."""
        count = len(self.vertex_ids)
        if count == 0:  # an empty list has no columns
            vertices = as_positions(vertices, name, self.dimension)
        values = as_positions(vertices, name, self.dimension, count, "one row a vertex of this rank")
        check_finite(values, name, where=self._where, but=np.flatnonzero(~self.is_owned | self.is_unused))
        return values


def _by_rank(rank: NDArray[np.integer], num_ranks: int) -> list[NDArray[np.intp]]:
    """For each rank the items that go to it, ascending."""
    order = np.argsort(rank, kind="stable")
    return np.split(order, np.cumsum(np.bincount(rank, minlength=num_ranks))[:-1])


def _at_home(said: NDArray[np.int64], ranks: NDArray[np.intp]) -> NDArray[np.int64]:
    """The owner of each vertex, and whether any rank uses it, given what ranks, ascending, say of it.

    Raises:
        ValueError: If they do not agree in its body or world, or it has no owner or several.
    """
    ids, owned = said[:, 0], said[:, 1]
    unique, first, place = np.unique(ids, return_index=True, return_inverse=True)
    for name, values in (("bodies", said[:, 2]), ("vertex_world", said[:, 3])):
        differs = values != values[first][place]
        if differs.any():
            k = int(np.argmax(differs))
            raise ValueError(
                f"{name} of vertex id {ids[k]} differs between ranks {ranks[first[place[k]]]} and {ranks[k]}; "
                f"expected the same on all ranks that hold it"
            )
    owner = ranks[first]  # the lowest
    if (owned >= 0).any():
        count = np.bincount(place, weights=owned == 1, minlength=len(unique))
        if (count != 1).any():
            k = int(np.argmax(count != 1))
            raise ValueError(f"owned is set for vertex id {unique[k]} on {int(count[k])} ranks; expected one")
        owner[place[owned == 1]] = ranks[owned == 1]
    is_used = np.bincount(place, weights=said[:, 4], minlength=len(unique)) > 0
    return np.stack([owner[place], is_used[place]], axis=1).astype(np.int64)


def _per_vertex(name: str, values: ArrayLike, count: int) -> NDArray[np.int64]:
    """One integer of at least 0 for each vertex, or a ValueError."""
    array = as_array(values, name, f"integers and shape {(count,)}")
    if array.shape != (count,) or (count and array.dtype.kind not in "iu"):
        raise ValueError(f"{name} has dtype {array.dtype} and shape {array.shape}; expected integers and {(count,)}")
    low, high = array.min(initial=0), array.max(initial=0)
    if low < 0 or high > np.iinfo(np.int64).max:
        raise ValueError(f"{name} holds {low if low < 0 else high}; expected integers of at least 0, below 2**63")
    return array.astype(np.int64)
