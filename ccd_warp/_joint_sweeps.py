"""Where links of a motion of joints are in the middle of windows of a slice, and how far their points go in it.

A point at an arm c of a link, whose origin moves by V(o) and that turns by ω, goes at most h (|V(o)| + |ω| |c|) from
its place in the middle of a window, h half of its duration (`_joint_bounds`). Seen from a link that carries it, only
the joints between the two move it, each by no more than its own rates times the length of the chain from it to the
point: links far out on an arm, which go fast together, hardly move against each other. Rates are bounds on all of a
slice, so they hold in each of its windows.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ccd_warp._joint_bounds import Window, _rates, motions
from ccd_warp._joint_courses import (
    EPS,
    Array,
    JointCourse,
    cross,
    length,
    offset_error,
    rotated,
    slope,
    step,
    turn_error,
)

_UP = 1.0 + 1024.0 * EPS  # rounding of a bound itself
_PLACE_ERROR = 128.0 * EPS  # of a place computed from a link's pose, relative to its coordinates
_VELOCITY_ERROR = 16.0  # of a velocity, relative to errors of turns and rates and to the lengths it is a sum of
_TIME_ERROR = 16.0 * EPS  # of the times of windows, which are 1 at most


class Sweeps(NamedTuple):
    """Bodies in the windows of slices, and how far they go; m windows a slice.

    Velocities and turns are those of half a slice: in a window of half its length what is not rounding is the half,
    and what the path bends the quarter.

    Attributes:
        position: Places of their origins in the middle of each window, shape [n, m, L, 3].
        rotation: Their unit quaternions, shape [n, m, L, 4].
        velocity: Velocities of their origins in the middle of each window, shape [n, m, L, 3].
        omega: Rotation vectors, shape [n, m, L, 3].
        reach: Of each body in a slice at most, shape [n, L, 6]: how far its origin goes from the middle, and by how
            much rounding may move it, and its velocity; the same of its turn, in radians. A point goes as far as the
            origin and the turn times the length of its arm. Then by how much the path of the origin bends from its
            velocity in the middle, and what an arm adds to that, times its length.
        relative: Of pairs of bodies, shape [n, p, 6]: points at arms a and b come by no more than the length, the first
            turn times |a| and the second one times |b| nearer to each other than they are in the middle; each is
            followed by what rounding adds. None where each of them goes as far as it goes against the world.
    """

    position: Array
    rotation: Array
    velocity: Array
    omega: Array
    reach: Array
    relative: Array


def slack(window: Window) -> Array:
    """By what share of a slice the times of its windows may be wrong."""
    return _TIME_ERROR / np.where(window.duration > 0.0, window.duration, 1.0)


def sweeps(
    courses: list[JointCourse],
    order: list[int],
    rows: list[int],
    window: Window,
    middles: Array,
    pairs: list[tuple[int, int]],
) -> Sweeps:
    """Links in slices, against the world and against each other.

    Args:
        courses: What the joints do.
        order: Links in an order in which each comes after the one that carries it.
        rows: The links that are bodies.
        window: The slices.
        middles: The middles of their windows, shape [m, n].
        pairs: Pairs of links.
    """
    shape = len(window.begin), len(middles), len(rows)
    fields = [np.empty((*shape, size)) for size in (3, 4, 3, 3)]
    with np.errstate(all="ignore"):
        for k, t in enumerate(middles):
            moving = _moving(courses, order, t, window.half * window.duration)
            for row, link in enumerate(rows):
                for field, values in zip(fields, moving[link], strict=True):
                    field[:, k, row] = values.T
        steps = {link: _step(courses[link], window) for link in order if courses[link].parent >= 0}
        reach, relative = _reach(courses, order, rows, window, steps), _relative(courses, pairs, window, steps)
    position, rotation, velocity, omega = fields
    return Sweeps(position, rotation, velocity, omega, reach, relative)


def _moving(
    courses: list[JointCourse], order: list[int], t: Array, pace: Array
) -> dict[int, tuple[Array, Array, Array, Array]]:
    """Position, rotation, velocity and rotation vector of all links at a time, the latter for so much of the step."""
    found: dict[int, tuple[Array, Array, Array, Array]] = {}
    none = np.zeros((3, len(t)))
    for link in order:
        course = courses[link]
        if course.parent < 0:
            found[link] = none, np.broadcast_to(course.turn, (4, len(t))), none, none
            continue
        position, rotation, velocity, omega = found[course.parent]
        here = step(course, rotation, t)
        velocity = velocity + cross(omega, here.offset)
        if course.slide is not None:
            velocity = velocity + rotated(here.frame, slope(course.slide, t) * pace)
        if course.angle is not None:
            axis = np.broadcast_to(course.axis, none.shape)  # type: ignore[arg-type]
            omega = omega + slope(course.angle, t) * pace * rotated(here.frame, axis)
        found[link] = position + here.offset, here.rotation, velocity, omega
    return found


def _reach(
    courses: list[JointCourse], order: list[int], rows: list[int], window: Window, steps: dict[int, _Step]
) -> Array:
    """``Sweeps.reach``.

    A velocity is a sum along the chain, whose parts may cancel: its error is relative to the sum of their lengths.
    """
    half, off = window.half, slack(window)
    none = np.zeros(len(window.begin))
    sums = {link: (none, none) for link in order}  # of lengths of velocities, and of rates of turns
    for link in order:
        if link in steps:
            velocity, turn = sums[courses[link].parent]
            own = steps[link]
            sums[link] = velocity + turn * own.length + own.slides, turn + own.turns
    found = motions(courses, order, window)
    reach = np.empty((len(none), len(rows), 6))
    for row, link in enumerate(rows):
        x, (velocity, turn) = found[link], sums[link]
        wrong = _VELOCITY_ERROR * (x.turned + x.relative + 8.0 * EPS)
        place = length(x.position) + x.most_velocity
        bend = 0.5 * half * half * (x.most_bend + x.most_omega * x.most_velocity)
        bend_of_arm = 0.5 * half * half * (x.most_alpha + x.most_omega * x.most_omega)
        moved = 2.0 * x.moved * (1.0 + turn) + wrong * velocity
        reach[:, row] = np.stack(
            [
                half * x.most_velocity,
                moved + _PLACE_ERROR * place + off * (x.most_velocity + 8.0 * bend),
                half * x.most_omega,
                2.0 * x.turned + wrong * turn + _PLACE_ERROR + off * (x.most_omega + 8.0 * bend_of_arm),
                bend,
                bend_of_arm,
            ],
            axis=1,
        )
    return reach * _UP


def _relative(
    courses: list[JointCourse], pairs: list[tuple[int, int]], window: Window, steps: dict[int, _Step]
) -> Array:
    """How far points of pairs of links go against each other in slices at most, shape [n, p, 6]."""
    n = len(window.begin)
    half, off = window.half, slack(window)
    reach = np.zeros((len(pairs), 6, n))
    for row, pair in zip(reach, pairs, strict=True):
        above = [_above(courses, link) for link in pair]
        for links, other, angle in ((above[0], above[1], 2), (above[1], above[0], 4)):
            chain = np.zeros(n)  # from a joint to the origin of the link
            for link in links:
                if link in other:
                    break
                each = steps[link]
                moved, wrong = each.slides + each.turns * chain, each.moved + each.turned * chain
                row[0] += half * moved
                row[1] += wrong + off * moved + _PLACE_ERROR * (chain + each.length)
                row[angle] += half * each.turns
                row[angle + 1] += each.turned + off * each.turns + _PLACE_ERROR
                chain = chain + each.length
    return np.ascontiguousarray(reach.transpose(2, 0, 1)) * _UP


def _above(courses: list[JointCourse], link: int) -> list[int]:
    """A link and those that carry it."""
    found = [link]
    while courses[found[-1]].parent >= 0:
        found.append(courses[found[-1]].parent)
    return found


class _Step(NamedTuple):
    """What a joint does in a slice at most; one number a slice each.

    Attributes:
        turns: By how many radians it turns its link.
        slides: By how much it slides it.
        turned: By how many radians rounding turns the link.
        moved: By how much rounding moves it.
        length: How far it is from the link that carries it.
    """

    turns: Array
    slides: Array
    turned: Array
    moved: Array
    length: Array


def _step(course: JointCourse, window: Window) -> _Step:
    angle, slide = _rates(course.angle, window), _rates(course.slide, window)
    none = np.zeros(len(window.begin))
    reach = none + length(course.place)
    if course.slide is not None:
        sizes = [length(c) for c in course.slide]  # times are no larger than 1
        reach = reach + np.sum(np.broadcast_arrays(*sizes), axis=0)
    wrong = 2.0 * turn_error(course), 2.0 * offset_error(course, reach)
    return _Step(none + angle.most[0], none + slide.most[0], none + wrong[0], none + wrong[1], reach)
