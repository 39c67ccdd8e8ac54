"""The kinds of pairs."""

import warp as wp

# ccd_warp.PairKind mirrors these.
VERTEX_FACE = wp.constant(0)
EDGE_EDGE = wp.constant(1)
POINT_SEGMENT = wp.constant(2)
POINT_POINT = wp.constant(3)
VERTEX_PLANE = wp.constant(4)
