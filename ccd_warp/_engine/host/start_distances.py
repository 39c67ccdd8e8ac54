"""How near vertices are to anything at the start of a step, found where something starts within its distance."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ccd_warp._engine.host.course import Ends
from ccd_warp._results.contacts import Contacts
from ccd_warp._scene.input.arguments import Per

_Positions = NDArray[np.float64]
# The least values, of those of the scene, of worlds, bodies or vertices, that any part of a mesh has found.
LeastOfParts = Callable[[NDArray[np.float64], Per], NDArray[np.float64]]


def of_one_part(values: NDArray[np.float64], per: Per) -> NDArray[np.float64]:
    """Those of a mesh that is one part."""
    return values


def in_all_parts(of_parts: LeastOfParts, value: float) -> float:
    """The least of a number over all parts of a mesh."""
    return float(of_parts(np.array([value]), "scene")[0])


def in_any_part(of_parts: LeastOfParts, flag: bool) -> bool:
    """Whether a flag is set in any part of a mesh."""
    return in_all_parts(of_parts, 0.0 if flag else 1.0) == 0.0


class StartDistances:
    """What a call asks that shortens a step, where pairs keep a distance within which they may start.

    A step is strict until something is known to start within its distance, as hardly anything does.
    """

    def __init__(
        self,
        distance: float,
        vertex_world: NDArray[np.int32],
        on_step: Callable[[Callable[[Any], Any], _Positions, _Positions], Any],
        of_parts: LeastOfParts = of_one_part,
    ) -> None:
        """Of vertices in worlds.

        Args:
            distance: Up to which distance it matters how near vertices are, radii besides.
            vertex_world: The world of each vertex.
            on_step: Does some work on a ``StartDistanceStep`` between two positions.
            of_parts: What all parts of the mesh have found; by default it is one.
        """
        self._distance, self._vertex_world, self._on_step = distance, vertex_world, on_step
        self._of_parts = of_parts

    def of(self, start: _Positions) -> _Positions | None:
        """How near each vertex is to anything, as share and length, shape [V, 2]; inf beyond it, None if all are."""
        distances = self._search(start)
        return distances if in_any_part(self._of_parts, bool(np.isfinite(distances).any())) else None

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

    def are_near(self, start: _Positions, ends: Ends, pairs: Contacts | None, *, are_first: bool = True) -> bool:
        """Whether one of some pairs starts within its distance, or passes by at it; pairs that are not known may.

        Only those of parts count in which they ``are_first`` of all.
        """
        are_unknown = in_any_part(self._of_parts, are_first and pairs is None)
        return are_unknown or self._worlds_near(start, ends, pairs if are_first else None) is not None

    def _worlds_near(self, start: _Positions, ends: Ends, contacts: Contacts | None) -> NDArray[np.bool_] | None:
        """In which worlds one of these contacts starts within its distance, or passes by at it; None for none.

        Whether a pair passes by on arcs is not known: any may.
        """
        if not in_any_part(self._of_parts, contacts is not None and len(contacts) > 0):
            return None
        if ends.paths is not None:
            return np.ones(self._vertex_world.max(initial=-1) + 1, dtype=bool)
        distance = self._distance
        worlds = lambda step: step.worlds_near(contacts or (), distance)  # noqa: E731
        near = self._on_step(worlds, start, ends.end)
        is_near: NDArray[np.bool_] = self._of_parts(np.where(near, 0.0, 1.0), "world") == 0.0
        return is_near if is_near.any() else None

    def _search(self, start: _Positions) -> _Positions:
        distance = self._distance
        return self._of_parts(self._on_step(lambda step: step.start_distances(distance), start, start), "vertex")
