"""The solver of a single pair on arcs: windows, each solved by `solver`, until the pair is free or in contact."""

import warp as wp

from ..boxes.thickness import radius_of
from ..interrupts import is_stopped
from ..pair_kind import EDGE_EDGE
from ..parameters import norm, only_method, real
from ..template import specialised
from .query import Options
from .single_points import Points
from .status import (
    STATUS_COLLISION,
    STATUS_INITIAL_CONTACT,
    STATUS_INVALID,
    STATUS_ITERATION_LIMIT,
    STATUS_NO_COLLISION,
)
from .turns import Turns
from .windows import Window, in_slice, in_step, next_window, reached

solver = specialised("pair.solver", norm=norm, real=real, only_method=only_method)
arcs = specialised("pair.arcs", norm=norm)
corotating = specialised("pair.corotating", norm=norm)
lane_windows = specialised("pair.lane_windows", norm=norm, real=real)
points_at = arcs.points_at
zero = wp.constant(wp.float64(0.0))
one = wp.constant(wp.float64(1.0))
two = wp.constant(wp.float64(2.0))
half = wp.constant(wp.float64(0.5))
eighth = wp.constant(wp.float64(0.125))


@wp.func
def arcs_of_pair(kind: int, first: wp.vec3i, second: wp.vec3i, turns: Turns) -> arcs.Arcs:
    """How the points of a pair of primitives turn, given by their vertices."""
    r = arcs.Arcs()
    body = turns.vertex_body[first[0]]
    r.t_begin = turns.t_begin[body]
    r.t_length = turns.t_end[body] - r.t_begin
    r.spin_a = r.t_length * turns.omega[body]
    r.spin_b = r.t_length * turns.omega[turns.vertex_body[second[0]]]
    r.slack = radius_of(turns.slack, first) + radius_of(turns.slack, second)
    r.excess = turns.excess[body] + turns.excess[turns.vertex_body[second[0]]]
    if arcs.turns_anywhere(r):
        r.v0 = turns.velocity[first[0]]
        if kind == EDGE_EDGE:
            r.v1 = turns.velocity[first[1]]
            r.v2 = turns.velocity[second[0]]
            r.v3 = turns.velocity[second[1]]
        else:
            r.v1 = turns.velocity[second[0]]
            r.v2 = turns.velocity[second[1]]
            r.v3 = turns.velocity[second[2]]
    return r


@wp.struct
class Tangents:
    """Both ends of straight motion on which points are at one time where they are on arcs, and move as they do then."""

    a: Points
    b: Points
    t: wp.float64  # the time between these ends
    slack: wp.float64  # how far both primitives may be from there, together


@wp.func
def tangents_of_arcs(
    kind: int, first: wp.vec3i, second: wp.vec3i, a: Points, b: Points, t: wp.float64, options: Options
) -> Tangents:
    """Where a pair is and how it moves at a time of the step."""
    turning = arcs_of_pair(kind, first, second, options.turns)
    r = Tangents()
    r.a = a
    r.b = b
    r.t = in_slice(t, turning.t_begin, turning.t_length)
    r.slack = turning.slack + turning.excess
    if not arcs.turns_anywhere(turning):
        return r
    x = points_at(kind, a, b, turning, r.t)
    v = arcs.velocities_at(kind, a, b, turning, r.t)
    r.t = half
    r.a.p0 = x.p0 - half * v.p0
    r.a.p1 = x.p1 - half * v.p1
    r.a.p2 = x.p2 - half * v.p2
    r.a.p3 = x.p3 - half * v.p3
    r.b.p0 = x.p0 + half * v.p0
    r.b.p1 = x.p1 + half * v.p1
    r.b.p2 = x.p2 + half * v.p2
    r.b.p3 = x.p3 + half * v.p3
    return r


@wp.struct
class Chords:
    """A pair in a window of its slice as if its points moved straight, and how far they are from that, per axis."""

    at_begin: Points
    at_end: Points
    sagitta: wp.vec3d
    is_corotating: bool  # seen from a body, with which everything turns


@wp.func
def chords_of(
    kind: int,
    a: Points,
    b: Points,
    turning: arcs.Arcs,
    amplitudes: wp.vec3d,
    window: Window,
    end: wp.float64,
    is_shared: bool,
) -> Chords:
    """The chords of a window, those seen from one of both bodies where their spins are alike and that is nearer."""
    r = Chords()
    r.at_begin = points_at(kind, a, b, turning, window.begin)
    r.at_end = points_at(kind, a, b, turning, end)
    r.sagitta = arcs.sagitta(amplitudes, window.h)
    if is_shared:
        of_body = corotating.corotating_window(kind, a, b, turning, r.at_begin, r.at_end, window.begin, window.h)
        off = of_body.sagitta + of_body.error
        r.is_corotating = off < wp.max(r.sagitta)
        if r.is_corotating:
            r.at_end = of_body.at_end
            r.sagitta = wp.vec3d(off, off, off)
    return r


@wp.func
def in_whole_step(
    outcome: solver.Outcome, t_reached: wp.float64, is_limit: bool, turning: arcs.Arcs, h: wp.float64, options: Options
) -> solver.Outcome:
    """What a window of this length has found, as times of the step."""
    outcome.toi = in_step(t_reached, turning.t_begin, turning.t_length)
    if outcome.status == STATUS_INVALID:
        outcome.toi = zero
    if outcome.status == STATUS_INITIAL_CONTACT and outcome.toi > zero:
        outcome.status = STATUS_COLLISION
    if outcome.status == STATUS_COLLISION and outcome.toi == zero:
        outcome.status = STATUS_INITIAL_CONTACT
    outcome.width = wp.where(is_limit, options.t_max - outcome.toi, outcome.width * h)
    return outcome


@wp.func(inline=only_method != "")
def solve_on_arcs(
    kind: int,
    first: wp.vec3i,
    second: wp.vec3i,
    t: wp.float64,
    used: int,
    a: Points,
    b: Points,
    options: Options,
    cap: int,
) -> solver.Outcome:
    """Earliest toi in the slice of a pair that is free up to a time of the step, after ``used`` iterations.

    The points are those at both ends of the slice, the options those of the pair.
    """
    turning = arcs_of_pair(kind, first, second, options.turns)
    amplitudes = arcs.amplitude(kind, turning)
    rounding = arcs.error_of(a, b, turning.slack, amplitudes)
    error = rounding + turning.excess
    of_window = options
    of_window.t_end = real(1.0)
    of_window.t_max = one
    if options.margin > zero:
        of_window.minimum_separation = wp.max(
            options.minimum_separation - lane_windows.start_distance_errors * error, zero
        )
    is_shared = corotating.are_alike(turning) and corotating.may_turn(of_window.minimum_separation)
    window = Window()
    window.begin = in_slice(t, turning.t_begin, turning.t_length)
    window.h = one - window.begin
    if used > 0:
        window.h = eighth * window.h
    outcome = solver.Outcome()
    outcome.toi = wp.float64(wp.inf)
    outcome.status = STATUS_NO_COLLISION
    is_open = bool(True)
    while is_open and not is_stopped(options.stop):
        end = wp.min(window.begin + window.h, one)
        window.h = end - window.begin
        chords = chords_of(kind, a, b, turning, amplitudes, window, end, is_shared)
        of_window.sagitta = lane_windows.enlarged(chords.sagitta, error)
        n = solver.normalise(kind, chords.at_begin, chords.at_end, of_window)
        outcome = solver.solve(kind, n, of_window, real(0.0), 0, cap - used)
        used += outcome.iterations
        if outcome.status != STATUS_NO_COLLISION:
            outcome.gap += two * wp.max(of_window.sagitta)
        if chords.is_corotating:
            outcome.gap = corotating.longest_turned * outcome.gap
        is_free = outcome.status == STATUS_NO_COLLISION
        is_limit = outcome.status == STATUS_ITERATION_LIMIT or outcome.status == STATUS_INVALID
        is_sharp = wp.max(chords.sagitta) <= lane_windows.sharpness(rounding, kind, chords.at_begin)
        t_reached = reached(window, end, is_free, wp.where(is_free, one, outcome.toi))
        is_open = not is_limit and ((is_free and end < one) or not (is_free or is_sharp))
        if not is_open and not is_free:
            outcome = in_whole_step(outcome, t_reached, is_limit, turning, window.h, options)
        window = next_window(window, t_reached, is_free)
    outcome.iterations = used
    return outcome
