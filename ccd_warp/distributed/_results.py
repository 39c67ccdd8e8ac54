"""Results of a step that ranks have made together."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ccd_warp._engine.host.candidates import Candidates
from ccd_warp._results.contacts import Contacts
from ccd_warp._results.intersections import Intersections
from ccd_warp._results.pairs import PairTable, bodies_of, vertices_of
from ccd_warp._results.proximities import Proximities
from ccd_warp._results.results import Counts
from ccd_warp._runtime.display import counted
from ccd_warp._runtime.status import IntersectionKind, PairKind

if TYPE_CHECKING:
    from ccd_warp.distributed._plan import RankPlan
    from ccd_warp.distributed._ranks import Ranks, Sent

# What tables of one process have besides kinds, vertices and bodies.
_COLUMNS: dict[type, tuple[str, ...]] = {
    Contacts: ("toi", "parameters", "normal", "points", "status", "gap", "width"),
    Proximities: ("parameters", "distance", "direction", "features"),
    Intersections: ("parameters", "edge_parameter", "points", "world"),
}


class DistributedPairs:
    """Pairs that this rank has found; each pair of the whole mesh is on one rank.

    Every column is an attribute: ``kind``, ``vertices`` and ``bodies``, and those of the result of one process, without
    the indices of primitives, which ranks do not number. Contacts have ``toi``, ``parameters``, ``normal``, ``points``,
    ``status``, ``gap`` and ``width``, what is near has ``parameters``, ``distance``, ``direction`` and ``features``,
    and what intersects has ``parameters``, ``edge_parameter``, ``points`` and ``world``.

    Attributes:
        columns: The columns by their names, a row for each pair. ``vertices`` are ids, int64; one that is met by a
            half-space is repeated, and which one meets it is the second of ``bodies``.
        total: Number of pairs of the whole mesh, the same on all ranks.
    """

    def __init__(self, columns: dict[str, NDArray[Any]], total: int, ranks: Ranks | None = None) -> None:
        self.columns, self.total, self._ranks = columns, total, ranks

    def __getattr__(self, name: str) -> NDArray[Any]:
        if name == "columns" or name not in self.columns:
            raise AttributeError(f"{type(self).__name__} has no column {name!r}")
        return self.columns[name]

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_ranks": None}  # a copy, or what was pickled, belongs to its rank alone

    def __len__(self) -> int:
        return len(self.kind)

    def __repr__(self) -> str:
        return f"DistributedPairs({counted(len(self), 'pair', 'pairs')} of {self.total:,} on this rank)"

    def to_root(self) -> DistributedPairs | None:
        """All pairs on rank 0, by kind and then by the ids of their vertices, and None on the others; collective."""
        ranks = self._ranks
        if ranks is None:
            raise ValueError(
                "to_root() is called on a copy, or on what it has brought to rank 0; expected the result of a call"
            )
        with ranks.together("to_root"):
            gathered = {name: ranks.at_root(values) for name, values in self.columns.items()}
        order = np.lexsort((*gathered["bodies"].T, *gathered["vertices"].T[::-1], gathered["kind"]))
        columns = {name: values[order] for name, values in gathered.items()}
        return DistributedPairs(columns, self.total) if ranks.rank == 0 else None


def columns_of(plan: RankPlan, pairs: Any) -> dict[str, NDArray[Any]]:
    """The columns of those pairs of a table of a part that count on this rank, or of candidates."""
    if isinstance(pairs, Candidates):
        lists = [getattr(pairs, kind.name.lower()) for kind in PairKind]
        kind = np.repeat(np.array(list(PairKind), dtype=np.int32), list(map(len, lists)))
        pairs = PairTable(kind, np.concatenate(lists))
    kinds, is_own = IntersectionKind if isinstance(pairs, Intersections) else PairKind, np.zeros(len(pairs), dtype=bool)
    for member in kinds:
        rows = np.flatnonzero(pairs.kind == int(member))
        is_own[rows] = plan.are_own(member, pairs.primitives[rows])
    own, width = pairs[is_own], 5 if kinds is IntersectionKind else 4
    of_pairs = plan.pipeline.mesh, kinds, own.kind, own.primitives
    vertices = vertices_of(*of_pairs, width)
    columns = {"kind": own.kind, "vertices": plan.ids[vertices], "bodies": bodies_of(*of_pairs, vertices)}
    return columns | {name: getattr(own, name) for name in _COLUMNS.get(type(pairs), ())}


@dataclass(frozen=True)
class RankWork:
    """What this rank has done in a call, and sent.

    Attributes:
        counts: Sizes of its part, and numbers of what each stage found there, of a line search in its last step.
        timings: Seconds of these stages, of a new ``plan``, of what brings ``positions``, and of all, ``total``.
        sent: What it has sent.
        num_ghosts: Vertices of its part that lie in the regions of other ranks.
        is_planned: Whether the call made a new plan.
    """

    counts: Counts
    timings: dict[str, float]
    sent: Sent
    num_ghosts: int
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
    """

    toi: float
    vertex_toi: NDArray[np.float64]
    body_toi: NDArray[np.float64]
    world_toi: NDArray[np.float64]
    contacts: DistributedPairs

    def __repr__(self) -> str:
        return f"DistributedResult(toi={self.toi!r}, {self.contacts!r})"


@dataclass(frozen=True, repr=False)
class DistributedLineSearch:
    """Result of :meth:`DistributedPipeline.line_search` on a rank.

    Attributes:
        vertices: End positions of the vertices on this rank, ghosts too, shape [n, 3], or [n, 2] in the plane.
        vertex_fraction: Fraction of its displacement by which each of them moves, 1 for static and kinematic ones,
            shape [n].
        fraction: The least fraction of all free vertices; the same on all ranks.
        touching: Pairs that keep their vertices from moving, as of :class:`ccd_warp.LineSearchResult`.
        num_rounds: Number of steps that were checked.
        is_limited: As of :class:`ccd_warp.LineSearchResult`.
        struck: Pairs of a kinematic body and vertices that stay in its way, as there.
        shortened_by: Pairs that the fractions below 1 come from, as there.
    """

    vertices: NDArray[np.float64]
    vertex_fraction: NDArray[np.float64]
    fraction: float
    touching: DistributedPairs
    num_rounds: int
    is_limited: bool
    struck: DistributedPairs
    shortened_by: DistributedPairs

    def __repr__(self) -> str:
        return f"DistributedLineSearch(fraction={self.fraction!r}, {self.num_rounds} rounds)"
