"""Exact oracle of the tests: the earliest time of impact in rational and real algebraic arithmetic.

It shares no code and no idea with the kernels. float64 coordinates are dyadic rationals, so one common power of two
makes every coordinate an integer; the time of impact is then a root of one of finitely many integer polynomials of
degree at most three, and every decision is the sign of such a polynomial at such a root.

Two primitives touch at t iff 0 lies in K(t) = conv{V_i(t)}, whose corners are linear in t:

    vertex-face    V_i = v - f_i, a triangle           edge-edge     V = a_i - b_j, a parallelogram
    point-segment  V = p - a, p - b, a segment         point-point   V = p - q, a point

Without separation (`_contact`): {t : 0 in K(t)} is closed, and whether t belongs to it depends only on the signs of
finitely many polynomials; it starts at 0 or at a root of one of them. If det(P, Q, R) is not identically zero, its
roots are the only candidates, since contact makes the three dependent. Otherwise every V_i lies in one plane through
the origin, and the candidates are the roots of one component of the products V_i x V_j, and of V_i . V_j where that
product vanishes for all t.

With separation d > 0 (`_separated_contact`): the origin becomes the cube [-d, d]^3, and K(t) + cube is a polytope of
full dimension whose facet normals are among e_k, edge x e_k and Q x R. While a normal separates it from the origin
there is no contact, so the search jumps to the first root of that normal's corner polynomials, and tests again.

References:
    Abbott, "Quadratic interval refinement for real roots", 2014 (the refinement of `Root`).
    Collins and Akritas, "Polynomial real root isolation using Descartes' rule of signs", 1976.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Sequence
from fractions import Fraction
from itertools import pairwise

import numpy as np
from flint import fmpq, fmpz_poly

KINDS = ("vertex-face", "edge-edge", "point-segment", "point-point")
POINTS = {"vertex-face": 4, "edge-edge": 4, "point-segment": 3, "point-point": 2}

# Corners V = points[i] - points[j]. The parallelogram goes round, so that consecutive corners share an edge.
_CORNERS = {
    "vertex-face": ((0, 1), (0, 2), (0, 3)),
    "edge-edge": ((0, 2), (1, 2), (1, 3), (0, 3)),
    "point-segment": ((0, 1), (0, 2)),
    "point-point": ((0, 1),),
}
# Triangles of corners that together cover K.
_TRIANGLES = {"vertex-face": ((0, 1, 2),), "edge-edge": ((0, 1, 2), (0, 2, 3)), "point-segment": (), "point-point": ()}
# Pairs of corners whose segments bound those triangles; a point is the segment from itself to itself.
_PAIRS = {
    "vertex-face": ((0, 1), (1, 2), (0, 2)),
    "edge-edge": ((0, 1), (1, 2), (0, 2), (2, 3), (0, 3)),
    "point-segment": ((0, 1),),
    "point-point": ((0, 0),),
}

Poly = tuple[int, ...]  # integer coefficients, lowest degree first; trailing zeros allowed
Line = tuple[tuple[int, ...], tuple[int, ...]]  # the moving vector line[0] + t line[1], three components each


# ----------------------------------------------------------------------------------------------------------------------
# Roots of integer polynomials in [0, 1]
# ----------------------------------------------------------------------------------------------------------------------


def _sign(value: int) -> int:
    return (value > 0) - (value < 0)


def _trim(poly: Sequence[int]) -> Poly:
    n = len(poly)
    while n and not poly[n - 1]:
        n -= 1
    return tuple(poly[:n])


def _value(poly: Poly, numerator: int, denominator: int) -> int:
    """poly(numerator / denominator) times denominator**degree, an integer of the same sign."""
    total = 0
    power = 1
    for c in reversed(poly):
        total = total * numerator + c * power
        power *= denominator
    return total


def _value_dyadic(poly: Poly, a: int, k: int) -> int:
    """poly(a / 2**k) times 2**(k degree)."""
    total = 0
    shift = 0
    for c in reversed(poly):
        total = total * a + (c << shift)
        shift += k
    return total


def _gcd(p: Poly, q: Poly) -> Poly:
    g = fmpz_poly(list(p)).gcd(fmpz_poly(list(q)))
    return tuple(int(c) for c in g.coeffs())


def _square_free(poly: Poly) -> Poly:
    f = fmpz_poly(list(poly))
    g = f.gcd(f.derivative())
    f = f // g if g.degree() > 0 else f
    return tuple(int(c) for c in (f // f.content()).coeffs())


class Root:
    """A real algebraic number in [0, 1]: an exact rational, or an irrational root in an open dyadic interval.

    Exactly one of the two forms is in use: `denominator > 0` marks the rational numerator / denominator; otherwise the
    number is the only root of the square-free `poly` in (a, a + 1) / 2**k, and neither end is a root.
    """

    __slots__ = ("a", "denominator", "k", "left", "numerator", "poly", "step")

    def __init__(self, numerator: int, denominator: int) -> None:
        self.numerator = numerator
        self.denominator = denominator

    @classmethod
    def isolated(cls, poly: Poly, a: int, k: int) -> Root:
        """The only root of the square-free `poly` in the open interval (a, a + 1) / 2**k."""
        if len(poly) == 2:
            sign = -1 if poly[1] < 0 else 1
            return cls(-poly[0] * sign, poly[1] * sign)
        root = cls(0, 0)
        root.poly, root.a, root.k, root.step = poly, a, k, 1
        left = _value_dyadic(poly, a, k)
        right = _value_dyadic(poly, a + 1, k)
        if left and right:
            root.left = _sign(left)
        else:
            # An end is a root of its own: the sign beside it is that of the derivative there.
            slope = tuple(i * c for i, c in enumerate(poly))[1:]
            root.left = _sign(left) or _sign(_value_dyadic(slope, a, k))
            while not (_value_dyadic(poly, root.a, root.k) and _value_dyadic(poly, root.a + 1, root.k)):
                root._subdivide(1)
                if root.denominator:
                    return root
        # A rational root has a denominator that divides the leading coefficient, so that leading * root is an integer;
        # an interval narrower than 1 / leading holds at most one such number.
        lead = abs(poly[-1])
        root.refine(lead.bit_length() + 1)
        if not root.denominator:
            m = ((root.a + 1) * lead) >> root.k
            if m << root.k > root.a * lead and _value(poly, m, lead) == 0:
                root.numerator, root.denominator = m, lead
        return root

    def _subdivide(self, m: int) -> bool:
        """One step of quadratic interval refinement into 2**m parts; False where the guessed part was wrong."""
        poly, k = self.poly, self.k + m
        if m == 1:
            guess = 2 * self.a + 1
        else:
            left = abs(_value_dyadic(poly, self.a, self.k))
            right = abs(_value_dyadic(poly, self.a + 1, self.k))
            offset = (((left << (m + 1)) // (left + right)) + 1) >> 1
            guess = (self.a << m) + min(max(offset, 1), (1 << m) - 1)
        sign = _sign(_value_dyadic(poly, guess, k))
        if sign == 0:
            self.numerator, self.denominator = guess, 1 << k
            return True
        other = guess + (1 if sign == self.left else -1)
        if m > 1:
            sign_other = _sign(_value_dyadic(poly, other, k))
            if sign_other == 0:
                self.numerator, self.denominator = other, 1 << k
                return True
            if sign_other == sign:
                return False
        self.a, self.k = min(guess, other), k
        return True

    def refine(self, k: int) -> None:
        """Narrows the interval to 2**-k or less; nothing to do for a rational."""
        while not self.denominator and self.k < k:
            if self._subdivide(self.step):
                self.step *= 2
            else:
                self.step = max(1, self.step // 2)

    def compare_rational(self, numerator: int, denominator: int) -> int:
        """Sign of this number minus numerator / denominator, with denominator > 0."""
        if self.denominator:
            return _sign(self.numerator * denominator - numerator * self.denominator)
        scaled = numerator << self.k
        if scaled <= self.a * denominator:
            return 1
        if scaled >= (self.a + 1) * denominator:
            return -1
        # An irrational root differs from every rational, so the sign here is never zero.
        return 1 if _sign(_value(self.poly, numerator, denominator)) == self.left else -1

    def compare(self, other: Root) -> int:
        """Sign of this number minus the other one."""
        if other.denominator:
            return self.compare_rational(other.numerator, other.denominator)
        if self.denominator:
            return -other.compare_rational(self.numerator, self.denominator)
        common = None
        while True:
            k = max(self.k, other.k)
            lo1, hi1 = self.a << (k - self.k), (self.a + 1) << (k - self.k)
            lo2, hi2 = other.a << (k - other.k), (other.a + 1) << (k - other.k)
            if hi1 <= lo2:
                return -1
            if hi2 <= lo1:
                return 1
            if common is None:
                common = _gcd(self.poly, other.poly)
                if len(common) > 1:
                    # A root of the common divisor in both intervals is the one root of either polynomial there.
                    lo, hi = max(lo1, lo2), min(hi1, hi2)
                    if _sign(_value_dyadic(common, lo, k)) != _sign(_value_dyadic(common, hi, k)):
                        return 0
            self.refine(k + 16)
            other.refine(k + 16)

    def sign_of(self, poly: Poly) -> int:
        """Sign of an integer polynomial at this number."""
        if self.denominator:
            return _sign(_value(poly, self.numerator, self.denominator))
        checked = False
        while True:
            low = high = 0
            shift = 0
            a = 1
            b = 1
            terms = []
            for c in poly:
                terms.append((c * a, c * b) if c >= 0 else (c * b, c * a))
                a *= self.a
                b *= self.a + 1
            for lo, hi in reversed(terms):
                low += lo << shift
                high += hi << shift
                shift += self.k
            if low > 0:
                return 1
            if high < 0:
                return -1
            if not checked:
                checked = True
                poly = _trim(poly)
                if not poly:
                    return 0
                common = _gcd(self.poly, poly)
                if len(common) > 1:
                    ends = (_value_dyadic(common, self.a, self.k), _value_dyadic(common, self.a + 1, self.k))
                    if _sign(ends[0]) != _sign(ends[1]):
                        return 0
            self.refine(2 * self.k + 8)


ZERO = Root(0, 1)


def _variations_on_unit_interval(poly: Poly) -> int:
    """Descartes' bound on the number of roots in (0, 1): 0 and 1 are exact, with multiplicity."""
    n = len(poly) - 1
    # Reversed and shifted by one, the roots of (0, 1) are those of (0, inf); the binomials are written out.
    if n == 1:
        coefficients = (poly[0], poly[0] + poly[1])
    elif n == 2:
        a, b, c = poly
        coefficients = (a, 2 * a + b, a + b + c)
    elif n == 3:
        a, b, c, d = poly
        coefficients = (a, 3 * a + b, 3 * a + 2 * b + c, a + b + c + d)
    else:
        shifted = list(reversed(poly))
        for i in range(n):
            for j in range(n - 1, i - 1, -1):
                shifted[j] += shifted[j + 1]
        coefficients = tuple(shifted)
    signs = [c > 0 for c in coefficients if c]
    return sum(s != t for s, t in pairwise(signs))


def _roots(poly: Poly) -> list[Root]:
    """All distinct roots in [0, 1], in increasing order, of a polynomial that is not identically zero."""
    poly = _trim(poly)
    roots = []
    if not poly[0]:
        roots.append(ZERO)
        while not poly[0]:
            poly = poly[1:]
    if len(poly) == 1:
        return roots
    variations = _variations_on_unit_interval(poly)
    if variations:
        poly = _square_free(poly)
        stack = [(poly, 0, 0)]
        while stack:
            local, a, k = stack.pop()
            if local is None:
                roots.append(Root(a, 1 << k))
                continue
            variations = _variations_on_unit_interval(local)
            if variations == 1:
                roots.append(Root.isolated(poly, a, k))
            elif variations > 1:
                n = len(local) - 1
                left = [c << (n - i) for i, c in enumerate(local)]
                right = list(left)
                for i in range(n):
                    for j in range(n - 1, i - 1, -1):
                        right[j] += right[j + 1]
                stack.append((tuple(right), 2 * a + 1, k + 1))
                if not right[0]:
                    stack.append((None, 2 * a + 1, k + 1))
                stack.append((tuple(left), 2 * a, k + 1))
    if not sum(poly):
        roots.append(Root(1, 1))
    return roots


# ----------------------------------------------------------------------------------------------------------------------
# The moving corners
# ----------------------------------------------------------------------------------------------------------------------


def _component(a: Line, b: Line, k: int) -> Poly:
    """Component k of the cross product of two moving vectors, degree two in t."""
    i, j = (k + 1) % 3, (k + 2) % 3
    (a0, a1), (b0, b1) = a, b
    return (
        a0[i] * b0[j] - a0[j] * b0[i],
        a0[i] * b1[j] + a1[i] * b0[j] - a0[j] * b1[i] - a1[j] * b0[i],
        a1[i] * b1[j] - a1[j] * b1[i],
    )


def _dot(a: Line, b: Line) -> Poly:
    (a0, a1), (b0, b1) = a, b
    return (
        a0[0] * b0[0] + a0[1] * b0[1] + a0[2] * b0[2],
        a0[0] * b1[0] + a0[1] * b1[1] + a0[2] * b1[2] + a1[0] * b0[0] + a1[1] * b0[1] + a1[2] * b0[2],
        a1[0] * b1[0] + a1[1] * b1[1] + a1[2] * b1[2],
    )


def _difference(a: Line, b: Line) -> Line:
    (a0, a1), (b0, b1) = a, b
    return (tuple(map(int.__sub__, a0, b0)), tuple(map(int.__sub__, a1, b1)))


def _times_line(quadratic: Poly, line: Line, k: int) -> Poly:
    """A quadratic times component k of a moving vector, degree three in t."""
    c0, c1, c2 = quadratic
    x0, x1 = line[0][k], line[1][k]
    return (c0 * x0, c0 * x1 + c1 * x0, c1 * x1 + c2 * x0, c2 * x1)


def _sum(polys: Iterable[Poly]) -> Poly:
    return tuple(sum(c) for c in zip(*polys, strict=True))


# ----------------------------------------------------------------------------------------------------------------------
# Contact without separation
# ----------------------------------------------------------------------------------------------------------------------


class _Products:
    """The polynomials V_i x V_j and V_i . V_j of one query, formed when they are first asked for."""

    def __init__(self, corners: list[Line]) -> None:
        self.corners = corners
        self.cache: dict[tuple[int, int, int], Poly] = {}

    def get(self, i: int, j: int, k: int) -> Poly:
        """Component k of V_i x V_j, or V_i . V_j for k = 3; i <= j."""
        key = (i, j, k)
        poly = self.cache.get(key)
        if poly is None:
            a, b = self.corners[i], self.corners[j]
            poly = self.cache[key] = _dot(a, b) if k == 3 else _component(a, b, k)
        return poly


def _member(kind: str, products: _Products, t: Root) -> bool:
    """Whether 0 is in K(t), given that the corners and the origin lie in one plane at t.

    The products V_i x V_j are all parallel then, so that the component k in which one of them is not zero tells the
    sign, and the vanishing, of all of them.
    """
    k = -1
    signs = {}
    for i, j in _PAIRS[kind]:
        sign = 0
        if k >= 0:
            sign = t.sign_of(products.get(i, j, k))
        elif i != j:
            for m in range(3):
                sign = t.sign_of(products.get(i, j, m))
                if sign:
                    k = m
                    break
        # Parallel corners: the origin is on their segment iff they do not point to the same side of it.
        if sign == 0 and t.sign_of(products.get(i, j, 3)) <= 0:
            return True
        signs[i, j] = sign
    # No side of a triangle holds the origin: it is inside iff it sees the three sides turn the same way.
    return any(signs[i, j] == signs[j, m] == -signs[i, m] != 0 for i, j, m in _TRIANGLES[kind])


def _contact(kind: str, corners: list[Line]) -> Root | None:
    """Earliest t in [0, 1] with 0 in K(t), exactly; None where there is none."""
    products = _Products(corners)
    if len(corners) > 2:
        p = corners[0]
        q = _difference(corners[1], p)
        r = _difference(corners[-1], p)
        det = _sum(_times_line(_component(q, r, k), p, k) for k in range(3))
        if any(det):
            return next((t for t in _roots(det) if _member(kind, products, t)), None)
    if _member(kind, products, ZERO):
        return ZERO
    # The corners stay in a plane through the origin, so all V_i x V_j that do not vanish for all t are multiples of one
    # another: a component that is not identically zero in one of them is so in none of them.
    k = -1
    critical = []
    for i, j in _PAIRS[kind]:
        cross = ()
        for m in range(3) if k < 0 else (k,):
            cross = products.get(i, j, m)
            if any(cross):
                k = m
                break
        if any(cross):
            critical.append(cross)
        elif i == j:
            # V . V = 0 iff every component vanishes; the one that is not identically zero has the simple root.
            line = corners[i]
            critical.append(next((x for x in zip(*line, strict=True) if any(x)), (0,)))
        else:
            critical.append(products.get(i, j, 3))
    best = None
    for poly in critical:
        if not any(poly):
            continue
        for t in _roots(poly):
            if best is not None and t.compare(best) >= 0:
                break
            if _member(kind, products, t):
                best = t
                break
    return best


# ----------------------------------------------------------------------------------------------------------------------
# Contact with separation
# ----------------------------------------------------------------------------------------------------------------------


def _edges(corners: list[Line]) -> list[Line]:
    if len(corners) == 1:
        return []
    edges = [_difference(corners[1], corners[0])]
    if len(corners) > 2:
        edges.append(_difference(corners[-1], corners[0]))
    if len(corners) == 3:
        edges.append(_difference(corners[2], corners[1]))
    return edges


def _normals(corners: list[Line], dimension: int) -> list[tuple[tuple[Poly, Poly, Poly], tuple[int, ...]]]:
    """Facet normals of K(t) + cube, as polynomials, each with the corners among which n . V takes all its values."""
    every = tuple(range(len(corners)))
    normals = []
    for k in range(dimension):
        normals.append((tuple((1,) if m == k else (0,) for m in range(3)), every))
    for index, edge in enumerate(_edges(corners)):
        # Both ends of an edge have the same product with its normals.
        if len(corners) == 4:
            ends = (0, 2)
        elif len(corners) == 3:
            ends = ((0, 2), (0, 1), (0, 1))[index]
        else:
            ends = (0,)
        for k in range(3) if dimension == 3 else (2,):
            i, j = (k + 1) % 3, (k + 2) % 3
            n: list[Poly] = [(0, 0)] * 3
            n[i] = (edge[0][j], edge[1][j])
            n[j] = (-edge[0][i], -edge[1][i])
            normals.append((tuple(n), ends))
    if len(corners) > 2:
        q, r, *_ = _edges(corners)
        normals.append((tuple(_component(q, r, k) for k in range(3)), (0,)))
    return normals


def _corner_polynomials(
    normal: tuple[Poly, Poly, Poly], ends: tuple[int, ...], corners: list[Line], d: int, dimension: int
) -> list[Poly]:
    """n . (V_i - d s) over the corners and the sign patterns s: n separates iff all are > 0 or all are < 0."""
    degree = len(normal[0])
    polys = []
    offsets = {(0,) * (degree + 1)}
    for k in range(dimension):
        if any(normal[k]):
            step = (*(d * c for c in normal[k]), 0)
            offsets = {tuple(map(sign, o, step)) for o in offsets for sign in (int.__add__, int.__sub__)}
    for i in ends:
        product = [0] * (degree + 1)
        for k in range(dimension):
            x0, x1 = corners[i][0][k], corners[i][1][k]
            for m, c in enumerate(normal[k]):
                product[m] += c * x0
                product[m + 1] += c * x1
        polys.extend(tuple(map(int.__add__, product, o)) for o in offsets)
    return polys


def _separated_contact(corners: list[Line], d: int, dimension: int) -> Root | None:
    """Earliest t in [0, 1] at which K(t) is within L-infinity distance d > 0 of the origin; None where it never is."""
    t = ZERO
    normals = _normals(corners, dimension)
    families: list[list[Poly] | None] = [None] * len(normals)
    order = list(range(len(normals)))
    satisfied = 0
    while satisfied < len(order):
        index = order[satisfied]
        family = families[index]
        if family is None:
            family = families[index] = _corner_polynomials(*normals[index], corners, d, dimension)
        first = t.sign_of(family[0])
        if first == 0 or any(t.sign_of(poly) != first for poly in family):
            satisfied += 1
            continue
        # This normal separates until the first of its polynomials vanishes. It holds from then on for a while at
        # least, so the next round asks the other normals first.
        earliest = None
        for poly in map(_trim, family):
            if earliest is not None:
                # With one root in (0, 1) at most, equal signs at t and at the earliest root so far leave none between.
                few = len(poly) < 3 or _variations_on_unit_interval(poly) < 2
                if few and earliest.sign_of(poly) == first:
                    continue
            for root in _roots(poly):
                if earliest is not None and root.compare(earliest) >= 0:
                    break
                if root.compare(t) > 0:
                    earliest = root
                    break
        if earliest is None:
            return None
        t = earliest
        order.append(order.pop(satisfied))
        satisfied = 0
    return t


# ----------------------------------------------------------------------------------------------------------------------
# The result
# ----------------------------------------------------------------------------------------------------------------------


class ExactToi:
    """An exact earliest time of impact tau = t_max * root, or none.

    Attributes:
        hit: Whether there is contact in [0, t_max].
        lo: Rational lower bound of tau; equal to `hi` where tau is rational. None without a hit.
        hi: Rational upper bound of tau. None without a hit.
        approx: tau as a float64 to about one unit in the last place; inf without a hit.
    """

    __slots__ = ("root", "t_max")

    def __init__(self, root: Root | None, t_max: float = 1.0) -> None:
        self.root = root
        self.t_max = t_max

    @property
    def hit(self) -> bool:
        return self.root is not None

    @property
    def rational(self) -> bool:
        """Whether tau is a rational number, which `lo == hi` then states exactly."""
        return self.root is not None and bool(self.root.denominator)

    def refine(self, bits: int = 80) -> tuple[fmpq, fmpq]:
        """Rational lo <= tau <= hi with hi - lo <= 2**-bits * hi."""
        root = self.root
        if root is None:
            raise ValueError("there is no contact to refine")
        p, q = self.t_max.as_integer_ratio()
        scale = fmpq(p, q)
        if not root.denominator:
            root.refine(bits)
            while root.a.bit_length() <= bits and not root.denominator:
                root.refine(root.k + bits + 1 - root.a.bit_length())
        if root.denominator:
            tau = scale * fmpq(root.numerator, root.denominator)
            return tau, tau
        return scale * fmpq(root.a, 1 << root.k), scale * fmpq(root.a + 1, 1 << root.k)

    @property
    def lo(self) -> fmpq | None:
        return self.refine()[0] if self.hit else None

    @property
    def hi(self) -> fmpq | None:
        return self.refine()[1] if self.hit else None

    @property
    def approx(self) -> float:
        if not self.hit:
            return math.inf
        lo = self.refine()[0]
        return int(lo.p) / int(lo.q)

    def compare(self, toi: float) -> int:
        """Sign of toi - tau, decided exactly; without a hit tau counts as inf."""
        toi = float(toi)
        if math.isnan(toi):
            raise ValueError("toi is nan; expected a number")
        if not self.hit:
            return 0 if toi == math.inf else -1
        if math.isinf(toi):
            return 1 if toi > 0 else -1
        if self.t_max == 0.0:
            return _sign(toi)
        p, q = toi.as_integer_ratio()
        mp, mq = self.t_max.as_integer_ratio()
        return -self.root.compare_rational(p * mq, q * mp)

    def late(self, toi: float) -> bool:
        """Whether toi > tau, exactly: a missed collision. Equal is not late; without a hit nothing is late."""
        return self.hit and self.compare(toi) > 0

    def early_by(self, toi: float) -> float:
        """tau - toi, rounded once from exact arithmetic, so that a difference far below 1e-16 is still seen."""
        if not self.hit or math.isinf(toi):
            raise ValueError("early_by needs a hit and a finite toi")
        p, q = float(toi).as_integer_ratio()
        difference = self.refine()[0] - fmpq(p, q)
        return int(difference.p) / int(difference.q)

    def __repr__(self) -> str:
        if not self.hit:
            return "ExactToi(none)"
        return f"ExactToi({self.approx!r}, {'rational' if self.rational else 'irrational'})"


# ----------------------------------------------------------------------------------------------------------------------
# Queries
# ----------------------------------------------------------------------------------------------------------------------


def _validated(kind: str, points_t0: np.ndarray, points_t1: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    if kind not in KINDS:
        raise ValueError(f"kind is {kind!r}; expected one of {KINDS}")
    p0 = np.asarray(points_t0, dtype=np.float64)
    p1 = np.asarray(points_t1, dtype=np.float64)
    dimensions = (3,) if POINTS[kind] == 4 else (2, 3)
    if p0.ndim != 3 or p0.shape[1] != POINTS[kind] or p0.shape[2] not in dimensions or p1.shape != p0.shape:
        raise ValueError(f"{kind} points have shapes {p0.shape} and {p1.shape}; expected [n, {POINTS[kind]}, 3] twice")
    if not (np.isfinite(p0).all() and np.isfinite(p1).all()):
        raise ValueError("points hold non-finite values")
    return p0, p1


def _certainly_apart(kind: str, p0: np.ndarray, p1: np.ndarray, separation: float) -> np.ndarray:
    """Queries that a fixed direction separates over the whole step, with a rigorous bound of the rounding, [n].

    Any direction may be tried, so how it was computed does not matter; only the products with it are bounded.
    """
    pairs = np.array(_CORNERS[kind])
    points = np.stack([p0, p1], axis=1)
    apart = np.zeros(len(p0), dtype=bool)
    with np.errstate(all="ignore"):
        corners = points[:, :, pairs[:, 0]] - points[:, :, pairs[:, 1]]  # [n, 2, corners, dim], each rounded once
        start, end = corners[:, 0], corners[:, 1]
        middle = 0.5 * (start + end)
        dim = p0.shape[2]
        directions = [np.broadcast_to(np.eye(dim)[k], (len(p0), dim)) for k in range(dim)]
        directions += [start.mean(axis=1), end.mean(axis=1), middle.mean(axis=1)]
        if dim == 3 and len(pairs) > 1:
            motion = (end - start).mean(axis=1)
            for shape in (start, middle, end):
                edges = [shape[:, 1] - shape[:, 0], shape[:, -1] - shape[:, 0], shape[:, -1] - shape[:, 1]]
                directions.append(np.cross(edges[0], edges[1]))
                directions += [np.cross(edge, motion) for edge in edges]
        elif dim == 2 and len(pairs) > 1:
            for shape in (start, middle, end):
                edge = shape[:, 1] - shape[:, 0]
                directions.append(np.stack([-edge[:, 1], edge[:, 0]], axis=1))
        for direction in directions:
            # The largest component becomes about one, so that neither the products nor their sum can overflow unless
            # the corners do; nan (a zero direction) separates nothing.
            n = (direction / np.abs(direction).max(axis=1, keepdims=True))[:, None, None, :]
            products = (n * corners).sum(axis=3)
            # Each corner and each product is rounded once, the sum of three twice more, and this bound and the
            # comparison add at most six: 16 units cover them. 2**-1060 covers products that underflow.
            bound = 2.0**-49 * (np.abs(n) * np.abs(corners)).sum(axis=3) + 2.0**-1060
            bound = bound + separation * np.abs(n).sum(axis=3) * (1 + 2.0**-49)
            apart |= (products > bound).all(axis=(1, 2)) | (products < -bound).all(axis=(1, 2))
    return apart


def _integer_rows(values: np.ndarray) -> list[list[int]]:
    """Each row times its own power of two, so that all entries are integers and at least one is odd."""
    mantissa, exponent = np.frexp(values)
    mantissa = np.ldexp(mantissa, 53).astype(np.int64)
    exponent = np.where(mantissa == 0, np.iinfo(np.int32).max, exponent)
    shift = np.where(mantissa == 0, 0, exponent - exponent.min(axis=1, keepdims=True, initial=2000))
    rows = []
    for row, by in zip(mantissa.tolist(), shift.tolist(), strict=True):
        integers = [m << s for m, s in zip(row, by, strict=True)]
        bits = 0
        for value in integers:
            bits |= value
        zeros = (bits & -bits).bit_length() - 1
        rows.append([value >> zeros for value in integers] if zeros > 0 else integers)
    return rows


def _moving_corners(kind: str, row: list[int], dimension: int, t_max: tuple[int, int]) -> list[Line]:
    """Corners as lines in s = t / t_max, times the denominator of t_max, from the flat integers of both ends."""
    p, q = t_max
    n = POINTS[kind] * dimension
    pad = (0,) * (3 - dimension)
    corners = []
    for i, j in _CORNERS[kind]:
        i, j = i * dimension, j * dimension
        start = tuple(row[i + k] - row[j + k] for k in range(dimension))
        motion = tuple(row[n + i + k] - row[n + j + k] - start[k] for k in range(dimension))
        if q != 1:
            start = tuple(q * x for x in start)
        if p != 1:
            motion = tuple(p * x for x in motion)
        corners.append((start + pad, motion + pad))
    return corners


def exact_tois(
    kind: str,
    points_t0: np.ndarray,
    points_t1: np.ndarray,
    separation: float = 0.0,
    t_max: float = 1.0,
    progress: bool = False,
) -> list[ExactToi]:
    """Exact earliest times of impact of many queries.

    Args:
        kind: "vertex-face", "edge-edge", "point-segment" or "point-point".
        points_t0: Positions at t = 0, float64, shape [n, 4, 3] ([n, 3, 2 or 3] and [n, 2, 2 or 3] for the last two).
        points_t1: Positions at t = 1, same shape.
        separation: L-infinity distance that counts as contact, in the unit of the points; its float64 value is exact.
        t_max: End of the step; its float64 value is exact.
        progress: Whether to print a count to stderr now and then.

    Returns:
        One result for each query.
    """
    p0, p1 = _validated(kind, points_t0, points_t1)
    if not (separation >= 0.0 and math.isfinite(separation)):
        raise ValueError(f"separation is {separation}; expected a finite number >= 0")
    if not 0.0 <= t_max <= 1.0:
        raise ValueError(f"t_max is {t_max}; expected a number in [0, 1]")
    separation, t_max = float(separation), float(t_max)
    dimension = p0.shape[2]
    none = ExactToi(None, t_max)
    results = [none] * len(p0)
    # The cull checks the whole of [0, 1], which contains [0, t_max].
    open_queries = np.flatnonzero(~_certainly_apart(kind, p0, p1, separation))
    flat = np.concatenate(
        [
            p0.reshape(len(p0), POINTS[kind] * dimension)[open_queries],
            p1.reshape(len(p1), POINTS[kind] * dimension)[open_queries],
            np.full((len(open_queries), 1), separation),
        ],
        axis=1,
    )
    ratio = t_max.as_integer_ratio()
    for done, (index, row) in enumerate(zip(open_queries.tolist(), _integer_rows(flat), strict=True)):
        corners = _moving_corners(kind, row, dimension, ratio)
        if separation > 0.0:
            root = _separated_contact(corners, row[-1] * ratio[1], dimension)
        else:
            root = _contact(kind, corners)
        if root is not None:
            results[index] = ExactToi(root, t_max)
        if progress and done % 1000 == 0:
            print(f"exact_tois: {done} of {len(open_queries)} open queries", file=sys.stderr)
    return results


def exact_toi(
    kind: str, points_t0: np.ndarray, points_t1: np.ndarray, separation: float = 0.0, t_max: float = 1.0
) -> ExactToi:
    """Exact earliest time of impact of one query; points of shape [4, 3], [3, 2 or 3] or [2, 2 or 3]."""
    return exact_tois(kind, np.asarray(points_t0)[None], np.asarray(points_t1)[None], separation, t_max)[0]


def exact_gap(kind: str, points_t0: np.ndarray, points_t1: np.ndarray, t: float | Fraction | fmpq) -> float:
    """L-infinity distance of the two primitives at the rational time t, exact and then rounded once.

    K is within d of the origin iff no facet normal n of K + cube separates them, that is iff min_i n.V_i <= d |n|_1 and
    max_i n.V_i >= -d |n|_1 for all n; the distance is the largest d that one of them requires.
    """
    p0, p1 = _validated(kind, np.asarray(points_t0)[None], np.asarray(points_t1)[None])
    p, q = (int(t.p), int(t.q)) if isinstance(t, fmpq) else t.as_integer_ratio()
    dimension = p0.shape[2]
    # One additional value carries the scale of the integers.
    row = _integer_rows(np.concatenate([p0.ravel(), p1.ravel(), [1.0]])[None])[0]
    lines = _moving_corners(kind, row, dimension, (1, 1))
    corners = [(tuple(q * a + p * b for a, b in zip(*line, strict=True)), (0, 0, 0)) for line in lines]
    best = Fraction(0)
    for normal, ends in _normals(corners, dimension):
        n = [c[0] for c in normal]
        length = sum(abs(c) for c in n)
        if length:
            products = [sum(n[k] * corners[i][0][k] for k in range(3)) for i in ends]
            best = max(best, Fraction(min(products), length), Fraction(-max(products), length))
    distance = best / (q * row[-1])
    return distance.numerator / distance.denominator
