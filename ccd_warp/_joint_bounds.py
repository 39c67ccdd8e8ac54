"""Velocities of links in a slice of a motion of joints, and bounds of how they change.

A link moves with the twist V, the field of velocity V(x) = v + ω × (x − o) of its points, o its origin. The derivatives
V′ and V″ of the field at a fixed place compose along the chain: a joint with the twist J, that turns by φ about the
axis z and slides by u, adds to its parent's Vₚ

    V′ = Vₚ′ + [Vₚ, J] + J₂,     V″ = Vₚ″ + [Vₚ′, J] + [Vₚ, J′] + [Vₚ, J₂] + J₃,

with [V, J](x) = ω × J(x) − ω_J × V(x) the bracket of twists and J₂, J₃ the derivatives of J in the parent's frame:
J₂(o) = u″ − φ′ z × u′ and J₃(o) = u‴ − 2 φ″ z × u′ − φ′ z × u″, turning by φ″ and φ‴. What is a vector in the middle
of the slice is a sum of lengths as a bound on all of it. One joint at constant speed has V′ = V″ = 0.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ccd_warp._joint_courses import EPS, Array, JointCourse, cross, length, offset_error, rotated, step, turn_error

_ARITHMETIC = 64.0 * EPS  # of a sum of a few products of vectors, relative to their lengths


class Window(NamedTuple):
    """A slice of the step, of each world.

    Attributes:
        begin: Its begin, shape [W].
        end: Its end.
        middle: A time between.
        duration: Its length.
        half: No time of it is farther from the middle than this times its length: 1/2, but for rounding.
    """

    begin: Array
    end: Array
    middle: Array
    duration: Array
    half: Array

    @classmethod
    def of(cls, begin: Array, end: Array) -> Window:
        middle, duration = begin + 0.5 * (end - begin), end - begin
        farthest = np.maximum(middle - begin, end - middle)
        half = np.where(duration > 0.0, farthest / np.where(duration > 0.0, duration, 1.0), 0.5)
        return cls(begin, end, middle, duration, half * (1.0 + 4.0 * EPS))


class Motion(NamedTuple):
    """A link in the middle of a slice, with time in units of the slice, and bounds of lengths on all of it.

    Attributes:
        position: o, shape [3, W].
        rotation: Unit quaternion, shape [4, W].
        omega: ω.
        alpha: ω′.
        velocity: v = V(o).
        bend: a = V′(o).
        most_omega: Bound of |ω|, shape [W], as those that follow.
        most_alpha: Of |ω′|.
        most_jerk: Of |ω″|.
        most_velocity: Of |V(o)|.
        most_bend: Of |V′(o)|.
        most_change: Of |V″(o)|.
        turned: By how much rounding turns the link, in radians.
        moved: By how much rounding moves its origin.
        relative: Relative error of what is computed in the middle.
    """

    position: Array
    rotation: Array
    omega: Array
    alpha: Array
    velocity: Array
    bend: Array
    most_omega: Array
    most_alpha: Array
    most_jerk: Array
    most_velocity: Array
    most_bend: Array
    most_change: Array
    turned: Array
    moved: Array
    relative: Array


def motions(courses: list[JointCourse], order: list[int], window: Window) -> list[Motion]:
    """All links in a slice of the step."""
    found: list[Any] = [None] * len(courses)
    for link in order:
        course = courses[link]
        parent = found[course.parent] if course.parent >= 0 else None
        found[link] = _root(course, len(window.begin)) if parent is None else _carried(course, parent, window)
    return found


def _root(course: JointCourse, count: int) -> Motion:
    vectors, lengths = [np.zeros((3, count))] * 4, [np.zeros(count)] * 9
    return Motion(np.zeros((3, count)), np.broadcast_to(course.turn, (4, count)), *vectors, *lengths)


class Rates(NamedTuple):
    """The derivatives of a polynomial in the middle of a slice, in its units of time, and bounds on all of it.

    Attributes:
        first: The first derivative, a number or a vector.
        second: The second one.
        most: Bounds of the lengths of the first three, shape [W] each.
        relative: How much of a bound the error of the derivatives is at most.
    """

    first: Any
    second: Any
    most: tuple[Any, Any, Any]
    relative: Any


_NONE = Rates(0.0, 0.0, (0.0, 0.0, 0.0), 0.0)


def _rates(coefficients: Array | None, window: Window) -> Rates:
    """The derivatives of a polynomial of degree 1 or 3, shape [2 or 4, W] or [2 or 4, 3, W]."""
    if coefficients is None:
        return _NONE
    lengths = [np.abs(c) if c.ndim == 1 else length(c) for c in coefficients]
    t, h, half = window.middle, window.duration, window.half
    if len(coefficients) == 2:
        first = coefficients[1] * h
        return Rates(first, 0.0, (lengths[1] * h * (1.0 + 16.0 * EPS), 0.0, 0.0), 16.0 * EPS)
    _, c1, c2, c3 = coefficients
    first = (c1 + t * (2.0 * c2 + t * 3.0 * c3)) * h
    second = (2.0 * c2 + t * 6.0 * c3) * (h * h)
    errors = (
        16.0
        * EPS
        * np.array(
            [(lengths[1] + 2.0 * lengths[2] + 3.0 * lengths[3]) * h, (2.0 * lengths[2] + 6.0 * lengths[3]) * h * h]
        )
    )
    third = 6.0 * lengths[3] * h**3 * (1.0 + 16.0 * EPS)
    at_middle = [np.abs(x) if x.ndim == 1 else length(x) for x in (first, second)]
    most_second = at_middle[1] + half * third + errors[1]
    most_first = at_middle[0] + half * (at_middle[1] + errors[1]) + 0.5 * half * half * third + errors[0]
    most = np.array([most_first, most_second])
    relative = (errors / np.where(most > 0.0, most, 1.0)).max(axis=0)
    return Rates(first, second, (most_first, most_second, third), relative)


def _carried(course: JointCourse, parent: Motion, window: Window) -> Motion:
    """A link in a slice, from the one that carries it."""
    half = window.half
    here = step(course, parent.rotation, window.middle)
    angle, slide = _rates(course.angle, window), _rates(course.slide, window)
    r, slides = here.offset, course.slide is not None
    w_p, al_p = parent.omega, parent.alpha
    # in the middle
    carried = parent.velocity + cross(w_p, r)  # Vₚ(o)
    alpha, bend, spin = al_p, parent.bend + cross(al_p, r), 0.0
    velocity = carried
    if slides:
        u1 = rotated(here.frame, slide.first)
        velocity = carried + u1
        bend = bend + cross(w_p, u1)
        if np.ndim(slide.second):
            bend = bend + rotated(here.frame, slide.second)
    omega = w_p
    if course.angle is not None:
        z = rotated(here.frame, np.broadcast_to(course.axis, r.shape))  # type: ignore[arg-type]
        spin = angle.first * z
        omega = w_p + spin
        alpha = al_p + cross(w_p, spin) + angle.second * z
        bend = bend - cross(spin, velocity)
    # bounds
    (f1, f2, f3), (g1, g2, g3) = angle.most, slide.most
    reach = length(r) * (1.0 + _ARITHMETIC) + half * g1
    off = offset_error(course, reach)
    reach = reach + off
    vo = parent.most_velocity + parent.most_omega * reach
    most_velocity = vo + g1
    own_bend = parent.most_omega * g1 + g2 + f1 * most_velocity
    own_alpha = f2 + f1 * parent.most_omega
    parent_bend = parent.most_bend + parent.most_alpha * reach
    most_alpha, most_bend = parent.most_alpha + own_alpha, parent_bend + own_bend
    most_jerk = parent.most_jerk + parent.most_alpha * f1 + parent.most_omega * (own_alpha + f2) + f3
    most_change = (
        (parent.most_change + parent.most_jerk * reach)
        + (parent.most_alpha * g1 + f1 * parent_bend)
        + (parent.most_omega * own_bend + own_alpha * vo)
        + (parent.most_omega * (g2 + f1 * g1) + f2 * vo)
        + (g3 + 2.0 * f2 * g1 + f1 * g2)
    )
    most_omega = parent.most_omega + f1
    # rounding
    turned = parent.turned + turn_error(course)
    moved = parent.moved + parent.turned * reach + off
    position = parent.position + r
    moved = moved + 2.0 * EPS * (length(position) + parent.most_velocity + most_velocity)
    relative = np.maximum(parent.relative, np.maximum(angle.relative, slide.relative))
    wrong = 4.0 * relative + 8.0 * turned
    # what is computed in the middle bounds more tightly than lengths do, where vectors cancel
    up = 1.0 + _ARITHMETIC
    alpha_near = length(alpha) * up + wrong * most_alpha + half * most_jerk
    most_alpha = np.minimum(most_alpha, alpha_near)
    omega_near = length(omega) * up + wrong * most_omega + half * most_alpha
    most_omega = np.minimum(most_omega, omega_near)
    moving = 2.0 * moved * (most_alpha + most_omega * most_omega)
    bend_near = length(bend) * up + wrong * most_bend + moving + half * (most_change + most_alpha * most_velocity)
    most_bend = np.minimum(most_bend, bend_near)
    moving = 2.0 * moved * most_omega
    velocity_near = (
        length(velocity) * up + wrong * most_velocity + moving + half * (most_bend + most_omega * most_velocity)
    )
    most_velocity = np.minimum(most_velocity, velocity_near)
    return Motion(
        position,
        here.rotation,
        omega,
        alpha,
        velocity,
        bend,
        most_omega,
        most_alpha,
        most_jerk,
        most_velocity,
        most_bend,
        most_change,
        turned,
        moved,
        relative,
    )
