"""Certified slices of a motion of joints: each link on a path of `BodyPaths`, and how far it may be from there.

In a slice, from s = 0 to 1, a link T(s) has a path P(s) with the same poses at both ends: a screw, with the constant
twist ξ, in a frame that moves on with a constant velocity w. With V the link's twist (`_joint_bounds`), a point is as
far from its place on the path as g(s) = P(0) P(s)⁻¹ T(s) X from x₀ = g(0), and

    |g″| ≤ |A(x)| + |ε| |E(x)|,     A = V′ − [ξ, E],     E = V − ξ,     ε and n the angular parts of E and ξ,

where V and ξ are those seen from the moving frame, and [ξ, E](x) = n × E(x) − ε × ξ(x). As g is x₀ at both ends,
|g − x₀| ≤ M₀/8 + M₁/24 where |g″(s)| ≤ M₀ + M₁ |2s − 1| (the solutions for a constant, and for |2s − 1|). In the middle
of the slice V′ is computed and E hardly more than rounding; M₁ is what they may change by to the ends. The bound falls
as the square of the slice, with V′: it is 0 but for rounding for one joint at constant speed, and for joints that make
a screw. The frame's velocity w cancels what of V′ is across ω, so that it is 0 for a free joint, too, whose body turns
while its origin moves straight, and smaller for all others.
"""

from __future__ import annotations

import numpy as np

from ccd_warp._body_paths import BodyPaths
from ccd_warp._joint_bounds import Motion, Window, motions
from ccd_warp._joint_courses import EPS, Array, JointCourse, cross, length, poses, rotated
from ccd_warp._rotations import arc_factors

_UP = 1.0 + 4096.0 * EPS  # rounding of a bound itself
_PATH_ERROR = 64.0 * EPS  # of the fields of a path, relative to what moves


def slices(
    courses: list[JointCourse], order: list[int], rows: list[int], window: Window, reach: Array, centre: Array
) -> tuple[BodyPaths, Array]:
    """The paths of links in a slice, as if it were a step from 0 to 1, and how far their points may be from there.

    Args:
        courses: What the joints do.
        order: Links after those that carry them.
        rows: The links that are asked for.
        window: The slice, of each world.
        reach: How far the points of each are from the centre at most, shape [L].
        centre: In the frame of each link, shape [L, 3].

    Returns:
        Paths of N = W·L bodies, those of a world after another's, and the lengths, shape [N].
    """
    num_worlds = len(window.begin)
    with np.errstate(all="ignore"):
        found = motions(courses, order, window)
        links = Motion(
            *(np.stack([x[k] for k in rows], axis=-1).reshape(*x[0].shape[:-1], -1) for x in zip(*found, strict=True))
        )
        begin, end = (_rows(poses(courses, order, t), rows) for t in (window.begin, window.end))
        around = np.tile(centre.T, num_worlds)
        arms = rotated(links.rotation, around)
        radius = np.tile(reach, num_worlds)
        frame = _frame(links, arms, radius)
        end[:, :3] -= frame.T
        paths = BodyPaths.between(begin, end, None)
        moving = BodyPaths(
            paths.rotation, paths.omega, paths.pivot, paths.pivot_t0, paths.velocity + frame.T, paths.turning
        )
        share = np.where(
            window.duration > 0.0,
            (window.middle - window.begin) / np.where(window.duration > 0.0, window.duration, 1.0),
            0.5,
        )
        each = len(rows)
        bound = _excess(links, paths, frame, arms, radius, np.repeat(share, each), np.repeat(window.half, each))
    return moving, bound


def _rows(placed: tuple[list[Array], list[Array]], rows: list[int]) -> Array:
    """Poses of links, shape [N, 7]."""
    positions, rotations = placed
    poses_of = [np.concatenate([positions[k], rotations[k]]) for k in rows]
    return np.ascontiguousarray(np.stack(poses_of, axis=-1).reshape(7, -1).T)


def _frame(links: Motion, arms: Array, radius: Array) -> Array:
    """w, which cancels V′ across ω at the centres of links; no larger than twice their velocities."""
    bend = links.bend + cross(links.alpha, arms)
    squared = (links.omega * links.omega).sum(axis=0)
    frame = cross(links.omega, bend) / np.where(squared > 0.0, squared, 1.0)
    most = 2.0 * (length(links.velocity + cross(links.omega, arms)) + length(links.omega) * radius)
    size = length(frame)
    factor = np.where(size <= most, 1.0, most / np.where(size > 0.0, size, 1.0))
    frame = factor * frame
    return np.where(np.isfinite(frame).all(axis=0), frame, 0.0)


def _excess(
    links: Motion, paths: BodyPaths, frame: Array, arms: Array, radius: Array, share: Array, half: Array
) -> Array:
    """How far points may be from their paths; the paths are seen from the moving frame, which is at 0 at the begin."""
    n, turning, velocity = paths.omega.T, paths.turning.T, paths.velocity.T
    first, second = (x[:, 0] for x in arc_factors(paths.omega, share))
    bent = cross(n, turning)
    origin = paths.pivot_t0.T + share * (velocity + frame) + first * turning + second * bent
    speed = velocity + turning + first * bent + second * cross(n, bent)  # of the path's own origin, in the middle
    # at the centre, in the middle
    arm = length(arms)
    apart = links.position - origin
    miss = links.velocity - frame - speed - cross(n, apart)
    miss = miss + cross(links.omega - n, arms)
    velocity_c = links.velocity + cross(links.omega, arms)
    bend_c = links.bend + cross(links.alpha, arms)
    # bounds at the centre
    relative = 4.0 * links.relative + 8.0 * links.turned
    size_w, size_n = length(frame), length(n)
    most_velocity = links.most_velocity + links.most_omega * arm
    most_bend = links.most_bend + links.most_alpha * arm
    change = links.most_change + links.most_jerk * arm
    accelerated = most_bend + links.most_omega * most_velocity  # |x″|
    most_here = length(velocity_c - frame) + half * accelerated
    most_there = length(velocity_c + frame) + half * accelerated
    # rounding of what was computed in the middle
    moving = 2.0 * links.moved * (links.most_alpha + links.most_omega**2)
    lengths = length(links.position) + length(velocity) + length(turning) + size_w
    of_bend = relative * (most_bend + links.most_omega * size_w) + moving
    of_miss = relative * most_velocity + _PATH_ERROR * (most_velocity + lengths * (1.0 + size_n) * size_n + size_w)
    of_miss = of_miss + links.moved * (links.most_omega + size_n) + _PATH_ERROR * (length(velocity) + length(turning))
    # each bound as a part in the middle and what it may grow by to the ends
    bend_0, bend_1 = (
        length(bend_c + cross(links.omega, frame)) + of_bend,
        half * (change + links.most_alpha * most_there),
    )
    most = most_bend + links.most_omega * size_w
    bend_0, bend_1 = np.minimum(bend_0, most), np.minimum(bend_1, most)
    alpha_0 = np.minimum(length(links.alpha) * (1.0 + _PATH_ERROR) + relative * links.most_alpha, links.most_alpha)
    alpha_1 = np.minimum(half * links.most_jerk, links.most_alpha)
    spin_0, spin_1 = length(links.omega - n) + relative * links.most_omega, half * links.most_alpha
    miss_0, miss_1 = length(miss) + of_miss, half * (bend_0 + bend_1 + (spin_0 + spin_1) * most_here)
    miss_all, spin_all = miss_0 + miss_1, spin_0 + spin_1
    screw = most_here + 2.0 * miss_all + spin_all * radius
    middle = bend_0 + size_n * miss_0 + spin_0 * screw + (alpha_0 + size_n * spin_0) * radius
    growth = bend_1 + size_n * miss_1 + spin_1 * screw + (alpha_1 + size_n * spin_1) * radius
    # the middle may be off half of the slice by rounding, and by all of it where the slice is a few floats
    off = 2.0 * (half - 0.5)
    of_slice = (middle + off * growth) / 8.0 + growth / 24.0
    # rounding of the poses at the ends, and of the fields that lead from one to the other
    reach = radius + arm
    ends = links.moved + links.turned * reach + 4.0 * EPS * (1.0 + size_n) * reach
    ends = ends + _PATH_ERROR * (length(velocity) + length(turning) * (1.0 + size_n) + size_w)
    bound: Array = (of_slice + ends) * _UP
    return bound
