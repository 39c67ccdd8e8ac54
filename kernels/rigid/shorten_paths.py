"""Bodies that turn in a line search on the device: how far each goes, and its path up to there."""

import warp as wp

from ..atomics import atomic_min_int64
from ..step.device_step import PER_SCENE, PER_WORLD
from ..step.minima import Minima, is_kinematic, world_of
from .place_bodies import BodyPaths

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

_INFINITY_BITS = wp.constant(wp.int64(0x7FF0000000000000))


@wp.kernel
def begin_paths(
    begin: int,
    # in
    paths: BodyPaths,
    # out
    whole: BodyPaths,
    least: wp.array[wp.int64],
):
    """Keep the whole path of a body, and let it have no toi."""
    body = begin + wp.tid()
    whole.omega[body] = paths.omega[body]
    whole.velocity[body] = paths.velocity[body]
    whole.turning[body] = paths.turning[body]
    least[body] = _INFINITY_BITS


@wp.kernel
def lower_bodies(
    begin: int,
    # in
    vertices: wp.array[wp.int32],
    per: int,
    m: Minima,
    # in and out
    least: wp.array[wp.int64],
):
    """Lower the toi of a body to that of the part that one of its vertices moves with; a rigid one moves as a whole."""
    v = vertices[begin + wp.tid()]
    if is_kinematic(m, v):
        return
    body = m.vertex_body[v]
    bits = m.body[body]
    if per == PER_SCENE:
        bits = m.scene[0]
    elif per == PER_WORLD:
        bits = m.world[world_of(m, v)]
    if bits < _INFINITY_BITS:
        atomic_min_int64(least, body, bits)


@wp.kernel
def shorten_paths(
    begin: int,
    # in
    safety: wp.float64,
    whole: BodyPaths,
    # in and out
    least: wp.array[wp.int64],
    fraction: wp.array[wp.float64],
    paths: BodyPaths,
):
    """Shorten the path of a body to the share ``safety`` of its toi, and forget that; with 0 the body stays."""
    body = begin + wp.tid()
    bits = least[body]
    if bits == _INFINITY_BITS or paths.is_rigid[body] == 0:
        return
    least[body] = _INFINITY_BITS
    f = fraction[body] * (safety * wp.cast(bits, wp.float64))
    fraction[body] = f
    paths.omega[body] = f * whole.omega[body]
    paths.velocity[body] = f * whole.velocity[body]
    paths.turning[body] = f * whole.turning[body]
