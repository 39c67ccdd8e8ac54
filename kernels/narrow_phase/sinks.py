"""Where what is found of pairs goes: a table of pairs given by their points, a list of contacts, a bound of the toi.

At one time: a list of what is near, bounds of displacements, or how near vertices are to anything.
"""

import warp as wp

# Sinks; the first is of pairs that are given by their points, the others of pairs of primitives of a mesh.
TABLE = wp.constant(0)
CONTACTS = wp.constant(1)
BOUND = wp.constant(2)
NEAR = wp.constant(3)
DISPLACEMENT = wp.constant(4)
START_DISTANCE = wp.constant(5)


@wp.struct
class Table:
    """Pairs given by their points, shape [n, 4], [n, 3] or [n, 2], and what is found of each."""

    points_t0: wp.array2d[wp.vec3d]
    points_t1: wp.array2d[wp.vec3d]
    toi: wp.array[wp.float64]
    status: wp.array[wp.int32]
    parameters: wp.array[wp.vec2d]
    gap: wp.array[wp.float64]
    width: wp.array[wp.float64]
    iterations: wp.array[wp.int32]
