"""Hostile families of pairs on arcs, each a function of the kind, the number of pairs and the random numbers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import product

import numpy as np
from arc_pairs import (
    COUNTS,
    KINDS,
    ArcPairs,
    directions,
    meeting,
    moving_bodies,
    quaternion,
    random_pairs,
    unit,
    weights,
)
from arc_samples import positions, turned

_Z = np.array([0.0, 0.0, 1.0])


def _margins(rng: np.random.Generator, n: int, least: float = -12.0, most: float = -3.0) -> np.ndarray:
    """Zero for some, for the others a small length of either sign."""
    lengths = 10 ** rng.uniform(least, most, n) * rng.choice([-1.0, 1.0], n)
    return np.where(rng.random(n) < 0.1, 0.0, lengths)


def staged(
    kind: str,
    points: tuple[np.ndarray, np.ndarray],
    centre: np.ndarray,
    omega: np.ndarray,
    velocity: np.ndarray,
    rng: np.random.Generator,
    *,
    distance: float = 0.0,
    in_space: bool = True,
) -> ArcPairs:
    """Bodies whose points at t = 0 are given, which turn about centres that move straight, all [n, 2, 3].

    With `in_space`, the scene is turned and each body has a frame of its own, up to rounding. The motion is a twist.
    """
    n = len(centre)
    frame = unit(rng.standard_normal((n, 1, 4))) if in_space else np.tile([0.0, 0.0, 0.0, 1.0], (n, 1, 1))
    orientation = unit(rng.standard_normal((n, 2, 4))) if in_space else np.tile([0.0, 0.0, 0.0, 1.0], (n, 2, 1))
    inverse = orientation * [-1, -1, -1, 1]
    centre, omega, velocity = (turned(frame, x) for x in (centre, omega, velocity))
    local = [turned(inverse[:, s : s + 1], turned(frame, points[s]) - centre[:, s : s + 1]) for s in (0, 1)]
    return moving_bodies(kind, *local, orientation, omega, velocity, by_twist=True, position=centre, distance=distance)


def _around(kind: str, side: int, rng: np.random.Generator, place: np.ndarray, size: float = 1.0) -> np.ndarray:
    """Points in the plane z = 0 about places in their inside, shape [n, points, 3]."""
    n, count = len(place), COUNTS[kind][side]
    first = rng.uniform(0, 2 * np.pi, (n, 1))
    angle = first + 2 * np.pi * np.arange(count) / count
    flat = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=2) * size * (count > 1)
    return place[:, None] + flat * rng.uniform(0.3, 1.0, (n, 1, 1))


def _over_a_plane(kind: str, n: int, rng: np.random.Generator, distance: float, slip: float) -> ArcPairs:
    """The lowest point of a wheel, or an edge along its axis, over what lies in a plane; 0 slip rolls, 1 stays."""
    radius = rng.uniform(0.3, 2.0, n)
    zero = np.zeros(n)
    b = _around(kind, 1, rng, np.stack([zero, zero, -_margins(rng, n) - distance], axis=1))
    a = np.zeros((n, COUNTS[kind][0], 3))
    if kind == "edge-edge":  # one along the axis, and the other one across
        a[:, :, 0] = np.stack([-rng.uniform(0.1, 1.0, n), rng.uniform(0.1, 1.0, n)], axis=1)
        half = unit(np.stack([rng.standard_normal(n), rng.uniform(0.3, 2.0, n), zero], axis=1))
        b = b.mean(axis=1)[:, None] + half[:, None] * np.array([-0.7, 0.9])[:, None]
    centre = np.stack([np.stack([zero, zero, radius], axis=1), b[:, 0]], axis=1)
    omega, velocity = np.zeros((n, 2, 3)), np.zeros((n, 2, 3))
    omega[:, 0, 0] = rng.uniform(0.2, 4.0, n)
    velocity[:, 0, 1] = -(1 - slip) * omega[:, 0, 0] * radius
    time = rng.uniform(0.05, 0.95, (n, 1))  # of the contact
    a = centre[:, :1] + turned(quaternion(-omega[:, :1] * time[:, :, None]), a - centre[:, :1])
    back = velocity[:, 0] * time
    centre[:, 0] -= back
    return staged(kind, (a - back[:, None], b), centre, omega, velocity, rng, distance=distance)


def grazing_arcs(kind: str, n: int, rng: np.random.Generator, distance: float) -> ArcPairs:
    """A primitive on a circle is tangent to another one at rest: it touches, or misses, by 1e-12 to 1e-3."""
    return _over_a_plane(kind, n, rng, distance, 1.0)


def rolling(kind: str, n: int, rng: np.random.Generator, distance: float) -> ArcPairs:
    """A point or an edge of a wheel that rolls without slipping comes to rest on the ground, or above or below it."""
    return _over_a_plane(kind, n, rng, distance, 0.0)


def _meeting_at(pairs: ArcPairs, time: np.ndarray, gap: np.ndarray, rng: np.random.Generator) -> ArcPairs:
    """Places in the inside of both are, at a time, a gap from counting as contact; up to rounding."""
    at = [weights(pairs.kind, side, rng, len(pairs)) for side in (0, 1)]
    way = directions(rng, len(pairs))
    if pairs.kind == "point-segment":
        ends = positions(pairs, 1, time[:, None])[:, 0]
        along = unit((ends[:, 1] - ends[:, 0]).astype(np.float64))
        way = unit(way - along * (along * way).sum(axis=1, keepdims=True))
    return meeting(pairs, time, *at, way * (gap + pairs.distance)[:, None])


def _small_motions(kind: str, n: int, rng: np.random.Generator, distance: float, **options) -> ArcPairs:
    return random_pairs(kind, int(rng.integers(2**31)), n, distance=distance, **options)


def contact_at_the_end(kind: str, n: int, rng: np.random.Generator, distance: float) -> ArcPairs:
    """Places of two bodies coincide at the very end of the step, up to rounding or some 1e-16 to 1e-6."""
    pairs = _small_motions(kind, n, rng, distance)
    gap = np.where(rng.random(n) < 0.3, 0.0, 10 ** rng.uniform(-16, -6, n))
    return _meeting_at(pairs, np.ones(n), gap, rng)


def contact_at_the_start(kind: str, n: int, rng: np.random.Generator, distance: float) -> ArcPairs:
    """Places of two bodies coincide at the start: exactly, in a scene of whole numbers, or up to some 1e-16 to 1e-6."""
    pairs = _small_motions(kind, n, rng, distance)
    gap = np.where(rng.random(n) < 0.3, 0.0, 10 ** rng.uniform(-16, -6, n))
    near = _meeting_at(pairs, np.zeros(n), gap, rng)
    whole = near.poses_t0.copy(), near.poses_t1.copy(), near.points_a.copy(), near.points_b.copy()
    exact = rng.random(n) < 0.5
    whole[0][exact] = [0, 0, 0, 0, 0, 0, 1]
    whole[1][exact, :, 3:] = quaternion(directions(rng, n, 2) * rng.uniform(0.01, 3.0, (n, 2, 1)))[exact]
    # a cross of two edges, a point in a face: the origin is in the inside of all
    a = rng.integers(-8, 9, (n, 3)).astype(float)
    b = rng.integers(-8, 9, (n, 2, 3)).astype(float)
    sides = {
        1: lambda x, y: np.zeros((n, 1, 3)),
        2: lambda x, y: np.stack([-x, 2 * x], axis=1),
        3: lambda x, y: np.stack([x, y, -(x + y)], axis=1),
    }
    counts = COUNTS[kind]
    whole[2][exact] = sides[counts[0]](a, a)[exact]
    whole[3][exact] = sides[counts[1]](b[:, 0], b[:, 1])[exact]
    return replace(near, poses_t0=whole[0], poses_t1=whole[1], points_a=whole[2], points_b=whole[3])


def _turning(
    kind: str, n: int, rng: np.random.Generator, distance: float, turn: np.ndarray, path: str = "linear"
) -> ArcPairs:
    """Bodies with turns [n, 2] by twists, which meet at some time in the step, or nearly."""
    points = [rng.standard_normal((n, count, 3)) for count in COUNTS[kind]]
    omega = directions(rng, n, 2) * turn[:, :, None]
    velocity = directions(rng, n, 2) * 10 ** rng.uniform(-2, 0.5, (n, 2, 1))
    orientation = unit(rng.standard_normal((n, 2, 4)))
    pairs = moving_bodies(kind, *points, orientation, omega, velocity, path=path, by_twist=True, distance=distance)
    away = np.where(rng.random(n) < 0.7, 0.0, rng.uniform(0.5, 4.0, n))
    return _meeting_at(pairs, rng.random(n), away, rng)


def many_turns(kind: str, n: int, rng: np.random.Generator, distance: float) -> ArcPairs:
    """One or ten turns in the step, of one body or both."""
    turn = rng.uniform(2 * np.pi, 20 * np.pi, (n, 2)) * (rng.random((n, 2)) < [1.0, 0.6])
    return _turning(kind, n, rng, distance, turn)


def huge_turns(kind: str, n: int, rng: np.random.Generator, distance: float) -> ArcPairs:
    """Fifty turns in the step."""
    return _turning(kind, n, rng, distance, np.full((n, 2), 100 * np.pi) * (rng.random((n, 2)) < [1.0, 0.5]))


def tiny_turns(kind: str, n: int, rng: np.random.Generator, distance: float) -> ArcPairs:
    """Turns by 1e-300 to 1e-8, so that most squares underflow."""
    return _turning(kind, n, rng, distance, 10 ** rng.uniform(-300, -8, (n, 2)) * (rng.random((n, 2)) < [1.0, 0.7]))


def tiny_screws(kind: str, n: int, rng: np.random.Generator, distance: float) -> ArcPairs:
    """Turns by 1e-300 to 1e-8 about far axes."""
    return _turning(kind, n, rng, distance, 10 ** rng.uniform(-300, -8, (n, 2)), path="screw")


def axis_through_the_contact(kind: str, n: int, rng: np.random.Generator, distance: float) -> ArcPairs:
    """Both bodies turn about the places that meet."""
    points = [rng.standard_normal((n, count, 3)) for count in COUNTS[kind]]
    at = [weights(kind, side, rng, n) for side in (0, 1)]
    centre = np.stack([(w[:, :, None] * x).sum(axis=1) for w, x in zip(at, points, strict=True)], axis=1)
    omega = directions(rng, n, 2) * rng.uniform(0.1, 2 * np.pi, (n, 2, 1)) * (rng.random((n, 2, 1)) < 0.8)
    velocity = directions(rng, n, 2) * 10 ** rng.uniform(-6, 0, (n, 2, 1))
    pairs = staged(kind, tuple(points), centre, omega, velocity, rng, distance=distance)
    gap = np.where(rng.random(n) < 0.6, 0.0, 10 ** rng.uniform(-9, -1, n)) + pairs.distance
    return meeting(pairs, rng.random(n), *at, directions(rng, n) * gap[:, None])


def needles(kind: str, n: int, rng: np.random.Generator, distance: float) -> ArcPairs:
    """Edges and faces whose sides differ by a factor of up to 1e6."""
    pairs = _small_motions(kind, n, rng, distance)
    sides = []
    for points in (pairs.points_a, pairs.points_b):
        thin = 10 ** rng.uniform(-6, -3, (n, 1, 1))
        long = unit(rng.standard_normal((n, 1, 3)))
        sides.append(thin * points + long * (long * points).sum(axis=2, keepdims=True))
    pairs = replace(pairs, points_a=sides[0], points_b=sides[1])
    gap = np.where(rng.random(n) < 0.6, 0.0, 10 ** rng.uniform(-6, 0, n))
    return _meeting_at(pairs, rng.random(n), gap, rng)


def _flat(kind: str, n: int, rng: np.random.Generator, distance: float, in_space: bool) -> ArcPairs:
    points = [rng.standard_normal((n, count, 3)) * [1, 1, 0] for count in COUNTS[kind]]
    apart = np.stack([rng.uniform(-3, 3, n), rng.uniform(-3, 3, n), np.zeros(n)], axis=1)
    points[1] += apart[:, None]
    omega = rng.uniform(-3, 3, (n, 2, 1)) * _Z
    centre = rng.standard_normal((n, 2, 3)) * [1, 1, 0] + np.stack([0 * apart, apart], axis=1)
    velocity = np.stack([apart, -apart], axis=1) * rng.uniform(0, 1, (n, 2, 1))
    pairs = staged(kind, tuple(points), centre, omega, velocity, rng, in_space=in_space, distance=distance)
    if not in_space:  # the shift has no part along z, not even by rounding
        at = [weights(kind, side, rng, n) for side in (0, 1)]
        pairs = meeting(pairs, rng.random(n), *at, rng.standard_normal((n, 3)) * [1, 1, 0] * rng.integers(0, 2, (n, 1)))
    return pairs


def in_one_plane(kind: str, n: int, rng: np.random.Generator, distance: float) -> ArcPairs:
    """All stays in the plane z = 0, exactly."""
    return _flat(kind, n, rng, distance, in_space=False)


def nearly_in_one_plane(kind: str, n: int, rng: np.random.Generator, distance: float) -> ArcPairs:
    """All stays in an oblique plane, up to the rounding of what is given."""
    return _flat(kind, n, rng, distance, in_space=True)


def _far(kind: str, n: int, rng: np.random.Generator, distance: float, far: float) -> ArcPairs:
    pairs = _small_motions(kind, n, rng, distance, path=str(rng.choice(["linear", "screw"])))
    shift = directions(rng, n)[:, None] * far
    for poses in (pairs.poses_t0, pairs.poses_t1):
        poses[:, :, :3] += shift
    return pairs


def far_from_the_origin(kind: str, n: int, rng: np.random.Generator, distance: float) -> ArcPairs:
    """Bodies at 1e6 from the origin."""
    return _far(kind, n, rng, distance, 1e6)


def very_far_from_the_origin(kind: str, n: int, rng: np.random.Generator, distance: float) -> ArcPairs:
    """Bodies at 1e8 from the origin."""
    return _far(kind, n, rng, distance, 1e8)


def far_from_their_own_origin(kind: str, n: int, rng: np.random.Generator, distance: float) -> ArcPairs:
    """Points at 1e6 from the origin of their body, which turns about a pivot among them."""
    pairs = _small_motions(kind, n, rng, distance)
    shift = directions(rng, n, 2) * 1e6
    moved = [turned(pose[:, :, 3:], shift) for pose in (pairs.poses_t0, pairs.poses_t1)]
    poses = [pose.copy() for pose in (pairs.poses_t0, pairs.poses_t1)]
    for pose, by in zip(poses, moved, strict=True):
        pose[:, :, :3] -= by
    return replace(
        pairs,
        points_a=pairs.points_a + shift[:, :1],
        points_b=pairs.points_b + shift[:, 1:],
        poses_t0=poses[0],
        poses_t1=poses[1],
        pivot=pairs.pivot + shift,
    )


def _hovering(kind: str, n: int, rng: np.random.Generator, gap: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Side A above side B by a gap along z, edges crossed or parallel."""
    b = _around(kind, 1, rng, np.zeros((n, 3)))
    a = _around(kind, 0, rng, np.stack([np.zeros(n), np.zeros(n), gap], axis=1))
    if kind == "edge-edge":
        parallel = rng.random(n) < 0.3
        a[parallel] = (b + np.stack([np.zeros(n), np.zeros(n), gap], axis=1)[:, None])[parallel]
    return a, b


def common_spin(kind: str, n: int, rng: np.random.Generator, distance: float) -> ArcPairs:
    """Two bodies turn about one axis as if they were one, and approach by a multiple of their gap of 1e-9 to 1e-1."""
    gap = 10 ** rng.uniform(-9, -1, n)
    a, b = _hovering(kind, n, rng, gap + distance)
    omega = np.repeat(directions(rng, n, 1) * rng.uniform(0.1, 2 * np.pi, (n, 1, 1)), 2, axis=1)
    along = rng.random((n, 1)) < 0.4  # about the normal, along which one sinks
    omega = np.where(along[:, :, None], np.linalg.norm(omega, axis=2, keepdims=True) * _Z, omega)
    centre = np.repeat(rng.standard_normal((n, 1, 3)), 2, axis=1)
    speed = gap * rng.choice([0.0, 0.5, 2.0, 10.0], n)
    velocity = np.zeros((n, 2, 3))
    velocity[:, 0] = -speed[:, None] * np.where(along, _Z, directions(rng, n))
    faster = np.where((rng.random(n) < 0.3)[:, None, None], 1 + np.stack([gap, 0 * gap], axis=1)[:, :, None], 1.0)
    return staged(kind, (a, b), centre, omega * faster, velocity, rng, distance=distance)


def counter_spins(kind: str, n: int, rng: np.random.Generator, distance: float) -> ArcPairs:
    """Two bodies turn against each other about parallel axes, or the same one."""
    points = [rng.standard_normal((n, count, 3)) for count in COUNTS[kind]]
    omega = directions(rng, n, 1) * rng.uniform(0.1, 4 * np.pi, (n, 1, 1))
    centre = np.repeat(rng.standard_normal((n, 1, 3)), 2, axis=1)
    centre[:, 1] += rng.standard_normal((n, 3)) * (rng.random((n, 1)) < 0.5)
    velocity = directions(rng, n, 2) * 10 ** rng.uniform(-6, 0, (n, 2, 1))
    pairs = staged(kind, tuple(points), centre, omega * [[[1], [-1]]], velocity, rng, distance=distance)
    gap = np.where(rng.random(n) < 0.6, 0.0, 10 ** rng.uniform(-9, 0.5, n))
    return _meeting_at(pairs, rng.random(n), gap, rng)


Family = Callable[[str, int, np.random.Generator, float], ArcPairs]
FAMILIES: dict[str, Family] = {
    family.__name__: family
    for family in (
        grazing_arcs,
        rolling,
        contact_at_the_end,
        contact_at_the_start,
        many_turns,
        huge_turns,
        tiny_turns,
        tiny_screws,
        axis_through_the_contact,
        needles,
        in_one_plane,
        nearly_in_one_plane,
        far_from_the_origin,
        very_far_from_the_origin,
        far_from_their_own_origin,
        common_spin,
        counter_spins,
    )
}


def hostile_pairs(name: str, kind: str, n: int, distance: float | None = None) -> ArcPairs:
    """A family by its name; the first pairs are not those of a smaller set."""
    if distance is None:  # points and segments meet in space only if a distance counts as contact
        distance = 0.1 if kind == "point-point" or (kind == "point-segment" and name != "in_one_plane") else 0.0
    return FAMILIES[name](kind, n, np.random.default_rng([list(FAMILIES).index(name), KINDS.index(kind)]), distance)


def hostile_sets(each: int) -> dict[str, ArcPairs]:
    """All families with pairs of all kinds; half as many of the kinds with points, and with a distance."""
    sets = {}
    for name, kind in product(FAMILIES, KINDS):
        n = each // 2 if kind.startswith("point") else each
        sets[f"{name}, {kind}"] = hostile_pairs(name, kind, n)
        if not kind.startswith("point"):
            sets[f"{name}, {kind}, a distance"] = hostile_pairs(name, kind, each // 2, 0.03)
    return sets
