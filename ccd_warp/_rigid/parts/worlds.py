"""Rigid bodies of many worlds by their parts: a world is a mesh of those that may touch in the step, or of nothing.

Slices of all worlds are tested by boxes (`overlap`), and the parts that may touch in some slice of a world are the
bodies of this world in a mesh of parts (`mesh`), along the paths of the whole bodies: so the answers are those of
whole bodies, in every bit.
"""

from collections.abc import Callable, Iterator
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ccd_warp._rigid.mesh_paths import TURN_OF_A_SLICE, MeshPaths
from ccd_warp._rigid.motion import RigidMotion
from ccd_warp._rigid.parts.mesh import MOST_BODIES, PartMesh, rows_within
from ccd_warp._rigid.parts.overlap import BodyParts, spans
from ccd_warp._rigid.parts.trees import distinct, ranges
from ccd_warp._runtime.launch import Execution

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
        motion: RigidMotion,
        t_max: float,
        reach: float,
        execution: Execution,
        memory_limit: int | None = None,
    ) -> None:
        """Find those of the parts that may come within a distance in a step up to a time."""
        self._motion, self._turn = motion, motion._body_paths.largest_turn
        self.parts = parts
        self._most_rows = rows_within(memory_limit, _MOST_ROWS)
        turns = motion.turns.reshape(motion.num_worlds, -1).max(axis=1, initial=0.0) * t_max
        num_slices = np.maximum(1.0, np.ceil(turns / TURN_OF_A_SLICE)).astype(np.intp)
        of_slice, begin, end = spans(num_slices, t_max)
        slices, a, b = self.parts.overlapping(motion, of_slice, begin, end, reach, execution)
        count = len(self.parts.body)
        of_pair = of_slice[slices] * count
        self._world, self._part = np.divmod(distinct(np.concatenate([of_pair + a, of_pair + b])), count)
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
            yield batch, parts, work(parts, MeshPaths.of_checked(parts.mesh, paths, turn=self._turn))
            k = last
