"""Where links of a motion of joints are in the middle of a slice, and how far their points go from there in it.

A point at an arm c of a link, whose origin moves by V(o) and that turns by ω, goes at most h (|V(o)| + |ω| |c|) from
its place in the middle of a slice, h half of its duration (`_joint_bounds`). Seen from a link that carries it, only the
joints between the two move it, each by no more than its own rates times the length of the chain from it to the point:
links far out on an arm, which go fast together, hardly move against each other.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ccd_warp._joint_bounds import Window, _rates, motions
from ccd_warp._joint_courses import EPS, Array, JointCourse, length, offset_error, turn_error

_UP = 1.0 + 1024.0 * EPS  # rounding of a bound itself
_PLACE_ERROR = 64.0 * EPS  # of a place computed from a link's pose, relative to its coordinates


class Sweeps(NamedTuple):
    """Links in slices, each slice a column.

    Attributes:
        position: Places of their origins in the middle, shape [L, 3, n].
        rotation: Their unit quaternions, shape [L, 4, n].
        moved: How far the origin goes from there at most, with the rounding of all of this, shape [L, n].
        turned: By how many radians the link turns from there at most, shape [L, n]: a point goes as far as ``moved``
            and this times the length of its arm.
    """

    position: Array
    rotation: Array
    moved: Array
    turned: Array


def sweeps(courses: list[JointCourse], order: list[int], rows: list[int], window: Window) -> Sweeps:
    """Links in slices, against the world."""
    with np.errstate(all="ignore"):
        found = motions(courses, order, window)
        links = [found[k] for k in rows]
        position, rotation = (np.stack([getattr(x, name) for x in links]) for name in ("position", "rotation"))
        moved = np.stack([window.half * x.most_velocity + x.moved + _PLACE_ERROR * length(x.position) for x in links])
        turned = np.stack([window.half * x.most_omega + x.turned + _PLACE_ERROR for x in links])
    return Sweeps(position, np.broadcast_to(rotation, (*rotation.shape[:2], moved.shape[1])), moved * _UP, turned * _UP)


def relative_sweeps(
    courses: list[JointCourse], pairs: list[tuple[int, int]], window: Window
) -> tuple[Array, Array, Array]:
    """How far points of two links go against each other in slices at most, from where they are in the middle.

    Args:
        courses: What the joints do.
        pairs: Pairs of links.
        window: The slices.

    Returns:
        Lengths and two angles for each pair, shape [m, n] each: points at arms a and b come by no more than the length
        and the angles times |a| and |b| nearer to each other than they are in the middle.
    """
    n = len(window.begin)
    steps: dict[int, tuple[Array, Array, Array]] = {}
    moved, first, second = np.zeros((len(pairs), n)), np.zeros((len(pairs), n)), np.zeros((len(pairs), n))
    with np.errstate(all="ignore"):
        for row, pair in enumerate(pairs):
            above = [_above(courses, link) for link in pair]
            for links, other, angle in ((above[0], above[1], first), (above[1], above[0], second)):
                chain = np.zeros(n)  # from a joint to the origin of the link
                for link in links:
                    if link in other:
                        break
                    if link not in steps:
                        steps[link] = _step(courses[link], window)
                    turns, slides, reach = steps[link]
                    moved[row] += window.half * (slides + turns * chain) + _PLACE_ERROR * (chain + reach)
                    angle[row] += window.half * turns + _PLACE_ERROR
                    chain = chain + reach
    return moved * _UP, first * _UP, second * _UP


def _above(courses: list[JointCourse], link: int) -> list[int]:
    """A link and those that carry it."""
    found = [link]
    while courses[found[-1]].parent >= 0:
        found.append(courses[found[-1]].parent)
    return found


def _step(course: JointCourse, window: Window) -> tuple[Array, Array, Array]:
    """By how much a joint turns and slides its link in a slice at most, and how far it is from the one that carries it.

    Twice the error of rounding is in both as if it were motion, of which half of the slice has the half.
    """
    angle, slide = _rates(course.angle, window), _rates(course.slide, window)
    reach = np.zeros(len(window.begin)) + length(course.place)
    if course.slide is not None:
        sizes = [length(c) for c in course.slide]  # times are no larger than 1
        reach = reach + np.sum(np.broadcast_arrays(*sizes), axis=0)
    turns = angle.most[0] + 2.0 * turn_error(course)
    slides = slide.most[0] + 2.0 * offset_error(course, reach)
    return np.zeros_like(reach) + turns, np.zeros_like(reach) + slides, reach
