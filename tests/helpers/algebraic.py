"""Real algebraic numbers: the roots in [0, 1] of polynomials with integer coefficients, and signs at them.

FLINT factors the polynomials. No two irreducible factors have a root in common, so that two numbers are equal, or one
is a root of a polynomial, only where factors are; and one of degree two or more has no root that is rational.

References:
    Collins and Akritas, "Polynomial real root isolation using Descartes' rule of signs", 1976.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cmp_to_key
from itertools import pairwise

from flint import arb, ctx, fmpq, fmpz_poly

Poly = tuple[int, ...]  # integer coefficients, lowest degree first; trailing zeros allowed


def signum(value: int | fmpq | arb) -> int:
    """The sign of a number, or of an interval: 0 where that is not certain."""
    return (value > 0) - (value < 0)


def trimmed(poly: Sequence[int]) -> Poly:
    n = len(poly)
    while n and not poly[n - 1]:
        n -= 1
    return tuple(poly[:n])


def _value_dyadic(poly: Poly, a: int, k: int) -> int:
    """poly(a / 2**k) times 2**(k degree)."""
    total = shift = 0
    for c in reversed(poly):
        total = total * a + (c << shift)
        shift += k
    return total


class Root:
    """A real algebraic number in [0, 1]: a rational one, or an irrational root in an open dyadic interval.

    `value` is the rational one; where it is None the number is the only root of the irreducible `poly` in
    (a, a + 1) / 2**k, to the left of which that has the sign `left`.
    """

    __slots__ = ("a", "k", "left", "poly", "value")

    def __init__(self, numerator: int, denominator: int = 1) -> None:
        self.value = fmpq(numerator, denominator)

    @classmethod
    def isolated(cls, poly: Poly, a: int, k: int) -> Root:
        """The only root in (a, a + 1) / 2**k of an irreducible polynomial of degree two or more."""
        root = cls(0)
        root.value, root.poly, root.a, root.k = None, poly, a, k
        root.left = signum(_value_dyadic(poly, a, k))
        return root

    def refine(self, k: int) -> None:
        """Narrows the interval to 2**-k or less; nothing to do for a rational."""
        while self.value is None and self.k < k:
            self.a, self.k = 2 * self.a, self.k + 1
            self.a += signum(_value_dyadic(self.poly, self.a + 1, self.k)) == self.left

    def bounds(self, bits: int) -> tuple[fmpq, fmpq]:
        """Rational lo <= self <= hi with hi - lo <= 2**-bits * hi; both are the number if it is rational."""
        if self.value is not None:
            return self.value, self.value
        while self.a.bit_length() <= bits:
            self.refine(self.k + bits + 1 - self.a.bit_length())
        return fmpq(self.a, 1 << self.k), fmpq(self.a + 1, 1 << self.k)

    def compare(self, other: Root) -> int:
        """Sign of this number minus the other one."""
        if self.value is not None:
            return signum(self.value - other.value) if other.value is not None else -other.compare(self)
        if other.value is not None:
            if not fmpq(self.a, 1 << self.k) < other.value < fmpq(self.a + 1, 1 << self.k):
                return signum(fmpq(self.a, 1 << self.k) - other.value) or 1
            return 1 if signum(fmpz_poly(list(self.poly))(other.value)) == self.left else -1
        while True:
            k = max(self.k, other.k)
            self.refine(k)
            other.refine(k)
            if self.a != other.a or self.poly == other.poly:
                return signum(self.a - other.a)
            self.refine(k + 16)

    def sign_of(self, poly: Poly) -> int:
        """Sign of an integer polynomial at this number."""
        values = fmpz_poly(list(poly))
        if self.value is not None:
            return signum(values(self.value))
        if not values % fmpz_poly(list(self.poly)):
            return 0
        while True:
            with ctx.workprec(2 * self.k + 64):
                interval = (arb(2 * self.a + 1) + arb(0, 1)) / (2 << self.k)
                if sign := signum(values(interval)):
                    return sign
            self.refine(2 * self.k + 8)


ZERO, ONE = Root(0), Root(1)


def _shifted(poly: Sequence[int]) -> list[int]:
    """The polynomial of x + 1."""
    shifted = list(poly)
    for i in range(len(poly) - 1):
        for j in range(len(poly) - 2, i - 1, -1):
            shifted[j] += shifted[j + 1]
    return shifted


def variations_on_unit_interval(poly: Sequence[int]) -> int:
    """Descartes' bound on the number of roots in (0, 1): 0 and 1 are exact, with multiplicity."""
    # reversed and shifted by one, the roots of (0, 1) are those of (0, inf)
    signs = [c > 0 for c in _shifted(poly[::-1]) if c]
    return sum(s != t for s, t in pairwise(signs))


def _irrational_roots(poly: Poly) -> Iterator[Root]:
    """The roots in (0, 1) of an irreducible polynomial of degree two or more."""
    stack = [(poly, 0, 0)]  # polynomials of s, where t = (a + s) / 2**k
    while stack:
        local, a, k = stack.pop()
        variations = variations_on_unit_interval(local)
        if variations == 1:
            yield Root.isolated(poly, a, k)
        elif variations > 1:
            left = [c << (len(local) - 1 - i) for i, c in enumerate(local)]
            stack += [(_shifted(left), 2 * a + 1, k + 1), (left, 2 * a, k + 1)]


def unit_roots(poly: Poly) -> list[Root]:
    """All distinct roots in [0, 1], in increasing order, of a polynomial that is not identically zero."""
    poly, roots = trimmed(poly), []
    if poly[0] and sum(poly) and not variations_on_unit_interval(poly):
        return roots
    for factor, _ in fmpz_poly(list(poly)).factor()[1]:
        coefficients = tuple(map(int, factor.coeffs()))
        if len(coefficients) > 2:
            roots += _irrational_roots(coefficients)
        elif 0 <= -coefficients[0] <= coefficients[1]:  # whose leading coefficient is positive
            roots.append(Root(-coefficients[0], coefficients[1]))
    return sorted(roots, key=cmp_to_key(Root.compare))
