"""Axis-aligned boxes around a moving point, in float64 and rounded outward."""

import warp as wp

from ..pair.rounding import INTERPOLATION, UNIT_ROUNDOFF

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

_LARGEST_FINITE = wp.constant(wp.float64(1.7976931348623157e308))
_ONE = wp.constant(wp.float64(1.0))
_INTERPOLATION = wp.constant(wp.float64(INTERPOLATION * UNIT_ROUNDOFF[wp.float64]))
_UNDERFLOW = wp.constant(wp.float64(2.0**-1070))


@wp.struct
class Box:
    """A closed box."""

    lower: wp.vec3d
    upper: wp.vec3d


@wp.func
def next_below(x: wp.float64) -> wp.float64:
    """Largest float64 below x; minus infinity stays."""
    bits = wp.cast(x, wp.int64)
    if x == wp.float64(0.0):
        bits = wp.int64(-9223372036854775807)  # the smallest negative number, 0x8000000000000001
    elif x > wp.float64(0.0):
        bits = bits - wp.int64(1)
    elif bits != wp.int64(-4503599627370496):  # 0xfff0000000000000, minus infinity
        bits = bits + wp.int64(1)
    return wp.cast(bits, wp.float64)


@wp.func
def point_box(a: wp.vec3d) -> Box:
    """The box of a point."""
    box = Box()
    box.lower = a
    box.upper = a
    return box


@wp.func
def united(a: Box, b: Box) -> Box:
    """The box around two boxes."""
    box = Box()
    box.lower = wp.min(a.lower, b.lower)
    box.upper = wp.max(a.upper, b.upper)
    return box


@wp.func
def end_box(a: wp.vec3d, b: wp.vec3d, t_end: wp.float64) -> Box:
    """A box around the position at ``t_end`` of a point that moves from a to b (rounding, step 12)."""
    if not t_end < _ONE:
        return point_box(b)
    end = (_ONE - t_end) * a + t_end * b
    error = _INTERPOLATION * wp.max(wp.abs(a), wp.abs(b)) + wp.vec3d(_UNDERFLOW, _UNDERFLOW, _UNDERFLOW)
    box = Box()
    box.lower = wp.max(end - error, wp.min(a, b))
    box.upper = wp.min(end + error, wp.max(a, b))
    return box


@wp.func
def inflated_below(x: wp.float64, inflation: wp.float64) -> wp.float64:
    """A lower bound minus ``inflation``: the difference rounds to nearest, so its neighbour bounds the exact value.

    Where it overflows, minus the largest finite number suffices: no coordinate lies below it.
    """
    return wp.max(next_below(x - inflation), -_LARGEST_FINITE)


@wp.func
def inflated(box: Box, inflation: wp.float64) -> Box:
    """The box enlarged by ``inflation`` on every side, rounded outward."""
    if inflation > wp.float64(0.0):
        for k in range(3):
            box.lower[k] = inflated_below(box.lower[k], inflation)
            box.upper[k] = -inflated_below(-box.upper[k], inflation)
    return box
