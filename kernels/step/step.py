"""A step as the kernels of its search and of half-spaces take it: positions at both ends, and what is found so far."""

import warp as wp

from .contacts import ContactList
from .minima import Minima


@wp.struct
class Step:
    """A step of a mesh on its way through the stages."""

    vertices_t0: wp.array[wp.vec3d]
    vertices_t1: wp.array[wp.vec3d]
    counts: wp.array2d[wp.int64]  # of the pairs of each kind; the columns are those of `minima`
    minima: Minima
    contacts: ContactList
    least_bits: wp.array[wp.int64]  # the least toi as bits, where no contacts are kept
