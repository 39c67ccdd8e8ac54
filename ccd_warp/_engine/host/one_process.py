"""What a step and a line search ask of all processes that share a mesh; here one process has it all."""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ccd_warp._engine.boxes.body_boxes import bodies_near
from ccd_warp._engine.host.plan import Batch, HostPlan
from ccd_warp._engine.mesh.topology import Positions, Topology
from ccd_warp._runtime.launch import Execution
from ccd_warp._runtime.status import PairKind


class OneProcess:
    """One process, which has the whole mesh and finds all of its pairs.

    Attributes:
        is_alone: Whether there is no other.
        timed: Adds the time of a block to that of a stage; a step has its own.
    """

    is_alone = True
    timed: Callable[[str], AbstractContextManager[Any]] = nullcontext

    def share_positions(self, positions: Positions) -> None:
        """Let all have what they need of the positions of a step."""

    def bodies_near(
        self,
        topology: Topology,
        positions: Positions,
        inflation: float,
        execution: Execution,
        vertex_radius: NDArray[np.float64] | None,
    ) -> NDArray[np.bool_]:
        """Which bodies that move may collide (`body_boxes.bodies_near`), wherever their vertices are."""
        return bodies_near(topology, positions, inflation, execution, vertex_radius)

    def own_batch(self, plan: HostPlan, batch: Batch) -> Batch:
        """What is left of a batch without the pairs that others are to solve."""
        return batch

    def all_open(self, num_open: dict[PairKind, int]) -> dict[PairKind, int]:
        """How many pairs of each kind are open everywhere; asked once for each round."""
        return num_open

    def least_number(self, number: float) -> float:
        """The least of a number everywhere."""
        return number

    def all(self, flag: bool) -> bool:
        """Whether a flag is set everywhere."""
        return flag

    def least(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """The least of each number everywhere."""
        return values

    def least_of_vertices(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """The least value of each vertex everywhere."""
        return values
