"""What a pair costs on arcs, by how far its bodies turn, beside the same pair on chords.

Pairs of two bodies, a world each: a point and a face, or two edges, which turn about points of their own and move past
each other. Times are those of the narrow phase, on one thread, for pairs that are free on arcs and on chords, and for
such that touch on both. Beyond 1 rad a chord is no path of the pair any more, and the price on chords is that at 1 rad.
"""

from __future__ import annotations

import time
from typing import Any, Literal

import numpy as np
from ccd_warp.benchmarks.rigid_scenes import rotations
from ccd_warp.benchmarks.timing import interleaved, medians

import ccd_warp as ccd

TURNS = (1e-3, 0.1, 0.2, 0.5, 1.0, np.pi, 2 * np.pi, 20 * np.pi)
KINDS = ("vertex-face", "edge-edge")
_LAST_CHORD = 1.0
_STAGE = "narrow phase"
# The primitives in the frames of their bodies, half a unit from the pivot.
_FACE = np.array([[0.5, -0.5, -0.3], [0.5, 0.5, -0.3], [0.5, 0.0, 0.6]])
_EDGE = np.array([[0.5, -0.5, 0.0], [0.5, 0.5, 0.0]])
_POINT = np.array([[0.5, 0.0, 0.0]])


class Pairs:
    """Pairs of a kind and a turn: a mesh of worlds, and poses at the start with the twist of each body.

    Attributes:
        parts: Vertices of both bodies in their own frames.
        mesh: A world of both.
        poses: Poses at t = 0, shape [n, 2, 7].
        twist: Displacement of the pivot, and rotation vector, shape [n, 2, 6].
    """

    def __init__(self, kind: str, poses: np.ndarray, twist: np.ndarray, path: Literal["linear", "screw"] = "linear"):
        self.kind, self.poses, self.twist = kind, poses, twist
        empty = np.zeros((0, 3), dtype=int)
        line = np.array([[0, 1]])
        if kind == "vertex-face":
            self.parts = (_POINT, _FACE)
            parts: list[Any] = [(_POINT, empty), (_FACE, np.array([[0, 1, 2]]))]
        else:
            self.parts = (_EDGE, _EDGE)
            parts = [(_EDGE, empty, line), (_EDGE, empty, line)]
        self.mesh = ccd.CollisionMesh.from_arrays(parts, self_collision=False, rigid=[0, 1]).replicate(len(poses))
        self.straight = ccd.CollisionMesh.from_arrays(parts, self_collision=False).replicate(len(poses))
        self.motion = ccd.RigidMotion(poses, twist=twist, path=path)
        self.arcs = ccd.CollisionPipeline(self.mesh, num_threads=1)
        self.chords = ccd.CollisionPipeline(self.straight, num_threads=1)
        self._chords = self.positions_at(0.0), self.positions_at(1.0)

    @classmethod
    def random(cls, kind: str, turn: float, count: int) -> Pairs:
        """Pairs in any position; in half of them a point of each is at the same place at some time of the step."""
        rng = np.random.default_rng(7)
        poses, twist = np.empty((count, 2, 7)), np.empty((count, 2, 6))
        quaternions, axes = (_on_sphere(rng, count * 2, m).reshape(count, 2, m) for m in (4, 3))
        poses[..., 3:] = quaternions
        twist[..., 3:] = turn * axes
        twist[..., :3] = rng.uniform(-0.5, 0.5, (count, 2, 3))
        when = rng.uniform(0.1, 0.9, count)
        places = []
        for k, body in enumerate(_parts(kind)):
            weights = rng.dirichlet(np.ones(len(body)), count)
            arms = (rotations(twist[:, k, 3:] * when[:, None]) @ _matrices(quaternions[:, k])) @ (weights @ body)[
                ..., None
            ]
            places.append(arms[..., 0] + when[:, None] * twist[:, k, :3])
        apart = np.where(np.arange(count) % 2 == 0, 0.0, 1.0)[:, None] * rng.uniform(-0.2, 0.2, (count, 3))
        poses[:, 0, :3] = 0.0
        poses[:, 1, :3] = places[0] - places[1] + apart
        return cls(kind, poses, twist)

    def chosen(self, which: np.ndarray) -> Pairs:
        """Some of the pairs."""
        return Pairs(self.kind, self.poses[which], self.twist[which])

    def spinning(self, turn: float) -> Pairs:
        """These pairs as parts of one body that spins about an axis through the origin."""
        omega = turn * np.array([0.0, 0.0, 1.0])
        twist = np.zeros_like(self.twist)
        twist[..., :3], twist[..., 3:] = np.cross(omega, self.poses[..., :3]), omega
        return Pairs(self.kind, self.poses, twist, "screw")

    def positions_at(self, t: float) -> np.ndarray:
        """Positions at a time, shape [n, V, 3]."""
        parts = []
        for k, body in enumerate(self.parts):
            turned = rotations(t * self.twist[:, k, 3:]) @ _matrices(self.poses[:, k, 3:])
            place = self.poses[:, k, :3] + t * self.twist[:, k, :3]
            parts.append(body @ turned.transpose(0, 2, 1) + place[:, None])
        return np.concatenate(parts, axis=1)

    def on_arcs(self) -> ccd.MeshResult:
        """Ours, with the motion."""
        x = self.mesh.vertices
        return self.arcs.mesh_ccd(x, x, motion=self.motion)

    def on_chords(self) -> ccd.MeshResult:
        """Ours, from one end straight to the other."""
        return self.chords.mesh_ccd(*self._chords)


def _parts(kind: str) -> tuple[np.ndarray, np.ndarray]:
    return (_POINT, _FACE) if kind == "vertex-face" else (_EDGE, _EDGE)


def _on_sphere(rng: np.random.Generator, count: int, dimension: int) -> np.ndarray:
    x = rng.standard_normal((count, dimension))
    return x / np.linalg.norm(x, axis=1, keepdims=True)


def _matrices(quaternions: np.ndarray) -> np.ndarray:
    """Rotation matrices of unit quaternions x y z w."""
    vectors, w = quaternions[:, :3], quaternions[:, 3]
    angles = 2.0 * np.arctan2(np.linalg.norm(vectors, axis=1), w)
    return rotations(angles[:, None] * vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def measure(kind: str, count: int, rounds: int, turns: tuple[float, ...] = TURNS) -> dict:
    """One record: a row for each turn, with nanoseconds of a free pair and of one that touches, on arcs and chords."""
    rows = []
    for turn in turns:
        pairs = Pairs.random(kind, turn, max(count // 4, int(count / max(1.0, turn))))
        hit = pairs.on_arcs().world_toi < np.inf
        is_chord = turn <= _LAST_CHORD
        same = pairs.on_chords().world_toi < np.inf if is_chord else hit
        row: dict[str, Any] = {"turn": turn}
        for name, which in (("free", ~hit & ~same), ("hit", hit & same)):
            row[name] = _price(pairs.chosen(which), rounds, is_chord)
        rows.append(row)
    for row in rows:
        last = max((other for other in rows if other["turn"] <= _LAST_CHORD), key=lambda other: other["turn"])
        for name in ("free", "hit"):
            row[name]["ratio"] = row[name]["arcs"] / (row if "chords" in row[name] else last)[name]["chords"]
    return {"what": "turns", "kind": kind, "rows": rows, "spin": _common_spin(kind, count // 4, rounds)}


def _common_spin(kind: str, count: int, rounds: int) -> dict[str, float]:
    """Seconds a pair whose bodies spin together by 1 rad, and of the same pairs that stand still: all stages."""
    near = Pairs.random(kind, 1e-3, count)
    near = near.chosen(near.on_arcs().world_toi == np.inf)
    calls = {name: near.spinning(turn).on_arcs for name, turn in (("spinning", 1.0), ("still", 0.0))}
    answers: dict[str, ccd.MeshResult] = {}
    times = medians(interleaved(calls, rounds, clock=time.process_time, after=answers.__setitem__))
    found = {name: seconds / len(near.poses) for name, seconds in times.items()}
    for name, answer in answers.items():
        found[f"{name}, narrow phase"] = answer.timings.get(_STAGE, 0.0) / len(near.poses)
        found[f"{name}, solved"] = sum(answer.counts.num_after_cull.values()) / len(near.poses)
        found[f"{name}, hits"] = int((answer.world_toi < np.inf).sum())
    return found


def _price(pairs: Pairs, rounds: int, is_chord: bool) -> dict[str, Any]:
    """Seconds of the narrow phase a pair, in all slices, and how often a pair comes to it."""
    calls = {"arcs": pairs.on_arcs} | ({"chords": pairs.on_chords} if is_chord else {})
    stages: dict[str, list[float]] = {name: [] for name in calls}
    solved = {}

    def keep(name: str, result: ccd.MeshResult) -> None:
        stages[name].append(result.timings[_STAGE])
        solved[name] = sum(result.counts.num_after_cull.values())

    interleaved(calls, rounds, is_settled=True, after=keep)
    count = len(pairs.poses)
    price: dict[str, Any] = {name: seconds / count for name, seconds in medians(stages).items()}
    return price | {"pairs": count} | {f"solved {name}": value / count for name, value in solved.items()}
