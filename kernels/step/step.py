"""A step as the kernels of its search and of half-spaces take it: positions at both ends, and what is found so far."""

import warp as wp

from .minima import Minima


@wp.struct
class ContactList:
    """Contacts of all kinds in any order, as many as the capacity allows, and the number of contacts found."""

    count: wp.array[wp.int32]
    kind: wp.array[wp.int32]
    primitives: wp.array[wp.vec2i]
    toi: wp.array[wp.float64]
    status: wp.array[wp.int32]
    parameters: wp.array[wp.vec2d]
    gap: wp.array[wp.float64]
    width: wp.array[wp.float64]
    normal: wp.array[wp.vec3d]


@wp.struct
class Step:
    """A step of a mesh on its way through the stages."""

    vertices_t0: wp.array[wp.vec3d]
    vertices_t1: wp.array[wp.vec3d]
    counts: wp.array2d[wp.int64]  # of the pairs of each kind; the columns are those of `minima`
    minima: Minima
    contacts: ContactList
    least_bits: wp.array[wp.int64]  # the least toi as bits, where no contacts are kept
