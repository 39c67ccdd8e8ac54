"""What becomes of the result of a pair of a list: it is left open, recorded as a contact, or lowers the least toi."""

import warp as wp

from ..atomics import atomic_min_int64, claim, claim_int
from ..pair.norm import Norm
from ..pair.pair_options import options_of_pair
from ..pair.query import Options
from ..pair.single_points import Points, corners, is_stationary, largest, points_of, relative_motion
from ..pair.start_distance import start_distance_of
from ..pair.status import (
    STATUS_COLLISION,
    STATUS_INITIAL_CONTACT,
    STATUS_ITERATION_LIMIT,
    STATUS_NO_COLLISION,
    STATUS_ROUNDING_LIMIT,
)
from ..pair.turns import turns_anywhere
from ..parameters import norm, only_method, real, width
from ..step.contact_normal import ContactGap, contact_at
from ..step.minima import (
    ANY_OPEN,
    CONTACTS_OVERFLOW,
    OPEN,
    ROUNDING_LIMIT,
    STRUCK,
    Minima,
    flag_world,
    is_kinematic,
    lower_pair,
)
from ..step.pair_list import LeastToi, PairList, PairVertices, Round, vertices_of_pair
from ..step.step import ContactList
from ..template import specialised
from .pair_outcome import most_gap, status_at_start
from .raised_toi import may_be_raised, raised_toi

# A pair that keeps its start distance (`start_distance`) has toi 0 if it touches within this fraction of the step and
# of its size: what is lost in the margin is no progress, and a response is to find the pair among those that touch.
_PRESSED = wp.constant(wp.float64(2.0**-20))

Outcome = specialised("pair.solver", real=real, norm=norm, only_method=only_method).Outcome
by_pair = norm.is_by_pair
on_arcs = norm.has_arcs
if on_arcs:
    tangents_of_arcs = specialised("pair.arc_solver", norm=norm, real=real, only_method=only_method).tangents_of_arcs
infinite = wp.constant(wp.float64(float("inf")))
# Contacts that ask for no distance are recorded several at once where there are lanes (`lane_contacts`).
in_lanes = width > 1 and norm == Norm.MAXIMUM


@wp.func
def stays_in_place(pairs: PairList, k: int, a: Points, b: Points, options: Options) -> bool:
    """Whether no point of a pair moves in the step, given its points at both ends."""
    if not is_stationary(a, b):
        return False
    if wp.static(on_arcs):
        vertices = vertices_of_pair(pairs, k)
        return not (turns_anywhere(vertices.first, options.turns) or turns_anywhere(vertices.second, options.turns))
    return True


@wp.func
def is_left_open(outcome: Outcome, round: Round, options: Options, cap: int) -> bool:
    """Whether a pair goes on in the second round."""
    return outcome.status == STATUS_ITERATION_LIMIT and round.is_second == 0 and cap < options.max_iterations


@wp.func
def leave_open(pairs: PairList, k: int):
    """Mark a pair for the second round."""
    pairs.keys[k] = ~pairs.keys[k]
    claim(pairs.counts, pairs.kind, OPEN, 1)
    claim(pairs.counts, 0, ANY_OPEN, 1)


@wp.func
def is_pressed(kind: int, a: Points, b: Points, toi: wp.float64) -> bool:
    """Whether a pair that keeps its start distance touches as good as from the start."""
    return toi <= _PRESSED and toi * relative_motion(a, b) <= _PRESSED * wp.max(largest(corners(kind, a)))


@wp.func(inline=only_method != "")
def is_struck(
    vertices: PairVertices, x_t0: wp.array[wp.vec3d], x_t1: wp.array[wp.vec3d], options: Options, minima: Minima
) -> bool:
    """Whether of a pair only what is kinematic moves."""
    free = vertices.first
    if is_kinematic(minima, vertices.first[0]):
        free = vertices.second
    elif not is_kinematic(minima, vertices.second[0]):
        return False
    for k in range(3):
        if not (x_t0[free[k]] == x_t1[free[k]]):
            return False
    if wp.static(on_arcs):
        return not turns_anywhere(free, options.turns)
    return True


@wp.func(inline=False if in_lanes else None)
def contact_of_pair(
    kind: int, a: Points, b: Points, t: wp.float64, parameters: wp.vec2d, slack: wp.float64
) -> ContactGap:
    """`contact_at`, out of line where few contacts come one by one."""
    return contact_at(kind, a, b, t, parameters, slack)


@wp.func(inline=True)
def record_contact(
    pairs: PairList,
    k: int,
    outcome: Outcome,
    options: Options,
    round: Round,
    # out
    minima: Minima,
    contacts: ContactList,
):
    """Lower the minima, and append the contact to the list if there is capacity; ``options`` are of all pairs.

    With ``only_moving`` a pair of which only what is kinematic moves sets a flag in place of lowering the minima.
    """
    vertices = vertices_of_pair(pairs, k)
    first = vertices.first
    second = vertices.second
    a = points_of(pairs.kind, first, second, pairs.vertices_t0)
    b = points_of(pairs.kind, first, second, pairs.vertices_t1)
    keeps_start_distance = bool(False)
    if wp.static(by_pair):
        if start_distance_of(options.start_distance, first, second).share < infinite:
            if is_pressed(pairs.kind, a, b, outcome.toi):
                keeps_start_distance = True
                outcome.toi = wp.float64(0.0)
                if outcome.status == STATUS_COLLISION:
                    outcome.status = STATUS_INITIAL_CONTACT
    toi = outcome.toi
    status = outcome.status
    most = most_gap(options)
    if status == STATUS_INITIAL_CONTACT and outcome.gap > most and not keeps_start_distance:
        separation = options_of_pair(options, first, second).minimum_separation
        status = status_at_start(pairs.kind, outcome.gap, most, a, separation)
        if status == STATUS_ROUNDING_LIMIT:
            flag_world(minima, first[0], ROUNDING_LIMIT)
    if may_be_raised(toi, round.gaps_moved) and not keeps_start_distance:
        toi = raised_toi(toi, outcome.gap, relative_motion(a, b), round.gaps_moved)
    if round.only_moving != 0 and is_struck(vertices, pairs.vertices_t0, pairs.vertices_t1, options, minima):
        flag_world(minima, first[0], STRUCK)
    else:
        lower_pair(minima, first, second, wp.cast(toi, wp.int64))
    n = claim_int(contacts.count, 0, 1)
    if n < contacts.toi.shape[0]:
        contacts.kind[n] = pairs.kind
        contacts.primitives[n] = vertices.pair
        contacts.toi[n] = outcome.toi
        contacts.status[n] = status
        contacts.gap[n] = outcome.gap
        contacts.width[n] = outcome.width
        t = outcome.toi
        slack = wp.float64(0.0)
        if wp.static(on_arcs):
            tangents = tangents_of_arcs(pairs.kind, first, second, a, b, t, options)
            a = tangents.a
            b = tangents.b
            t = tangents.t
            slack = tangents.slack
        at_toi = contact_of_pair(pairs.kind, a, b, t, outcome.parameters, slack)
        contacts.parameters[n] = at_toi.parameters
        contacts.normal[n] = at_toi.direction
    else:
        flag_world(minima, first[0], CONTACTS_OVERFLOW)


@wp.func(inline=True)
def settle_least(
    pairs: PairList,
    k: int,
    outcome: Outcome,
    options: Options,
    round: Round,
    cap: int,
    # out
    least: LeastToi,
    earliest: ContactList,
):
    """Lower the least toi by the result of a pair, or leave the pair open.

    Where there is a list, it gets each pair that is as early as the least toi so far, and so the earliest; of several
    that are equally early, those that are solved later may be left out.
    """
    if is_left_open(outcome, round, options, cap):
        leave_open(pairs, k)
        least.open_toi[k] = outcome.toi
    elif outcome.status != STATUS_NO_COLLISION:
        atomic_min_int64(least.bits, 0, wp.cast(outcome.toi, wp.int64))
        if earliest.toi.shape[0] > 0:
            if wp.cast(outcome.toi, wp.int64) <= least.bits[0]:
                n = claim_int(earliest.count, 0, 1)
                if n < earliest.toi.shape[0]:
                    earliest.kind[n] = pairs.kind
                    earliest.primitives[n] = vertices_of_pair(pairs, k).pair
                    earliest.toi[n] = outcome.toi
                    earliest.parameters[n] = outcome.parameters
