"""The parameters of the templates, as those see them who import a template plainly: one pair in float64.

A template (`template`) imports from here the parameters that it depends on, and has their values of the specialisation.
"""

from typing import Any

import warp as wp

from .pair.norm import Norm

real: Any = wp.float64  # floating-point type of the iteration
width = 1  # number of lanes
norm = Norm.MAXIMUM  # that of the separation (`norm`)
sink = 0  # where the outcomes of a kernel of the narrow phase on CUDA go (`sinks`)
stage = "first"  # which of the kernels of a round it is (`queued_pairs`)
only_method = ""  # of single pairs on CUDA: "clipping", by all threads of a warp, or "bisection", by one
with_facets = True  # whether rounds are later ones, with facets or directions that turn
dimension = 3  # of the positions that are read or written
end = "list"  # stage at which a search ends (`search_types`)
with_lists = False  # whether there are lists of excluded pairs
is_thick = False  # whether vertices have radii
in_warps = False  # whether a warp takes queries of a search, as on CUDA
