"""Hostile families of pairs on arcs: many turns and tiny ones, contacts at the ends, thin and far primitives.

A family is a function of the kind, the number of pairs, the random numbers, and the distance that counts as contact.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import product

import numpy as np
from arc_pairs import COUNTS, KINDS, ArcPairs, directions, meeting_at, moving_bodies, quaternion, random_pairs, unit
from arc_samples import turned
from arc_staged import (
    axis_through_the_contact,
    common_spin,
    counter_spins,
    grazing_arcs,
    in_one_plane,
    nearly_in_one_plane,
    rolling,
)


def _small_motions(kind: str, n: int, rng: np.random.Generator, distance: float, **options) -> ArcPairs:
    return random_pairs(kind, int(rng.integers(2**31)), n, distance=distance, **options)


def contact_at_the_end(kind: str, n: int, rng: np.random.Generator, distance: float) -> ArcPairs:
    """Places of two bodies coincide at the very end of the step, up to rounding or some 1e-16 to 1e-6."""
    pairs = _small_motions(kind, n, rng, distance)
    gap = np.where(rng.random(n) < 0.3, 0.0, 10 ** rng.uniform(-16, -6, n))
    return meeting_at(pairs, np.ones(n), gap, rng)


def contact_at_the_start(kind: str, n: int, rng: np.random.Generator, distance: float) -> ArcPairs:
    """Places of two bodies coincide at the start: exactly, in a scene of whole numbers, or up to some 1e-16 to 1e-6."""
    pairs = _small_motions(kind, n, rng, distance)
    gap = np.where(rng.random(n) < 0.3, 0.0, 10 ** rng.uniform(-16, -6, n))
    near = meeting_at(pairs, np.zeros(n), gap, rng)
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
    return meeting_at(pairs, rng.random(n), away, rng)


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
    """Turns by 1e-300 to 1e-8 between two poses, about far axes."""
    pairs = _turning(kind, n, rng, distance, 10 ** rng.uniform(-300, -8, (n, 2)), path="screw")
    velocity, omega = pairs.twist[:, :, :3], pairs.twist[:, :, 3:]
    poses = np.zeros((2, n, 2, 7))
    poses[0, :, :, :3] = pairs.poses_t0[:, :, :3]
    poses[1, :, :, :3] = pairs.poses_t0[:, :, :3] + velocity
    poses[1, :, :, 3:6] = 0.5 * omega
    poses[..., 6] = 1.0
    local = [turned(pairs.poses_t0[:, s : s + 1, 3:], x) for s, x in enumerate((pairs.points_a, pairs.points_b))]
    straight = [x.astype(np.float64) for x in local]
    return replace(pairs, points_a=straight[0], points_b=straight[1], poses_t0=poses[0], poses_t1=poses[1], twist=None)


def many_turns_in_a_cloth(kind: str, n: int, rng: np.random.Generator, distance: float) -> ArcPairs:
    """One to ten turns in the step within what deforms."""
    pairs = many_turns(kind, n, rng, distance)
    end = pairs.points_b + rng.standard_normal((n, 1, 3)) + 0.3 * rng.standard_normal(pairs.points_b.shape)
    pairs = replace(pairs, points_b_t1=end)
    return meeting_at(pairs, rng.random(n), np.where(rng.random(n) < 0.7, 0.0, rng.uniform(0.5, 4.0, n)), rng)


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
    return meeting_at(pairs, rng.random(n), gap, rng)


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
        many_turns_in_a_cloth,
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
