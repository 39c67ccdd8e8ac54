"""Which parts of bodies that turn may touch, and in which slices of the step: trees of boxes and of times.

The parts of a body are the leaves of a tree without pointers: node n of the 2^(d + 1) - 1 nodes of a body with 2^d
parts has the children 2n + 1 and 2n + 2; its root is the whole body. A node has a sphere and an oriented box around the
same centre, in the frame of its body.

**Any direction is a proof.** Two nodes cannot touch between two times, h before and after their middle, if they are
farther apart along a direction d in the middle than their points come nearer along it. With V the velocity of the
centres against each other in the middle and v its part that stays the same, ω the turn of a body, k the sine of the
angle between d and ω, ρ the distance of a centre from its pivot, u the part of the velocity of the pivot that turns
with the body and r the radius of a node, that is no more than

    |d·V| h + Σ k ω(|u| + ωρ) h²/2    or    |d·v| h + Σ k (min(ωh, 2) ρ + min(h, 2/ω) |u|)

for the centres, and k min(ωh, 2) r for the points of each box; a sphere turns into itself. Along the axis of a body
nothing turns. For an observer who turns with one of both, that body stands, and the other turns by w, the difference
of both: its centre is at D, which changes by D' in the middle, and is off by at most h²/2 times

    (|w × ω| + w²) ρ + w |u| + ω |difference of u| + 2|ω × v| + ω |ω × P|

with ω of the observer, ρ and u of the other, and P between their pivots. P and u are those in the middle: of P + vs,
which is turned by -sω a time s later, P leaves its tangent by at most ω|ω × P| s²/2, and vs leaves vs by |ω × v| s²,
the half of what counts for it; nothing of them is linear in s beside D'. So two bodies that share a spin are at rest.
Directions are those of the centres, of the sides of both boxes and of both axes. What they do not separate is divided,
the times where motion takes more than the nodes do, and otherwise the larger node, down to parts in slices.

Where rows stand on the device and are not known beforehand, the tree of a body is its root, made in each step.
"""

import warp as wp

from ..interrupts import is_stopped
from ..pair.rounding import PLACE, PLACE_POSITION, UNIT_ROUNDOFF
from .place_bodies import BodyPaths, BodyPlace, place_at, rotated

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

# A traversal keeps the second halves of what it divides: nodes of both trees, no deeper than 28 as primitives are
# numbered in 31 bits, and times, no deeper than 23 as no body turns by more than a million radians.
_STACK = 80
_DIRECTIONS = wp.constant(9)
_ZERO = wp.constant(wp.float64(0.0))
_HALF = wp.constant(wp.float64(0.5))
_ONE = wp.constant(wp.float64(1.0))
_TWO = wp.constant(wp.float64(2.0))
# Of places, lengths and distances, relative to the coordinates of both.
_ERROR = wp.constant(wp.float64(256.0 * UNIT_ROUNDOFF[wp.float64]))
# Of a centre: four times what rounding moves a vertex by (rounding, step 18).
_PLACE_POSITION = wp.constant(wp.float64(4.0 * PLACE_POSITION * UNIT_ROUNDOFF[wp.float64]))
_PLACE = wp.constant(wp.float64(4.0 * PLACE * UNIT_ROUNDOFF[wp.float64]))
# Of lengths, whose squares vanish below 1e-162 and are rounded coarsely up to 1e-154; a smaller turn has no axis.
_UNDERFLOW = wp.constant(wp.float64(1e-150))
# The narrow phase may count as touching what is off in the corner of a box: the square root of three, rounded up.
_DIAGONAL = wp.constant(wp.float64(1.75))
# Of half sides and radii.
_UP = wp.constant(wp.float64(1.0 + 64.0 * UNIT_ROUNDOFF[wp.float64]))
# No distance whose square overflows is less.
_OVERFLOW = wp.constant(wp.float64(1e154))
# What of two nodes is divided.
_TIME = wp.constant(0)
_FIRST = wp.constant(1)
_SECOND = wp.constant(2)
_NOTHING = wp.constant(3)

Stack = wp.types.vector(length=_STACK, dtype=wp.int32)


@wp.struct
class PartTrees:
    """The trees of all bodies, those of a body one after another."""

    first: wp.array[wp.int32]  # node of each body
    num_parts: wp.array[wp.int32]  # of each body, a power of two
    first_part: wp.array[wp.int32]
    link: wp.array[wp.int32]  # the row of a motion, of its rows of a world, that a body is; -1 of one that stands
    centre: wp.array[wp.vec3d]  # of each node
    radius: wp.array[wp.float64]  # of a sphere around the node
    axes: wp.array2d[wp.vec3d]  # directions of the sides of a box around it
    half: wp.array[wp.vec3d]  # half of each side
    thickness: wp.array[wp.float64]  # the largest radius of its vertices, around both
    plane_point: wp.array[wp.vec3d]
    plane_normal: wp.array[wp.vec3d]  # of length 1


@wp.struct
class NearMarks:
    """What may touch, 1 for each body or part that does; a part may also touch a half-space."""

    bodies: wp.array2d[wp.int32]  # in each slice, those of one world after those of another, [S, W * B]
    is_any: wp.array[wp.int32]  # whether any does in a slice, [S]
    parts: wp.array2d[wp.int32]  # of each world in any slice, [W, P]; empty where they are not asked for


@wp.struct
class MovedBody:
    """A body in the middle between two times."""

    place: BodyPlace
    pivot: wp.vec3d
    line: wp.vec3d  # the part of its velocity that stays
    omega: wp.vec3d
    turn: wp.float64
    turning: wp.float64  # the length of what turns of the velocity of its pivot
    excess: wp.float64  # how far its points may be from where they are computed, and of that what is relative to arms
    wrong: wp.float64


@wp.struct
class MovedNode:
    """A node of such a body."""

    centre: wp.vec3d
    velocity: wp.vec3d  # of the centre
    arm: wp.float64  # distance of the centre from the pivot
    x: wp.vec3d  # directions of the sides of its box
    y: wp.vec3d
    z: wp.vec3d
    half: wp.vec3d
    radius: wp.float64
    bend: wp.float64  # how far the centre may be from where its velocity takes it
    turned: wp.float64  # how far the turn alone takes it at most
    swing: wp.float64  # how far the turn takes the points of the node from where they are to the centre
    error: wp.float64


@wp.struct
class Observed:
    """How a node moves for an observer who turns with the other body."""

    velocity: wp.vec3d
    bend: wp.float64
    swing: wp.float64


@wp.struct
class Separation:
    """How far two nodes stay apart along the best direction, and what their motion takes of that."""

    least: wp.float64
    moved: wp.float64


@wp.struct
class BodyPair:
    """Two bodies of a world, or one and a half-space."""

    world: int
    first: int
    second: int  # the first again where there is a half-space
    is_plane: bool
    plane: int
    row_a: int  # of a motion; negative of a body that stands
    row_b: int
    inner_a: int  # so many nodes of the body have children
    inner_b: int


@wp.struct
class Approach:
    """Whether two nodes may come near each other, and how far motion takes them."""

    is_near: bool
    moved: wp.float64
    radius_a: wp.float64
    radius_b: wp.float64  # 0 of a half-space


@wp.func
def moved_body(paths: BodyPaths, row: int, t: wp.float64, h: wp.float64) -> MovedBody:
    """The body of a row of a motion; one that stands has none."""
    r = MovedBody()
    r.place.rotation = wp.vec4d(_ZERO, _ZERO, _ZERO, _ONE)
    r.turn = _UNDERFLOW
    if row >= 0:
        r.place = place_at(paths, row, t)
        r.pivot = paths.pivot[row]
        r.line = paths.velocity[row]
        r.omega = paths.omega[row]
        r.turn = wp.max(wp.length(r.omega), _UNDERFLOW)
        r.turning = wp.length(r.place.turning)
        start = paths.start[row]
        far = wp.max(wp.max(wp.abs(start)), wp.max(wp.abs(start + r.line)))
        r.wrong = _PLACE * (_ONE + _HALF * r.turn) * (_ONE + h * r.turn)
        r.excess = _DIAGONAL * paths.excess[row] + _PLACE_POSITION * far
        r.excess += r.wrong * (wp.length(r.pivot) + r.turning + wp.length(r.line))
    return r


@wp.func
def moved_node(trees: PartTrees, n: int, body: MovedBody, is_standing: bool, h: wp.float64) -> MovedNode:
    """Node n of a body."""
    r = MovedNode()
    r.centre = trees.centre[n]
    r.x = trees.axes[n, 0]
    r.y = trees.axes[n, 1]
    r.z = trees.axes[n, 2]
    r.half = trees.half[n]
    r.radius = trees.radius[n]
    if not is_standing:
        q = body.place.rotation
        size = largest(r.centre)
        arm = rotated(q, r.centre - body.pivot)
        r.centre = body.place.position + arm
        r.velocity = body.line + body.place.turning + wp.cross(body.omega, arm)
        r.arm = wp.length(arm)
        r.x = rotated(q, r.x)
        r.y = rotated(q, r.y)
        r.z = rotated(q, r.z)
        angle = wp.min(h * body.turn, _TWO)
        r.bend = _HALF * h * h * body.turn * (body.turning + body.turn * r.arm)
        r.turned = angle * r.arm + wp.min(h, _TWO / body.turn) * body.turning
        r.swing = angle * r.radius
        r.error = body.excess + body.wrong * (r.arm + size + r.radius)
    return r


@wp.func
def largest(x: wp.vec3d) -> wp.float64:
    """The largest magnitude of a coordinate."""
    return wp.max(wp.max(wp.abs(x[0]), wp.abs(x[1])), wp.abs(x[2]))


@wp.func
def observed(a: MovedBody, b: MovedBody, node_a: MovedNode, node_b: MovedNode, h: wp.float64) -> Observed:
    """How the second node moves for an observer who turns with the first body."""
    apart = node_b.centre - node_a.centre
    between = b.place.position - a.place.position
    line = b.line - a.line
    difference = b.omega - a.omega
    w = wp.length(difference)
    turning = wp.length(b.place.turning - a.place.turning)
    bends = (wp.length(wp.cross(difference, a.omega)) + w * w) * node_b.arm + w * b.turning + a.turn * turning
    bends += _TWO * wp.length(wp.cross(a.omega, line))
    bends += a.turn * wp.length(wp.cross(a.omega, between))
    r = Observed()
    r.velocity = node_b.velocity - node_a.velocity - wp.cross(a.omega, apart)
    r.bend = _HALF * h * h * bends
    r.swing = wp.min(h * w, _TWO) * node_b.radius
    return r


@wp.func
def share_across(d: wp.vec3d, body: MovedBody) -> wp.float64:
    """The sine of the angle between a direction and the axis of a body; 1 of one that hardly turns."""
    if body.turn > _UNDERFLOW:
        return wp.min(wp.length(wp.cross(d, body.omega)) / body.turn, _ONE)
    return _ONE


@wp.func
def along_box(node: MovedNode, d: wp.vec3d) -> wp.float64:
    """How far a box reaches along a direction."""
    of_x = node.half[0] * wp.abs(wp.dot(node.x, d))
    return of_x + node.half[1] * wp.abs(wp.dot(node.y, d)) + node.half[2] * wp.abs(wp.dot(node.z, d))


@wp.func
def better(
    best: Separation,
    apart: wp.float64,
    moved: wp.float64,
    a: MovedNode,
    b: MovedNode,
    of_a: wp.float64,
    of_b: wp.float64,
) -> Separation:
    """The better of a separation and that of nodes which are so far apart, move so much and reach so far."""
    r = best
    least = apart - moved - wp.min(a.radius, of_a) - wp.min(b.radius, of_b)
    if least > best.least:
        r.least = least
        r.moved = moved
    return r


@wp.func
def along_direction(
    best: Separation,
    d: wp.vec3d,
    apart: wp.float64,
    a: MovedBody,
    b: MovedBody,
    node_a: MovedNode,
    node_b: MovedNode,
    h: wp.float64,
) -> Separation:
    """The better of a separation and that along a direction, along which two nodes are so far apart."""
    across_a = share_across(d, a)
    across_b = share_across(d, b)
    bent = wp.abs(wp.dot(d, node_b.velocity - node_a.velocity)) * h + across_a * node_a.bend + across_b * node_b.bend
    turned = wp.abs(wp.dot(d, b.line - a.line)) * h + across_a * node_a.turned + across_b * node_b.turned
    of_a = along_box(node_a, d) + across_a * node_a.swing
    of_b = along_box(node_b, d) + across_b * node_b.swing
    return better(best, apart, wp.min(bent, turned), node_a, node_b, of_a, of_b)


@wp.func
def along_observed(
    best: Separation,
    d: wp.vec3d,
    apart: wp.float64,
    node_a: MovedNode,
    node_b: MovedNode,
    of_a: Observed,
    of_b: Observed,
    h: wp.float64,
) -> Separation:
    """The same along a direction that turns with the body of either node, given how each is seen from the other."""
    reach_a = along_box(node_a, d)
    reach_b = along_box(node_b, d)
    moved = wp.abs(wp.dot(d, of_b.velocity)) * h + of_b.bend
    r = better(best, apart, moved, node_a, node_b, reach_a, reach_b + of_b.swing)
    moved = wp.abs(wp.dot(d, of_a.velocity)) * h + of_a.bend
    return better(r, apart, moved, node_a, node_b, reach_a + of_a.swing, reach_b)


@wp.func
def direction(k: int, a: MovedNode, b: MovedNode, body_a: MovedBody, body_b: MovedBody, between: wp.vec3d) -> wp.vec3d:
    """One of the directions along which two nodes are looked at."""
    if k == 0:
        return between
    if k == 1:
        return a.x
    if k == 2:
        return a.y
    if k == 3:
        return a.z
    if k == 4:
        return b.x
    if k == 5:
        return b.y
    if k == 6:
        return b.z
    if k == 7:
        return body_a.omega / body_a.turn
    return body_b.omega / body_b.turn


@wp.func
def separation(
    a: MovedBody, b: MovedBody, node_a: MovedNode, node_b: MovedNode, h: wp.float64, enough: wp.float64
) -> Separation:
    """How far two nodes stay apart, or that it is enough."""
    apart = node_b.centre - node_a.centre
    distance = wp.length(apart)
    bent = wp.length(node_b.velocity - node_a.velocity) * h + node_a.bend + node_b.bend
    turned = wp.length(b.line - a.line) * h + node_a.turned + node_b.turned
    r = Separation()
    r.moved = wp.min(bent, turned)
    r.least = wp.min(distance, _OVERFLOW) - r.moved - node_a.radius - node_b.radius
    if r.least > enough:
        return r
    between = apart
    if distance > _ZERO:
        between = apart / distance
    both_turn = a.turn > _UNDERFLOW and b.turn > _UNDERFLOW
    of_a = Observed()
    of_b = Observed()
    if both_turn:
        of_a = observed(b, a, node_b, node_a, h)
        of_b = observed(a, b, node_a, node_b, h)
    k = int(0)
    while k < _DIRECTIONS:  # a loop with an end that Warp knows is written out
        d = direction(k, node_a, node_b, a, b, between)
        along = wp.abs(wp.dot(apart, d))
        # a direction along which both reach farther than they are apart separates nothing
        if along > r.least:
            r = along_direction(r, d, along, a, b, node_a, node_b, h)
            if both_turn:
                r = along_observed(r, d, along, node_a, node_b, of_a, of_b, h)
        k += 1
    return r


@wp.func
def separation_from_plane(
    a: MovedBody, node: MovedNode, point: wp.vec3d, normal: wp.vec3d, h: wp.float64
) -> Separation:
    """How far a node stays away from the solid of a half-space."""
    across = share_across(normal, a)
    bent = wp.abs(wp.dot(normal, node.velocity)) * h + across * node.bend
    turned = wp.abs(wp.dot(normal, a.line)) * h + across * node.turned
    r = Separation()
    r.moved = wp.min(bent, turned)
    reach = wp.min(node.radius, along_box(node, normal) + across * node.swing)
    r.least = wp.dot(node.centre - point, normal) - r.moved - reach
    return r


@wp.kernel
def bound_rows(
    begin: int,
    # in
    vertices: wp.array[wp.int32],
    first: wp.array[wp.int32],
    body: wp.array[wp.int32],  # of each run of them
    links: wp.array[wp.int32],  # of each body: -1 of one whose vertices go straight
    start: wp.array[wp.vec3d],
    end: wp.array[wp.vec3d],
    radius: wp.array[wp.float64],  # empty where there is none
    # out
    lower: wp.array[wp.vec3d],
    upper: wp.array[wp.vec3d],
    thickness: wp.array[wp.float64],
):
    """Box and largest radius of each run of vertices of a body, over all of a straight motion.

    Of a coordinate that is no number the radius is none.
    """
    run = begin + wp.tid()
    goes_straight = links[body[run]] < 0
    low = start[vertices[first[run]]]
    high = low
    thick = _ZERO
    odd = _ZERO
    for k in range(first[run], first[run + 1]):
        v = vertices[k]
        x = start[v]
        y = x
        if goes_straight:
            y = end[v]
        low = wp.min(low, wp.min(x, y))
        high = wp.max(high, wp.max(x, y))
        for axis in range(3):
            odd += (x[axis] - x[axis]) + (y[axis] - y[axis])
        if radius.shape[0] > 0:
            thick = wp.max(thick, radius[v])
            odd += radius[v] - radius[v]
    lower[run] = low
    upper[run] = high
    thickness[run] = thick + odd


@wp.kernel
def bound_bodies(
    begin: int,
    # in
    first: wp.array[wp.int32],  # run of each body
    lower: wp.array[wp.vec3d],
    upper: wp.array[wp.vec3d],
    thickness: wp.array[wp.float64],
    # out
    trees: PartTrees,
):
    """Let the tree of each body be one node around its runs of vertices."""
    i = begin + wp.tid()
    if first[i] == first[i + 1]:
        return
    low = lower[first[i]]
    high = upper[first[i]]
    thick = _ZERO
    odd = _ZERO
    for run in range(first[i], first[i + 1]):
        low = wp.min(low, lower[run])
        high = wp.max(high, upper[run])
        thick = wp.max(thick, thickness[run])
        odd += thickness[run] - thickness[run]
    centre = _HALF * low + _HALF * high
    half = wp.max(high - centre, centre - low) * _UP
    trees.centre[i] = centre
    trees.half[i] = half
    trees.radius[i] = wp.length(half) * _UP + _UNDERFLOW
    trees.thickness[i] = thick + odd


@wp.kernel
def clear_marks(
    begin: int,
    # in
    always: wp.array[wp.int32],  # bodies that are searched in every slice
    is_any: int,  # whether there are such
    active: wp.array[wp.int32],  # bodies that are searched at all
    # out
    near: NearMarks,
):
    """Mark in each slice the bodies that are searched in every one."""
    item = begin + wp.tid()
    num_bodies = always.shape[0]
    k = item / num_bodies
    i = item % num_bodies
    near.bodies[k, i] = always[i] * active[i]
    if i == 0:
        near.is_any[k] = is_any


@wp.kernel
def sweep_bodies(
    begin: int,
    # in
    trees: PartTrees,
    paths: BodyPaths,
    num_links: int,
    t_max: wp.float64,
    reach: wp.float64,
    # out
    lower: wp.array2d[wp.vec3d],
    upper: wp.array2d[wp.vec3d],
):
    """Boxes around bodies in the whole step, of each world and body, grown so that those that meet may be in reach."""
    item = begin + wp.tid()
    num_bodies = lower.shape[1]
    world = item / num_bodies
    i = item % num_bodies
    if trees.num_parts[i] == 0:
        return
    link = trees.link[i]
    row = wp.where(link < 0, link, world * num_links + link)
    h = _HALF * t_max
    body = moved_body(paths, row, h, h)
    n = trees.first[i]
    node = moved_node(trees, n, body, link < 0, h)
    r = node.turned + node.radius + trees.thickness[n] + reach + node.error
    r += _ERROR * (largest(node.centre) + largest(body.line) + r) + _UNDERFLOW
    size = h * wp.abs(body.line) + wp.vec3d(r, r, r)
    lower[world, i] = node.centre - size
    upper[world, i] = node.centre + size


@wp.func
def are_apart(lower: wp.vec3d, upper: wp.vec3d) -> bool:
    """Whether a box ends below the begin of another; one that is no number does not."""
    return upper[0] < lower[0] or upper[1] < lower[1] or upper[2] < lower[2]


@wp.func
def are_known(near: NearMarks, i: int, j: int, begin: int, end: int) -> bool:
    """Whether both of two bodies are marked in all slices from one to another."""
    k = begin
    while k < end:
        if near.bodies[k, i] == 0 or near.bodies[k, j] == 0:
            return False
        k += 1
    return True


@wp.func
def body_pair(bodies: wp.vec2i, world: int, trees: PartTrees, num_links: int) -> BodyPair:
    """A pair of bodies in a world: the first is a link, and the second is -1 - k of half-space k."""
    r = BodyPair()
    r.world = world
    r.is_plane = bodies[1] < 0
    r.first = bodies[0]
    r.second = wp.where(r.is_plane, bodies[0], bodies[1])
    r.plane = -1 - bodies[1]
    link_a = trees.link[r.first]
    link_b = trees.link[r.second]
    r.row_a = wp.where(link_a < 0, link_a, world * num_links + link_a)
    r.row_b = wp.where(link_b < 0, link_b, world * num_links + link_b)
    r.inner_a = trees.num_parts[r.first] - 1
    r.inner_b = wp.where(r.is_plane, 0, trees.num_parts[r.second] - 1)
    return r


@wp.func
def approach_of(
    pair: BodyPair, u: int, v: int, trees: PartTrees, a: MovedBody, b: MovedBody, h: wp.float64, reach: wp.float64
) -> Approach:
    """Whether two nodes of a pair may come within ``reach`` in a time h before and after the middle."""
    m = trees.first[pair.first] + u
    node_a = moved_node(trees, m, a, pair.row_a < 0, h)
    lengths = reach + trees.thickness[m] + node_a.error
    sizes = largest(node_a.centre) + node_a.radius + node_a.turned + h * largest(a.line)
    r = Separation()
    found = Approach()
    found.radius_a = node_a.radius
    if pair.is_plane:
        point = trees.plane_point[pair.plane]
        r = separation_from_plane(a, node_a, point, trees.plane_normal[pair.plane], h)
        sizes += largest(point)
    else:
        n = trees.first[pair.second] + v
        node_b = moved_node(trees, n, b, pair.row_b < 0, h)
        found.radius_b = node_b.radius
        lengths += trees.thickness[n] + node_b.error
        sizes += largest(node_b.centre) + node_b.radius + node_b.turned + h * largest(b.line)
        sizes *= _ONE + h * (a.turn + b.turn)
        lengths += _ERROR * (sizes + lengths)
        r = separation(a, b, node_a, node_b, h, lengths)
    lengths += _ERROR * (sizes + lengths + r.moved) + _UNDERFLOW
    found.is_near = not r.least > lengths  # also where a number is none
    found.moved = r.moved
    return found


@wp.func
def divided(pair: BodyPair, u: int, v: int, num_slices: int, found: Approach) -> int:
    """What is divided of two nodes that may touch in some slices: these, the larger node, or nothing any more."""
    splits_a = u < pair.inner_a
    splits_b = v < pair.inner_b
    if num_slices > 1 and (not (splits_a or splits_b) or found.moved >= wp.max(found.radius_a, found.radius_b)):
        return _TIME
    if splits_a and (not splits_b or found.radius_a >= found.radius_b):
        return _FIRST
    return wp.where(splits_b, _SECOND, _NOTHING)


@wp.func
def mark(near: NearMarks, trees: PartTrees, pair: BodyPair, k: int, u: int, v: int):
    """Mark a pair of bodies in a slice, and the parts that two nodes without children are."""
    first_body = pair.world * trees.num_parts.shape[0]
    near.bodies[k, first_body + pair.first] = 1
    near.bodies[k, first_body + pair.second] = 1
    near.is_any[k] = 1
    if near.parts.shape[0] > 0:
        near.parts[pair.world, trees.first_part[pair.first] + u - pair.inner_a] = 1
        if not pair.is_plane:
            near.parts[pair.world, trees.first_part[pair.second] + v - pair.inner_b] = 1


@wp.kernel
def mark_near(
    begin: int,
    # in
    body_pairs: wp.array[wp.vec2i],  # as `body_pair` takes them
    trees: PartTrees,
    paths: BodyPaths,
    num_links: int,
    lower: wp.array2d[wp.vec3d],
    upper: wp.array2d[wp.vec3d],
    num_slices: int,
    num_begins: int,
    t_max: wp.float64,
    reach: wp.float64,
    active: wp.array[wp.int32],  # bodies of which one of each pair is; empty, all are
    stop: wp.array[wp.int32],
    # out
    near: NearMarks,
):
    """Mark what may come within ``reach``, of the parts of a pair of bodies of a world, in all slices.

    The slices of a pair are divided among as many items as there are begins. Where no parts are asked for, those of
    two bodies that are marked in a slice are not looked at in it.
    """
    item = begin + wp.tid()
    number = item % num_begins
    num_pairs = body_pairs.shape[0]
    of_world = item / num_begins
    world = of_world / num_pairs
    pair = body_pair(body_pairs[of_world % num_pairs], world, trees, num_links)
    i = pair.first
    j = pair.second
    if active.shape[0] > 0:
        if active[i] == 0 and active[j] == 0:
            return
    if not pair.is_plane:
        if are_apart(lower[world, i], upper[world, j]) or are_apart(lower[world, j], upper[world, i]):
            return
    begins = Stack()
    ends = Stack()
    nodes_a = Stack()
    nodes_b = Stack()
    begins[0] = wp.int32(wp.int64(number) * wp.int64(num_slices) / wp.int64(num_begins))
    ends[0] = wp.int32(wp.int64(number + 1) * wp.int64(num_slices) / wp.int64(num_begins))
    if begins[0] == ends[0]:
        return  # of fewer slices than items
    first_body = world * trees.num_parts.shape[0]
    size = wp.int32(1)
    first_slice = wp.int32(-1)
    last_slice = wp.int32(-1)
    h = _ZERO
    a = MovedBody()
    b = MovedBody()
    while size > 0:
        if is_stopped(stop):
            return
        size -= 1
        if near.parts.shape[0] == 0 and are_known(near, first_body + i, first_body + j, begins[size], ends[size]):
            continue
        if begins[size] != first_slice or ends[size] != last_slice:
            first_slice = begins[size]
            last_slice = ends[size]
            t_begin = t_max * wp.float64(first_slice) / wp.float64(num_slices)
            t_end = t_max * wp.float64(last_slice) / wp.float64(num_slices)
            h = _HALF * (t_end - t_begin)
            a = moved_body(paths, pair.row_a, t_begin + h, h)
            b = moved_body(paths, pair.row_b, t_begin + h, h)
        u = nodes_a[size]
        v = nodes_b[size]
        found = approach_of(pair, u, v, trees, a, b, h, reach)
        if not found.is_near:
            continue
        divides = divided(pair, u, v, last_slice - first_slice, found)
        if divides == _NOTHING:
            mark(near, trees, pair, first_slice, u, v)
        else:
            middle = first_slice + (last_slice - first_slice) / 2
            for k in range(2):  # the earlier half, and the first child, are on top
                begins[size] = wp.where(divides == _TIME and k == 0, middle, first_slice)
                ends[size] = wp.where(divides == _TIME and k == 1, middle, last_slice)
                nodes_a[size] = wp.where(divides == _FIRST, 2 * u + 2 - k, u)
                nodes_b[size] = wp.where(divides == _SECOND, 2 * v + 2 - k, v)
                size += 1
