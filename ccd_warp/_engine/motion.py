"""How vertices move in a step: all that the stages know of a motion, and straight motion, which is one slice."""

from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ccd_warp._engine.host.workspace import Workspace
from ccd_warp._engine.mesh.topology import Positions, Topology
from ccd_warp._results.contact_place import Paths
from ccd_warp._runtime.launch import Execution
from ccd_warp._scene.input.options import Options


class Slice(NamedTuple):
    """An interval of a step.

    Attributes:
        t_begin: Its begin, a time of the step; of each body, shape [B], where they go through different parts at once.
        t_end: Its end.
        active: Bodies that are searched in it, bool, shape [B]; None for all.
    """

    t_begin: float | NDArray[np.float64]
    t_end: float | NDArray[np.float64]
    active: NDArray[np.bool_] | None = None


class Slices(NamedTuple):
    """So many slices of equal length, of [0, t_max], which are made when they are asked for."""

    num_slices: int
    t_max: float

    def times(self, number: NDArray[np.integer]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Begins and ends of slices with these numbers."""
        begin, end = (self.t_max * k / self.num_slices for k in (number, number + 1))
        return begin, np.where(number + 1 == self.num_slices, self.t_max, end)

    def slice(self, number: int) -> Slice:
        """One of them."""
        begin, end = self.times(np.asarray(number))
        return Slice(float(begin), float(end))

    def all(self) -> list[Slice]:
        """All of them."""
        begins, ends = self.times(np.arange(self.num_slices))
        return [Slice(begin, end) for begin, end in zip(begins.tolist(), ends.tolist(), strict=True)]


class Motion:
    """A motion on straight lines; where bodies turn, another class says what they do.

    Attributes:
        on_arcs: Whether bodies turn, for which the narrow phase has norms of their own.
        slices: The parts of the step, which are searched one after another; at least one.
        t_end: The end of a slice, as a fraction of the way between the positions at its ends.
        radius: By how much each vertex is enlarged in a slice.
        box_radius: The same for its boxes.
    """

    on_arcs = False

    def __init__(self, topology: Topology, t_max: float) -> None:
        self.slices, self.t_end = [Slice(0.0, t_max)], t_max
        self.radius, self.box_radius = topology.radius, topology.box_radius

    def placed(self, time_slice: Slice, execution: Execution) -> Positions | None:
        """The positions at both ends of a slice; None where they are those of the step."""
        return None

    def turns(self, time_slice: Slice) -> Any:
        """How the vertices turn in a slice, which only the kernels read; None where they move straight."""
        return None

    def release(self) -> None:
        """Do not keep the caller's arrays alive."""


class StepPaths(Paths, Protocol):
    """Paths of bodies along which a step can be made."""

    def begin(self, workspace: Workspace, positions: Positions, options: Options, *, for_impacts: bool) -> Motion:
        """Begin a step between positions, of these bodies in their own frames; a workspace keeps its arrays.

        Where it is for impacts alone, slices in which none can be need not be searched.
        """


def moved(start: NDArray[np.float64], end: NDArray[np.float64], fraction: NDArray[np.float64]) -> NDArray[np.float64]:
    """Positions at the fractions of the displacements: exactly the start at 0 and the end at 1."""
    f = fraction[..., None]
    # No difference of two distant positions is formed, which could overflow. Stationary coordinates must not move by
    # rounding. Vertices that take no part may be at no number.
    with np.errstate(invalid="ignore"):
        return np.where((f == 0) | (start == end), start, np.where(f == 1, end, (1 - f) * start + f * end))
