"""From times of impact to a step that can be taken: one for the scene, for each body, or for each vertex."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ccd_warp._engine.contact_corners import contact_vertices
from ccd_warp._mesh import CollisionMesh
from ccd_warp._results import Contacts, MeshResult

DEFAULT_SAFETY = 0.9
DEFAULT_MAX_ROUNDS = 16
# What moves by one fraction of its displacement.
Per = Literal["scene", "world", "body", "vertex"]
EVERY_PER: tuple[Per, ...] = get_args(Per)
# A pair that has toi 0 but does not touch where nothing moves is looked at again over a motion of so many of its gaps,
# and over this share of what it was at most. Of 2 to 64 gaps and shares of 1/64 to 1/4 these gave the most even steps:
# on draped cloths in float32 a sixth of the exact one at least, in five rounds or fewer.
_GAPS = 4.0
_LARGEST_CUT = 2.0**-3
# Fraction of a displacement at which this ends: a pair that has toi 0 even then stops its vertices.
_LEAST_FRACTION = 2.0**-30
# Rounds that a search which takes too long ends with: one fraction for each world, then none.
_ROUNDS_BY_WORLD = 2
# Rounds that are to be left where bodies or vertices of toi 0 are looked at again.
_ROUNDS_TO_SHORTEN = 6


@dataclass(frozen=True)
class LineSearchResult:
    """A step that is certain to be free of collisions.

    Attributes:
        vertices: Positions at its end, an array of its own, float64, shape [V, 3].
        vertex_fraction: Share of its own displacement that each vertex moves, in [0, 1], shape [V]; 1 at static ones.
        fraction: The least of them among vertices that move.
        touching: Pairs that keep vertices where they are, in the order of :class:`ccd_warp.Contacts`, each once; none
            of their vertices moves. They touch at the start, or come within the minimum separation, or their gap is too
            small for the precision over however short a step, or what is left of the step is lost in the rounding of
            positions. Each is as it was found in the last round in which it had a vertex that was still to move: toi
            and all else are of the step of that round. Where a search that takes too long stops a world, they are all
            the pairs of this world that touched in its last step, so that their toi may be above 0.
        num_rounds: Calls of ``mesh_ccd`` that were made.
        is_limited: Whether fractions of their own took too many rounds, and all of a world move by one, or not at all.
    """

    vertices: NDArray[np.float64]
    vertex_fraction: NDArray[np.float64]
    fraction: float
    touching: Contacts
    num_rounds: int
    is_limited: bool


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
    start, end = mesh.frames(vertices_t0, vertices_t1)
    moves = ~mesh.static[mesh.vertex_body]
    fraction = np.ones(mesh.num_vertices)
    vertices = end.copy()  # the caller's own array may be what `frames` returns
    common = np.empty(0)  # the fraction of each vertex's world by the first round
    is_common = np.full(mesh.num_vertices, per in ("scene", "world"))
    at_start: NDArray[np.uint64] | None = None
    stopping: list[Contacts] = []
    is_limited = False
    num_rounds = 0
    while num_rounds < max_rounds:
        contacts = solve(start, vertices).contacts
        num_rounds += 1
        corners = contact_vertices(mesh, contacts)
        is_held = ((fraction[corners] == 0) | ~moves[corners]).all(axis=1)
        if is_held.all():
            stopping.append(contacts)
            break
        contacts, corners = _chosen(contacts, ~is_held), corners[~is_held]
        toi = contacts.toi
        if not toi.all():
            has_time = max_rounds - num_rounds >= _ROUNDS_TO_SHORTEN
            if at_start is None and has_time:
                at_start = _keys(solve(start, start).contacts)
                num_rounds += 1
            # with too few rounds left, trying would in the end stop others of the world, too
            can_be_shorter = (fraction[corners].max(axis=1) > _LEAST_FRACTION) & (has_time or is_common.all())
            if at_start is not None:
                can_be_shorter &= ~np.isin(_keys(contacts), at_start)
            can_be_shorter &= (_least(toi, corners, mesh, per)[corners] == 0).any(axis=1)
            share = _resolved_share(contacts, start[corners], vertices[corners])
            toi = np.where(can_be_shorter, np.maximum(toi, share), toi)
        if num_rounds >= max_rounds - 1:
            toi = np.zeros(len(contacts))
            is_common[:] = True
        of_world = _least(toi, corners, mesh, "scene" if per == "scene" else "world")
        if len(common) == 0:
            common = np.minimum(safety * of_world, 1.0)
        own = safety * toi[:, None] * fraction[corners]
        if max_rounds - num_rounds > _ROUNDS_BY_WORLD:
            bound = _least(toi, corners, mesh, per)
            touched = np.isfinite(bound)
            fraction[touched] *= safety * bound[touched]
        else:
            # one fraction for each world that touches, and none in the end; other worlds stay as this round has found
            # them free, so that even the last round needs none after it
            is_limited = True
            touched = np.isfinite(of_world)
            shorter = fraction[touched] * safety * of_world[touched]
            fraction[touched] = np.where(is_common[touched], shorter, common[touched])
            is_common |= touched
        fraction[~moves] = 1.0
        vertices = _moved(start, end, fraction)
        stops = (_moved(start[corners], end[corners], own) == start[corners]).all(axis=(1, 2))
        stopping.append(_chosen(contacts, stops))
    return LineSearchResult(
        vertices=vertices,
        vertex_fraction=fraction,
        fraction=float(fraction[moves].min(initial=1.0)),
        touching=_of_resting(mesh, stopping, (vertices == start).all(axis=1)),
        num_rounds=num_rounds,
        is_limited=is_limited,
    )


def _resolved_share(contacts: Contacts, start: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.float64]:
    """Share of a contact's motion beside which its gap is no longer lost in rounding, shape [m]; of its four vertices.

    The gap of a contact with toi 0 is no less than that at the start, so a pair that closes it head-on does so within a
    quarter of the share, unless rounding is most of that gap; then the next round shortens it again.
    """
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        share = _GAPS * contacts.gap / np.ptp(end - start, axis=1).max(axis=1, initial=0.0)
    return np.where(share < _LARGEST_CUT, share, _LARGEST_CUT)  # also where there is no number


def _keys(contacts: Contacts) -> NDArray[np.uint64]:
    """Each pair as one number; ascending keys are contacts in their order."""
    first, second = contacts.primitives.astype(np.uint64).T
    return contacts.kind.astype(np.uint64) << np.uint64(62) | first << np.uint64(31) | second


def _of_resting(mesh: CollisionMesh, stopping: list[Contacts], is_at_start: NDArray[np.bool_]) -> Contacts:
    """Contacts of all rounds whose vertices all are where they began, each pair once, as it was found last."""
    names = vars(stopping[0])
    contacts = Contacts(**{name: np.concatenate([vars(c)[name] for c in reversed(stopping)]) for name in names})
    rests: NDArray[np.bool_] = is_at_start[contact_vertices(mesh, contacts)]
    contacts = _chosen(contacts, np.flatnonzero(rests.all(axis=1)))
    return _chosen(contacts, np.unique(_keys(contacts), return_index=True)[1])


def _least(toi: NDArray[np.float64], corners: NDArray[np.int32], mesh: CollisionMesh, per: str) -> NDArray[np.float64]:
    """For each vertex the least toi of all contacts of the vertices that it moves with, inf if there is none."""
    least = np.full(mesh.num_vertices, np.inf)
    np.minimum.at(least, corners, toi[:, None])
    if per == "scene":
        return np.full_like(least, least.min(initial=np.inf))
    if per == "vertex":
        return least
    group, count = (mesh.vertex_body, mesh.num_bodies) if per == "body" else (mesh.vertex_world, mesh.num_worlds)
    of_group = np.full(count, np.inf)
    np.minimum.at(of_group, group, least)
    return of_group[group]


def _moved(start: NDArray[np.float64], end: NDArray[np.float64], fraction: NDArray[np.float64]) -> NDArray[np.float64]:
    """Positions at the fractions of the displacements: exactly the start at 0 and the end at 1."""
    f = fraction[..., None]
    # no difference of two far positions is formed, which could overflow; what rests is not to move by a rounding
    return np.where((f == 0) | (start == end), start, np.where(f == 1, end, (1 - f) * start + f * end))


def _chosen(contacts: Contacts, chosen: NDArray[Any]) -> Contacts:
    return Contacts(**{name: values[chosen] for name, values in vars(contacts).items()})
