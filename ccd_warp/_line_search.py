"""From times of impact to a step that can be taken: one for the scene, for each body, or for each vertex."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ccd_warp._contact_corners import contact_vertices
from ccd_warp._mesh import CollisionMesh
from ccd_warp._results import Contacts, MeshResult

DEFAULT_SAFETY = 0.9
DEFAULT_MAX_ROUNDS = 16
_PER = ("scene", "world", "body", "vertex")


@dataclass(frozen=True)
class LineSearchResult:
    """A step that is certain to be free of collisions.

    Attributes:
        vertices: Positions at its end, float64, shape [V, 3].
        vertex_fraction: Share of its own displacement that each vertex moves, in [0, 1], shape [V]; 1 at static ones.
        fraction: The least of them among vertices that move.
        touching: Pairs that keep vertices where they are: they touch at the start, or come within the minimum
            separation; none of their vertices moves.
        num_rounds: Calls of ``mesh_ccd`` that were made.
        is_limited: Whether fractions of their own took too many rounds, and all of a world move by one, or not at all.
    """

    vertices: NDArray[np.float64]
    vertex_fraction: NDArray[np.float64]
    fraction: float
    touching: Contacts
    num_rounds: int
    is_limited: bool


def check_line_search(per: str, safety: float) -> None:
    """Check the options of a line search.

    Raises:
        ValueError: If one is out of its range.
    """
    if per not in _PER:
        raise ValueError(f"per is {per!r}; expected one of {', '.join(map(repr, _PER))}")
    if not (isinstance(safety, (int, float)) and math.isfinite(safety) and 0 < safety < 1):
        raise ValueError(f"safety is {safety!r}; expected a number between 0 and 1")


def check_step_is_whole(t_max: float) -> None:
    """Check that a line search looks at all of the step.

    Raises:
        ValueError: If not.
    """
    if t_max != 1.0:
        raise ValueError(f"t_max is {t_max!r}; expected 1, as a line search looks at the whole step")


def search_step(
    mesh: CollisionMesh,
    vertices_t0: ArrayLike,
    vertices_t1: ArrayLike,
    solve: Callable[[NDArray[np.float64], NDArray[np.float64]], MeshResult],
    *,
    per: str,
    safety: float,
    max_rounds: int,
) -> LineSearchResult:
    """Shorten displacements until ``solve`` finds no contact of a vertex that moves."""
    check_line_search(per, safety)
    if isinstance(max_rounds, bool) or not isinstance(max_rounds, int) or max_rounds < 3:
        raise ValueError(f"max_rounds is {max_rounds!r}; expected an integer of at least 3")
    start, end = mesh.frames(vertices_t0, vertices_t1)
    moves = ~mesh.static[mesh.vertex_body]
    fraction = np.ones(mesh.num_vertices)
    vertices = end
    common = fraction
    is_limited = False
    for num_rounds in range(1, max_rounds + 1):
        contacts = solve(start, vertices).contacts
        corners = contact_vertices(mesh, contacts)
        is_held = ((fraction[corners] == 0) | ~moves[corners]).all(axis=1)
        if is_held.all():
            break
        bound = np.full(mesh.num_vertices, np.inf)
        np.minimum.at(bound, corners[~is_held], contacts.toi[~is_held, None])
        of_world = _shared(bound, mesh, "scene" if per == "scene" else "world")
        if num_rounds == 1:
            common = np.minimum(safety * of_world, 1.0)
        bound = _shared(bound, mesh, per)
        touched = np.isfinite(bound)
        fraction[touched] *= safety * bound[touched]
        if num_rounds >= max_rounds - 2:
            # one fraction for each world that touches, which the first round has found free; and then none, which ends
            # the search
            is_limited = True
            fraction = np.where(np.isinf(of_world), fraction, common if num_rounds == max_rounds - 2 else 0.0)
        fraction[~moves] = 1.0
        vertices = _moved(start, end, fraction)
    return LineSearchResult(
        vertices=vertices,
        vertex_fraction=fraction,
        fraction=float(fraction[moves].min(initial=1.0)),
        touching=_chosen(contacts, is_held),
        num_rounds=num_rounds,
        is_limited=is_limited,
    )


def _shared(bound: NDArray[np.float64], mesh: CollisionMesh, per: str) -> NDArray[np.float64]:
    """The least bound of all vertices that move together."""
    if per == "scene":
        return np.full_like(bound, bound.min(initial=np.inf))
    if per == "vertex":
        return bound
    group, count = (mesh.vertex_body, mesh.num_bodies) if per == "body" else (mesh.vertex_world, mesh.num_worlds)
    least = np.full(count, np.inf)
    np.minimum.at(least, group, bound)
    return least[group]


def _moved(start: NDArray[np.float64], end: NDArray[np.float64], fraction: NDArray[np.float64]) -> NDArray[np.float64]:
    """Positions at the fractions of the displacements: exactly the start at 0 and the end at 1."""
    f = fraction[:, None]
    # no difference of two far positions is formed, which could overflow; what rests is not to move by a rounding
    return np.where((f == 0) | (start == end), start, np.where(f == 1, end, (1 - f) * start + f * end))


def _chosen(contacts: Contacts, chosen: NDArray[np.bool_]) -> Contacts:
    return Contacts(**{name: values[chosen] for name, values in vars(contacts).items()})
