"""Rigid bodies of many worlds by their parts: a world is a mesh of those that may touch in the step, or of nothing.

The parts that may touch in some slice of a world (`overlap`) are the bodies of this world in a mesh of parts (`mesh`),
along the paths of the whole bodies: so the answers are those of whole bodies, in every bit, but for pairs that do not
touch, and of which a search of all would say so at its limits alone.
"""

from collections.abc import Callable, Iterator
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ccd_warp._engine.motion import Slice, Slices
from ccd_warp._rigid.mesh_paths import MeshPaths
from ccd_warp._rigid.motion import RigidMotion
from ccd_warp._rigid.parts.mesh import MOST_BODIES, PartMesh, rows_within
from ccd_warp._rigid.parts.near_search import Near
from ccd_warp._rigid.parts.overlap import BodyParts
from ccd_warp._rigid.parts.trees import ranges

_T = TypeVar("_T")
_MOST_ROWS = 1 << 19  # primitives of a mesh of parts


class WorldsOfParts:
    """The parts of all worlds of a motion, for a mesh of one, that may touch.

    Attributes:
        parts: Those of the mesh.
        num_primitives: The number of primitives of all parts that may touch.
    """

    def __init__(
        self,
        parts: BodyParts,
        near: Near,
        motion: RigidMotion,
        slices: Slices,
        memory_limit: int | None = None,
    ) -> None:
        """Those that are near in slices of the step."""
        self._motion, self._slices, self.parts = motion, slices, parts
        self._most_rows = rows_within(memory_limit, _MOST_ROWS)
        self._near = near
        self._world, self._part = np.nonzero(near.parts)
        self._sizes = np.diff(self.parts.begins)[self._part]
        self.num_primitives = int(self._sizes.sum())

    def search(self, work: Callable[[PartMesh, MeshPaths], _T]) -> Iterator[tuple[NDArray[np.intp], PartMesh, _T]]:
        """What some work on a mesh finds, along paths, for some worlds at a time; of the others nothing is near."""
        first, sizes = self.parts.begins, self._sizes
        worlds, start = np.unique(self._world, return_index=True)
        bounds = np.append(start, len(self._world))
        before = np.append(0, np.cumsum(sizes))[bounds]
        number = np.repeat(np.arange(len(worlds)), np.diff(bounds))
        bodies = np.append(0, np.cumsum(self.parts.num_bodies(number, self._part, len(worlds))))
        k = 0
        while k < len(worlds):
            fits = (
                int(np.searchsorted(of, of[k] + most, side="right")) - 1
                for of, most in ((before, self._most_rows), (bodies, MOST_BODIES))
            )
            last = min(max(k + 1, min(fits)), len(worlds))
            batch, rows = worlds[k:last], slice(bounds[k], bounds[last])
            of_part = np.searchsorted(batch, self._world[rows])
            part, counts = self._part[rows], sizes[rows]
            parts = PartMesh.of(self.parts, len(batch), np.repeat(of_part, counts), ranges(first[part], counts))
            paths = self._motion._of_worlds(batch).rows(np.flatnonzero(parts.is_used.ravel()))
            searched = self._searched(batch, parts)
            yield batch, parts, work(parts, MeshPaths.of_checked(parts.mesh, paths, searched=searched))
            k = last

    def _searched(self, batch: NDArray[np.intp], parts: PartMesh) -> list[Slice]:
        """The slices in which anything is near in some worlds, with the bodies of their mesh that are."""
        near = self._near.bodies[:, batch].reshape(len(self._near.number), -1)[:, parts.body]
        active = np.zeros((len(near), parts.mesh.num_bodies), dtype=bool)
        active[:, : len(parts.body)] = near
        of_slices = zip(self._near.number.tolist(), active, strict=True)
        return [self._slices.slice(number)._replace(active=bodies) for number, bodies in of_slices if bodies.any()]
