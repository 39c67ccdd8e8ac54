"""How the vertices of a mesh turn in a slice of a step (`arcs`)."""

import warp as wp


@wp.struct
class Turns:
    """What is known of all vertices; lengths are of the whole slice. The arrays are empty if none turns."""

    velocity: wp.array[wp.vec3d]  # of each vertex: the part of its velocity at the start that turns with its body
    omega: wp.array[wp.vec3d]  # rotation vector of each body in the whole step; 0 where it does not turn
    slack: wp.array[wp.float64]  # of each vertex: by how much rounding may move it
    excess: wp.array[wp.float64]  # of each body: how far its points may be from their arcs besides
    vertex_body: wp.array[wp.int32]
    t_begin: wp.array[wp.float64]  # of each body: the slice as part of the step
    t_end: wp.array[wp.float64]


@wp.func
def turns_anywhere(vertices: wp.vec3i, turns: Turns) -> bool:
    """Whether a vertex of a primitive turns: then it moves, also where it is at one place at both ends of a slice."""
    for k in range(3):
        v = turns.velocity[vertices[k]]
        if v[0] != wp.float64(0.0) or v[1] != wp.float64(0.0) or v[2] != wp.float64(0.0):
            return True
    return False
