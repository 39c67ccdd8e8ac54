"""Vertices and half-spaces in a step: beside the narrow phase, or in place of it at one time; and as candidates."""

from collections.abc import Callable

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._engine.host.plan import HostPlan
from ccd_warp._engine.mesh.planes import plane_candidates
from ccd_warp._engine.mesh.topology import Positions
from ccd_warp._engine.stages import Stages
from ccd_warp._runtime.launch import Recording
from ccd_warp._runtime.status import PairKind
from ccd_warp.kernels.step.minima import FOUND

_Record = Callable[[Stages, Recording], None]


class PlaneStage:
    """The stage of a step in which vertices meet planes."""

    def __init__(self, plan: HostPlan) -> None:
        self._plan = plan

    def meet(self, record: _Record | None = None) -> int:
        """Let vertices meet planes, by default in the narrow phase; returns the number of pairs."""
        plan, kind = self._plan, PairKind.VERTEX_PLANE
        found = plan.num_met_by_planes = self._met(record)
        plan.num_searches[kind] += 1
        plan.num_candidates[kind] += found
        return found

    def _met(self, record: _Record | None) -> int:
        plan = self._plan
        plan.clear_counts()
        plan.play("planes", record or plan.meet_planes)
        return int(plan.counts()[PairKind.VERTEX_PLANE, FOUND])

    def listed(self, expected: int, begin: Callable[[int], None], record: _Record | None = None) -> int:
        """Let all pairs that meet be listed; returns their number.

        ``begin`` begins a list for so many pairs: as many as are expected, and then all, where they are more.
        """
        begin(expected)
        found = self.meet(record)
        if found > expected:
            begin(found)
            self._met(record)
        return found

    def candidates(self, positions: Positions, inflation: float, box_radius: wp.array) -> NDArray[np.int32]:
        """The pairs whose boxes overlap, which NumPy finds."""
        topology = self._plan.topology
        vertices = topology.plane_vertices.numpy()
        return plane_candidates(topology.mesh, vertices, positions, inflation, box_radius.numpy())
