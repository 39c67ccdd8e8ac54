"""Pairs of primitives of bodies that turn, in plain arrays, and random sets of them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from arc_samples import positions

COUNTS = {"vertex-face": (1, 3), "edge-edge": (2, 2), "point-segment": (1, 2), "point-point": (1, 1)}
KINDS = tuple(COUNTS)
PATHS = ("linear", "screw")


@dataclass(frozen=True)
class ArcPairs:
    """Pairs of one kind, each of two bodies, with one path for all.

    Attributes:
        kind: One of `KINDS`; the vertex or point is on side A.
        points_a, points_b: In the frames of the bodies, float64, shape [n, points, 3].
        poses_t0: Of both bodies, position and unit quaternion (x, y, z, w), shape [n, 2, 7].
        poses_t1: The same at the end of the step; None where a twist is given.
        pivot: In the frames of the bodies; zero for screws, shape [n, 2, 3].
        path: "linear" or "screw".
        twist: Velocity of the pivots and rotation vectors of the step, world frame, shape [n, 2, 6], or None.
        points_b_t1: None, or the end of the points of side B, which then belong to a deformable body: they are in the
            world, and the second body's pose, pivot and twist mean nothing.
        distance: Euclidean distance that counts as contact; 0 for touching.
    """

    kind: str
    points_a: np.ndarray
    points_b: np.ndarray
    poses_t0: np.ndarray
    poses_t1: np.ndarray | None
    pivot: np.ndarray
    path: str = "linear"
    twist: np.ndarray | None = None
    points_b_t1: np.ndarray | None = None
    distance: float = 0.0

    def __len__(self) -> int:
        return len(self.points_a)

    def __getitem__(self, rows) -> ArcPairs:
        """Some of the pairs, by a slice or an array of indices."""
        arrays = {name: value[rows] for name, value in vars(self).items() if isinstance(value, np.ndarray)}
        return replace(self, **arrays)

    def moved(self, shift: np.ndarray) -> ArcPairs:
        """The same pairs with the second body elsewhere all the time; shape [n, 3]."""
        if self.points_b_t1 is not None:
            shift = shift[:, None]
            return replace(self, points_b=self.points_b + shift, points_b_t1=self.points_b_t1 + shift)
        poses = [None if pose is None else pose.copy() for pose in (self.poses_t0, self.poses_t1)]
        for pose in poses:
            if pose is not None:
                pose[:, 1, :3] += shift
        return replace(self, poses_t0=poses[0], poses_t1=poses[1])


def unit(rows: np.ndarray) -> np.ndarray:
    return rows / np.linalg.norm(rows, axis=-1, keepdims=True)


def directions(rng: np.random.Generator, *shape: int) -> np.ndarray:
    """Random unit vectors."""
    return unit(rng.standard_normal((*shape, 3)))


def quaternion(vectors: np.ndarray) -> np.ndarray:
    """The quaternions (x, y, z, w) of rotation vectors."""
    angle = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.concatenate([vectors * (0.5 * np.sinc(angle / (2 * np.pi))), np.cos(0.5 * angle)], axis=-1)


def product_of(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The quaternion of the rotation by b and then by a."""
    (av, aw), (bv, bw) = (a[..., :3], a[..., 3:]), (b[..., :3], b[..., 3:])
    v = aw * bv + bw * av + np.cross(av, bv)
    return np.concatenate([v, aw * bw - (av * bv).sum(axis=-1, keepdims=True)], axis=-1)


def moving_bodies(
    kind: str,
    points_a: np.ndarray,
    points_b: np.ndarray,
    orientation: np.ndarray,
    omega: np.ndarray,
    displacement: np.ndarray,
    *,
    path: str = "linear",
    pivot: np.ndarray | None = None,
    by_twist: bool = False,
    position: np.ndarray | None = None,
    distance: float = 0.0,
) -> ArcPairs:
    """Pairs of two rigid bodies by their motions; `displacement` is that of the body's origin, [n, 2, 3], as omega.

    With `by_twist`, it is the first part of the twist.
    """
    pivot = np.zeros_like(omega) if pivot is None else pivot
    position = np.zeros_like(omega) if position is None else position
    poses_t0 = np.concatenate([position, orientation], axis=2)
    twist = np.concatenate([displacement, omega], axis=2) if by_twist else None
    end = unit(product_of(quaternion(omega), orientation))
    poses_t1 = None if by_twist else np.concatenate([position + displacement, end], axis=2)
    return ArcPairs(kind, points_a, points_b, poses_t0, poses_t1, pivot, path, twist, None, distance)


def weights(kind: str, side: int, rng: np.random.Generator, n: int) -> np.ndarray:
    """Random convex combinations of the points of a side, shape [n, points]."""
    return rng.dirichlet(np.ones(COUNTS[kind][side]), n)


def meeting(pairs: ArcPairs, time: np.ndarray, at_a: np.ndarray, at_b: np.ndarray, gap: np.ndarray) -> ArcPairs:
    """The second bodies moved so that at a time, up to rounding, a place on B is `gap` [n, 3] from a place on A."""
    a, b = (positions(pairs, side, time[:, None])[:, 0] for side in (0, 1))
    shift = (at_a[:, :, None] * a).sum(axis=1) - (at_b[:, :, None] * b).sum(axis=1) + gap
    return pairs.moved(shift.astype(np.float64))


def meeting_at(pairs: ArcPairs, time: np.ndarray, gap: np.ndarray, rng: np.random.Generator) -> ArcPairs:
    """Places in the inside of both are, at a time, a gap from counting as contact; up to rounding."""
    at = [weights(pairs.kind, side, rng, len(pairs)) for side in (0, 1)]
    way = directions(rng, len(pairs))
    if pairs.kind == "point-segment":
        ends = positions(pairs, 1, time[:, None])[:, 0]
        along = unit((ends[:, 1] - ends[:, 0]).astype(np.float64))
        way = unit(way - along * (along * way).sum(axis=1, keepdims=True))
    return meeting(pairs, time, *at, way * (gap + pairs.distance)[:, None])


def random_pairs(
    kind: str,
    seed: int,
    n: int,
    *,
    path: str = "linear",
    other: str = "turning",
    by_twist: bool = False,
    distance: float | None = None,
    in_plane: bool = False,
) -> ArcPairs:
    """Random pairs of which a good half touches, with turns from 1e-3 to π, by a twist to 2π.

    Args:
        kind: One of `KINDS`.
        other: "turning", "at rest" or "deformable", the second body.
        by_twist: Whether the motion is given by a twist and not by an end pose.
        distance: That counts as contact; 0 by default, and 0.1 for kinds that would never meet.
        in_plane: Whether all is in the plane z = 0, and turns about z.
    """
    kept = np.array([1.0, 1.0, 0.0 if in_plane else 1.0])
    rng = np.random.default_rng([KINDS.index(kind), seed])
    if distance is None:
        distance = 0.1 if kind.startswith("point") else 0.0
    points = [rng.standard_normal((n, count, 3)) * 10 ** rng.uniform(-1.0, 0.5, (n, 1, 1)) for count in COUNTS[kind]]
    points = [x * kept for x in points]
    largest = 2 * np.pi if by_twist else np.pi - 1e-3
    turn = np.where(rng.random((n, 2)) < 0.5, rng.uniform(1e-3, largest, (n, 2)), 10 ** rng.uniform(-3, 0, (n, 2)))
    axes = directions(rng, n, 2)
    omega = (np.sign(axes[..., 2:]) * [0.0, 0, 1] if in_plane else axes) * turn[:, :, None]
    displacement = directions(rng, n, 2) * 10 ** rng.uniform(-2, 0.5, (n, 2, 1)) * kept
    orientation = unit(rng.standard_normal((n, 2, 4)) * [*(2 * [kept[2]]), 1.0, 1.0])
    pivot = np.zeros((n, 2, 3)) if path == "screw" else rng.standard_normal((n, 2, 3)) * rng.integers(0, 2, (n, 1, 1))
    pivot *= kept
    if other == "at rest":
        omega[:, 1], displacement[:, 1] = 0.0, 0.0
    pairs = moving_bodies(
        kind, *points, orientation, omega, displacement, path=path, pivot=pivot, by_twist=by_twist, distance=distance
    )
    if other == "at rest" and pairs.poses_t1 is not None:
        pairs.poses_t1[:, 1] = pairs.poses_t0[:, 1]
    if other == "deformable":
        moves = rng.standard_normal((n, 1, 3)) + 0.3 * rng.standard_normal(pairs.points_b.shape)
        pairs = replace(pairs, points_b_t1=pairs.points_b + moves * kept)
    at_a, at_b = (weights(kind, side, rng, n) for side in (0, 1))
    away = np.where(rng.random((n, 1)) < 0.6, 0.0, rng.uniform(0.1, 3.0, (n, 1)))
    gap = directions(rng, n) * (away + distance * rng.uniform(0, 1.3, (n, 1))) * kept
    return meeting(pairs, rng.uniform(0.0, 1.0, n), at_a, at_b, gap)


def prisms(pairs: ArcPairs) -> ArcPairs:
    """Pairs of points and segments in the plane z = 0, the points as edges across it: they meet at the same times."""
    across = np.array([[0.0, 0, -1], [0, 0, 1]])
    return replace(pairs, kind="edge-edge", points_a=pairs.points_a + across)


def random_sets(each: int) -> dict[str, ArcPairs]:
    """Random pairs of all kinds, paths and second bodies, half as many of the kinds with points."""
    sets = {}
    for kind, path, other, by_twist in product(KINDS, PATHS, ("turning", "at rest", "deformable"), (False, True)):
        n = each // 2 if kind.startswith("point") else each
        name = f"{kind}, {path}, {other}" + by_twist * ", twist"
        sets[name] = random_pairs(kind, len(sets), n, path=path, other=other, by_twist=by_twist)
        if not kind.startswith("point") and not by_twist:
            more = random_pairs(kind, len(sets), each // 4, path=path, other=other, distance=0.05)
            sets[f"{name}, a distance"] = more
    return sets
