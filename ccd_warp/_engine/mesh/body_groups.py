"""Groups of bodies that may meet the same bodies, by which a search skips what holds no partner of a query."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from ccd_warp._scene.mesh import CollisionMesh

# Rows of the largest table; of more groups, neighbours by number share a row.
_MOST_ROWS = 1 << 10
# Bodies up to which single excluded pairs of bodies alone are worth a table of all pairs.
_MOST_LISTED = 1 << 12
# Share of the pairs of vertices that a filter leaves below which the order of the trees is by group first.
_SPARSE = 0.25


@dataclass(frozen=True)
class BodyGroups:
    """The groups of the bodies of a mesh.

    Attributes:
        of_body: The group of each body, int32, shape [B]; groups are numbered as they first appear.
        meets_itself: Whether the bodies of a group may meet each other and themselves, shape [G].
        meets: Which groups may meet, bool, by row, shape [n, n]; None where only a body that ignores itself is
            excluded, and each body is a group.
        shift: By how many bits the number of a group is shifted to that of its row.
    """

    of_body: NDArray[np.int32]
    meets_itself: NDArray[np.bool_]
    meets: NDArray[np.bool_] | None = None
    shift: int = 0

    @staticmethod
    def of(mesh: "CollisionMesh") -> "BodyGroups | None":
        """The groups of a mesh; None where all bodies that move may meet themselves and all others."""
        listed = mesh.exclude_pairs.get("bodies", np.zeros((0, 2), dtype=np.int32))
        if mesh.body_pairs is None and (len(listed) == 0 or mesh.num_bodies > _MOST_LISTED):
            if mesh.self_collision[mesh._is_free].all():
                return None
            return BodyGroups(np.arange(mesh.num_bodies, dtype=np.int32), mesh.self_collision)
        may = bodies_that_may_meet(mesh)
        np.fill_diagonal(may, mesh.self_collision)
        if may.all():
            return None
        rows = np.packbits(may, axis=1)
        _, first, of_body = np.unique(
            rows.view(np.dtype((np.void, rows.shape[1]))).ravel(), return_index=True, return_inverse=True
        )
        representatives = np.sort(first)
        number = np.searchsorted(representatives, first[of_body]).astype(np.int32)
        meets, meets_itself = may[np.ix_(representatives, representatives)], may.diagonal()[representatives]
        shift = max(0, (len(representatives) - 1).bit_length() - (_MOST_ROWS - 1).bit_length())
        for axis in (0, 1) if shift else ():
            meets = np.logical_or.reduceat(meets, np.arange(0, len(representatives), 1 << shift), axis=axis)
        return BodyGroups(number, meets_itself, meets, shift)

    @staticmethod
    def none() -> "BodyGroups":
        """No groups, of no body."""
        return BodyGroups(np.zeros(0, dtype=np.int32), np.zeros(0, dtype=bool))

    @property
    def table(self) -> NDArray[np.int32]:
        """Numbers of the pairs of rows that may meet, of lower numbers than each row and each column.

        How many of a range of rows and another may meet then follows from four numbers of it, shape [n + 1, n + 1].
        """
        if self.meets is None:
            return np.zeros((0, 0), dtype=np.int32)
        counts = self.meets.cumsum(axis=0, dtype=np.int32).cumsum(axis=1, dtype=np.int32)
        return np.pad(counts, ((1, 0), (1, 0)))

    def between(self, a: NDArray[np.bool_], b: NDArray[np.bool_]) -> tuple[bool, bool]:
        """Whether any, and whether all, of the pairs of two sets of bodies, given by flags, may meet.

        Where several groups share a row, what one of them may counts for all, and some pair may not.
        """
        if self.meets is None:
            return True, not (a & b & ~self.meets_itself[self.of_body]).any()
        meets = self.meets[np.ix_(*(np.unique(self.of_body[bodies] >> self.shift) for bodies in (a, b)))]
        return bool(meets.any()), bool(meets.all()) and self.shift == 0

    def is_sparse(self, mesh: "CollisionMesh") -> bool:
        """Whether so few pairs may meet that primitives of different groups are better apart, whatever their places."""
        if self.meets is None:
            return False
        sizes, row = np.diff(mesh.body_vertex_range), self.of_body >> self.shift
        of_all, of_free = (np.bincount(row, sizes * flags, len(self.meets)) for flags in (1, mesh._is_free))
        return bool(of_free @ self.meets @ of_all < _SPARSE * of_free.sum() * of_all.sum())


def bodies_that_may_meet(mesh: "CollisionMesh") -> NDArray[np.bool_]:
    """Which pairs of two different bodies the filter leaves, shape [B, B], in a new array."""
    shape = mesh.num_bodies, mesh.num_bodies
    may_meet = np.ones(shape, dtype=bool) if mesh.body_pairs is None else mesh.body_pairs.copy()
    a, b = mesh.exclude_pairs.get("bodies", np.zeros((0, 2), dtype=np.int32)).T
    may_meet[a, b] = may_meet[b, a] = False
    np.fill_diagonal(may_meet, False)
    return may_meet
