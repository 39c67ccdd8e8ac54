"""What `unique()` keeps of contacts, from its definition: every two contacts compared, every vertex with every plane.

Two contacts are one touch where their closest points span the same vertices. Which vertices these are, and on which
side of a plane a vertex is, is known to a length that rounding, or the tolerance, hides. A touch of which any of this
would be another with a quarter or four times of that length is not judged.
"""

from dataclasses import dataclass

import numpy as np

import ccd_warp as ccd

PLANE = int(ccd.PairKind.VERTEX_PLANE)
_FACTORS = (0.25, 1.0, 4.0)


@dataclass(eq=False)
class Touch:
    """A contact: vertices and features of both sides, by what may be hidden, and how it moves."""

    row: int
    kind: int
    toi: float
    slack: float
    normal: np.ndarray
    approach: float
    speed: float
    noise: float  # of both, by rounding
    sides: tuple[list[int], list[int]]
    points: np.ndarray
    reach: float
    features: list[tuple[frozenset, frozenset]]

    @property
    def apart(self) -> float:
        return float(np.linalg.norm(self.points[0] - self.points[1]))

    @property
    def is_apart(self) -> bool:
        return self.apart > 16 * self.reach


def touches_of(contacts, start, end, tolerance: float) -> list[Touch]:
    """The contacts of primitives with each other."""
    found = []
    for row in np.flatnonzero(contacts.kind != PLANE).tolist():
        kind, toi, vertices = int(contacts.kind[row]), float(contacts.toi[row]), contacts.vertices[row]
        cut, weight = 1 if kind == ccd.PairKind.VERTEX_FACE else 2, np.abs(contacts.weights[row])
        x = (1 - toi) * start[vertices] + toi * end[vertices]
        sides = slice(0, cut), slice(cut, 4)
        points = np.array([weight[side] @ x[side] for side in sides])
        moves = end[vertices] - start[vertices]
        velocity = contacts.weights[row] @ moves
        is_limit = contacts.status[row] >= ccd.CCDStatus.ITERATION_LIMIT
        gap, speed = 0.0 if is_limit else max(float(contacts.gap[row]), 0.0), float(np.linalg.norm(velocity))
        reach = max(2 * gap, 2.0**-48 * np.abs(x).max())
        reach += np.sqrt(2 * np.linalg.norm(points[0] - points[1]) * reach)
        hidden = max(reach, min(tolerance, 2.0**-10 * np.linalg.norm(np.ptp(x, axis=0))))
        features = []
        for factor in _FACTORS:
            of_sides = []
            for side, point in zip(sides, points, strict=True):
                shift = weight[side] * np.linalg.norm(x[side] - point, axis=1)
                spans = (shift > factor * hidden) | (weight[side] == weight[side].max())
                of_sides.append(frozenset(vertices[side][spans & (weight[side] > 0)].tolist()))
            features.append(tuple(of_sides))
        corners = tuple([*dict.fromkeys(vertices[side].tolist())] for side in sides)
        slack = min(2 * gap / speed if speed > 0 else 0.0, 2.0**-11)
        approach = -float(contacts.normal[row] @ velocity)
        of_motion = approach, speed, 2.0**-48 * float(np.abs(moves).max())
        found.append(Touch(row, kind, toi, slack, contacts.normal[row], *of_motion, corners, points, reach, features))
    return found


def groups_of(touches: list[Touch], copies, worlds) -> list[list[Touch]]:
    """Those with the same features, where these are clear of all; one with the inside of a face alone has no other."""
    by_features, unclear = {}, set()
    for touch in touches:
        keys = {(int(worlds[touch.row]), frozenset(sides)) for sides in touch.features}
        unclear |= keys if len(keys) > 1 else set()
        for key in keys:
            by_features.setdefault(key, []).append(touch)
    found = [group for key, group in by_features.items() if key not in unclear]
    return [g for g in found if max(map(len, g[0].features[1])) < 3 or max(g[0].features[1], key=len) in copies]


def is_wrong(touch: Touch, touches: list[Touch], group: list[Touch], start, end) -> bool | None:
    """Whether something around its features is beyond the plane of its normal; None where rounding hides it."""
    if len(group) == 1 and not touch.is_apart:
        return False
    t, around = touch.toi, {0: {}, 1: {}}
    a, b = touch.features[1]
    for other in touches if max(len(a), len(b)) < 3 else []:
        for first in (0, 1):
            if a <= {*other.sides[first]} and b <= {*other.sides[1 - first]}:
                for side, vertices in ((0, other.sides[first]), (1, other.sides[1 - first])):
                    for v in vertices:
                        around[side][v] = min(around[side].get(v, np.inf), other.toi - other.slack)
    slope = 1e-6 + (2 * touch.reach / max(touch.apart, 1e-300) if touch.is_apart else 0.0)
    worst = np.zeros((2, len(_FACTORS)))
    for side, vertices in around.items():
        for v, since in vertices.items():
            if since <= t + touch.slack:
                along = (1 - t) * start[v] + t * end[v] - touch.points[side]
                beyond = float(along @ touch.normal) * (1 if side else -1)
                allowed = (touch.reach + slope * np.linalg.norm(along)) * np.array(_FACTORS)
                worst = np.maximum(worst, [beyond - allowed, -beyond - allowed])
    violated = worst[0] > 0 if touch.is_apart else worst.min(axis=0) > 0
    return bool(violated[1]) if violated.all() == violated.any() else None


def kept_of(group: list[Touch], wrong: list[bool]) -> list[Touch]:
    """The one that is kept: right, then earliest, then what approaches most, then by kind and pair.

    None, or of several whose speeds are but rounding one.
    """
    told = [touch for touch, is_wrong in zip(group, wrong, strict=True) if not is_wrong] or group
    until = min(touch.toi + touch.slack for touch in told)
    first = [touch for touch in told if touch.toi - touch.slack <= until]
    most = max(touch.approach for touch in first)
    best = min((t for t in first if t.approach >= most - 1e-9 * t.speed), key=lambda touch: (touch.kind, touch.row))
    if all(wrong) and best.is_apart:
        return []
    rounded = [touch for touch in first if abs(touch.approach - most) <= touch.noise + 1e-9 * touch.speed]
    return rounded if max(touch.noise for touch in group) > 1e-9 * best.speed else [best]


def least_toi(kept: Touch, group: list[Touch]) -> float:
    """The least toi of a touch, to rounding."""
    return min(touch.toi for touch in group if touch.toi + touch.slack >= kept.toi - kept.slack)


def check_unique(mesh, contacts, start, end, tolerance: float) -> int:
    """Of every clear touch one contact is kept, with the least toi; returns how many touches have several contacts."""
    unique = contacts.unique()
    pairs = [(k, *p) for k, p in zip(contacts.kind.tolist(), contacts.primitives.tolist(), strict=True)]
    row_of, num_shared = {pair: row for row, pair in enumerate(pairs)}, 0
    rows = [row_of[k, *p] for k, p in zip(unique.kind.tolist(), unique.primitives.tolist(), strict=True)]
    toi_of = dict(zip(rows, unique.toi.tolist(), strict=True))
    assert rows == sorted(toi_of) and unique.toi.min(initial=np.inf) == contacts.toi.min(initial=np.inf)
    assert all(toi_of[row] == contacts.toi[row] for row in np.flatnonzero(contacts.kind == PLANE).tolist())
    corners = [frozenset(face) for face in mesh.faces.tolist()]
    copies = {face for face in corners if len(face) == 3 and corners.count(face) > 1} if len(contacts) else set()
    touches, earlier = touches_of(contacts, start, end, tolerance), []
    for group in groups_of(touches, copies, contacts.world):
        wrong = [is_wrong(touch, touches, group, start, end) for touch in group]
        if None not in wrong:
            kept, of_group = kept_of(group, wrong), [touch for touch in group if touch.row in toi_of]
            assert len(of_group) == min(len(kept), 1) and all(touch in kept for touch in of_group), pairs[group[0].row]
            earlier += [toi_of[touch.row] for touch in of_group if toi_of[touch.row] != least_toi(touch, group)]
            num_shared += len(group) > 1
    assert earlier in ([], [contacts.toi.min(initial=np.inf)])  # the first, where what is earliest is left out
    return num_shared


def check_first(result) -> None:
    """It is, of the touches that are first to rounding, the first of those that approach most."""
    contacts = result.contacts
    if not len(contacts):
        assert result.first is None
        return
    gap = np.where(contacts.status >= ccd.CCDStatus.ITERATION_LIMIT, 0.0, np.maximum(contacts.gap, 0.0))
    speed = np.linalg.norm(contacts.relative_velocity, axis=1)
    slack = np.minimum(np.divide(2 * gap, speed, out=np.zeros(len(gap)), where=speed > 0), 2.0**-11)
    earliest = int(np.argmin(contacts.toi))
    at_once = contacts[contacts.toi - slack <= contacts.toi[earliest] + slack[earliest]]
    kept = at_once.unique()
    first = (int(result.first.kind), *result.first.primitives)
    if len(kept):
        approach = -(kept.normal * kept.relative_velocity).sum(axis=1)
        most = approach >= approach.max() - 1e-9 * np.linalg.norm(kept.relative_velocity, axis=1)
        kept = kept[np.flatnonzero(most)]
    assert first in [(k, *p) for k, p in zip(kept.kind.tolist(), kept.primitives.tolist(), strict=True)] or not len(
        kept
    )
