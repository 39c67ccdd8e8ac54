"""How the result of a pair was obtained."""

import warp as wp

# Status of a pair; ccd_warp.CCDStatus mirrors these.
STATUS_NO_COLLISION = wp.constant(0)
STATUS_COLLISION = wp.constant(1)
STATUS_INITIAL_CONTACT = wp.constant(2)
STATUS_ITERATION_LIMIT = wp.constant(3)
STATUS_RESOLUTION_LIMIT = wp.constant(4)
STATUS_INVALID = wp.constant(5)
STATUS_ROUNDING_LIMIT = wp.constant(6)
