"""Directions for a patch and a ball: a Euclidean distance has no facets, and what separates is the closest pair.

The direction of the closest pair touches the ball where the patch is nearest, so it separates as long as any does. Kept
as it is, it converges quadratically for a corner, whose distance from the origin is a convex function of time. Of a
side that turns, however, the far end swings out along a fixed direction as fast as the near one approaches, and the
convergence is linear. Therefore there is a second direction, which turns with the side: e(t) × a, with a constant
vector a = d × e at the time reached, where it is the closest pair's direction d itself up to its length. It is linear
in t and stays orthogonal to the side, and the direction of the closest pair leaves it only within the plane across the
side, to which a distance is stationary: the convergence is quadratic. A point inside the patch is left to the normal,
which is that of `volume`.
"""

import warp as wp

from ..parameters import real, width
from ..template import specialised
from . import simd
from .lane_closest import closest
from .moving_clip import clip_along
from .norm import Norm
from .patch import Corners, gap_along, num_sides, side_of
from .rounding import RELATIVE, TINY, TINY_DIRECTION, UNIT_ROUNDOFF
from .simd import (
    Lanes,
    Mask,
    Vec3,
    cross,
    dot,
    greatest,
    greatest_of,
    is_at_most,
    is_less,
    least,
    magnitude,
    minus,
    select,
    spread,
    square_root,
    vec,
)

norm = specialised("pair.support", real=real, width=width, norm=Norm.EUCLIDEAN)

zero = wp.constant(real(0.0))
one = wp.constant(real(1.0))
two = wp.constant(real(2.0))
huge = wp.constant(real(1.0e30))
tiny = wp.constant(real(TINY[real]))
round_up = wp.constant(real(1.0 + RELATIVE * UNIT_ROUNDOFF[real]))
tiny_direction = wp.constant(real(TINY_DIRECTION[real]))


@simd.func
def offset(d: Vec3, error: Vec3, separation: Vec3) -> Lanes:
    """Upper bound of the rounding errors and the distance along d (rounding, steps 6 and 13)."""
    return (dot(magnitude(d), error) + norm.support(separation, d)) * round_up


@simd.func
def with_largest_one(d: Vec3) -> Vec3:
    """A direction with its largest component at about one; no number where it vanishes, which proves nothing."""
    m = magnitude(d)
    return (one / greatest_of(m)) * d


@simd.func
def is_in_ball(x: Vec3, slack: Vec3, radius: Vec3) -> Mask:
    """Whether x is within ``slack``, per axis, of the ellipsoid with the given half axes."""
    nothing = spread(zero)
    m = magnitude(x)
    y = vec(
        greatest(m.x - slack.x, nothing) / (radius.x + tiny),
        greatest(m.y - slack.y, nothing) / (radius.y + tiny),
        greatest(m.z - slack.z, nothing) / (radius.z + tiny),
    )
    return is_at_most(dot(y, y), one)


@simd.func
def time_to_ball(p: Vec3, velocity: Vec3, radius: Lanes, longest: Lanes) -> Lanes:
    """Time in which a point outside a ball reaches it, or comes closest to it; 0 if it recedes, at most longest."""
    nothing = spread(zero)
    a = dot(velocity, velocity)
    b = dot(p, velocity)
    c = dot(p, p) - radius * radius
    root = square_root(greatest(b * b - a * c, nothing))
    h = select(is_less(nothing, root), c / (root - b), minus(b) / a)
    return greatest(least(select(is_less(b, nothing), h, nothing), longest), nothing)


@wp.struct
class Turn:
    """A side, and the constant vector whose cross product with it is a direction."""

    number: Lanes  # of the side
    axis: Vec3
    share: Lanes  # squared cosine between side and direction, as a fraction share / size
    size: Lanes
    is_face: bool  # whether there is a third side


@simd.func
def chosen(turn: Turn, c: Corners) -> Vec3:
    """The side of each lane."""
    e = select(is_less(turn.number, one), side_of(c, 0), side_of(c, 1))
    if turn.is_face:
        e = select(is_at_most(two, turn.number), side_of(c, 2), e)
    return e


@simd.func
def direction(turn: Turn, c: Corners) -> Vec3:
    """The direction of each lane, linear in time."""
    return cross(chosen(turn, c), turn.axis)


@simd.func
def consider(turn: Turn, number: int, e: Vec3, d: Vec3) -> Turn:
    """Keep the side that is more nearly orthogonal to d."""
    size = dot(e, e)
    along = dot(d, e)
    share = along * along
    is_better = is_less(tiny, size) & is_less(share * turn.size, turn.share * size)
    turn.number = select(is_better, real(number), turn.number)
    turn.share = select(is_better, share, turn.share)
    turn.size = select(is_better, size, turn.size)
    return turn


@simd.func
def turn_of_side(number: int, later: Corners, ahead: Vec3, is_face: bool) -> Turn:
    """The turn about a given side that comes to the part of ``ahead`` across it at the later corners."""
    turn = Turn()
    turn.is_face = is_face
    turn.number = spread(real(number))
    turn.axis = cross(ahead, side_of(later, number))
    return turn


@simd.func
def turn_along(c: Corners, d: Vec3, later: Corners, ahead: Vec3, is_face: bool) -> Turn:
    """The turn to ``ahead`` at the later corners, about the side to which d is most nearly orthogonal."""
    turn = Turn()
    turn.is_face = is_face
    turn.number = spread(zero)
    turn.share = spread(huge)
    turn.size = spread(one)
    turn = consider(turn, 0, side_of(c, 0), d)
    turn = consider(turn, 1, side_of(c, 1), d)
    if is_face:
        turn = consider(turn, 2, side_of(c, 2), d)
    turn.axis = cross(ahead, chosen(turn, later))
    return turn


@simd.func
def share_along(c: Corners, d: Vec3, separation: Vec3, error: Vec3) -> Lanes:
    """Lower bound of the distance along one direction, as a share of the separation."""
    d = with_largest_one(d)
    along = norm.support(separation, d)
    counts = is_at_most(tiny_direction, norm.length(d)) & is_less(zero, along)
    share = (gap_along(d, c) - dot(magnitude(d), error) * round_up) / along
    return select(counts, share, zero)


@wp.func
def start_gap_share(c: Corners, is_face: bool, separation: Vec3, error: Vec3) -> Lanes:
    """Tight lower bound of the Euclidean distance at one time, as a share of the separation."""
    share = share_along(c, cross(side_of(c, 0), side_of(c, 1)), separation, error)
    near = closest(c, is_face)
    share = greatest(share, share_along(c, near.d, separation, error))
    share = greatest(share, share_along(c, near.point, separation, error))
    for side in range(num_sides(is_face)):
        e = side_of(c, side)
        share = greatest(share, share_along(c, cross(e, cross(near.point, e)), separation, error))
    return share


clip_turn = clip_along(Turn, direction, offset)
