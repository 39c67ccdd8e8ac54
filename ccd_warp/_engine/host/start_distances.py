"""How near vertices are to anything at the start of a step, found where something starts within its distance."""

from collections.abc import Callable
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from ccd_warp._engine.host.course import Ends
from ccd_warp._engine.host.one_process import OneProcess
from ccd_warp._results.contacts import Contacts

_Positions = NDArray[np.float64]


class StartDistances:
    """What a call asks that shortens a step, where pairs keep a distance within which they may start.

    A step is strict until something is known to start within its distance, as hardly anything does.
    """

    def __init__(
        self,
        distance: float,
        vertex_world: NDArray[np.int32],
        on_step: Callable[[Callable[[Any], Any], _Positions, _Positions], Any],
        everywhere: OneProcess | None = None,
    ) -> None:
        """Of vertices in worlds, here and ``everywhere``.

        Args:
            distance: Up to which distance it matters how near vertices are, radii besides.
            vertex_world: The world of each vertex.
            on_step: Does some work on a ``StartDistanceStep`` between two positions.
            everywhere: The processes that share the mesh; by default this one alone.
        """
        self._distance, self._vertex_world, self._on_step = distance, vertex_world, on_step
        self._everywhere = everywhere or OneProcess()

    def of(self, start: _Positions) -> _Positions | None:
        """How near each vertex is to anything, as share and length, shape [V, 2]; inf beyond it, None if all are."""
        distances = self._search(start)
        return None if self._everywhere.all(not np.isfinite(distances).any()) else distances

    def of_worlds_near(self, start: _Positions, ends: Ends, contacts: Contacts) -> _Positions | None:
        """The same in worlds where one of all contacts of a step starts within its distance, or passes by at it.

        Such a contact is one whichever way its vertices move. ``start`` are the positions in the world. Other worlds
        have inf, as worlds do not depend on each other; None where all are such.
        """
        is_near = self._worlds_near(start, ends, contacts)
        if is_near is None:
            return None
        distances = self._search(start)
        distances[~is_near[self._vertex_world]] = np.inf
        return distances

    def are_near(self, start: _Positions, ends: Ends, pairs: Contacts | None) -> bool:
        """Whether one of some pairs starts within its distance, or passes by at it; pairs that are not known may."""
        are_known = self._everywhere.all(pairs is not None)
        return not are_known or self._worlds_near(start, ends, cast(Contacts, pairs)) is not None

    def _worlds_near(self, start: _Positions, ends: Ends, contacts: Contacts) -> NDArray[np.bool_] | None:
        """In which worlds one of these contacts starts within its distance, or passes by at it; None for none.

        Whether a pair passes by on arcs is not known: any may.
        """
        if self._everywhere.all(not len(contacts)):
            return None
        if ends.paths is not None:
            return np.ones(self._vertex_world.max(initial=-1) + 1, dtype=bool)
        distance = self._distance
        near = self._on_step(lambda step: step.worlds_near(contacts, distance), start, ends.end)
        is_near: NDArray[np.bool_] = self._everywhere.least(np.where(near, 0.0, 1.0)) == 0.0
        return is_near if is_near.any() else None

    def _search(self, start: _Positions) -> _Positions:
        distance = self._distance
        return self._everywhere.least_of_vertices(
            self._on_step(lambda step: step.start_distances(distance), start, start)
        )
