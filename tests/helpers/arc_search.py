"""The first time in a step at which a pair touches, by interval arithmetic.

Each function of a feature (`arc_contacts`) is enclosed on an interval of time by c0 + c1·s + [−E, E], which says where
in the interval it can be zero, or not negative, and where it certainly is. What is left of the interval after all
functions is looked at again, in two halves if it has hardly shrunk: near a contact the width falls quadratically.
"""

from __future__ import annotations

from arc_contacts import FEATURES, Feature, PairOnInterval, is_separated
from arc_paths import UNIT
from flint import arb, arb_poly, ctx

BITS = 256  # 77 digits
_ONE = arb(1)
_WIDTH = arb(2) ** -72  # of an answer: 2e-22
_LEAST_WIDTH = arb(2) ** -104  # of an interval that is looked at: 5e-32
_LARGEST_TURN = 1.5  # rad, of half an interval
_MOST_TURN = 1e4  # rad, in the step
_MOST_LOOKS = 4000
_LOOKS_AFTER_DOUBT = 300  # at what comes after an interval without an answer


class Parts:
    """Where in s ∈ [−1, 1] a function may hold, and where it certainly does."""

    def __init__(self):
        self.may = [-_ONE, _ONE]
        self.does = [-_ONE, _ONE]
        self.root: list[arb] | None = None
        self.roots = 0  # functions that must vanish and are not zero throughout

    def is_empty(self) -> bool:
        return self.may[0] > self.may[1]

    def _cut(self, which: list[arb], low: arb, high: arb) -> None:
        which[0] = low if low > which[0] else which[0]
        which[1] = high if high < which[1] else which[1]

    def _never(self, which: list[arb]) -> None:
        which[:] = [_ONE * 2, -_ONE * 2]

    def zero(self, p: arb_poly) -> None:
        if p.length() == 0:
            return
        self.roots += 1
        c0, c1, rest = _linear(p)
        if c1 > 0 or c1 < 0:
            root = (-c0 + rest * UNIT) / c1
            low, high = root.lower(), root.upper()
            self._cut(self.may, low, high)
            if low >= -1 and high <= 1:
                self.root = [low, high]
        elif abs(c0).lower() > rest + c1.abs_upper():
            self._never(self.may)

    def not_negative(self, p: arb_poly) -> None:
        c0, c1, rest = _linear(p)
        most, least = (c0 + rest).upper(), (c0 - rest).lower()
        if c1 > 0:
            self._cut(self.may, (-most / c1).lower(), _ONE)
            self._cut(self.does, (-least / c1).upper(), _ONE)
        elif c1 < 0:
            self._cut(self.may, -_ONE, (-most / c1).upper())
            self._cut(self.does, -_ONE, (-least / c1).lower())
        else:
            slope = c1.abs_upper()
            if most + slope < 0:
                self._never(self.may)
            if not least - slope >= 0:
                self._never(self.does)

    def contact(self) -> arb | None:
        """An s by which all conditions have certainly held at once, if there is one."""
        low, high = self.does
        if self.roots == 0:
            return low if low <= high else None
        if self.roots == 1 and self.root is not None and low <= self.root[0] and self.root[1] <= high:
            return self.root[1]
        return None


def _linear(p: arb_poly) -> tuple[arb, arb, arb]:
    """c0, c1 and E of an enclosure c0 + c1·s + [−E, E]."""
    if p.length() <= 2:
        return p[0], p[1], arb(0)
    return p[0], p[1], p.right_shift(2)(UNIT).abs_upper()


class Search:
    """The first time at which a feature touches.

    Attributes:
        lo: No contact before; None if there is none at all.
        hi: A contact by then; None if none is certain.
        looks: How many intervals were looked at.
    """

    def __init__(self, feature: Feature, paths, kind: str, distance: arb, end: arb):
        self._feature, self._paths, self._kind, self._distance = feature, paths, kind, distance
        self._turn = max(float(path.theta) for path in paths)
        if self._turn > _MOST_TURN:
            raise ValueError(f"a turn by {self._turn} rad takes hours; expected at most {_MOST_TURN}")
        self.lo: arb | None = None
        self.hi: arb | None = None
        self.looks = 0
        self._run(end)

    def _run(self, end: arb) -> None:
        stack, most = [(arb(0), end)], _MOST_LOOKS
        while stack:
            a, b = stack.pop()
            if self._turn * float(b - a) > 2 * _LARGEST_TURN:
                stack += _halves(a, b)
                continue
            self.looks += 1
            left = self._look(a, b) if self.looks <= most else (a, b, None)
            if left is None:
                continue
            low, high, contact = left
            if contact is not None:
                self.hi, high = contact, contact
                stack.clear()
            if self.looks > most or high - low < (_WIDTH if self.hi is not None else _LEAST_WIDTH):
                if self.hi is None and self._touches_at(low):
                    self.hi = low
                self.lo = low if self.lo is None else self.lo
                if self.hi is not None or self.looks > most:
                    return
                most = min(most, self.looks + _LOOKS_AFTER_DOUBT)
            else:
                stack += [(low, high)] if high - low < 0.6 * (b - a) else _halves(low, high)

    def _look(self, a: arb, b: arb) -> tuple[arb, arb, arb | None] | None:
        """What is left of an interval, and a time by which there is a contact; None if there is none in it."""
        middle = ((a + b) / 2).mid()
        right, left = (b - middle).upper(), (middle - a).upper()
        half = right if right > left else left
        at, parts = PairOnInterval(self._paths, middle, half), Parts()
        for function in self._feature.zero:
            parts.zero(function(at))
            if parts.is_empty():
                return None
        for function in self._feature.not_negative:
            parts.not_negative(function(at))
            if parts.is_empty():
                return None
        low, high = ((middle + half * s) for s in parts.may)
        low, high = low.lower(), high.upper()
        low, high = low if low > a else a, high if high < b else b
        if low > high:
            return None
        found = parts.contact()
        if not self._says_something(at):
            if is_separated(at, self._paths, self._kind, self._distance):
                return None
            found = None
        if found is not None:
            found = (middle + half * found).upper()
            found = a if found < a else found if found <= b else None
        return low, high, found

    def _says_something(self, at: PairOnInterval) -> bool:
        """Whether the normal or edge, without which all conditions of the feature hold, certainly never vanishes."""
        key = self._feature.may_vanish
        if key is None:
            return True
        squared = at.product(key, key)
        return bool(squared[0] - squared.right_shift(1)(UNIT).abs_upper() > 0)

    def _touches_at(self, t: arb) -> bool:
        at = PairOnInterval(self._paths, t, arb(0))
        return (
            self._says_something(at)
            and all(f(at).length() == 0 for f in self._feature.zero)
            and all(f(at)[0] >= 0 for f in self._feature.not_negative)
        )


def _halves(a: arb, b: arb) -> list[tuple[arb, arb]]:
    """The later half, and the earlier one, which is popped first."""
    middle = ((a + b) / 2).mid()
    return [(middle, b), (a, middle)]


def first_contact(kind: str, paths, distance: float = 0.0) -> tuple[arb | None, arb | None, int]:
    """When two primitives first come within a distance of each other, in [0, 1].

    Args:
        kind: "vertex-face", "edge-edge", "point-segment" or "point-point".
        paths: Of the vertex, first edge or point, and of the other primitive.
        distance: Euclidean; its float64 value is exact.

    Returns:
        lo, hi and the number of intervals looked at: no contact before lo, or at all if None; a contact by hi, or none
        that is certain if None.
    """
    with ctx.workprec(BITS):
        exact = arb(float(distance))
        lo, hi, looks, end = None, None, 0, _ONE
        for feature in FEATURES[kind](exact * exact if distance > 0 else None):
            found = Search(feature, paths, kind, exact, end)
            looks += found.looks
            if found.lo is not None and (lo is None or found.lo < lo):
                lo = found.lo
            if found.hi is not None and (hi is None or found.hi < hi):
                hi = end = found.hi
        return lo, hi, looks
