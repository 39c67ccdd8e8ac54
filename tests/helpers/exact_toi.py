"""An exact time of impact, and comparisons with it."""

from __future__ import annotations

import math

from algebraic import Root, signum
from flint import fmpq


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
        return self.hit and self.root.value is not None

    def refine(self, bits: int = 80) -> tuple[fmpq, fmpq]:
        """Rational lo <= tau <= hi with hi - lo <= 2**-bits * hi."""
        if self.root is None:
            raise ValueError("there is no contact to refine")
        scale = fmpq(*self.t_max.as_integer_ratio())
        lo, hi = self.root.bounds(bits)
        return scale * lo, scale * hi

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
            return signum(toi)
        p, q = toi.as_integer_ratio()
        mp, mq = self.t_max.as_integer_ratio()
        return Root(p * mq, q * mp).compare(self.root)

    def late(self, toi: float) -> bool:
        """Whether toi > tau, exactly: a missed collision. Equal is not late; without a hit nothing is late."""
        return self.hit and self.compare(toi) > 0

    def early_by(self, toi: float) -> float:
        """tau - toi, rounded once from exact arithmetic, so that a difference far below 1e-16 is still seen."""
        if not self.hit or math.isinf(toi):
            raise ValueError("early_by needs a hit and a finite toi")
        p, q = float(toi).as_integer_ratio()
        difference = self.refine(200)[0] - fmpq(p, q)
        return int(difference.p) / int(difference.q)

    def __repr__(self) -> str:
        if not self.hit:
            return "ExactToi(none)"
        return f"ExactToi({self.approx!r}, {'rational' if self.rational else 'irrational'})"
