"""Which parts of bodies that turn may touch in a slice of the step: trees of boxes, tested from the top.

The parts of a body are the leaves of a tree without pointers: node n of the 2^(d + 1) - 1 nodes of a body with 2^d
parts has the children 2n + 1 and 2n + 2. A node has a sphere and an oriented box around the same centre, in the frame
of its body.

**Any direction is a proof.** Two nodes cannot touch in a slice if in its middle they are farther apart along some
direction d than their points come nearer along it in half of the slice: no more than |d·v| h + A h²/2 + ω r h, with v
the velocity of their centres against each other in the middle, A a bound of what the paths of the centres bend, and r
the radii of the nodes, which turn by ω h; and no more than their points move at all. Directions are those of the
centres and of the sides of both boxes. Otherwise the larger of both nodes is divided into its children.
"""

import warp as wp

from ..atomics import claim
from ..interrupts import is_stopped
from ..pair.rounding import UNIT_ROUNDOFF

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

# A traversal keeps the second children of nodes of both trees, no deeper than 28 as primitives are numbered in 31 bits.
_STACK = 64
_TWO = wp.constant(wp.float64(2.0))
_ZERO = wp.constant(wp.float64(0.0))
# Of places, lengths and distances, relative to the coordinates of both.
_ERROR = wp.constant(wp.float64(128.0 * UNIT_ROUNDOFF[wp.float64]))
# Of lengths, whose squares vanish below 1e-162 and are rounded coarsely up to 1e-154.
_UNDERFLOW = wp.constant(wp.float64(1e-150))

Stack = wp.types.vector(length=_STACK, dtype=wp.int32)
vec6d = wp.types.vector(length=6, dtype=wp.float64)


@wp.struct
class PartTrees:
    """The trees of all bodies, those of a body one after another."""

    first: wp.array[wp.int32]  # node of each body
    num_parts: wp.array[wp.int32]  # of each body, a power of two
    first_part: wp.array[wp.int32]
    link: wp.array[wp.int32]  # the row of a motion that a body is; -1 of one that stands
    centre: wp.array[wp.vec3d]  # of each node
    arm: wp.array[wp.float64]  # its length
    radius: wp.array[wp.float64]  # of a sphere around the node
    axes: wp.array2d[wp.vec3d]  # directions of the sides of a box around it
    half: wp.array[wp.vec3d]  # half of each side
    thickness: wp.array[wp.float64]  # the largest radius of its vertices, around both


@wp.struct
class PartMotion:
    """Where bodies are in slices of the step, and how far they go."""

    # of each link in the middle of each slice: [slice, link]
    position: wp.array2d[wp.vec3d]
    rotation: wp.array2d[wp.vec4d]  # unit quaternions
    velocity: wp.array2d[wp.vec3d]  # of the origin, times half the slice
    omega: wp.array2d[wp.vec3d]  # rotation in half the slice
    # How far the origin of a link goes from the middle of a slice at most, what rounding adds, and both of its turn in
    # radians: points go as far as the first and the turn times their arm. Then how far the path of the origin bends
    # from its velocity in the middle at most, and what an arm adds to that, times its length.
    reach: wp.array2d[vec6d]


@wp.struct
class PartPairs:
    """Pairs of parts that may touch, in no order; more than the capacity are counted, but not kept."""

    count: wp.array2d[wp.int64]  # [1, 1]
    row: wp.array[wp.int32]  # the slice
    a: wp.array[wp.int32]
    b: wp.array[wp.int32]


@wp.struct
class Sides:
    """The directions of the sides of a box."""

    x: wp.vec3d
    y: wp.vec3d
    z: wp.vec3d


@wp.struct
class PlacedNode:
    """A node in the world, in the middle of a slice."""

    centre: wp.vec3d
    velocity: wp.vec3d  # of the centre
    sides: Sides
    bend: wp.float64  # how far points may be from where the velocity of the centre takes it


@wp.func
def turned(q: wp.vec4d, x: wp.vec3d) -> wp.vec3d:
    """A vector turned by a unit quaternion."""
    axis = wp.vec3d(q[0], q[1], q[2])
    twice = _TWO * wp.cross(axis, x)
    return x + q[3] * twice + wp.cross(axis, twice)


@wp.func
def along_sides(sides: Sides, x: wp.vec3d) -> wp.vec3d:
    """A vector along each side."""
    return wp.vec3d(wp.dot(sides.x, x), wp.dot(sides.y, x), wp.dot(sides.z, x))


@wp.func
def placed(trees: PartTrees, motion: PartMotion, row: int, link: int, n: int) -> PlacedNode:
    """Node n of a link, or of a body that stands."""
    r = PlacedNode()
    r.centre = trees.centre[n]
    r.sides.x = trees.axes[n, 0]
    r.sides.y = trees.axes[n, 1]
    r.sides.z = trees.axes[n, 2]
    if link >= 0:
        q = motion.rotation[row, link]
        reach = motion.reach[row, link]
        arm = turned(q, r.centre)
        r.centre = motion.position[row, link] + arm
        r.velocity = motion.velocity[row, link] + wp.cross(motion.omega[row, link], arm)
        r.sides.x = turned(q, r.sides.x)
        r.sides.y = turned(q, r.sides.y)
        r.sides.z = turned(q, r.sides.z)
        bent = reach[4] + reach[5] * trees.arm[n] + (reach[2] + reach[3]) * trees.radius[n]
        r.bend = bent + reach[1] + reach[3] * trees.arm[n]
    return r


@wp.func
def largest(x: wp.vec3d) -> wp.float64:
    """The largest magnitude of a coordinate."""
    return wp.max(wp.max(wp.abs(x[0]), wp.abs(x[1])), wp.abs(x[2]))


@wp.func
def along(size: wp.vec3d, d: wp.vec3d) -> wp.float64:
    """How far a box reaches along a direction in its own axes."""
    return size[0] * wp.abs(d[0]) + size[1] * wp.abs(d[1]) + size[2] * wp.abs(d[2])


@wp.struct
class Separation:
    """How far two nodes stay apart in a slice along the best direction, and what motion and both nodes take of that."""

    least: wp.float64
    lost: wp.float64


@wp.func
def better(best: Separation, apart: wp.float64, moves: wp.float64, of_a: wp.float64, of_b: wp.float64) -> Separation:
    """The better one of a separation and that along another direction."""
    r = best
    least = apart - moves - of_a - of_b
    if least > best.least:
        r.least = least
        r.lost = moves + of_a + of_b
    return r


@wp.func
def separation(
    trees: PartTrees,
    a: PlacedNode,
    b: PlacedNode,
    m: int,
    n: int,
    most: wp.float64,
    turns: wp.float64,
) -> Separation:
    """How far two nodes, m and n, stay apart: their centres come by ``most`` nearer to each other, or points by more.

    Spheres turn into themselves; the points of a box do not, and have longer arms than the centre.
    """
    apart = b.centre - a.centre
    speed = b.velocity - a.velocity
    bend = a.bend + b.bend
    radius_a = trees.radius[m]
    radius_b = trees.radius[n]
    half_a = trees.half[m]
    half_b = trees.half[n]
    distance = wp.length(apart)
    r = Separation()
    r.least = distance - most - radius_a - radius_b
    r.lost = most + radius_a + radius_b
    most += turns
    apart_a = along_sides(a.sides, apart)
    apart_b = along_sides(b.sides, apart)
    speed_a = along_sides(a.sides, speed)
    speed_b = along_sides(b.sides, speed)
    if distance > _ZERO:
        moves = wp.min(most, wp.abs(wp.dot(apart, speed)) / distance + bend)
        towards_a = wp.min(radius_a, along(half_a, apart_a) / distance)
        towards_b = wp.min(radius_b, along(half_b, apart_b) / distance)
        r = better(r, distance, moves, towards_a, towards_b)
    # the sides of a along those of b, and the other way round
    x = along_sides(b.sides, a.sides.x)
    y = along_sides(b.sides, a.sides.y)
    z = along_sides(b.sides, a.sides.z)
    of_b = wp.vec3d(along(half_b, x), along(half_b, y), along(half_b, z))
    x = wp.abs(x)
    y = wp.abs(y)
    z = wp.abs(z)
    of_a = half_a[0] * x + half_a[1] * y + half_a[2] * z
    for k in range(3):
        r = better(r, wp.abs(apart_a[k]), wp.min(most, wp.abs(speed_a[k]) + bend), half_a[k], wp.min(radius_b, of_b[k]))
        r = better(r, wp.abs(apart_b[k]), wp.min(most, wp.abs(speed_b[k]) + bend), wp.min(radius_a, of_a[k]), half_b[k])
    return r


@wp.kernel
def find_overlapping_parts(
    begin: int,
    # in
    body_pairs: wp.array[wp.vec2i],  # the first is a link
    trees: PartTrees,
    motion: PartMotion,
    reach: wp.float64,
    stop: wp.array[wp.int32],
    # out
    pairs: PartPairs,
):
    """List the pairs of parts of a pair of bodies that may come within ``reach`` in a slice."""
    item = begin + wp.tid()
    num_pairs = body_pairs.shape[0]
    row = item / num_pairs
    bodies = body_pairs[item % num_pairs]
    link_a = trees.link[bodies[0]]
    link_b = trees.link[bodies[1]]
    first_a = trees.first[bodies[0]]
    first_b = trees.first[bodies[1]]
    inner_a = trees.num_parts[bodies[0]] - 1  # so many nodes of the body have children
    inner_b = trees.num_parts[bodies[1]] - 1
    goes_a = motion.reach[row, link_a]
    goes_b = vec6d()
    if link_b >= 0:
        goes_b = motion.reach[row, link_b]
    turn_a = goes_a[2] + goes_a[3]
    turn_b = goes_b[2] + goes_b[3]
    nodes_a = Stack()
    nodes_b = Stack()
    size = wp.int32(1)
    while size > 0:
        if is_stopped(stop):
            return
        size -= 1
        a = nodes_a[size]
        b = nodes_b[size]
        m = first_a + a
        n = first_b + b
        node_a = placed(trees, motion, row, link_a, m)
        node_b = placed(trees, motion, row, link_b, n)
        most = goes_a[0] + goes_b[0] + (goes_a[1] + goes_b[1]) + turn_a * trees.arm[m] + turn_b * trees.arm[n]
        turns = turn_a * trees.radius[m] + turn_b * trees.radius[n]
        best = separation(trees, node_a, node_b, m, n, most, turns)
        lengths = reach + trees.thickness[m] + trees.thickness[n] + best.lost
        size_of_both = largest(node_a.centre) + largest(node_b.centre) + trees.radius[m] + trees.radius[n] + lengths
        if best.least > reach + trees.thickness[m] + trees.thickness[n] + _ERROR * size_of_both + _UNDERFLOW:
            continue  # not where a number is none, which is near
        splits_a = a < inner_a
        splits_b = b < inner_b
        if splits_a and (not splits_b or trees.radius[m] >= trees.radius[n]):
            for k in range(2):
                nodes_a[size] = 2 * a + 2 - k
                nodes_b[size] = b
                size += 1
        elif splits_b:
            for k in range(2):
                nodes_a[size] = a
                nodes_b[size] = 2 * b + 2 - k
                size += 1
        else:
            place = claim(pairs.count, 0, 0, 1)
            if place < wp.int64(pairs.a.shape[0]):
                k = wp.int32(place)
                pairs.row[k] = row
                pairs.a[k] = trees.first_part[bodies[0]] + a - inner_a
                pairs.b[k] = trees.first_part[bodies[1]] + b - inner_b
