"""Lengths that are rounded up."""

import math
import sys


def half_rounded_up(length: float) -> float:
    """Half a length, rounded up, for the boxes of both primitives of a pair."""
    return 0.0 if length <= 0.0 else next_above(0.5 * length)


def add_rounded_up(a: float, b: float) -> float:
    """The sum of two lengths, rounded up."""
    return a + b if a == 0.0 or b == 0.0 else next_above(a + b)


def next_above(length: float) -> float:
    """The next number above a length, but no larger one than the largest."""
    return min(math.nextafter(length, math.inf), sys.float_info.max)
