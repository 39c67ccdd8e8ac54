"""Trajectories and distances in extended precision, many at once: places for the sets, and a second opinion of them.

What is seen is no proof. It shares nothing with the oracle but the definition of a trajectory; a contact that is seen
before the oracle allows one, or a gap where the oracle claims a contact, is a fault of one of them.
"""

from __future__ import annotations

import numpy as np

Long = np.longdouble


def turned(q: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Vectors turned by quaternions (x, y, z, w)."""
    v = np.broadcast_to(q[..., :3], x.shape)
    once = np.cross(v, x)
    return x + 2 * (q[..., 3:] * once + np.cross(v, once)) / (q * q).sum(axis=-1, keepdims=True)


def _rotation_vector(q0: np.ndarray, q1: np.ndarray) -> np.ndarray:
    """The shortest one between two orientations."""
    conjugate = q0 * np.array([-1, -1, -1, 1])
    v = q1[..., 3:] * conjugate[..., :3] + conjugate[..., 3:] * q1[..., :3] + np.cross(q1[..., :3], conjugate[..., :3])
    w = q1[..., 3] * conjugate[..., 3] - (q1[..., :3] * conjugate[..., :3]).sum(axis=-1)
    v, w = np.where(w[..., None] < 0, -v, v), np.abs(w)
    sine = np.linalg.norm(v, axis=-1)
    with np.errstate(all="ignore"):
        return np.where(sine[..., None] > 0, v * (2 * np.arctan2(sine, w) / sine)[..., None], 0)


def _sigmas(theta: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """sin(θt)/θ and (1 − cos θt)/θ²."""
    angle = theta * t
    small = np.abs(angle) < 1e-4
    safe, angle2 = np.where(theta > 0, theta, 1), angle * angle
    first = np.where(small, t * (1 - angle2 / 6 * (1 - angle2 / 20)), np.sin(angle) / safe)
    half = np.where(small, t / 2 * (1 - angle2 / 24 * (1 - angle2 / 80)), np.sin(angle / 2) / safe)
    return first, 2 * half * half


def positions(pairs, side: int, t: np.ndarray) -> np.ndarray:
    """The points of a side at times of each pair, shape [n, times] to [n, times, points, 3]."""
    local = (pairs.points_a, pairs.points_b)[side].astype(Long)[:, None]
    t = t.astype(Long)[:, :, None, None]
    if side == 1 and pairs.points_b_t1 is not None:
        return local + t * (pairs.points_b_t1.astype(Long)[:, None] - local)
    start = pairs.poses_t0[:, side].astype(Long)
    pivot, q0 = pairs.pivot[:, side].astype(Long), start[:, 3:]
    origin = start[:, :3] + turned(q0, pivot)
    if pairs.twist is not None:
        moved, omega = (pairs.twist[:, side, part].astype(Long) for part in (slice(3), slice(3, 6)))
    else:
        end = pairs.poses_t1[:, side].astype(Long)
        moved, omega = end[:, :3] + turned(end[:, 3:], pivot) - origin, _rotation_vector(q0, end[:, 3:])
    theta = np.linalg.norm(omega, axis=1)[:, None]
    velocity, turning = moved, np.zeros_like(moved)
    if pairs.path == "screw":
        axis = omega / np.where(theta > 0, theta, 1)
        along = axis * (axis * moved).sum(axis=1, keepdims=True)
        velocity, turning = np.where(theta > 0, along, moved), np.where(theta > 0, moved - along, 0)
        if pairs.twist is None:
            s1, s2 = _sigmas(theta, np.ones_like(theta))
            turning = (s1 * turning - s2 * np.cross(omega, turning)) / (s1 * s1 + theta * theta * s2 * s2)
    arm = turned(q0[:, None], local[:, 0] - pivot[:, None])
    q = np.cross(omega[:, None], arm) + turning[:, None]
    bent = np.cross(omega[:, None], q)
    s1, s2 = _sigmas(theta[:, :, None, None], t)
    return (origin[:, None] + arm)[:, None] + t * velocity[:, None, None] + s1 * q[:, None] + s2 * bent[:, None]


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return (a * b).sum(axis=-1)


def _to_segment(p: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    e = b - a
    with np.errstate(all="ignore"):
        u = np.nan_to_num(np.clip(_dot(p - a, e) / _dot(e, e), 0, 1))
    return np.linalg.norm(p - a - u[..., None] * e, axis=-1)


def _over_interior(w: np.ndarray, n: np.ndarray, inside: list[np.ndarray]) -> np.ndarray:
    squared = _dot(n, n)
    is_inside = np.all([value >= 0 for value in inside], axis=0) & (squared > 0)
    with np.errstate(all="ignore"):
        return np.where(is_inside, np.abs(_dot(w, n)) / np.sqrt(squared), np.inf)


def distances(kind: str, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Distances of primitives with points of shape [..., points, 3]."""
    a, b = np.moveaxis(a, -2, 0), np.moveaxis(b, -2, 0)
    if kind == "point-point":
        return np.linalg.norm(a[0] - b[0], axis=-1)
    if kind == "point-segment":
        return _to_segment(a[0], b[0], b[1])
    if kind == "vertex-face":
        w, e1, e2 = a[0] - b[0], b[1] - b[0], b[2] - b[0]
        n = np.cross(e1, e2)
        u, v = _dot(np.cross(w, e2), n), _dot(np.cross(e1, w), n)
        edges = [_to_segment(a[0], b[i], b[j]) for i, j in ((0, 1), (1, 2), (2, 0))]
        return np.min([*edges, _over_interior(w, n, [u, v, _dot(n, n) - u - v])], axis=0)
    w, e1, e2 = b[0] - a[0], a[1] - a[0], b[1] - b[0]
    n = np.cross(e1, e2)
    u, v = _dot(np.cross(w, e2), n), _dot(np.cross(w, e1), n)
    ends = [_to_segment(p, b[0], b[1]) for p in a] + [_to_segment(q, a[0], a[1]) for q in b]
    return np.min([*ends, _over_interior(w, n, [u, v, _dot(n, n) - u, _dot(n, n) - v])], axis=0)


def gaps(pairs, t: np.ndarray) -> np.ndarray:
    """Distances less that which counts as contact, at times of each pair, shape [n, times]."""
    return distances(pairs.kind, positions(pairs, 0, t), positions(pairs, 1, t)) - pairs.distance


def _minima(pairs, before: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Local minima of the gap in [0, before] next to samples that may be near one: pairs, times and gaps."""
    t = np.linspace(0, 1, count + 1, dtype=Long)[None] * before.astype(Long)[:, None]
    values = gaps(pairs, t)
    padded = np.pad(values, ((0, 0), (1, 1)), constant_values=np.inf)
    rows, k = np.nonzero((values <= padded[:, :-2]) & (values <= padded[:, 2:]))
    low, high = t[rows, np.maximum(k - 1, 0)], t[rows, np.minimum(k + 1, count)]
    few, when, least = pairs[rows], t[rows, k], values[rows, k]
    for _ in range(32):
        near = low[:, None] + (high - low)[:, None] * np.linspace(0, 1, 7, dtype=Long)
        found = gaps(few, near)
        at, each = found.argmin(axis=1), np.arange(len(rows))
        when = np.where(found[each, at] < least, near[each, at], when)
        least = np.minimum(found[each, at], least)
        low, high = near[each, np.maximum(at - 1, 0)], near[each, np.minimum(at + 1, 6)]
    return rows, when, least


def least_gap(pairs, before: np.ndarray | None = None, count: int = 400) -> np.ndarray:
    """The least gap that is seen in [0, before], by samples and searches between them, shape [n]."""
    rows, _, values = _minima(pairs, np.ones(len(pairs)) if before is None else before, count)
    least = np.full(len(pairs), np.inf, dtype=Long)
    np.minimum.at(least, rows, values)
    return least


def first_contact_seen(pairs, count: int = 400, touching: float = 1e-14) -> np.ndarray:
    """When a gap of at most `touching` is first seen; inf where none is, shape [n]."""
    rows, times, values = _minima(pairs, np.ones(len(pairs)), count)
    seen = np.full(len(pairs), np.inf, dtype=Long)
    np.minimum.at(seen, rows[values <= touching], times[values <= touching])
    t = np.linspace(0, 1, count + 1, dtype=Long)
    inside = gaps(pairs, np.broadcast_to(t, (len(pairs), count + 1))) <= touching
    seen = np.minimum(seen, np.where(inside.any(axis=1), t[inside.argmax(axis=1)], np.inf))
    hit = np.flatnonzero(np.isfinite(seen) & (seen > 0))
    few, high = pairs[hit], seen[hit]
    low = t[np.searchsorted(t, high) - 1]
    for _ in range(60):
        middle = (low + high) / 2
        is_free = gaps(few, middle[:, None])[:, 0] > touching
        low, high = np.where(is_free, middle, low), np.where(is_free, high, middle)
    seen[hit] = high
    return seen
