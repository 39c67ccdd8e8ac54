"""Vertices and half-spaces in a step: with the narrow phase, or in place of it at one time; and as candidates."""

from collections.abc import Callable

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._engine.host.plan import HostPlan
from ccd_warp._engine.host.workspace import Workspace
from ccd_warp._engine.mesh.planes import plane_candidates, plane_query
from ccd_warp._engine.mesh.scene import norm_of
from ccd_warp._engine.mesh.topology import Positions
from ccd_warp._engine.stages import Stages
from ccd_warp._runtime.launch import Recording, Slot
from ccd_warp._runtime.status import PairKind
from ccd_warp._scene.input.options import Options
from ccd_warp.kernels.step.minima import FOUND

_FOUND = int(FOUND)
_Record = Callable[[Stages, Recording], None]


class PlaneStage:
    """The stage of a step in which vertices meet planes."""

    def __init__(self, plan: HostPlan, workspace: Workspace) -> None:
        self._plan, self._workspace, self._topology = plan, workspace, workspace.topology

    def bind(self, options: Options, length_scale: float, bodies: NDArray[np.bool_] | None, *, lets_part: bool) -> None:
        """Let the kernels have what is asked for, and of which bodies the vertices meet planes; of all by default.

        ``lets_part`` is whether what starts within its distance may part and slide.
        """

        def query() -> object:
            is_euclidean = norm_of(self._topology.mesh, options).is_ball
            return plane_query(options, length_scale, is_euclidean=is_euclidean, lets_part=lets_part)

        packed = self._workspace.packed_once(("planes", options, length_scale, lets_part), query)
        searched = None if bodies is None else self._topology.array(bodies, wp.int32)
        self._plan.bind(plane_query=packed, searched=searched)

    def meet(self, record: _Record | None = None) -> int:
        """Let vertices meet planes, by default in the narrow phase; returns the number of pairs."""
        self._play(record)
        return self.count()

    def _play(self, record: _Record | None) -> None:
        self._plan.counters.clear()
        self._plan.play("planes", record or self._in_narrow_phase)

    def count(self) -> int:
        """Count the pairs that have met; returns their number."""
        plan, kind = self._plan, PairKind.VERTEX_PLANE
        num_pairs = plan.counters.rows()[kind][_FOUND]
        plan.num_searches[kind] += 1
        plan.num_candidates[kind] += num_pairs
        return num_pairs

    def _in_narrow_phase(self, stages: Stages, recording: Recording) -> None:
        """Record that vertices meet planes, with the narrow phase."""
        stages.meet_planes(recording, self._plan.sink, Slot("searched"))

    def listed(self, expected: int, begin: Callable[[int], None], record: _Record | None = None) -> int:
        """Let all pairs that meet be listed; returns their number.

        ``begin`` begins a list for so many pairs: as many as are expected, and then all, where they are more.
        """
        begin(expected)
        num_pairs = self.meet(record)
        if num_pairs > expected:
            begin(num_pairs)
            self._play(record)
        return num_pairs

    def candidates(self, positions: Positions, inflation: float, box_radius: wp.array) -> NDArray[np.int32]:
        """The pairs whose boxes overlap, which NumPy finds."""
        vertices = self._topology.plane_vertices.numpy()
        return plane_candidates(self._topology.mesh, vertices, positions, inflation, box_radius.numpy())
