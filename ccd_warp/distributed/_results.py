"""Results of a step that ranks have made together."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, field, fields, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from ccd_warp._engine.host.candidates import Candidates
from ccd_warp._results.intersections import Intersections
from ccd_warp._results.proximities import Proximities
from ccd_warp._results.results import Contacts, Counts
from ccd_warp._rigid.motion import RigidMotion
from ccd_warp._runtime.display import counted
from ccd_warp._runtime.lazy import lazy_property
from ccd_warp._runtime.status import IntersectionKind, PairKind, primitives_of
from ccd_warp._runtime.texts import text_completed_by

if TYPE_CHECKING:
    from ccd_warp.distributed._part import Part, PartTopology
    from ccd_warp.distributed._ranks import Ranks


_PairsT = TypeVar("_PairsT", bound="PairsOnRanks")


@dataclass(frozen=True, repr=False, eq=False)
class OnRanks:
    """What is spread over the ranks that have found it; a copy, or what was pickled, belongs to its rank alone."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "_ranks", None)

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_ranks": None}

    def _of(self, ranks: Ranks) -> Self:
        """The same, as what this rank has found in a call."""
        vars(self)["_ranks"] = ranks
        return self

    def to_root(self) -> Self | None:
        """All pairs in order on rank 0, and None on the others; collective."""
        ranks: Ranks | None = vars(self)["_ranks"]
        if ranks is None:
            raise ValueError(
                "to_root() is called on a copy, or on what it has brought to rank 0; expected the result of a call"
            )
        with ranks.together("to_root"):
            columns = {name: values for name, values in vars(self).items() if isinstance(values, np.ndarray)}
            gathered = ranks.at_root(columns)
        return None if gathered is None else replace(self, **self._in_order(gathered))

    @staticmethod
    def _in_order(columns: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        """The columns in the order of kinds and primitives."""
        order = np.lexsort((*columns["primitives"].T[::-1], columns["kind"]))
        return {name: values[order] for name, values in columns.items()}


@dataclass(frozen=True, repr=False, eq=False)
class PairsOnRanks(OnRanks):
    """The table of a rank, with the numbers of primitives and the ids of vertices in the whole mesh."""

    kind: NDArray[np.int32]
    primitives: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.kind)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({counted(len(self), 'pair', 'pairs')} on this rank)"


def of_part(table: type[_PairsT], part: Part, pairs: Any, ranks: Ranks, **more: Any) -> _PairsT:
    """The pairs of a part in a table of the whole mesh, which has the columns of both, and what else is given."""
    columns = {field.name: getattr(pairs, field.name) for field in fields(table) if field.name not in more}
    kinds = IntersectionKind if isinstance(pairs, Intersections) else PairKind
    columns["primitives"] = whole_pairs(part, kinds, pairs.kind, pairs.primitives)
    columns["vertices"] = part.vertex_ids[pairs.vertices]
    return table(**columns, **more)._of(ranks)


@text_completed_by(Contacts)
@dataclass(frozen=True, repr=False, eq=False)
class DistributedContacts(PairsOnRanks):
    """Contacts that this rank has found; each contact of the whole mesh is on one rank.

    They are ordered by kind and then by primitives, as :class:`ccd_warp.Contacts` are; primitives are indices in the
    whole mesh, whose edges are ordered by (max, min) of their vertices, and faces by their sorted vertices; that of a
    half-space is its number in ``mesh.planes``.

    Attributes:
        primitives: Indices of both primitives in the whole mesh, int64, shape [m, 2].
        vertices: Ids of the vertices, as in ``ccd_warp.Contacts.vertices``, int64, shape [m, 4].
        bodies: Bodies of the first and the second primitive, int32, shape [m, 2].
        points: Position at toi, a length, float64, shape [m, 3], of a mesh in the plane [m, 2].
    """

    vertices: NDArray[np.int64]
    bodies: NDArray[np.int32]
    toi: NDArray[np.float64]
    parameters: NDArray[np.float64]
    normal: NDArray[np.float64]
    points: NDArray[np.float64]
    status: NDArray[np.int32]
    gap: NDArray[np.float64]
    width: NDArray[np.float64]


def whole_pairs(
    part: Part,
    kinds: type[PairKind] | type[IntersectionKind],
    kind: NDArray[np.int32],
    pairs: NDArray[np.int32],
) -> NDArray[np.int64]:
    """Pairs of primitives of a part as those of the whole mesh."""
    result = np.empty(pairs.shape, dtype=np.int64)
    numbers = {"vertex": part.vertex_numbers, "edge": part.edge_numbers, "face": part.face_numbers}
    numbers["plane"] = np.arange(len(part.mesh.planes))  # all ranks have all of them
    for member in kinds:
        rows = kind == int(member)
        if rows.any():
            for k, name in enumerate(primitives_of(member)):
                result[rows, k] = numbers[name][pairs[rows, k]]
    return result


@dataclass(frozen=True)
class RankWork:
    """What this rank has done in a call, and sent.

    Attributes:
        counts: Sizes of its part, and numbers of what each stage found there.
        timings: Seconds of each stage, and the ``total``; ``reductions``, which are part of other stages, are mostly
            waits for other ranks.
        bytes_sent: Bytes sent to other ranks, reductions left out.
        num_neighbours: Ranks to which positions went.
        num_primitives: Primitives of the part.
        num_ghosts: Those of them that lie in the regions of other ranks.
        imbalance: The largest work of a rank in multiples of the mean.
        is_planned: Whether the call made a new plan.
    """

    counts: Counts
    timings: dict[str, float]
    bytes_sent: int
    num_neighbours: int
    num_primitives: int
    num_ghosts: int
    imbalance: float
    is_planned: bool


@dataclass(frozen=True, repr=False)
class DistributedResult:
    """Result of :meth:`DistributedPipeline.mesh_ccd` on a rank.

    Attributes:
        toi: Earliest time of impact of the whole mesh, inf if there is certainly none; the same on all ranks.
        vertex_toi: Earliest toi of each vertex on this rank, ghosts too, shape [n].
        body_toi: Earliest toi of each body, the same on all ranks, shape [B].
        world_toi: Earliest toi of each world, the same on all ranks, shape [W].
        contacts: The contacts that this rank has found.
        num_contacts: Number of contacts of the whole mesh.
        work: What this rank has done.
    """

    toi: float
    vertex_toi: NDArray[np.float64]
    body_toi: NDArray[np.float64]
    world_toi: NDArray[np.float64]
    contacts: DistributedContacts
    num_contacts: int
    work: RankWork

    @property
    def hit(self) -> bool:
        """Whether any pair of the whole mesh has a finite toi."""
        return bool(np.isfinite(self.toi))

    def __repr__(self) -> str:
        return f"DistributedResult(toi={self.toi!r}, {len(self.contacts)} of {self.num_contacts} contacts on this rank)"


@dataclass(frozen=True, repr=False)
class DistributedLineSearch:
    """Result of :meth:`DistributedPipeline.line_search` on a rank.

    Attributes:
        vertices: End positions of the vertices on this rank, ghosts too, shape [n, 3], or [n, 2] in the plane.
        vertex_fraction: Fraction of its displacement by which each of them moves, 1 for static and kinematic ones,
            shape [n].
        fraction: The least fraction of all free vertices; the same on all ranks.
        touching: Pairs that keep their vertices from moving, as of :class:`ccd_warp.LineSearchResult`, each on one
            rank.
        num_rounds: Number of steps that were checked.
        is_limited: As of :class:`ccd_warp.LineSearchResult`.
        struck: Pairs of a kinematic body and vertices that stay in its way, as there, each on one rank.
        motion: The motion of the rigid bodies up to the end of the step, the same on all ranks; None without one.
    """

    vertices: NDArray[np.float64]
    vertex_fraction: NDArray[np.float64]
    fraction: float
    touching: DistributedContacts
    num_rounds: int
    is_limited: bool
    struck: DistributedContacts
    motion: RigidMotion | None = None
    _find_shortening: Callable[[], DistributedContacts] = field(kw_only=True, repr=False, compare=False)

    @lazy_property
    def shortened_by(self) -> DistributedContacts:
        """Pairs that the fractions below 1 come from, as of :class:`ccd_warp.LineSearchResult`, each on one rank."""
        return self._find_shortening()

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_find_shortening": partial(copy, self.shortened_by)}

    def __repr__(self) -> str:
        return f"DistributedLineSearch(fraction={self.fraction!r}, {self.num_rounds} rounds)"


@text_completed_by(Proximities)
@dataclass(frozen=True, repr=False, eq=False)
class DistributedProximities(PairsOnRanks):
    """Pairs that are near at one time and that this rank has found; each pair is on one rank.

    They are ordered as those of :class:`ccd_warp.Proximities`.

    Attributes:
        primitives: Indices of both primitives in the whole mesh, int64, shape [m, 2].
        vertices: Ids of the vertices, as in ``ccd_warp.Proximities.vertices``, int64, shape [m, 4].
    """

    vertices: NDArray[np.int64]
    parameters: NDArray[np.float64]
    distance: NDArray[np.float64]
    direction: NDArray[np.float64]
    features: NDArray[np.int32]


@dataclass(frozen=True, repr=False, eq=False)
class DistributedCandidates(OnRanks):
    """Candidate pairs that this rank has found, as indices in the whole mesh; each pair is on one rank.

    Attributes:
        vertex_face: Vertex and face indices, int64, shape [m, 2].
        edge_edge: Edge indices, first < second, int64, shape [k, 2].
        point_segment: Indices of codimensional points and codimensional edges, int64, shape [n, 2]; of a mesh in the
            plane, of any vertices and edges.
        point_point: Indices of codimensional points, first < second, int64, shape [l, 2].
        vertex_plane: Indices of vertices and of planes of ``mesh.planes``, int64, shape [h, 2].
    """

    vertex_face: NDArray[np.int64]
    edge_edge: NDArray[np.int64]
    point_segment: NDArray[np.int64]
    point_point: NDArray[np.int64]
    vertex_plane: NDArray[np.int64]

    def __repr__(self) -> str:
        total = sum(len(getattr(self, f.name)) for f in fields(self))
        return f"DistributedCandidates({total:,} on this rank)"

    @staticmethod
    def _in_order(columns: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        return {name: _in_order(pairs) for name, pairs in columns.items()}


def candidates_of(part: Part, topology: PartTopology, candidates: Candidates, ranks: Ranks) -> DistributedCandidates:
    """The candidates of a part that belong to this rank, in lexicographic order, as pairs of the whole mesh."""
    by_kind = {}
    for kind in PairKind:
        pairs: Any = getattr(candidates, kind.name.lower())
        if kind != PairKind.VERTEX_PLANE:  # those are asked for only where they belong
            pairs = pairs[topology.own_pairs(kind, *pairs.T)]
        of_kind = np.full(len(pairs), kind, dtype=np.int32)
        by_kind[kind.name.lower()] = _in_order(whole_pairs(part, PairKind, of_kind, pairs))
    return DistributedCandidates(**by_kind)._of(ranks)


def _in_order(pairs: Any) -> NDArray[np.int64]:
    ordered: NDArray[np.int64] = pairs[np.lexsort(pairs.T[::-1])]
    return ordered
