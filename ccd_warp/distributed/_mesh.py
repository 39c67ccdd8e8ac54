"""The part of a mesh that a rank hands in, and what is known of the whole."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ccd_warp._engine.mesh.samples import uneven_samples
from ccd_warp._engine.mesh.topology import NUM_SAMPLES
from ccd_warp._runtime.display import counted
from ccd_warp._scene.half_space import HalfSpace
from ccd_warp._scene.input.arguments import shown
from ccd_warp._scene.input.arrays import as_any_array, as_array, as_positions, check_finite, validated_indices
from ccd_warp._scene.input.excluded_pairs import ExcludedPairs
from ccd_warp._scene.input.half_spaces import half_spaces_by_body, planes_of
from ccd_warp._scene.input.mesh_checks import (
    validated_body_pairs,
    validated_flags,
    validated_rigid,
    validated_rings,
    validated_static,
)
from ccd_warp._scene.input.worlds import move_alone, worlds_of_bodies
from ccd_warp.distributed import _numbering as numbering
from ccd_warp.distributed._exchange import Exchange
from ccd_warp.distributed._handed_in import HandedIn, handed_in
from ccd_warp.distributed._homes import Homes
from ccd_warp.distributed._interrupts import Interrupts
from ccd_warp.distributed._primitives import Primitives, numbered_edges, numbered_faces
from ccd_warp.distributed._ranks import Ranks, mpi
from ccd_warp.distributed._rings import Rings

_MOST_VERTICES = np.iinfo(np.int32).max


class DistributedMesh:
    """A mesh whose parts lie on the ranks of a communicator; no rank ever has all of it.

    Each rank hands in its own part. A vertex may be on several ranks, as a ghost or on the rim that two parts share; it
    has one **owner**, whose positions count. A face may be handed in by several ranks and counts once. All ranks make
    the mesh together, and every method that takes one is collective, too.

    Results are those of one process with **the whole mesh**: all vertices in the order of their ids, body by body, each
    face once. Where copies of a face give its vertices in different orders, the lexicographically first order counts,
    by id.

    A mesh **in the plane** has positions with two coordinates on all ranks, edges and no faces, as one of
    :class:`ccd_warp.CollisionMesh`; a body without edges on any rank consists of points. Wherever positions are taken
    or given they have two columns, and so have points and normals of contacts.

    Attributes:
        dimension: Number of coordinates of a position, 3, or 2 of a mesh in the plane.
        num_vertices: Vertices of the whole mesh.
        num_edges: Its edges.
        num_faces: Its faces.
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
        comm: Any,
        vertices: ArrayLike,
        faces: ArrayLike | None = None,
        *,
        vertex_ids: ArrayLike,
        edges: ArrayLike | None = None,
        bodies: ArrayLike | None = None,
        static: Iterable[int] | None = (),
        kinematic: Iterable[int] | None = (),
        rigid: Iterable[int] | None = (),
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
                the owners count. All ranks have the same number of columns, those with shape [0, 3] or [0, 2] as well;
                an empty list has none, and goes by the other ranks.
            faces: Rows of these vertices, integer, shape [f, 3]; by default there are none.
            vertex_ids: Id of each vertex in the whole mesh, integers of at least 0, each once on a rank, shape [n].
                They need not follow one another without gaps.
            edges: Rows of the vertices of codimensional edges, integer, shape [e, 2]. A given edge that belongs to a
                face of any rank counts as an edge of that face.
            bodies: Body of each vertex, integers that ascend with the ids, shape [n]. By default there is one body.
            static: Bodies that do not move; the same on all ranks, as all that follows but ``vertex_world``,
                ``radius`` and ``owned``.
            kinematic: Bodies that move as they are told, as of :class:`ccd_warp.CollisionMesh`; no half-spaces.
            rigid: Bodies that keep their shape, as of :class:`ccd_warp.CollisionMesh`; calls with a ``motion`` take
                their vertices in the bodies' own frames. A body may lie on several ranks.
            self_collision: Whether a body may collide with itself: one flag for all bodies or one for each.
            codimensional_points: Whether the vertices of a body that no face and no edge of any rank uses are
                codimensional points: one flag for all bodies or one for each. Without it they take no part, unless the
                body has neither, as of :class:`ccd_warp.CollisionMesh`.
            body_pairs: Which pairs of different bodies may collide, symmetric, bool, shape [B, B].
            exclusion_rings: As of :class:`ccd_warp.CollisionMesh`, over the edges of the whole mesh.
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
        interrupts = Interrupts()
        with interrupts.taken():  # from here on, as ranks wait for each other before they can agree
            self.ranks = ranks = Ranks(mpi().COMM_WORLD if comm is None else comm, interrupts)
            with ranks.together("DistributedMesh"):
                self.dimension = dimension = self._common_dimension(vertices)
                self._half_spaces = half_spaces_by_body({} if half_spaces is None else half_spaces)
                of_all = dimension, self._half_spaces
                part = handed_in(*of_all, vertices, faces, vertex_ids, edges, bodies, vertex_world, radius, owned)
                self._number_vertices(part)
                self._take_tables(
                    part,
                    (static, kinematic),
                    rigid,
                    self_collision,
                    codimensional_points,
                    body_pairs,
                    exclusion_rings,
                    exclude_pairs,
                )
                self._number_primitives(part)
                self._measure()
                self._choose_samples()
                between = self.numbers[self.primitives["edge"].corners]
                self.rings = Rings.of(self._homes, between, self.numbers, self.exclusion_rings, self._excluded)

    def __repr__(self) -> str:
        sizes = f"{self.num_vertices:,} vertices, {self.num_edges:,} edges, {self.num_faces:,} faces"
        sizes += f", {counted(len(self.planes), 'half-space', 'half-spaces')}" if len(self.planes) else ""
        sizes += ", in the plane" if self.dimension == 2 else ""
        if self._num_unused:
            sizes += f", {counted(self._num_unused, 'vertex takes no part', 'vertices take no part')}"
        return (
            f"DistributedMesh({self.num_bodies} bodies, {sizes}; "
            f"rank {self.ranks.rank} of {self.ranks.size} has {len(self.vertex_ids):,} vertices)"
        )

    def _common_dimension(self, vertices: ArrayLike) -> int:
        """2 if the ranks have vertices in the plane, and 3 otherwise."""
        shape = as_any_array(vertices, "vertices", "positions").shape
        columns = self.ranks.every(np.array([shape[1] if len(shape) == 2 else 0]))
        planar, others = np.flatnonzero(columns == 2), np.flatnonzero((columns != 0) & (columns != 2))
        if len(planar) and len(others):
            raise ValueError(
                f"vertices has 2 columns on rank {planar[0]} and {columns[others[0]]} on rank {others[0]}; "
                f"expected all ranks in the plane, or none"
            )
        return 2 if len(planar) else 3

    def _number_vertices(self, part: HandedIn) -> None:
        """Number the vertices of the whole mesh by their ids, and find their owners."""
        ranks = self.ranks
        self.vertices, self.vertex_ids, self._order = part.vertices, part.vertex_ids, part.order
        self.bodies, self.worlds, self.radius = part.bodies, part.worlds, part.radius
        has = [(part.owned >= 0).any(), (part.owned < 0).any(), self.radius is not None, self.radius is None]
        some = ranks.most(np.array(has, dtype=np.int64))
        for name, flags in (("owned", some[:2]), ("radius", some[2:])):
            if flags.all():
                raise ValueError(f"{name} is given on some ranks and not on others; expected it on all or on none")
        of_ids = Homes(ranks, numbering.splitters(ranks.every(numbering.id_samples(self.vertex_ids)), ranks.size))
        queries = of_ids.ask(np.stack([self.vertex_ids, part.owned, self.bodies, self.worlds], axis=1), self.vertex_ids)
        ids, owned, bodies, worlds = queries.rows.T
        home = numbering.vertices_at_home(ids, queries.holder, owned, {"bodies": bodies, "vertex_world": worlds})
        before = ranks.sum_before(len(home.ids))
        self._check_bodies(home.ids, bodies[home.first])
        answers = queries.answers(np.stack([before + home.place, home.owner[home.place]], axis=1))
        self.numbers, self.owner = np.ascontiguousarray(answers.T)
        self._ordered = self.numbers[self._order]
        self.is_owned = self.owner == ranks.rank
        self.owned_rows = np.flatnonzero(self.is_owned)
        counts = ranks.every(np.array([len(home.ids)]))
        self.num_vertices = int(counts.sum())
        if self.num_vertices > _MOST_VERTICES:
            raise ValueError(f"the ranks hold {self.num_vertices} vertices; expected at most {_MOST_VERTICES}")
        self._homes = Homes(ranks, np.cumsum(counts)[:-1])  # of numbers, in place of ids
        largest = {
            "bodies": self.bodies.max(initial=0),
            "half_spaces": max(self._half_spaces, default=0),
            "vertex_world": self.worlds.max(initial=0),
        }
        of_all = ranks.most(np.array(list(largest.values()), dtype=np.int64)).tolist()
        for name, value in zip(largest, of_all, strict=True):
            more = 0 if name == "vertex_world" else len(self._half_spaces)
            most = max(self.num_vertices, 1) + more
            if value >= most:
                of = "all vertices and half-spaces" if more else "all vertices"
                raise ValueError(f"{name} holds {value}; expected numbers below {most}, that of {of}")
        self.num_bodies, self.num_worlds = max(of_all[:2]) + 1, of_all[2] + 1
        every = self._exchange_to(self.numbers, self.owner)
        every.sources[ranks.rank] = every.targets[ranks.rank] = np.zeros(0, dtype=np.intp)  # owners have their own rows
        self.copies = Exchange(ranks, every.sources, every.targets)
        self.has_ghosts = ranks.agree(-float(self.copies.num_sent))[0] < 0.0

    def worlds_of_bodies(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """The first and the last world of each body's vertices that take part, shape [B]; collective."""
        used = ~self.is_unused
        first, last = worlds_of_bodies(self.bodies[used], self.worlds[used], self.num_bodies)
        return self.ranks.least(first), self.ranks.most(last)

    def _move_alone(self) -> bool:
        """Whether at most one body moves in each world, and none of them collides with itself; collective."""
        first, last = worlds_of_bodies(self.bodies, self.worlds, self.num_bodies)
        return move_alone(~self.static, self.self_collision, self.ranks.least(first), self.ranks.most(last))

    def _check_bodies(self, ids: NDArray[np.int64], bodies: NDArray[np.int64]) -> None:
        """Check that bodies follow one another over all homes."""
        ends = self.ranks.every(np.stack([ids, bodies], axis=1)[[0, -1]] if len(ids) else np.zeros((0, 2), np.int64))
        numbering.check_bodies_follow(*ends.T)
        numbering.check_bodies_follow(ids, bodies)

    def _exchange_to(
        self, numbers: NDArray[np.int64], owner: NDArray[np.int64], rows: NDArray[np.intp] | None = None
    ) -> Exchange:
        """The exchange that brings rows of the owners to an array of vertices with these numbers; collective.

        Args:
            numbers: Numbers of the vertices.
            owner: Their owners.
            rows: Rows of the array for them; by default all in order.
        """
        targets = numbering.by_destination(owner, self.ranks.size)
        requested = self.ranks.swap([numbers[items] for items in targets])
        if rows is not None:
            targets = [rows[items] for items in targets]
        sources = [self._order[np.searchsorted(self._ordered, wanted)].astype(np.intp) for wanted in requested]
        return Exchange(self.ranks, sources, targets)

    def _take_tables(
        self,
        part: HandedIn,
        prescribed: tuple[Iterable[int] | None, Iterable[int] | None],
        rigid: Iterable[int] | None,
        self_collision: bool | Sequence[bool],
        codimensional_points: bool | Sequence[bool],
        body_pairs: ArrayLike | Iterable[Any] | None,
        exclusion_rings: int,
        exclude_pairs: Mapping[str, Any] | None,
    ) -> None:
        """Check what is the same on all ranks."""
        names = [f"body {b}" for b in range(self.num_bodies)]
        self.names = tuple(names)
        self.static, self.kinematic = validated_static(*prescribed, names)
        for body in filter(self._half_spaces.__contains__, np.flatnonzero(self.kinematic).tolist()):
            raise ValueError(
                f"kinematic holds body {body}, a half-space; expected none of a distributed mesh, in which half-spaces "
                f"are static"
            )
        if len(self._half_spaces) == self.num_bodies:
            raise ValueError("half_spaces holds all bodies; expected at least one body with vertices")
        self.planes = planes_of(
            ((b, f"body {b}", half_space) for b, half_space in self._half_spaces.items()), self.dimension
        )
        self.static[self.planes.bodies] = True
        self._is_static = self.static[self.bodies]
        self._has_static = bool(self._is_static.any())
        self.rigid = validated_rigid(rigid, names, np.isin(np.arange(self.num_bodies), self.planes.bodies))
        self.self_collision = validated_flags(self_collision, self.num_bodies, "self_collision") & ~self.rigid
        self.moves_alone = self._move_alone()
        self._with_points = validated_flags(codimensional_points, self.num_bodies, "codimensional_points")
        self.body_pairs = validated_body_pairs(body_pairs, names)
        self.exclusion_rings = validated_rings(exclusion_rings)
        self._excluded = np.zeros((0, 2), dtype=np.int64)
        excluded_bodies = np.zeros((0, 2), dtype=np.int64)
        if exclude_pairs is not None:
            if not isinstance(exclude_pairs, Mapping) or not set(exclude_pairs) <= {"bodies", "vertices"}:
                raise ValueError(
                    f"exclude_pairs is {shown(exclude_pairs)}; expected a mapping with 'bodies' and 'vertices'"
                )
            if "bodies" in exclude_pairs:
                excluded_bodies = validated_indices(
                    exclude_pairs["bodies"], 2, self.num_bodies, "exclude_pairs['bodies']"
                )
        is_self = excluded_bodies[:, 0] == excluded_bodies[:, 1]
        self.self_collision[excluded_bodies[is_self, 0]] = False
        self.exclude_pairs = ExcludedPairs({"bodies": excluded_bodies[~is_self]})
        same: list[NDArray[Any]] = [self.static, self.kinematic, self.rigid, self.self_collision, self._with_points]
        same += [self.exclude_pairs.get("bodies", np.zeros(0))]
        same += [np.zeros(0) if self.body_pairs is None else self.body_pairs, *vars(self.planes).values()]
        excluded = _pairs_of_ids((exclude_pairs or {}).get("vertices", ()))
        same += [np.asarray(self.exclusion_rings), excluded]
        text = b"".join(bytes(str(array.shape), "ascii") + array.tobytes() for array in same)
        digest = int.from_bytes(hashlib.sha256(text).digest()[:6], "big")
        if any(mine != least for mine, least in zip((digest, -digest), self.ranks.agree(digest, -digest), strict=True)):
            raise ValueError(
                "static, kinematic, rigid, self_collision, codimensional_points, body_pairs, exclusion_rings, "
                "exclude_pairs or half_spaces differs between ranks; expected the same on all"
            )
        if self.dimension == 2:
            has_edges = np.zeros(self.num_bodies, dtype=np.int64)
            has_edges[self.bodies[part.edges]] = 1
            self._with_points |= self.ranks.most(has_edges) == 0  # such a body consists of points
        if len(excluded):
            self._excluded = self._numbers_of(excluded)

    def _numbers_of(self, ids: NDArray[np.int64]) -> NDArray[np.int64]:
        """Pairs of ids as pairs of numbers; a rank gives those of its own vertices."""
        ordered = self.vertex_ids[self._order]
        place = np.minimum(np.searchsorted(ordered, ids), max(len(ordered) - 1, 0))
        numbers = np.full(ids.shape, -1, dtype=np.int64)
        if len(ordered):
            is_here = ordered[place] == ids
            numbers[is_here] = self._ordered[place[is_here]]
        numbers = self.ranks.most(numbers)
        if (numbers < 0).any():
            raise ValueError(
                f"exclude_pairs['vertices'] holds id {ids[numbers < 0][0]}; expected ids of the whole mesh"
            )
        return numbers

    def _number_primitives(self, part: HandedIn) -> None:
        """Number edges and faces of the whole mesh, and choose for each the rank that answers for it."""
        edges, self.num_edges = numbered_edges(self._homes, self.numbers, self._order, part.faces, part.edges)
        faces, self.num_faces = numbered_faces(self._homes, self.numbers, part.faces)
        is_used, has_primitives = np.zeros(len(self.numbers)), np.zeros(self.num_bodies, dtype=np.int64)
        for corners in (part.faces, part.edges[part.edges[:, 0] != part.edges[:, 1]]):
            is_used[corners], has_primitives[self.bodies[corners]] = 1.0, 1
        is_used_by_any = is_used.copy()
        self.copies.back(is_used, is_used_by_any, np.add)
        self.copies.forward([(is_used_by_any, is_used_by_any)])
        is_alone, is_of_points = is_used_by_any == 0.0, self._with_points[self.bodies]
        is_of_particles = self.ranks.most(has_primitives)[self.bodies] == 0
        is_point = is_alone & is_of_points
        self.is_unused = is_alone & ~is_of_points & ~is_of_particles
        self._num_unused = int(self.ranks.total(np.array((self.is_unused & self.is_owned).sum())))
        check_finite(
            self.vertices,
            "vertices",
            where=lambda row: f" (vertex id {self.vertex_ids[row]})",
            but=np.flatnonzero(self.is_unused),
        )
        owned_rows = np.flatnonzero(self.is_owned & ~self.is_unused)
        vertices = Primitives(self.numbers[owned_rows], owned_rows[:, None].astype(np.int64), is_point[owned_rows])
        self.primitives = {"edge": edges, "face": faces, "vertex": vertices}

    def _measure(self) -> None:
        """The longest side of the whole mesh; rest positions of ghosts become those of their owners."""
        self.vertices = self.vertices.copy()
        self.copies.forward([(self.vertices, self.vertices)])
        self._measure_radii()
        positions = self.vertices[self.is_owned & ~self.is_unused]
        lower = self.ranks.least(positions.min(axis=0, initial=np.inf))
        upper = self.ranks.most(positions.max(axis=0, initial=-np.inf))
        with np.errstate(over="ignore"):
            side = float((upper - lower).max()) if self.num_vertices else 0.0
        self.length_scale = min(side, float(np.finfo(np.float64).max)) or 1.0

    def _measure_radii(self) -> None:
        """The largest radius of the primitives around each vertex, and that of each body; zeros without radii."""
        self.box_radius = np.zeros(len(self.numbers))
        self.body_radius: NDArray[np.float64] | None = None
        self.is_thick = self.radius is not None
        if self.radius is None:
            return
        self.copies.forward([(self.radius, self.radius)])
        self.box_radius = self.radius.copy()
        for a, b in (self.primitives["edge"].corners.T, self.primitives["edge"].corners.T[::-1]):
            np.maximum.at(self.box_radius, a, self.radius[b])
        self.copies.back(self.box_radius.copy(), self.box_radius, np.maximum)
        self.copies.forward([(self.box_radius, self.box_radius)])
        body_radius = np.zeros(self.num_bodies)
        np.maximum.at(body_radius, self.bodies, np.where(self.is_unused, 0.0, self.radius))
        self.body_radius = self.ranks.most(body_radius)

    def _choose_samples(self) -> None:
        """The numbers of the vertices from which one process would choose its quantization; see Topology.samples."""
        kind, count = next(
            ((k, n) for k, n in (("edge", self.num_edges), ("face", self.num_faces)) if n),
            ("vertex", self.num_vertices),
        )
        primitives = self.primitives[kind]
        wanted = uneven_samples(count, NUM_SAMPLES)
        corners = np.full((NUM_SAMPLES, primitives.corners.shape[1]), -1, dtype=np.int64)
        if len(primitives.numbers):
            order = np.argsort(primitives.numbers)
            place = np.minimum(np.searchsorted(primitives.numbers[order], wanted), len(order) - 1)
            is_here = primitives.numbers[order][place] == wanted
            corners[is_here] = self.numbers[primitives.corners[order[place[is_here]]]]
        self.sample_primitives = self.ranks.most(corners).T
        self.sample_vertices = samples = uneven_samples(self.num_vertices, NUM_SAMPLES)
        is_unused = np.isin(samples, self.numbers[self.is_unused]).astype(np.int64)
        self.sample_vertices = np.where(self.ranks.most(is_unused), self.sample_primitives[0], samples)

    def frames(
        self, vertices_t0: ArrayLike, vertices_t1: ArrayLike, name_t0: str = "vertices_t0"
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Check the positions on this rank: those that it owns and that take part must be finite, ghosts are ignored.

        Args:
            vertices_t0: Start positions of the vertices on this rank, shape [n, 3], or [n, 2] in the plane.
            vertices_t1: End positions, in which static bodies are where they start.
            name_t0: Name of the first argument in errors.

        Returns:
            Both as float64, static vertices at their start positions; ghosts hold anything.

        Raises:
            ValueError: If a shape differs, a value that is read is not finite, or a static body moves.
        """
        count = len(self.vertex_ids)
        if count == 0:  # an empty list has no columns
            vertices_t0, vertices_t1 = (
                as_positions(vertices_t0, name_t0, self.dimension),
                as_positions(vertices_t1, "vertices_t1", self.dimension),
            )
        start = as_positions(vertices_t0, name_t0, self.dimension, count, "one row a vertex of this rank")
        end = as_positions(vertices_t1, "vertices_t1", self.dimension, count, "one row a vertex of this rank")
        is_all = len(self.owned_rows) == count
        for name, values in ((name_t0, start), ("vertices_t1", end)):
            # rows are copied only where one that is not finite may be a ghost's
            is_checked = is_all or np.isfinite(values).all()
            unused = np.flatnonzero(self.is_unused if is_checked else self.is_unused[self.owned_rows])
            check_finite(values if is_checked else values[self.owned_rows], name, where=self._where, but=unused)
        if self._has_static and end is not start:
            moved = np.flatnonzero(self._is_static & self.is_owned & ~self.is_unused & (start != end).any(axis=1))
            if len(moved):
                self._refuse_motion(moved, start[moved], end[moved])
            end = np.where((self._is_static & ~self.is_unused)[:, None], start, end)
        return start, end

    def _refuse_motion(self, rows: NDArray[np.intp], start: NDArray[np.float64], end: NDArray[np.float64]) -> NoReturn:
        """Raise the error for rows of static bodies that differ at both ends of a step."""
        with np.errstate(over="ignore", invalid="ignore"):
            length = np.linalg.norm(end - start, axis=1)
        row = int(np.argmax(length))
        body = int(self.bodies[rows[row]])
        raise ValueError(
            f"vertices_t1 moves the vertex with id {self.vertex_ids[rows[row]]} of body {body}, which is static, by "
            f"{length[row]:.6g}; expected its position in vertices_t0, or kinematic=[{body}] in place of "
            f"static=[{body}] for a body that moves as it is told"
        )

    def _where(self, row: int) -> str:
        return f" (vertex id {self.vertex_ids[self.owned_rows[row]]})"


def _pairs_of_ids(values: Any) -> NDArray[np.int64]:
    """Pairs of ids of vertices, shape [k, 2], or a ValueError."""
    name = "exclude_pairs['vertices']"
    ids = as_array(values, name, "integers and shape (k, 2)")
    if ids.size == 0 and ids.ndim <= 2 and ids.shape[-1:] in ((0,), (2,)):
        return np.zeros((0, 2), dtype=np.int64)
    if ids.ndim != 2 or ids.shape[1] != 2 or ids.dtype.kind not in "iu":
        raise ValueError(f"{name} has dtype {ids.dtype} and shape {ids.shape}; expected integers and (k, 2)")
    if ids.max() > np.iinfo(np.int64).max:
        raise ValueError(f"{name} holds {ids.max()}; expected ids of the whole mesh")
    return ids.astype(np.int64)
