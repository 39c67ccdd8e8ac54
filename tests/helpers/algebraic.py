"""Real algebraic numbers: the roots in [0, 1] of polynomials with integer coefficients, and signs at them.

References:
    Abbott, "Quadratic interval refinement for real roots", 2014 (the refinement of `Root`).
    Collins and Akritas, "Polynomial real root isolation using Descartes' rule of signs", 1976.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

from flint import fmpz_poly

Poly = tuple[int, ...]  # integer coefficients, lowest degree first; trailing zeros allowed


def signum(value: int) -> int:
    return (value > 0) - (value < 0)


def trimmed(poly: Sequence[int]) -> Poly:
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


def value_dyadic(poly: Poly, a: int, k: int) -> int:
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
        left = value_dyadic(poly, a, k)
        right = value_dyadic(poly, a + 1, k)
        if left and right:
            root.left = signum(left)
        else:
            # An end is a root of its own: the sign beside it is that of the derivative there.
            slope = tuple(i * c for i, c in enumerate(poly))[1:]
            root.left = signum(left) or signum(value_dyadic(slope, a, k))
            while not (value_dyadic(poly, root.a, root.k) and value_dyadic(poly, root.a + 1, root.k)):
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
            left = abs(value_dyadic(poly, self.a, self.k))
            right = abs(value_dyadic(poly, self.a + 1, self.k))
            offset = (((left << (m + 1)) // (left + right)) + 1) >> 1
            guess = (self.a << m) + min(max(offset, 1), (1 << m) - 1)
        sign = signum(value_dyadic(poly, guess, k))
        if sign == 0:
            self.numerator, self.denominator = guess, 1 << k
            return True
        other = guess + (1 if sign == self.left else -1)
        if m > 1:
            sign_other = signum(value_dyadic(poly, other, k))
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
            return signum(self.numerator * denominator - numerator * self.denominator)
        scaled = numerator << self.k
        if scaled <= self.a * denominator:
            return 1
        if scaled >= (self.a + 1) * denominator:
            return -1
        # An irrational root differs from every rational, so the sign here is never zero.
        return 1 if signum(_value(self.poly, numerator, denominator)) == self.left else -1

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
                    if signum(value_dyadic(common, lo, k)) != signum(value_dyadic(common, hi, k)):
                        return 0
            self.refine(k + 16)
            other.refine(k + 16)

    def sign_of(self, poly: Poly) -> int:
        """Sign of an integer polynomial at this number."""
        if self.denominator:
            return signum(_value(poly, self.numerator, self.denominator))
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
                poly = trimmed(poly)
                if not poly:
                    return 0
                common = _gcd(self.poly, poly)
                if len(common) > 1:
                    ends = (value_dyadic(common, self.a, self.k), value_dyadic(common, self.a + 1, self.k))
                    if signum(ends[0]) != signum(ends[1]):
                        return 0
            self.refine(2 * self.k + 8)


ZERO = Root(0, 1)


def variations_on_unit_interval(poly: Poly) -> int:
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


def unit_roots(poly: Poly) -> list[Root]:
    """All distinct roots in [0, 1], in increasing order, of a polynomial that is not identically zero."""
    poly = trimmed(poly)
    roots = []
    if not poly[0]:
        roots.append(ZERO)
        while not poly[0]:
            poly = poly[1:]
    if len(poly) == 1:
        return roots
    variations = variations_on_unit_interval(poly)
    if variations:
        poly = _square_free(poly)
        stack = [(poly, 0, 0)]
        while stack:
            local, a, k = stack.pop()
            if local is None:
                roots.append(Root(a, 1 << k))
                continue
            variations = variations_on_unit_interval(local)
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
