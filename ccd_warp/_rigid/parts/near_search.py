"""The search for parts that are near, for so many worlds: its arrays and its launches, which are made once."""

from typing import Any

import numpy as np
import warp as wp

from ccd_warp._engine.motion import Slices
from ccd_warp._rigid.arcs import PathTable
from ccd_warp._rigid.body_paths import BodyPaths
from ccd_warp._rigid.parts.walk import record_walk
from ccd_warp._runtime.launch import Execution, Recording, Slot
from ccd_warp._runtime.threads import StopFlag
from ccd_warp.kernels.rigid import part_overlap as kernels

_CAPACITY = 1 << 12  # pairs of parts at first
# Columns of what is found.
_COLUMNS = ("world", "slice", "a", "b")


class NearSearch:
    """A search among the bodies of a number of worlds, by one thread at a time."""

    def __init__(self, trees: Any, pairs: wp.array, num_links: int, num_worlds: int, device: Any, threads: int) -> None:
        """Record the launches for the pairs of bodies of each world, with so many rows of the motion."""
        flag = StopFlag(device)
        self._execution = Execution(device, threads, flag)
        self._paths = PathTable(num_worlds * num_links, device)
        self._count = wp.zeros((1, 1), dtype=wp.int64, device=device)
        every = wp.empty(0, dtype=wp.int32, device=device)
        values = {"slices": 1, "t_max": 1.0, "reach": 0.0, "any": False, "found": self._new_list(_CAPACITY)}
        self._recording = recording = Recording(self._execution, values)
        slots = map(Slot, ("slices", "t_max", "reach", "any"))
        with recording.section("near"):
            of_worlds = self._paths.table, num_links, num_worlds
            record_walk(recording, trees, pairs, *of_worlds, Slot("found"), every, flag.array, *slots)

    def _new_list(self, capacity: int) -> Any:
        """A list for so many pairs of parts."""
        pairs, device = kernels.PartPairs(), self._execution.device
        pairs.count = self._count
        self._lists = [wp.empty(capacity, dtype=wp.int32, device=device) for _ in _COLUMNS]
        for name, array in zip(_COLUMNS, self._lists, strict=True):
            setattr(pairs, name, array)
        return pairs

    def find(self, paths: BodyPaths, slices: Slices, reach: float, *, any_suffices: bool) -> list[Any]:
        """The columns of the pairs of parts that are near, each int32; any of two bodies in a slice may suffice."""
        recording = self._recording
        self._paths.assign(paths)
        values = {"slices": slices.num_slices, "t_max": slices.t_max, "reach": reach, "any": any_suffices}
        for name, value in values.items():
            recording.bind(name, value)
        while True:
            self._count.zero_()
            recording.play("near")
            count = int(self._count.numpy()[0, 0])
            if count <= len(self._lists[0]):
                return [np.array(x.numpy()[:count]) for x in self._lists]
            recording.bind("found", self._new_list(count + count // 8))
