"""Windows: the parts of a slice over which a pair on arcs is solved on chords, which shorten toward a contact.

A **window** is a part [t, t + h] of a slice. The pair is solved on the chords over it, with their sagitta added to its
separation (`arcs`). Where that is free, the pair is, and the next window is longer; otherwise the pair is free up to
the time found, and the next window begins there and is shorter. The pair touches where a window ends in a contact whose
sagitta is of the size of rounding errors.

**How much shorter.** A window of length h that ends in a contact after a gain g leaves a gap of its sagitta, which a
pair that goes on as it came crosses in the time g·(h / h')², h' the length of the window before that ended in a
contact. A chord of four times that length has the contact in its middle, and leaves a gap that is smaller by the square
of the ratio of both: Newton's iteration, from below. In lanes windows that end where a pair seems to meet come first
(`lane_windows`).
"""

import warp as wp

from ..parameters import width
from ..template import specialised
from .rounding import UNIT_ROUNDOFF

simd = specialised("pair.simd", width=width)
Lanes = simd.Lanes

zero = wp.constant(wp.float64(0.0))
four = wp.constant(wp.float64(4.0))
eighth = wp.constant(wp.float64(0.125))
least_share = wp.constant(wp.float64(2.0**-10))
slice_down = wp.constant(wp.float64(1.0 - 8.0 * UNIT_ROUNDOFF[wp.float64]))
step_down = wp.constant(wp.float64(1.0 - 4.0 * UNIT_ROUNDOFF[wp.float64]))


@simd.func
def in_slice(t: Lanes, begin: Lanes, length: Lanes) -> Lanes:
    """A time of the step as one of the slice, rounded down, which begins then and is so long."""
    since = (t - begin) / length
    return simd.greatest(since * slice_down, zero)


@simd.func
def in_step(t: Lanes, begin: Lanes, length: Lanes) -> Lanes:
    """A time of the slice as one of the step, rounded down."""
    return (begin + length * t) * step_down


@wp.struct
class Window:
    """The window of each lane."""

    begin: Lanes
    h: Lanes
    last: Lanes  # length of the last window that ended in a contact; 0 before there is one


@simd.func
def reached(window: Window, end: Lanes, is_free: simd.Mask, share: Lanes) -> Lanes:
    """The time up to which a window shows that a pair is free: its end, or after a share of it, rounded down."""
    t = (window.begin + window.h * share * slice_down) * step_down
    return simd.select(is_free, end, simd.least(simd.greatest(window.begin, t), end))


@simd.func
def next_window(window: Window, t: Lanes, is_free: simd.Mask) -> Window:
    """The window after one that is free up to a time."""
    gain = t - window.begin
    shorter = eighth * window.h
    ratio = window.h / simd.greatest(window.last, window.h)
    ahead = simd.greatest(four * gain * (ratio * ratio), least_share * window.h)
    ahead = simd.select(simd.is_less(zero, window.last), simd.least(shorter, ahead), shorter)
    r = Window()
    r.begin = t
    r.last = simd.select(is_free, window.last, window.h)
    r.h = simd.select(is_free, four * window.h, ahead)
    return r
