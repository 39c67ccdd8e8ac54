"""Pairs of primitives on links of an arm with seven joints: sets of them, and when they first touch."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from chain_paths import ChainJoint, chain
from laws.trajectories import Trajectory, straight
from laws.turning import COUNTS, directions, turned, unit, weights

Long = np.longdouble
NUM_JOINTS = 7


@dataclass(frozen=True)
class ChainPairs:
    """Pairs of one kind on two links of one arm, which moves otherwise in each pair; or on a link and at rest.

    Attributes:
        kind: One of `KINDS` of pairs that turn; the vertex is on side A.
        points_a, points_b: In the frames of the links, float64, shape [n, points, 3].
        joints: Kinds of the joints from the root on, "revolute" or "prismatic".
        origins: Of the joints in the frames of their parents, position and quaternion (x, y, z, w), shape [J, 7].
        axes: Shape [J, 3].
        q0, q1: Coordinates at both ends, between which they go straight, shape [n, J].
        link_a, link_b: How many joints are between the root and the link; 0 is the root, which rests.
        distance: Euclidean distance that counts as contact; 0 for touching.
    """

    kind: str
    points_a: np.ndarray
    points_b: np.ndarray
    joints: tuple[str, ...]
    origins: np.ndarray
    axes: np.ndarray
    q0: np.ndarray
    q1: np.ndarray
    link_a: int
    link_b: int
    distance: float = 0.0

    def __len__(self) -> int:
        return len(self.points_a)


def trajectories_of(pairs: ChainPairs, k: int) -> list[Trajectory]:
    """Those of a pair."""
    ends = np.stack([pairs.q0[k], pairs.q1[k]], axis=1)
    joints = [ChainJoint(*rest, ends=q) for *rest, q in zip(pairs.joints, pairs.origins, pairs.axes, ends, strict=True)]
    rows = ((pairs.points_a[k], pairs.link_a), (pairs.points_b[k], pairs.link_b))
    return [chain(local, joints[:link]) if link else straight(local, local) for local, link in rows]


def positions(pairs: ChainPairs, side: int, t: np.ndarray) -> np.ndarray:
    """Points of a side at times of each pair, in extended precision, shape [n, times] to [n, times, points, 3]."""
    x = (pairs.points_a, pairs.points_b)[side].astype(Long)[:, None]
    x = np.broadcast_to(x, (len(x), t.shape[1], *x.shape[2:]))
    q = pairs.q0[:, None] + t.astype(Long)[:, :, None] * (pairs.q1.astype(Long) - pairs.q0)[:, None]
    for k in reversed(range((pairs.link_a, pairs.link_b)[side])):
        axis, angle = unit(pairs.axes[k].astype(Long)), q[:, :, k, None, None]
        if pairs.joints[k] == "prismatic":
            x = x + axis * angle
        else:
            along = axis * (x * axis).sum(axis=-1, keepdims=True)
            x = along + (x - along) * np.cos(angle) + np.cross(axis, x) * np.sin(angle)
        x = pairs.origins[k, :3] + turned(unit(pairs.origins[k, 3:].astype(Long)), x)
    return x


def random_chain_pairs(
    kind: str,
    seed: int,
    n: int,
    *,
    turn: float = 0.5,
    other: int = 0,
    slides: bool = False,
    distance: float = 0.0,
    relative: float = 1.0,
    far: float = 0.0,
    time: float | None = None,
) -> ChainPairs:
    """Pairs of the last link of an arm with another one, of which a good half touches.

    Args:
        kind: One of `KINDS` of pairs that turn.
        turn: By how much each joint turns at most, in radians.
        other: The other link, by the number of joints before it.
        slides: Whether the fourth joint slides.
        distance: That counts as contact.
        relative: How much of `turn` the joints between both links turn by.
        far: How far from the origin the arm stands.
        time: When the links are near each other; by default at any time.
    """
    rng = np.random.default_rng([seed, list(COUNTS).index(kind)])
    joints = ["revolute"] * NUM_JOINTS
    if slides:
        joints[3] = "prismatic"
    place = directions(rng, NUM_JOINTS) * rng.uniform(0.05, 0.4, (NUM_JOINTS, 1))
    origins = np.concatenate([place, rng.standard_normal((NUM_JOINTS, 4))], axis=1)
    origins[rng.random(NUM_JOINTS) < 0.5, 3:] = [0, 0, 0, 1]
    origins[0, :3] += far * directions(rng)
    axes = np.where(
        rng.random((NUM_JOINTS, 1)) < 0.5, np.eye(3)[rng.integers(0, 3, NUM_JOINTS)], directions(rng, NUM_JOINTS)
    )
    q0 = rng.uniform(-np.pi, np.pi, (n, NUM_JOINTS))
    q1 = q0 + rng.uniform(-turn, turn, (n, NUM_JOINTS)) * np.where(np.arange(NUM_JOINTS) < other, 1.0, relative)
    sides = [rng.standard_normal((n, count, 3)) * 10 ** rng.uniform(-1.3, -0.3, (n, 1, 1)) for count in COUNTS[kind]]
    pairs = ChainPairs(kind, *sides, tuple(joints), origins, axes, q0, q1, NUM_JOINTS, other, distance)
    # at some time, a place on B is near one on A: B is moved in its own frame, whose directions at that time are those
    # in which it sees three points at distance one
    near = rng.random((n, 1)) if time is None else np.full((n, 1), time)
    away = np.where(rng.random((n, 1)) < 0.6, 0.0, rng.uniform(0.05, 0.5, (n, 1)) * relative) + distance * rng.uniform(
        0, 1.3, (n, 1)
    )
    at_a, at_b = (weights(kind, side, rng, n) for side in (0, 1))
    frame = positions(replace(pairs, points_b=np.broadcast_to([[0, 0, 0], *np.eye(3)], (n, 4, 3))), 1, near)[:, 0]
    seen = (at_a[:, :, None] * positions(pairs, 0, near)[:, 0]).sum(axis=1) + directions(rng, n) * away - frame[:, 0]
    local = np.einsum("nij,nj->ni", frame[:, 1:] - frame[:, :1], seen)
    shift = local - (at_b[:, :, None] * pairs.points_b).sum(axis=1)
    return replace(pairs, points_b=(pairs.points_b + shift[:, None]).astype(np.float64))


def chain_sets(each: int) -> dict[str, ChainPairs]:
    """Twelve sets; of 25 pairs each, they are 300."""
    sets = {}
    for kind, turn, other in product(("vertex-face", "edge-edge"), (0.1, 0.5, 2.0), (0, 2)):
        name = f"{kind}, {turn} rad, {'at rest' if other == 0 else 'two links'}"
        sets[name] = random_chain_pairs(
            kind, len(sets), each, turn=turn, other=other, slides=turn == 0.5, distance=0.01 if turn == 2.0 else 0.0
        )
    return sets
