"""A toi near 0 for the minima: the time in which a pair moves by some of its gaps, if that is later.

A step that is as short as such a toi makes no progress, and the pair would stop it again and again.
"""

import warp as wp

# A toi below this may be so small only because the gap is lost in the rounding of a float32 motion.
LOST_TOI = wp.constant(wp.float64(2.0**-20))


@wp.func
def may_be_raised(toi: wp.float64, gaps_moved: wp.float64) -> bool:
    """Whether a toi is near 0, and such a toi is to be raised."""
    return gaps_moved > wp.float64(0.0) and toi < LOST_TOI


@wp.func
def raised_toi(toi: wp.float64, gap: wp.float64, motion: wp.float64, gaps_moved: wp.float64) -> wp.float64:
    """The toi for the minima of a pair that moves by ``motion`` in the step, a length as the gap."""
    if may_be_raised(toi, gaps_moved) and gaps_moved * gap < motion:
        return wp.max(toi, gaps_moved * gap / motion)
    return toi
