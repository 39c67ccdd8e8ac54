"""The steps of a line search, on straight lines; where bodies turn, another class says where they are."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ccd_warp._engine.motion import moved

# The most that rounding takes of a way, as a share of the coordinates, which count as no less than this.
_ROUNDINGS, _LEAST = 2.0**-49, 2.0**-900


class Ends(NamedTuple):
    """A step as a solver takes it.

    Attributes:
        start: Positions at its start; of bodies on ``paths`` in their own frames.
        end: Those at its end.
        paths: The paths of bodies that turn, up to there; None where there are none.
    """

    start: NDArray[np.float64]
    end: NDArray[np.float64]
    paths: Any = None


class Course:
    """Where vertices are at fractions of their displacements, on straight lines, and the steps there.

    Attributes:
        start: Positions at the start, in the world.
        end: Positions at the end.
    """

    def __init__(self, start: NDArray[np.float64], end: NDArray[np.float64]) -> None:
        self.start, self.end = start, end

    def at(self, fraction: NDArray[np.float64], vertices: Any = slice(None)) -> NDArray[np.float64]:
        """The positions of vertices, an array of any shape, at a fraction of each; of all by default."""
        return moved(self.start[vertices], self.end[vertices], fraction)

    def step_to(self, vertices: NDArray[np.float64], fraction: NDArray[np.float64]) -> Ends:
        """The step to positions that are those at a fraction of each."""
        return Ends(self.start, vertices)

    def motion_to(self, fraction: NDArray[np.float64]) -> Any:
        """The motion of the call up to a fraction of each vertex; None where there is none."""
        return None

    def are_at_start(self, vertices: NDArray[np.float64], fraction: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which vertices have not moved on the way to positions that are those at a fraction of each, shape [V]."""
        is_at_start: NDArray[np.bool_] = (vertices == self.start).all(axis=1)
        return is_at_start

    def may_stay(self, fraction: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which vertices may be where they start at these fractions; the others are not, nor at any larger ones."""
        with np.errstate(over="ignore", invalid="ignore"):
            way = fraction[:, None] * np.abs(0.5 * self.end - 0.5 * self.start)
            largest = np.maximum(np.maximum(np.abs(self.start), np.abs(self.end)), _LEAST)
            may_stay: NDArray[np.bool_] = np.asarray((~(way > _ROUNDINGS * largest)).all(axis=1))
        return may_stay

    def shared(self, least: NDArray[np.float64]) -> NDArray[np.float64]:
        """A value of each vertex, which vertices share that have one fraction whatever is asked for."""
        return least
