"""The kernels in which every vertex that moves meets the planes of half-spaces; see `planes`."""

import warp as wp

from ..atomics import atomic_min_int32, atomic_min_int64, claim, claim_int
from ..pair.status import STATUS_COLLISION, STATUS_INITIAL_CONTACT, STATUS_ROUNDING_LIMIT
from ..pair.turns import Turns, turns_anywhere
from ..pair_key import pair_key
from ..pair_kind import VERTEX_PLANE
from ..step.minima import (
    CONTACTS_OVERFLOW,
    FOUND,
    ROUNDING_LIMIT,
    STRUCK,
    Minima,
    flag_world,
    lower_primitive,
    world_of,
)
from ..step.step import ContactList, Step
from .arc_planes import meeting_on_arc
from .planes import PlaneMeeting, PlaneQuery, Planes, end_of_planes, first_plane, meeting_of, nth_plane, point_of
from .raised_toi import raised_toi
from .sinks import BOUND

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

_ZERO = wp.constant(wp.float64(0.0))


@wp.func
def is_pair_excluded(v: int, k: int, excluded: wp.array[wp.int64]) -> bool:
    """Whether the pair of a vertex and a plane is listed, by binary search."""
    key = pair_key(v, k)
    low = int(0)
    high = excluded.shape[0]
    while low < high:
        middle = low + (high - low) / 2
        if excluded[middle] < key:
            low = middle + 1
        else:
            high = middle
    if low < excluded.shape[0]:
        return excluded[low] == key
    return False


@wp.func
def record_meeting(
    v: int,
    k: int,
    meeting: PlaneMeeting,
    toi: wp.float64,  # to which the minima are lowered
    is_struck: bool,
    planes: Planes,
    most_gap: wp.float64,
    # in and out
    step: Step,
):
    """Lower the minima, unless only the plane moves, and append the contact to the list if there is capacity."""
    if is_struck:
        flag_world(step.minima, v, STRUCK)
    else:
        bits = wp.cast(toi, wp.int64)
        lower_primitive(step.minima, wp.vec3i(v, v, v), bits)
        atomic_min_int64(step.minima.body, planes.body[k], bits)
        atomic_min_int64(step.minima.world, world_of(step.minima, v), bits)
        atomic_min_int64(step.minima.scene, 0, bits)
    status = STATUS_COLLISION
    if meeting.toi == _ZERO:
        status = STATUS_INITIAL_CONTACT
        if meeting.gap > most_gap:
            status = STATUS_ROUNDING_LIMIT
            flag_world(step.minima, v, ROUNDING_LIMIT)
    n = claim_int(step.contacts.count, 0, 1)
    if n < step.contacts.toi.shape[0]:
        step.contacts.kind[n] = VERTEX_PLANE
        step.contacts.primitives[n] = wp.vec2i(v, k)
        step.contacts.toi[n] = meeting.toi
        step.contacts.status[n] = status
        step.contacts.parameters[n] = wp.vec2d(_ZERO, _ZERO)
        step.contacts.gap[n] = meeting.gap
        step.contacts.width[n] = _ZERO
        step.contacts.normal[n] = planes.unit[k]
    else:
        flag_world(step.minima, v, CONTACTS_OVERFLOW)


@wp.kernel(cuda_max_registers=128)
def meet_planes(
    begin: int,
    # in
    sink: int,
    vertices: wp.array[wp.int32],
    planes: Planes,
    query: PlaneQuery,
    vertex_body: wp.array[wp.int32],
    box_radius: wp.array[wp.float64],  # the largest of the primitives around each vertex; empty: there are none
    turns: Turns,  # empty where nothing turns
    active: wp.array[wp.int32],  # by body: 0, its vertices are left out; empty, none is
    only_moving: int,  # 1: a vertex that does not move is left out, so it may touch; planes that move strike it
    gaps_moved: wp.float64,  # above 0: a toi near 0 is raised to the time in which the vertex moves by this many gaps
    # in and out
    step: Step,
):
    """Meet every plane with a vertex that is free; lower the minima and list the contacts, or lower the least toi.

    For the least toi `BOUND` is the sink, and of the minima only the worlds are read.
    """
    v = vertices[begin + wp.tid()]
    body = vertex_body[v]
    if active.shape[0] > 0:
        if active[body] == 0:
            return
    x0 = step.vertices_t0[v]
    x1 = step.vertices_t1[v]
    is_struck = only_moving != 0 and x0 == x1
    if turns.velocity.shape[0] > 0:
        is_struck = is_struck and not turns_anywhere(wp.vec3i(v, v, v), turns)
    if is_struck and planes.vertex.shape[0] == 0:
        return
    radius = _ZERO
    if box_radius.shape[0] > 0:
        radius = box_radius[v]
    world = world_of(step.minima, v)
    for i in range(first_plane(planes, world), end_of_planes(planes, world)):
        k = nth_plane(planes, i)
        p0 = point_of(planes, k, step.vertices_t0)
        p1 = point_of(planes, k, step.vertices_t1)
        if planes.meets[k, body] == wp.uint8(0) or (is_struck and p0 == p1):
            continue
        meeting = PlaneMeeting()
        if turns.velocity.shape[0] > 0:
            meeting = meeting_on_arc(v, x0, x1, p0, p1, radius, planes, k, query, turns)
        else:
            meeting = meeting_of(x0, x1, p0, p1, radius, planes, k, query)
        if meeting.toi > query.t_max:
            continue
        if is_pair_excluded(v, k, planes.excluded):
            continue
        claim(step.counts, VERTEX_PLANE, FOUND, 1)
        if sink == BOUND:
            atomic_min_int64(step.least_bits, 0, wp.cast(meeting.toi, wp.int64))
        else:
            motion = wp.max(wp.abs(x1 - x0)) + wp.max(wp.abs(p1 - p0))
            toi = raised_toi(meeting.toi, meeting.gap, motion, gaps_moved)
            record_meeting(v, k, meeting, toi, is_struck, planes, query.most_gap, step)


@wp.kernel
def first_plane_contacts(
    begin: int,
    # in
    contacts: ContactList,
    plane_body: wp.array[wp.int32],
    minima: Minima,
    # out
    body_contact: wp.array[wp.int32],
):
    """The contact that the toi of each half-space belongs to, as `first_contacts` finds that of all other bodies."""
    n = begin + wp.tid()
    if n >= contacts.count[0]:
        return
    if contacts.kind[n] == VERTEX_PLANE:
        body = plane_body[contacts.primitives[n][1]]
        if minima.body[body] == wp.cast(contacts.toi[n], wp.int64):
            atomic_min_int32(body_contact, body, n)
