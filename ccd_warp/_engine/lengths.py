"""Lengths of a call: the unit of tolerance and separation, and lengths that are rounded up."""

import math
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ccd_warp._input.options import Options
    from ccd_warp._mesh import CollisionMesh


def length_scale_of(mesh: "CollisionMesh", options: "Options") -> float:
    """The unit of tolerance and separation: that of the options, or the size of the mesh."""
    return mesh.length_scale if options.length_scale is None else options.length_scale


def half_up(length: float) -> float:
    """Half a length, rounded up, for the boxes of both primitives of a pair."""
    return 0.0 if length <= 0.0 else next_above(0.5 * length)


def sum_up(a: float, b: float) -> float:
    """The sum of two lengths, rounded up."""
    return a + b if a == 0.0 or b == 0.0 else next_above(a + b)


def next_above(length: float) -> float:
    """The next number above a length, but no larger one than the largest."""
    return min(math.nextafter(length, math.inf), sys.float_info.max)
