"""Bodies that turn: their trajectories, pairs of their primitives at random and of hostile families, as meshes."""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace

import numpy as np
from flint import arb, arb_poly
from kept import kept

import ccd_warp as ccd
from laws import trajectories
from laws.trajectories import (
    Trajectory,
    Vector,
    add,
    cross,
    dot,
    exact,
    first_contact,
    precise,
    scaled,
    short,
    sine_and_cosine,
    straight,
    sub,
)

COUNTS = {"vertex-face": (1, 3), "edge-edge": (2, 2), "point-segment": (1, 2), "point-point": (1, 1)}
KINDS = tuple(COUNTS)
AT_REST = np.array([0.0, 0, 0, 0, 0, 0, 1])
_Z = np.array([0.0, 0, 1])


def rotated(quaternion: Vector, x: Vector) -> Vector:
    """A vector turned by a quaternion (x, y, z, w) of any length."""
    *v, w = quaternion
    once = cross(v, x)
    return add(x, scaled(2 / (dot(v, v) + w * w), add(scaled(w, once), cross(v, once))))


def shortest_rotation_vector(start: Vector, end: Vector) -> Vector:
    """The rotation vector of at most π that takes one orientation to another, world frame."""
    (*v0, w0), (*v1, w1) = start, end
    v, w = sub(sub(scaled(w0, v1), scaled(w1, v0)), cross(v1, v0)), w0 * w1 + dot(v0, v1)
    if w < 0:
        v, w = scaled(-1, v), -w
    if all(x.is_zero() for x in v):
        return v
    sine = dot(v, v).sqrt()
    return scaled(2 * arb.atan2(sine, w) / sine, v)


@precise
def turning(local, pose, end=None, path="linear", pivot=(0.0, 0.0, 0.0), twist=None) -> Trajectory:
    """Points of a rigid body between two poses, each a position and a quaternion (x, y, z, w), or along a twist.

    With σ1(t) = sin(θt)/θ, σ2(t) = (1 − cos θt)/θ², θ = |ω|, and the arm r = R0·(local − pivot) of a point,

        x(t) = place of the pivot at 0 + r + t·velocity + σ1(t)·q + σ2(t)·(ω × q),     q = ω × r + turning;

    the pivot moves straight, without `turning`, or on a screw the body turns about a fixed axis.
    """
    place, first, pivot = exact(pose[:3]), exact(pose[3:]), exact(pivot)
    start = add(place, rotated(first, pivot))
    if twist is not None:
        moved, omega = exact(twist[:3]), exact(twist[3:])
    else:
        last = exact(end[3:])
        moved, omega = sub(add(exact(end[:3]), rotated(last, pivot)), start), shortest_rotation_vector(first, last)
    squared = dot(omega, omega)
    theta, velocity, curved = squared.sqrt(), moved, exact([0, 0, 0])

    def sigmas(sine, cosine):  # of half the angle, so that no digits cancel
        return short(sine * cosine) * (2 / theta), short(sine * sine) * (2 / squared)

    if path == "screw" and not theta.is_zero():
        velocity = scaled(dot(omega, moved) / squared, omega)
        curved = sub(moved, velocity)
        if twist is None:  # what takes the origin to its end
            s1, s2 = sigmas(*(theta / 2).sin_cos())
            across = sub(scaled(s1, curved), scaled(s2, cross(omega, curved)))
            curved = scaled(1 / (s1 * s1 + squared * s2 * s2), across)
    rows = []
    for point in local:
        arm = rotated(first, sub(exact(point), pivot))
        q = add(cross(omega, arm), curved)
        rows.append((add(start, arm), velocity, q, cross(omega, q)))

    def points(t: arb_poly) -> list[Vector]:
        s1, s2 = (t, t) if theta.is_zero() else sigmas(*sine_and_cosine(t * (theta / 2)))
        return [[x + v * t + q * s1 + p * s2 for x, v, q, p in zip(*row, strict=True)] for row in rows]

    return points


# --- pairs, a world each ---


@dataclass(frozen=True)
class Pairs:
    """Pairs of one kind, each of two bodies, with one path for all.

    Attributes:
        kind: One of `KINDS`; the vertex or point is on side 0.
        points: Of both sides in the frames of their bodies, float64, shape [n, points, 3] each.
        poses: Of both bodies at t = 0, position and quaternion (x, y, z, w), shape [n, 2, 7].
        ends: The same at the end of the step; None where a twist is given.
        twist: Velocities of the pivots and rotation vectors, shape [n, 2, 6], or None.
        pivot: In the frames of the bodies; zero for screws, shape [n, 2, 3].
        path: "linear" or "screw".
        cloth: None, or where the points of side 1 end, which then deform: they are in the world.
        distance: Euclidean distance that counts as contact; 0 for touching.
    """

    kind: str
    points: tuple[np.ndarray, np.ndarray]
    poses: np.ndarray
    ends: np.ndarray | None = None
    twist: np.ndarray | None = None
    pivot: np.ndarray | None = None
    path: str = "linear"
    cloth: np.ndarray | None = None
    distance: float = 0.0

    def __len__(self) -> int:
        return len(self.poses)

    def trajectories(self, k: int) -> list[Trajectory]:
        """Those of a pair."""
        if self.cloth is not None:
            return [self._rigid(k, 0), straight(self.points[1][k], self.cloth[k])]
        return [self._rigid(k, side) for side in (0, 1)]

    def _rigid(self, k: int, side: int) -> Trajectory:
        end, twist, pivot = (None if x is None else x[k, side] for x in (self.ends, self.twist, self.pivot))
        pivot = np.zeros(3) if pivot is None else pivot
        return turning(self.points[side][k], self.poses[k, side], end, self.path, pivot, twist)

    @precise
    def at(self, k: int, side: int, t: float) -> np.ndarray:
        """The points of a side at a time, up to rounding."""
        points = self.trajectories(k)[side](arb_poly([arb(float(t))]))
        return np.array([[float(arb_poly(x)[0]) for x in point] for point in points])

    def moved(self, shift: np.ndarray) -> Pairs:
        """The same pairs with the second body elsewhere all the time; shape [n, 3]."""
        if self.cloth is not None:
            points = self.points[0], self.points[1] + shift[:, None]
            return replace(self, points=points, cloth=self.cloth + shift[:, None])
        by = np.stack([np.zeros_like(shift), shift], axis=1)
        by = np.concatenate([by, np.zeros((len(self), 2, 4))], axis=2)
        return replace(self, poses=self.poses + by, ends=None if self.ends is None else self.ends + by)

    def meeting(self, time, at, gap) -> Pairs:
        """The second bodies moved so that places on both, by weights, are a vector from each other at a time."""
        places = [[at[side][k] @ self.at(k, side, t) for side in (0, 1)] for k, t in enumerate(time)]
        return self.moved(np.array([a - b for a, b in places]) + gap)

    def near(self, rng, time, gap) -> Pairs:
        """Places in the inside of both are, at a time, a gap from counting as contact; up to rounding."""
        at, way = [weights(self.kind, side, rng, len(self)) for side in (0, 1)], directions(rng, len(self))
        if self.kind == "point-segment":
            ends = np.array([self.at(k, 1, t) for k, t in enumerate(time)])
            along = unit(ends[:, 1] - ends[:, 0])
            way = unit(way - along * (along * way).sum(axis=1, keepdims=True))
        return self.meeting(time, at, way * (gap + self.distance)[:, None])


def _solve(pairs: Pairs) -> tuple[np.ndarray, np.ndarray]:
    found = [first_contact(pairs.kind, *pairs.trajectories(k), pairs.distance) for k in range(len(pairs))]
    return tuple(np.array([rounded_down(x[side]) for x in found]) for side in (0, 1))


def rounded_down(t: arb | None) -> float:
    """The largest float64 that is no larger than a time of [0, 1]; inf for None."""
    value = np.inf if t is None else float(t)
    while t is not None and not arb(value) <= t:
        value = float(np.nextafter(value, -1.0))
    return value


def question_of(pairs: Pairs) -> list:
    return list(vars(pairs).items())


# lo, hi of each pair, inf for None, rounded down; a toi is late iff it is larger than hi
answers = kept(_solve, trajectories, sys.modules[__name__], question_of=question_of)


SPACE = {
    1: lambda x: (x, np.zeros((0, 3), int)),
    2: lambda x: (x, np.zeros((0, 3), int), [[0, 1]]),
    3: lambda x: (x, [[0, 1, 2]]),
}
_PLANE = {count: lambda x, e=[[0, 1]][: count - 1]: (x[:, :2], np.reshape(e, (-1, 2))) for count in (1, 2)}


def step_of(pairs: Pairs, in_plane: bool = False):
    """Mesh, positions at both ends, motion and options of one call; ``world_toi`` is the toi of each pair."""
    n, sides = len(pairs), slice(0, 1 if pairs.cloth is not None else 2)
    make = _PLANE if in_plane else SPACE
    mesh = ccd.CollisionMesh.from_arrays(
        [make[x.shape[1]](x[k]) for k in range(n) for x in pairs.points],
        rigid=range(0, 2 * n, 3 - sides.stop),
        codimensional_points=not in_plane,
        vertex_world=np.repeat(np.arange(n), sum(x.shape[1] for x in pairs.points)),
    )
    end = mesh.vertices
    if pairs.cloth is not None:
        end = np.concatenate([pairs.points[0], pairs.cloth], axis=1).reshape(-1, 3)[:, : mesh.dimension]
    poses, ends, twist, pivot = (
        None if x is None else x[:, sides].reshape(-1, x.shape[2])
        for x in (pairs.poses, pairs.ends, pairs.twist, pairs.pivot if pairs.path == "linear" else None)
    )
    motion = {"poses_t0": poses, "poses_t1": ends, "path": pairs.path, "pivot": pivot, "twist": twist}
    motion = {name: x for name, x in motion.items() if x is not None}
    options = {"pair_kinds": [pairs.kind.replace("-", "_")]}
    return mesh, mesh.vertices, end, motion, options | ({"minimum_distance": pairs.distance} if pairs.distance else {})


# --- pairs at random ---


def unit(rows: np.ndarray) -> np.ndarray:
    return rows / np.linalg.norm(rows, axis=-1, keepdims=True)


def directions(rng, *shape: int) -> np.ndarray:
    return unit(rng.standard_normal((*shape, 3)))


def weights(kind: str, side: int, rng, n: int) -> np.ndarray:
    """Random convex combinations of the points of a side, shape [n, points]."""
    return rng.dirichlet(np.ones(COUNTS[kind][side]), n)


def quaternion(vectors: np.ndarray) -> np.ndarray:
    """The quaternions (x, y, z, w) of rotation vectors."""
    angle = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.concatenate([vectors * (0.5 * np.sinc(angle / (2 * np.pi))), np.cos(0.5 * angle)], axis=-1)


def product_of(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The quaternion of the rotation by b and then by a."""
    (av, aw), (bv, bw) = (a[..., :3], a[..., 3:]), (b[..., :3], b[..., 3:])
    v = aw * bv + bw * av + np.cross(av, bv)
    return np.concatenate([v, aw * bw - (av * bv).sum(axis=-1, keepdims=True)], axis=-1)


def turned(q: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Vectors turned by unit quaternions."""
    v = np.broadcast_to(q[..., :3], x.shape)
    once = np.cross(v, x)
    return x + 2 * (q[..., 3:] * once + np.cross(v, once))


def bodies(
    kind, rng, n, omega, velocity, *, points=None, position=0.0, orientation=None, by_twist=True, **names
) -> Pairs:
    """Pairs of two bodies that turn by `omega` [n, 2, 3] and whose origins or pivots move by `velocity`."""
    points = [rng.standard_normal((n, count, 3)) for count in COUNTS[kind]] if points is None else points
    orientation = unit(rng.standard_normal((n, 2, 4))) if orientation is None else orientation
    position = np.broadcast_to(position, (n, 2, 3))
    poses = np.concatenate([position, orientation], axis=2)
    if by_twist:
        return Pairs(kind, tuple(points), poses, twist=np.concatenate([velocity, omega], axis=2), **names)
    ends = np.concatenate([position + velocity, unit(product_of(quaternion(omega), orientation))], axis=2)
    return Pairs(kind, tuple(points), poses, ends, **names)


def random_pairs(
    kind, rng, n, *, path="linear", other="turning", by_twist=False, distance=None, in_plane=False
) -> Pairs:
    """Pairs of which a good half touches, with turns from 1e-3 to π, by a twist to 2π.

    Args:
        other: "turning", "at rest" or "deformable", the second body.
        distance: That counts as contact; 0 by default, and 0.1 for kinds that would never meet.
        in_plane: Whether all is in the plane z = 0, and turns about z.
    """
    kept = np.array([1.0, 1.0, 0.0 if in_plane else 1.0])
    distance = (0.1 if kind.startswith("point") else 0.0) if distance is None else distance
    points = [kept * rng.standard_normal((n, m, 3)) * 10 ** rng.uniform(-1.0, 0.5, (n, 1, 1)) for m in COUNTS[kind]]
    largest = 2 * np.pi if by_twist else np.pi - 1e-3
    turn = np.where(rng.random((n, 2)) < 0.5, rng.uniform(1e-3, largest, (n, 2)), 10 ** rng.uniform(-3, 0, (n, 2)))
    axes = directions(rng, n, 2)
    omega = (np.sign(axes[..., 2:]) * _Z if in_plane else axes) * turn[:, :, None]
    velocity = directions(rng, n, 2) * 10 ** rng.uniform(-2, 0.5, (n, 2, 1)) * kept
    orientation = unit(rng.standard_normal((n, 2, 4)) * [kept[2], kept[2], 1.0, 1.0])
    pivot = np.zeros((n, 2, 3)) if path == "screw" else rng.standard_normal((n, 2, 3)) * rng.integers(0, 2, (n, 1, 1))
    if other == "at rest":
        omega[:, 1], velocity[:, 1] = 0.0, 0.0
    names = {"orientation": orientation, "by_twist": by_twist, "path": path, "pivot": pivot * kept}
    pairs = bodies(kind, rng, n, omega, velocity, points=points, distance=distance, **names)
    if other == "at rest" and not by_twist:
        pairs.ends[:, 1] = pairs.poses[:, 1]
    if other == "deformable":
        moves = rng.standard_normal((n, 1, 3)) + 0.3 * rng.standard_normal(points[1].shape)
        pairs = replace(pairs, cloth=points[1] + moves * kept)
    away = np.where(rng.random((n, 1)) < 0.6, 0.0, rng.uniform(0.1, 3.0, (n, 1))) + distance * rng.uniform(
        0, 1.3, (n, 1)
    )
    at = [weights(kind, side, rng, n) for side in (0, 1)]
    return pairs.meeting(rng.uniform(0.0, 1.0, n), at, directions(rng, n) * away * kept)


def prisms(pairs: Pairs) -> Pairs:
    """Pairs of points and segments in the plane z = 0, the points as edges across it: they meet at the same times."""
    return replace(pairs, kind="edge-edge", points=(pairs.points[0] + np.array([-_Z, _Z]), pairs.points[1]))


# --- hostile families: functions of the kind, random numbers, how many, and the distance ---


def _sometimes_zero(rng, n, least, most, share=0.3):
    return np.where(rng.random(n) < share, 0.0, 10 ** rng.uniform(least, most, n))


def _contact_at(time):
    def family(kind, rng, n, distance):
        pairs = random_pairs(kind, rng, n, distance=distance)
        return pairs.near(rng, np.full(n, time), _sometimes_zero(rng, n, -16, -6))

    return family


def _whole_numbers_at_the_start(kind, rng, n, distance):
    """The origin is in the inside of both, exactly: a cross of two edges, a point in a face."""
    whole = [rng.integers(-8, 9, (n, 2, 3)).astype(float) for _ in range(2)]
    sides = {
        1: lambda x: 0 * x[:, :1],
        2: lambda x: np.stack([-x[:, 0], 2 * x[:, 0]], axis=1),
        3: lambda x: np.stack([x[:, 0], x[:, 1], -x.sum(axis=1)], axis=1),
    }
    points = [sides[count](x) for count, x in zip(COUNTS[kind], whole, strict=True)]
    omega = directions(rng, n, 2) * rng.uniform(0.01, 3.0, (n, 2, 1))
    orientation = np.tile(AT_REST[3:], (n, 2, 1))
    names = {"points": points, "orientation": orientation, "by_twist": False, "distance": distance}
    return bodies(kind, rng, n, omega, 0.1 * directions(rng, n, 2), **names)


def _turns(low, high, share, *, is_logarithmic=False, path="linear", with_cloth=False):
    """Turns from `low` to `high` by twists, of the second body in a share of the pairs alone."""

    def family(kind, rng, n, distance):
        turn = rng.uniform(low, high, (n, 2, 1))
        turn = (10**turn if is_logarithmic else turn) * (rng.random((n, 2, 1)) < [[1.0], [share]])
        velocity = directions(rng, n, 2) * 10 ** rng.uniform(-2, 0.5, (n, 2, 1))
        pairs = bodies(kind, rng, n, directions(rng, n, 2) * turn, velocity, path=path, distance=distance)
        if path == "screw":  # between two poses, about far axes
            poses, ends = pairs.poses.copy(), pairs.poses.copy()
            poses[..., 3:], ends[..., 3:6], ends[..., 6] = AT_REST[3:], 0.5 * pairs.twist[..., 3:], 1.0
            ends[..., :3] += velocity
            pairs = replace(pairs, poses=poses, ends=ends, twist=None)
        if with_cloth:
            moves = rng.standard_normal((n, 1, 3)) + 0.3 * rng.standard_normal(pairs.points[1].shape)
            pairs = replace(pairs, cloth=pairs.points[1] + moves)
        return pairs.near(rng, rng.random(n), np.where(rng.random(n) < 0.7, 0.0, rng.uniform(0.5, 4.0, n)))

    return family


def _needles(kind, rng, n, distance):
    """Edges and faces whose sides differ by a factor of up to 1e6."""
    pairs, sides = random_pairs(kind, rng, n, distance=distance), []
    for points in pairs.points:
        long = directions(rng, n, 1)
        sides.append(10 ** rng.uniform(-6, -3, (n, 1, 1)) * points + long * (long * points).sum(axis=2, keepdims=True))
    return replace(pairs, points=tuple(sides)).near(rng, rng.random(n), _sometimes_zero(rng, n, -6, 0, 0.6))


def _far(far):
    def family(kind, rng, n, distance):
        pairs = random_pairs(kind, rng, n, distance=distance, path=str(rng.choice(["linear", "screw"])))
        shift = np.concatenate([directions(rng, n, 1) * far, np.zeros((n, 1, 4))], axis=2)
        return replace(pairs, poses=pairs.poses + shift, ends=pairs.ends + shift)

    return family


def _far_from_their_own_origin(kind, rng, n, distance):
    """Points at 1e6 from the origin of their body, which turns about a pivot among them."""
    pairs, shift = random_pairs(kind, rng, n, distance=distance), directions(rng, n, 2) * 1e6
    poses, ends = pairs.poses.copy(), pairs.ends.copy()
    for pose in (poses, ends):
        pose[..., :3] -= turned(pose[..., 3:], shift)
    points = tuple(x + shift[:, side, None] for side, x in enumerate(pairs.points))
    return replace(pairs, points=points, poses=poses, ends=ends, pivot=pairs.pivot + shift)


def _staged(kind, rng, points, centre, omega, velocity, distance, in_space=True) -> Pairs:
    """Points at t = 0 of bodies that turn about centres, the scene turned in space and each in a frame of its own."""
    n = len(centre)
    frame, orientation = unit(rng.standard_normal((n, 1, 4))), unit(rng.standard_normal((n, 2, 4)))
    if not in_space:
        frame[:], orientation[:] = AT_REST[3:], AT_REST[3:]
    centre, omega, velocity = (turned(frame, x) for x in (centre, omega, velocity))
    inverse = orientation * [-1, -1, -1, 1]
    local = [turned(inverse[:, s, None], turned(frame, points[s]) - centre[:, s, None]) for s in (0, 1)]
    names = {"points": local, "position": centre, "orientation": orientation, "distance": distance}
    return bodies(kind, rng, n, omega, velocity, **names)


def _around(kind, side, rng, place, size=1.0):
    """Points in the plane z = 0 about places in their inside, shape [n, points, 3]."""
    n, count = len(place), COUNTS[kind][side]
    angle = rng.uniform(0, 2 * np.pi, (n, 1)) + 2 * np.pi * np.arange(count) / count
    flat = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=2) * size * (count > 1)
    return place[:, None] + flat * rng.uniform(0.3, 1.0, (n, 1, 1))


def _over_a_plane(slip):
    """The lowest point of a wheel, or an edge along its axis, grazes what lies in a plane, or misses it; 0 rolls."""

    def family(kind, rng, n, distance):
        radius, zero = rng.uniform(0.3, 2.0, n), np.zeros(n)
        margin = _sometimes_zero(rng, n, -12, -3, 0.1) * rng.choice([-1.0, 1.0], n)
        b = _around(kind, 1, rng, np.stack([zero, zero, margin - distance], axis=1))
        a = np.zeros((n, COUNTS[kind][0], 3))
        if kind == "edge-edge":  # one along the axis, and the other one across
            a[:, :, 0] = rng.uniform(0.1, 1.0, (n, 2)) * [-1, 1]
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
        return _staged(kind, rng, (a - back[:, None], b), centre, omega, velocity, distance)

    return family


def _axis_through_the_contact(kind, rng, n, distance):
    """Both bodies turn about the places that meet."""
    points = [rng.standard_normal((n, count, 3)) for count in COUNTS[kind]]
    at = [weights(kind, side, rng, n) for side in (0, 1)]
    points = [x - (w[:, :, None] * x).sum(axis=1, keepdims=True) for w, x in zip(at, points, strict=True)]
    omega = directions(rng, n, 2) * rng.uniform(0.1, 2 * np.pi, (n, 2, 1)) * (rng.random((n, 2, 1)) < 0.8)
    velocity = directions(rng, n, 2) * 10 ** rng.uniform(-6, 0, (n, 2, 1))
    pairs = bodies(kind, rng, n, omega, velocity, points=points, distance=distance)
    gap = _sometimes_zero(rng, n, -9, -1, 0.6) + distance
    return pairs.meeting(rng.random(n), at, directions(rng, n) * gap[:, None])


def _in_one_plane(in_space):
    """All stays in the plane z = 0, exactly; or in an oblique one, up to rounding."""

    def family(kind, rng, n, distance):
        flat = np.array([1.0, 1, 0])
        points = [rng.standard_normal((n, count, 3)) * flat for count in COUNTS[kind]]
        apart = rng.uniform(-3, 3, (n, 3)) * flat
        points[1] += apart[:, None]
        centre = rng.standard_normal((n, 2, 3)) * flat + np.stack([0 * apart, apart], axis=1)
        velocity = np.stack([apart, -apart], axis=1) * rng.uniform(0, 1, (n, 2, 1))
        omega = rng.uniform(-3, 3, (n, 2, 1)) * _Z
        pairs = _staged(kind, rng, points, centre, omega, velocity, distance, in_space)
        if not in_space:  # the shift has no part along z, not even by rounding
            at, gap = [weights(kind, side, rng, n) for side in (0, 1)], rng.standard_normal((n, 3)) * flat
            pairs = pairs.meeting(rng.random(n), at, gap * rng.integers(0, 2, (n, 1)))
        return pairs

    return family


def _common_spin(kind, rng, n, distance):
    """Two bodies turn about one axis as if they were one, and approach by a multiple of their gap of 1e-9 to 1e-1."""
    gap = 10 ** rng.uniform(-9, -1, n)
    above = (gap + distance)[:, None] * _Z
    b, a = _around(kind, 1, rng, np.zeros((n, 3))), _around(kind, 0, rng, above)
    if kind == "edge-edge":
        parallel = rng.random(n) < 0.3
        a[parallel] = (b + above[:, None])[parallel]
    omega = np.repeat(directions(rng, n, 1) * rng.uniform(0.1, 2 * np.pi, (n, 1, 1)), 2, axis=1)
    along = rng.random((n, 1)) < 0.4  # about the normal, along which one sinks
    omega = np.where(along[:, :, None], np.linalg.norm(omega, axis=2, keepdims=True) * _Z, omega)
    centre, velocity = np.repeat(rng.standard_normal((n, 1, 3)), 2, axis=1), np.zeros((n, 2, 3))
    speed = (gap * rng.choice([0.0, 0.5, 2.0, 10.0], n))[:, None]
    velocity[:, 0] = -speed * np.where(along, _Z, directions(rng, n))
    omega[:, 0] *= 1 + (gap * (rng.random(n) < 0.3))[:, None]
    return _staged(kind, rng, (a, b), centre, omega, velocity, distance)


def _counter_spins(kind, rng, n, distance):
    """Two bodies turn against each other about parallel axes, or the same one."""
    points = [rng.standard_normal((n, count, 3)) for count in COUNTS[kind]]
    omega = directions(rng, n, 1) * rng.uniform(0.1, 4 * np.pi, (n, 1, 1)) * [[[1.0], [-1]]]
    centre = np.repeat(rng.standard_normal((n, 1, 3)), 2, axis=1)
    centre[:, 1] += rng.standard_normal((n, 3)) * (rng.random((n, 1)) < 0.5)
    velocity = directions(rng, n, 2) * 10 ** rng.uniform(-6, 0, (n, 2, 1))
    pairs = _staged(kind, rng, points, centre, omega, velocity, distance)
    return pairs.near(rng, rng.random(n), _sometimes_zero(rng, n, -9, 0.5, 0.6))


FAMILIES = {
    "grazing arcs": _over_a_plane(1.0),
    "rolling": _over_a_plane(0.0),
    "contact at the end": _contact_at(1.0),
    "contact at the start": _contact_at(0.0),
    "whole numbers at the start": _whole_numbers_at_the_start,
    "many turns": _turns(2 * np.pi, 20 * np.pi, 0.6),
    "fifty turns": _turns(100 * np.pi, 100 * np.pi, 0.5),
    "tiny turns": _turns(-300, -8, 0.7, is_logarithmic=True),
    "tiny screws": _turns(-300, -8, 0.7, is_logarithmic=True, path="screw"),
    "many turns in a cloth": _turns(2 * np.pi, 20 * np.pi, 0.6, with_cloth=True),
    "axis through the contact": _axis_through_the_contact,
    "needles": _needles,
    "in one plane": _in_one_plane(False),
    "nearly in one plane": _in_one_plane(True),
    "far": _far(1e6),
    "very far": _far(1e8),
    "far from their own origin": _far_from_their_own_origin,
    "common spin": _common_spin,
    "counter spins": _counter_spins,
}


def hostile_pairs(name: str, kind: str, n: int, distance: float | None = None) -> Pairs:
    """A family by its name."""
    if distance is None:  # points and segments meet in space only if a distance counts as contact
        distance = 0.1 if kind == "point-point" or (kind == "point-segment" and name != "in one plane") else 0.0
    rng = np.random.default_rng([list(FAMILIES).index(name), KINDS.index(kind)])
    return FAMILIES[name](kind, rng, n, distance)
