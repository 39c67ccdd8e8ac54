"""What a line search returns."""

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Generic

import numpy as np
from numpy.typing import NDArray

from ccd_warp._results.contacts import Contacts
from ccd_warp._results.intersections import Intersections, crossing_at_start
from ccd_warp._results.results import MotionT
from ccd_warp._runtime.lazy import lazy_property


@dataclass(frozen=True)
class LineSearchResult(Generic[MotionT]):
    """A step that is certain to be free of collisions.

    Attributes:
        vertices: Positions at its end, a new array, float64, shape [V, 3], or [V, 2] in the plane.
        vertex_fraction: Fraction of its displacement by which each vertex moves, in [0, 1], shape [V]; 1 for vertices
            of static and kinematic bodies.
        fraction: The least fraction of the vertices of free bodies.
        touching: Pairs that keep their vertices from moving, in the order of :class:`ccd_warp.Contacts`, each once;
            none of their vertices moves. Such a pair touches at the start, or presses on from within its distance, or
            its gap is too small for the precision over any step however short, or the rest of the step is lost in the
            rounding of positions. Each pair is reported as found in the last round in which one of its vertices was
            still to move: its toi and all other fields refer to the step of that round. Where a search that takes too
            long stops a world, these are all pairs of this world that touched in its last step, so that their toi may
            be above 0.
        struck: Pairs of a kinematic body that moves and vertices that stay where they are and that it meets on its way,
            in the order of :class:`ccd_warp.Contacts`; their toi is when. Empty: it passes through nothing. Otherwise
            the end positions are those of vertices that it has passed through: the response has to move them out of
            its way, or the motion of that body has to be cut to a little less than ``struck.toi.min()`` and searched
            again, with the response whole. (Where the whole step is cut, the response is cut with it.)
        num_rounds: Number of times that a step was checked, one after another; a first check that is made again because
            something starts within its distance counts once.
        is_limited: Whether individual fractions took too many rounds, so that all vertices of a world move by one
            fraction, or not at all.
        start: What touches or crosses at the start, exactly, with ``check_start=True``; otherwise None.
        motion: The :class:`ccd_warp.RigidMotion` up to the end of the step, where one was given: its ``poses_t1`` are
            the poses of the rigid bodies there, and ``vertices`` has their vertices in the world. Otherwise None.
    """

    vertices: NDArray[np.float64]
    vertex_fraction: NDArray[np.float64]
    fraction: float
    touching: Contacts
    num_rounds: int
    is_limited: bool
    struck: Contacts
    start: Intersections | None = None
    motion: MotionT | None = None
    _find_shortening: Callable[[], Contacts] = field(kw_only=True, repr=False, compare=False)

    @lazy_property
    def shortened_by(self) -> Contacts:
        """Pairs that the fractions below 1 come from, in the order of :class:`ccd_warp.Contacts`, each once.

        Of what shares a fraction (a vertex, a body, a world, the scene) they are the earliest contacts of every round
        that made it less, and the fraction is the product of ``safety`` times their tois: what a response has to mind
        that is to take it farther. What stops it, of ``touching`` and ``struck``, is among them where it did so first.
        Each is reported as found in the first of these rounds: its toi and all other fields refer to the step of that
        round. Empty: everything goes all its way, and what does not move was not to. Computed when it is first read.
        """
        return self._find_shortening()

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_find_shortening": partial(copy, self.shortened_by)}

    def __repr__(self) -> str:
        limited = ", is_limited" if self.is_limited else ""
        struck = f", {len(self.struck)} struck" if len(self.struck) else ""
        touching = f"{len(self.touching)} touching{struck}, {self.num_rounds} rounds{limited}"
        crossing = crossing_at_start(self.start)
        at_start = f";\n{crossing}" if crossing else ""
        least = f"least fraction {self.fraction!r} of {len(self.vertices):,} vertices"
        return f"LineSearchResult({least}, {touching}{at_start})"
