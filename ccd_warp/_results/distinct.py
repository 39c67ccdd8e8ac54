"""Which contacts of a list say what no other says: one for each two features that touch.

The closest points of a contact lie on two features: a vertex, an edge or the inside of a face each. A vertex that lands
on the edge between two faces touches both of them there, and each of its own edges touches the common edge: one touch,
in several pairs. So contacts are grouped by their features, and one of each group is kept.

Faces with the same vertices are one feature; the inside of any other face is in one pair only.

**Where a closest point lies** is known to rounding. What the solver leaves open is the gap g of the contact; at a
distance d of the closest points another place is as near within g if it is up to √(2 d g) away. A vertex that moves a
closest point by no more than that, or by no more than the tolerance, is none of those that span its feature: a tip that
lands so near a diagonal touches the diagonal, and its own edges, which meet that next to it, touch nothing else.

**Which contact is kept.** Pairs of one group have normals of their own: two edges that meet at their ends have their
cross product, which may point anywhere. A normal is right where its plane separates what is around the two features,
which is tested against the vertices of all contacts around them. Of those that are right the earliest is kept, of those
at one toi the one that approaches most, and of equal ones a vertex and a face before two edges. Its toi becomes the
least of those that are the same to rounding, so that no touch is later than the list has it.

**What is at a distance** has the direction of the gap as its normal in all pairs of a group. If it separates nothing,
something beside the features is nearer, which touches in a pair of its own: the contact is that of a ball that has
already met the face beside an edge, and is left out. Where it is the earliest of all, by a rounding, the first contact
that is kept has its toi.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ccd_warp._results.pairs import feature_number, features_of, first_columns
from ccd_warp._runtime.status import CCDStatus, PairKind

# Roundings of the coordinates that count as no distance, and the sine of an angle that counts as none.
_ROUNDINGS, _ANGLE = 2.0**-48, 1e-6
# Of the size of a pair: how much of it the tolerance may hide.
_MOST_HIDDEN = 2.0**-10
# Of the step: how far apart two tois may be at most that rounding tells apart.
MOST_APART = 2.0**-10
# Of a relative speed: what counts as no difference between two. Groups that are looked at before all are.
_SAME_SPEED, _MOST_GROUPS = 1e-9, 8
_MOST_ROWS = 1 << 20  # of vertices around contacts that are looked at together
# Columns of the vertices of each two features that are vertices or edges: of a vertex and a face, and of two edges.
_OF_FACE = np.array([[(0, 0), b] for b in [(1, 1), (2, 2), (3, 3), (1, 2), (2, 3), (1, 3)]])
_OF_EDGES = np.array([[a, b] for a in [(0, 0), (1, 1), (0, 1)] for b in [(2, 2), (3, 3), (2, 3)]])
Contacts = Any  # of `ccd_warp._results.contacts`, whose place imports this module
Array = NDArray[np.float64]
Indices = NDArray[np.intp]
# Positions of vertices at a time of each, shape [n, 1]: `MovingVertices.at`.
At = Callable[[NDArray[np.integer[Any]], Array], Array]


def slack_of(contacts: Contacts) -> Array:
    """By how much rounding may shift the toi of each contact: what its gap takes at its relative velocity."""
    speed = np.linalg.norm(contacts.relative_velocity, axis=1)
    slack = np.divide(2.0 * _gap_of(contacts), speed, out=np.zeros(len(speed)), where=speed > 0.0)
    return np.minimum(slack, 0.5 * MOST_APART)


def _gap_of(contacts: Contacts) -> Array:
    """What rounding leaves open of each gap: none at a limit, where it is not rounding."""
    return np.where(contacts.status >= int(CCDStatus.ITERATION_LIMIT), 0.0, np.maximum(contacts.gap, 0.0))


@np.errstate(over="ignore", invalid="ignore")
def distinct(contacts: Contacts, position_at: At | None) -> tuple[Indices, Array]:
    """The rows of the contacts to keep, ascending, and the toi of each: the least that its touch has, to rounding."""
    kept, group = _kept(contacts, position_at)
    rows, least = np.flatnonzero(kept == np.arange(len(kept))), contacts.toi.copy()
    same, slack = np.flatnonzero((group >= 0) & (kept >= 0)), slack_of(contacts)
    of_same = kept[same]
    is_near = contacts.toi[same] + slack[same] >= contacts.toi[of_same] - slack[of_same]
    np.minimum.at(least, of_same[is_near], contacts.toi[same[is_near]])
    if len(rows):  # the earliest may be left out, where what is beside it touches at the same time to rounding
        earliest, first = np.argmin(contacts.toi), rows[np.argmin(least[rows])]
        if kept[earliest] < 0 and least[first] - slack[first] <= contacts.toi[earliest] + slack[earliest]:
            least[first] = contacts.toi[earliest]
    return rows, least[rows]


def _kept(contacts: Contacts, position_at: At | None) -> tuple[Indices, Indices]:
    """The row that is kept for each contact, -1 for none, and its group, -1 for what is in no other pair.

    Without positions normals of two edges count as doubtful.
    """
    groups = _Groups(contacts, position_at)
    rows, kind = groups.rows, contacts.kind[groups.rows]
    approach, speed = approach_of(contacts)
    is_wrong = kind == int(PairKind.EDGE_EDGE)
    if position_at is not None:
        is_wrong = groups.violations(position_at)[rows] > 0.0
    slack, until, most = slack_of(contacts)[rows], np.full(groups.count, np.inf), np.full(groups.count, -np.inf)
    # a normal that is wrong says nothing beside one that is right
    has_right = np.zeros(groups.count, dtype=bool)
    has_right[groups.group[~is_wrong]] = True
    is_told = ~is_wrong | ~has_right[groups.group]
    np.minimum.at(until, groups.group, np.where(is_told, contacts.toi[rows] + slack, np.inf))
    is_later = contacts.toi[rows] - slack > until[groups.group]
    np.maximum.at(most, groups.group, np.where(is_told & ~is_later, approach[rows], -np.inf))
    is_less = approach[rows] < most[groups.group] - _SAME_SPEED * speed[rows]
    order = np.lexsort((rows, kind, is_less, is_later, is_wrong, groups.group))
    first = order[np.searchsorted(groups.group[order], np.arange(groups.count))]
    kept, group = np.arange(len(contacts)), np.full(len(contacts), -1)
    kept[rows] = np.where(is_wrong[first] & groups.is_apart[rows[first]], -1, rows[first])[groups.group]
    group[rows] = groups.group
    return kept, group


def approach_of(contacts: Contacts) -> tuple[Array, Array]:
    """How fast each contact approaches along its normal, and its relative speed, in lengths a step."""
    velocity = contacts.relative_velocity
    return -(contacts.normal * velocity).sum(axis=1), np.linalg.norm(velocity, axis=1)


@np.errstate(over="ignore", invalid="ignore")
def first_of(contacts: Contacts, position_at: At | None) -> int:
    """Index of the earliest contact; of the distinct ones at its toi, to rounding, of that which approaches most.

    What is around a contact decides whether it is one of them, so that few of many are looked at.
    """
    earliest = int(np.argmin(contacts.toi))
    rows = np.flatnonzero(contacts.toi <= contacts.toi[earliest] + MOST_APART)
    if len(rows) > 1:
        slack = slack_of(contacts[rows])
        rows = rows[contacts.toi[rows] - slack <= contacts.toi[earliest] + slack[rows == earliest]]
    if len(rows) == 1:
        return earliest
    same = contacts[rows]
    approach, speed = approach_of(same)
    vertices, is_first = same.vertices, first_columns(same.kind)
    for _ in range(_MOST_GROUPS):
        best = _most(approach, speed)
        is_near = np.isin(vertices, vertices[best])
        near = np.flatnonzero((is_near & is_first).any(axis=1) & (is_near & ~is_first).any(axis=1))
        at = int(np.searchsorted(near, best))
        kept, group = _kept(same[near], position_at)
        if kept[at] >= 0 and approach[near[kept[at]]] >= approach[best] - _SAME_SPEED * speed[best]:
            return int(rows[near[kept[at]]])
        others = near[group == group[at]]
        approach[others[others != near[kept[at]]] if kept[at] >= 0 else others] = -np.inf
    rows = rows[distinct(same, position_at)[0]]
    return int(rows[_most(*approach_of(contacts[rows]))]) if len(rows) else earliest


def _most(approach: Array, speed: Array) -> int:
    """The first of those that approach most, to rounding."""
    return int(np.argmax(approach >= approach.max() - _SAME_SPEED * speed))


class _Groups:
    """Contacts on two features that other pairs may have, by these: not on the inside of a face without a copy.

    Attributes:
        rows: The contacts.
        group: The group of each of them.
        count: Number of groups.
        is_apart: Whether the closest points of each contact of the list are apart, beyond rounding.
    """

    def __init__(self, contacts: Contacts, position_at: At | None) -> None:
        self._contacts = contacts
        self._vertices = contacts.vertices.astype(np.int64)
        self._world, weights = contacts.world.astype(np.int64), contacts.weights
        self._is_first, size = first_columns(contacts.kind), np.abs(weights)
        spans = size > 1e-9
        self._reach = np.zeros(len(contacts))
        self.is_apart = np.zeros(len(contacts), dtype=bool)
        if position_at is not None:
            x = _positions(position_at, self._vertices, contacts.toi)
            self._points = np.stack([(size * side)[..., None] * x for side in (self._is_first, ~self._is_first)])
            self._points = self._points.sum(axis=2)
            self._apart = np.linalg.norm(self._points[0] - self._points[1], axis=1)
            noise = _ROUNDINGS * np.abs(x).max(axis=(1, 2))
            self._reach = np.maximum(2.0 * _gap_of(contacts), noise)
            self._reach += np.sqrt(2.0 * self._apart * self._reach)
            self.is_apart = self._apart > 16.0 * self._reach
            of_column = np.where(self._is_first[..., None], self._points[0][:, None], self._points[1][:, None])
            largest = np.linalg.norm(np.ptp(x, axis=1), axis=1)
            hidden = np.maximum(self._reach, np.minimum(contacts._place.tolerance, _MOST_HIDDEN * largest))
            spans = size * np.linalg.norm(x - of_column, axis=2) > hidden[:, None]
        for side in (self._is_first, ~self._is_first):  # the nearest vertex of a side always belongs to it
            largest = np.where(side, size, -1.0)
            spans |= largest == largest.max(axis=1, keepdims=True)
        spans &= size > 0.0
        is_listed, copies = contacts.kind != int(PairKind.VERTEX_PLANE), contacts._known_mesh()._copies_of_faces
        is_inside = (spans & ~self._is_first).sum(axis=1) > 2
        is_copy = np.zeros(len(contacts), dtype=bool)
        if len(copies):
            is_copy[is_inside] = copies[contacts.primitives[is_inside, 1]] >= 0
        self.rows = np.flatnonzero(is_listed & (~is_inside | is_copy))
        codes = features_of(contacts.kind[self.rows], self._vertices[self.rows], spans[self.rows])
        if len(copies):  # no edge has a negative number
            of_copy = is_copy[self.rows]
            codes[1][of_copy] = -1 - copies[contacts.primitives[self.rows[of_copy], 1]]
        self._is_turned = np.zeros(len(contacts), dtype=bool)
        self._is_turned[self.rows] = codes[0] > codes[1]
        self._tables = [np.unique(feature) for feature in (np.minimum(*codes), np.maximum(*codes))]
        self._keys, self.group = np.unique(self._key(self.rows, *codes), return_inverse=True)
        self.count = len(self._keys)

    def _key(self, rows: Indices, a: NDArray[np.int64], b: NDArray[np.int64]) -> NDArray[np.int64]:
        """One number for the world of rows and two features, in either order; -1 where no group has one of them."""
        pairs = zip(self._tables, (np.minimum(a, b), np.maximum(a, b)), strict=True)
        places = [_place_in(table, features) for table, features in pairs]
        key = (self._world[rows] * len(self._tables[0]) + places[0]) * len(self._tables[1]) + places[1]
        return np.where(np.minimum(*places) < 0, -1, key)

    def _group_of(self, rows: Indices, a: NDArray[np.int64], b: NDArray[np.int64]) -> Indices:
        """The group of two features, -1 where there is none."""
        return _place_in(self._keys, self._key(rows, a, b))

    def _around(self) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
        """What is around the features of each group: group, side and vertex in one number, sorted, and since when."""
        contacts, width = self._contacts, np.int64(int(self._vertices.max(initial=0)) + 1)
        begin = contacts.toi - slack_of(contacts)
        is_face = contacts.kind == int(PairKind.VERTEX_FACE)
        is_other = ~is_face & (contacts.kind != int(PairKind.VERTEX_PLANE))
        codes, of = [], []
        for is_of_kind, pairs in ((is_face, _OF_FACE), (is_other, _OF_EDGES)):
            rows = np.flatnonzero(is_of_kind).repeat(len(pairs))
            corners = np.sort(self._vertices[is_of_kind][:, pairs], axis=3).reshape(-1, 4)
            a, b = feature_number(corners[:, 0], corners[:, 1]), feature_number(corners[:, 2], corners[:, 3])
            at = self._group_of(rows, a, b)
            rows, at, is_turned = rows[at >= 0], at[at >= 0], (a > b)[at >= 0]
            side = self._is_first[rows] ^ is_turned[:, None]
            codes.append(((2 * at[:, None] + side) * width + self._vertices[rows]).ravel())
            of.append(np.repeat(rows, 4))
        code, since = np.concatenate(codes), begin[np.concatenate(of)]
        order = np.lexsort((since, code))
        code, since = code[order], since[order]
        is_new = np.concatenate([[True], code[1:] != code[:-1]])[: len(code)]
        code, since = code[is_new], since[is_new]
        return code // width, code % width, since

    def violations(self, position_at: At) -> Array:
        """By how much what is around the features of each contact passes the plane of its normal; 0 within rounding.

        Of two that touch and part the normal may be the opposite of one that separates them, as it opposes the motion.
        """
        contacts, violation = self._contacts, np.zeros((2, len(self._contacts)))
        is_open = (np.bincount(self.group, minlength=self.count) > 1)[self.group] | self.is_apart[self.rows]
        rows, group = self.rows[is_open], self.group[is_open]
        if len(rows) == 0:
            return violation[0]
        of_side, vertex, since = self._around()
        begin = np.searchsorted(of_side, 2 * group)
        count = np.searchsorted(of_side, 2 * group + 1, side="right") - begin
        until = contacts.toi + slack_of(contacts)
        slope = np.full(len(contacts), _ANGLE)
        slope += np.where(self.is_apart, 2.0 * self._reach / np.maximum(self._apart, 1e-300), 0.0)
        for part in np.split(np.arange(len(rows)), _breaks(count)):
            k = np.repeat(rows[part], count[part])
            shift = np.cumsum(count[part]) - count[part]
            at = np.arange(len(k)) + np.repeat(begin[part] - shift, count[part])
            is_in_time = since[at] <= until[k]
            k, at = k[is_in_time], at[is_in_time]
            is_of_first = (of_side[at] % 2 == 1) ^ self._is_turned[k]
            along = _positions(position_at, vertex[at][:, None], contacts.toi[k])[:, 0]
            along -= np.where(is_of_first[:, None], self._points[0][k], self._points[1][k])
            beyond = (along * contacts.normal[k]).sum(axis=1) * np.where(is_of_first, -1.0, 1.0)
            allowed = self._reach[k] + slope[k] * np.linalg.norm(along, axis=1)
            np.maximum.at(violation[0], k, beyond - allowed)
            np.maximum.at(violation[1], k, -beyond - allowed)
        return np.where(self.is_apart, violation[0], violation.min(axis=0))


def _positions(position_at: At, vertices: NDArray[Any], toi: Array) -> Array:
    """Positions of vertices, shape [m, k], at the toi of each row."""
    positions = position_at(vertices.ravel(), np.repeat(toi, vertices.shape[1])[:, None])
    return positions.reshape(*vertices.shape, positions.shape[-1])


def _place_in(table: NDArray[np.int64], numbers: NDArray[np.int64]) -> Indices:
    """Where numbers are in an ascending table, -1 where they are not."""
    if len(table) == 0:
        return np.full(len(numbers), -1)
    at = np.minimum(np.searchsorted(table, numbers), len(table) - 1)
    return np.where(table[at] == numbers, at, -1)


def _breaks(count: Indices) -> Indices:
    """Where to divide rows so that the counts of a part add up to no more than `_MOST_ROWS`, or it is one row."""
    part = np.cumsum(count) // _MOST_ROWS
    return np.flatnonzero(np.diff(part)) + 1
