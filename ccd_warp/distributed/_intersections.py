"""What intersects at one time, as a rank has found it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ccd_warp._display import counted
from ccd_warp._intersections import PRIMITIVES_OF, Intersections, are_crossing
from ccd_warp.distributed._results import OnRanks, at_root, whole_pairs

if TYPE_CHECKING:
    from ccd_warp.distributed._part import Part
    from ccd_warp.distributed._ranks import Ranks


@dataclass(frozen=True, repr=False, eq=False)
class DistributedIntersections(OnRanks):
    """Pairs that touch or pass through each other at one time and that this rank has found; each is on one rank.

    They are ordered as those of :class:`ccd_warp.Intersections`.

    Attributes:
        kind: :class:`ccd_warp.IntersectionKind` of each pair, int32, shape [m].
        primitives: Indices of both primitives in the whole mesh, int64, shape [m, 2].
        parameters: (u, v) of the common point, as in ``ccd_warp.Intersections.parameters``, float64, shape [m, 2].
        edge_parameter: Of an edge through a face the place on the edge, 0 for all other kinds, float64, shape [m].
        points: The common points, a length, float64, shape [m, 3], or [m, 2] in the plane.
        vertices: Ids of the vertices, as in ``ccd_warp.Intersections.vertices``, int64, shape [m, 5].
        bodies: Bodies of the first and the second primitive, int32, shape [m, 2].
        world: World of each pair, int32, shape [m].
        num_intersections: Number of pairs of the whole mesh, the same on all ranks.
    """

    kind: NDArray[np.int32]
    primitives: NDArray[np.int64]
    parameters: NDArray[np.float64]
    edge_parameter: NDArray[np.float64]
    points: NDArray[np.float64]
    vertices: NDArray[np.int64]
    bodies: NDArray[np.int32]
    world: NDArray[np.int32]
    num_intersections: int

    def __len__(self) -> int:
        return len(self.kind)

    @property
    def is_crossing(self) -> NDArray[np.bool_]:
        """Whether the pair passes through each other, bool, shape [m]; otherwise it touches, and CCD has it at toi 0.

        Edges through faces, and in the plane edges that cross, are what ``mesh_ccd`` does not see.
        """
        return are_crossing(self.kind, self.points.shape[1])

    @property
    def num_crossing(self) -> int:
        """Number of pairs on this rank that pass through each other."""
        return int(self.is_crossing.sum())

    @property
    def num_touching(self) -> int:
        """Number of pairs on this rank that touch."""
        return len(self) - self.num_crossing

    def __repr__(self) -> str:
        here = f"{counted(self.num_crossing, 'crossing', 'crossings')} and {self.num_touching:,} that touch"
        return f"DistributedIntersections({here} on this rank, {self.num_intersections:,} on all)"

    def to_root(self) -> DistributedIntersections | None:
        """All pairs in order on rank 0, and None on the others; collective."""
        gathered = at_root(self)
        return (
            None if gathered is None else DistributedIntersections(**gathered, num_intersections=self.num_intersections)
        )


def intersections_of(part: Part, found: Intersections, ranks: Ranks) -> DistributedIntersections:
    """The intersections of a part, with the numbers and ids of the whole mesh; collective."""
    names = ("parameters", "edge_parameter", "points", "bodies", "world")
    result = DistributedIntersections(
        kind=found.kind,
        primitives=whole_pairs(part, found.kind, found.primitives, PRIMITIVES_OF),
        vertices=part.vertex_ids[found.vertices],
        num_intersections=int(ranks.total(np.array(len(found)))),
        **{name: getattr(found, name) for name in names},
    )
    vars(result)["_ranks"] = ranks
    return result
