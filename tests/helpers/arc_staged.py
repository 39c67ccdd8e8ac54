"""Hostile families of pairs on arcs that are built in a scene of their own, and then turned in space.

A family is a function of the kind, the number of pairs, the random numbers, and the distance that counts as contact.
"""

from __future__ import annotations

import numpy as np
from arc_pairs import COUNTS, ArcPairs, directions, meeting, meeting_at, moving_bodies, quaternion, unit, weights
from arc_samples import turned

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
    return meeting_at(pairs, rng.random(n), gap, rng)
