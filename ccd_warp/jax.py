"""Times of impact and line searches as differentiable functions of JAX, which is in the extra ``interop``.

Arrays are read and written where they are, by Warp's own bridge to JAX. Both passes are launches, so a backward pass
makes the forward one again. The functions may be called within ``jax.jit`` and differentiated once, in reverse.

``jax.vmap`` is over the worlds of the mesh, all of them: with a pipeline of ``mesh.replicate(W)`` and positions of one
world, shape [V / W, 3], in a batch of W. Nothing else may be mapped. Tois are float64, so JAX has to be run with
``jax_enable_x64``.

:func:`rigid_toi`, of poses, is a call on the host, whose gradients are computed with its tois; ``jax.vmap`` of it is
over anything, in one call.

What has a gradient, and what has 0 in its place, is told in the guide to gradients (docs/gradients.md).
"""

from __future__ import annotations  # ArrayLike, written out, would fill a screen of help()

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ccd_warp._calls.pipeline import DEFAULT_NUM_ROUNDS, CollisionPipeline
from ccd_warp._calls.rigid_tois import RigidTois, checked_end
from ccd_warp._engine.host.line_search import DEFAULT_SAFETY
from ccd_warp._gradients import jax_calls as calls
from ccd_warp._runtime.texts import text_completed_by
from ccd_warp._scene.input.arguments import EVERY_PER, Per, check_choice, check_instance

try:
    import jax
except ImportError as error:
    raise ImportError("ccd_warp.jax needs JAX; install with: pip install 'ccd-warp[interop]'") from error

__all__ = ["collision_free_step", "line_search", "line_search_is_regular", "rigid_toi", "toi", "toi_is_regular"]


def toi(
    pipeline: CollisionPipeline, vertices_t0: jax.Array, vertices_t1: jax.Array, *, per: Per = "scene"
) -> jax.Array:
    """Earliest times of impact of a step, as :meth:`ccd_warp.CollisionPipeline.launch` finds them.

    Args:
        pipeline: The pipeline, on the device of the arrays. Its capacities are those of its ``reserve()``.
        vertices_t0: Start positions, float32 or float64, shape [V, 3] or [W, V / W, 3]; within ``jax.vmap`` over the
            worlds [V / W, 3].
        vertices_t1: End positions, of the same type.
        per: ``"scene"``, ``"world"``, ``"body"`` or ``"vertex"``; within ``jax.vmap`` not ``"world"``.

    Returns:
        An array of float64, of the scene of shape [], of worlds, bodies or vertices with one each; inf where there is
        certainly no collision. Within ``jax.vmap`` those of one world.

    Raises:
        ValueError: If an array is not as described. What is found in a launch is raised as an error of JAX.

    Guarantee: that of ``launch``; gradients have no part in it.
    """
    check_choice("per", per, EVERY_PER)
    start, end = _checked(pipeline, vertices_t0, vertices_t1)
    found = _toi(pipeline, per, start, end)
    return found[0] if per == "scene" else found


@text_completed_by(toi)
def collision_free_step(pipeline: CollisionPipeline, vertices_t0: jax.Array, vertices_t1: jax.Array) -> jax.Array:
    """Largest fraction of a step that is certain to be free of collisions: the toi, or t_max where there is none.

    Returns:
        An array of float64 of shape [], in [0, t_max].

    Guarantee: no pair touches before the returned fraction of the step.
    """
    return jax.numpy.minimum(toi(pipeline, vertices_t0, vertices_t1), pipeline._options.t_max)


@text_completed_by(toi)
def line_search(
    pipeline: CollisionPipeline,
    vertices_t0: jax.Array,
    vertices_t1: jax.Array,
    *,
    per: Per = "scene",
    safety: float = DEFAULT_SAFETY,
    num_rounds: int = DEFAULT_NUM_ROUNDS,
) -> jax.Array:
    """Shorten a step until it is certain to be free, as :meth:`ccd_warp.CollisionPipeline.launch_line_search` does.

    Args:
        vertices_t1: Wished end positions.
        per: As of ``launch_line_search``, and so are ``safety`` and ``num_rounds``. Within ``jax.vmap`` ``"scene"`` is
            the scene of all worlds.
        safety: Fraction of its toi by which a vertex in contact may move.
        num_rounds: Number of passes.

    Returns:
        The positions at the end of the shortened step, an array like ``vertices_t1``.

    Guarantee: that of ``launch_line_search``; gradients have no part in it.
    """
    start, end = _checked(pipeline, vertices_t0, vertices_t1)
    return _line_search(pipeline, (per, safety, num_rounds), start, end).reshape(vertices_t1.shape)


def toi_is_regular(
    pipeline: CollisionPipeline, vertices_t0: jax.Array, vertices_t1: jax.Array, *, per: Per = "scene"
) -> jax.Array:
    """Which of the tois of :func:`toi` have a gradient; the others, as those of inf, give 0. It makes the launch again.

    Args:
        pipeline: As of :func:`toi`, and so are all other arguments.
        vertices_t0: Start positions.
        vertices_t1: End positions.
        per: Of which tois.

    Returns:
        An array of bool of the shape of the tois.

    Raises:
        ValueError: As :func:`toi`.
    """
    check_choice("per", per, EVERY_PER)
    start, end = _checked(pipeline, vertices_t0, vertices_t1)
    call = calls.callable_of(pipeline, calls.write_toi_is_regular, (per,), start, 1)
    found = call(start, end, output_dims=_num_tois(pipeline, per, start))[0]
    return found[0] if per == "scene" else found


def line_search_is_regular(
    pipeline: CollisionPipeline,
    vertices_t0: jax.Array,
    vertices_t1: jax.Array,
    *,
    per: Per = "scene",
    safety: float = DEFAULT_SAFETY,
    num_rounds: int = DEFAULT_NUM_ROUNDS,
) -> jax.Array:
    """Which positions of :func:`line_search` have a derivative. It makes the launch again.

    Args:
        pipeline: As of :func:`line_search`, and so are all other arguments.
        vertices_t0: Start positions.
        vertices_t1: Wished end positions.
        per: What moves by one fraction.
        safety: Fraction of its toi by which a vertex in contact may move.
        num_rounds: Number of passes.

    Returns:
        An array of bool for each vertex, shape [V], or within ``jax.vmap`` [V / W], as
        :meth:`ccd_warp.LaunchResult.is_regular` says it.

    Raises:
        ValueError: As :func:`line_search`.
    """
    start, end = _checked(pipeline, vertices_t0, vertices_t1)
    call = calls.callable_of(pipeline, calls.write_shortened_is_regular, (per, safety, num_rounds), start, 1)
    return call(start, end, output_dims=len(end))[0]


def rigid_toi(
    pipeline: CollisionPipeline,
    poses_t0: jax.Array,
    poses_t1: jax.Array | None = None,
    *,
    twist: jax.Array | None = None,
    pivot: ArrayLike | None = None,
) -> jax.Array:
    """Earliest time of impact of rigid bodies that turn, in each world: what ``mesh_ccd`` finds with a ``motion``.

    The vertices of the mesh stand in the frames of its rigid bodies, and all others rest. Bodies move on the linear
    paths of :class:`ccd_warp.RigidMotion`; screws have no gradients, nor has a motion with ``within``. Of each world
    little more than its first contact is searched, and the gradient is that of this contact, on the host.

    Args:
        pipeline: The pipeline of a mesh with ``rigid`` bodies: of one world, or of as many as there are poses of.
        poses_t0: Poses of the rigid bodies at t = 0, position and quaternion **x y z w** of any length but 0, float32
            or float64, shape [B, 7], or with one or more axes of worlds in front [W, B, 7].
        poses_t1: Poses at t = 1, of the same shape; between them is the shortest turn.
        twist: In place of ``poses_t1``, motion in the whole step, **linear part first, then angular** in radians,
            [B, 6] or [W, B, 6].
        pivot: Points about which the bodies turn, in their own frames, [3], [B, 3] or [W, B, 3], numbers that JAX does
            not trace. Within ``jax.vmap`` the last of these is not possible.

    Returns:
        An array of float64, of shape [W], or [] where poses have no axis of worlds; inf where there is certainly no
        collision. Its gradients by ``poses_t0`` and ``poses_t1`` or ``twist`` are 0 of worlds in which nothing touches
        or whose contact is not regular, as where toi is 0; of several contacts with one toi it is that of the first in
        the order of :class:`ccd_warp.Contacts`. Along a quaternion they are 0. ``jax.vmap`` adds axes of worlds.

    Raises:
        ValueError: If an array is not as described, or both or neither of ``poses_t1`` and ``twist`` are given. What is
            found in a call, as :class:`ccd_warp.RigidMotion` and :func:`ccd_warp.mesh_ccd` say it, is raised as an
            error of JAX.

    Guarantee: that of :func:`ccd_warp.mesh_ccd` with a motion; gradients have no part in it.
    """
    check_instance("pipeline", pipeline, CollisionPipeline)
    _check_precision()
    end = checked_end(poses_t0, poses_t1, twist)
    pivot = None if pivot is None else np.asarray(pivot)
    return _rigid_toi(pipeline, pivot, twist is not None, poses_t0, end)


def _check_precision() -> None:
    if jax.numpy.zeros(0).dtype != "float64":
        raise ValueError("tois are float64; expected jax.config.update('jax_enable_x64', True)")


def _checked(pipeline: CollisionPipeline, *vertices: jax.Array) -> list[jax.Array]:
    """Positions with one axis of rows, as they can be handed over."""
    check_instance("pipeline", pipeline, CollisionPipeline)
    _check_precision()
    dimension = pipeline.mesh.dimension
    for k, array in enumerate(vertices):
        dtype, shape = getattr(array, "dtype", None), tuple(getattr(array, "shape", ()))
        if str(dtype) not in ("float32", "float64") or len(shape) not in (2, 3) or shape[-1] != dimension:
            raise ValueError(
                f"vertices_t{k} has dtype {dtype} and shape {shape}; expected float32 or float64 and (n, {dimension})"
            )
        if (dtype, shape) != (vertices[0].dtype, vertices[0].shape):
            raise ValueError(
                f"vertices_t{k} has dtype {dtype} and shape {shape}; expected {vertices[0].dtype} and "
                f"{vertices[0].shape} like vertices_t0"
            )
    rows = vertices[0].size // dimension
    if rows not in (pipeline.mesh.num_vertices, pipeline.mesh.num_vertices / pipeline.mesh.num_worlds):
        raise ValueError(
            f"vertices_t0 has {rows} rows; expected {pipeline.mesh.num_vertices}, one a vertex, or those of a world "
            "within jax.vmap"
        )
    return [array.reshape(rows, dimension) for array in vertices]


@partial(jax.custom_vjp, nondiff_argnums=(0, 1))
def _toi(pipeline: CollisionPipeline, per: str, start: jax.Array, end: jax.Array) -> jax.Array:
    call = calls.callable_of(pipeline, calls.write_toi, (per,), start, 1)
    return call(start, end, output_dims=_num_tois(pipeline, per, start))[0]


def _num_tois(pipeline: CollisionPipeline, per: str, start: jax.Array) -> int:
    mesh = pipeline.mesh
    count = {"scene": 1, "world": mesh.num_worlds, "body": mesh.num_bodies, "vertex": mesh.num_vertices}[per]
    return count // mesh.num_worlds if len(start) < mesh.num_vertices and per != "scene" else count


def _toi_forward(pipeline: CollisionPipeline, per: str, start: jax.Array, end: jax.Array) -> Any:
    return _toi(pipeline, per, start, end), (start, end)


def _toi_backward(pipeline: CollisionPipeline, per: str, ends: tuple[jax.Array, ...], of_toi: jax.Array) -> Any:
    call = calls.callable_of(pipeline, calls.write_gradient_of_toi, (per,), ends[0], 2)
    return tuple(call(*ends, of_toi, output_dims=len(ends[0])))


_toi.defvjp(_toi_forward, _toi_backward)


@partial(jax.custom_vjp, nondiff_argnums=(0, 1))
def _line_search(pipeline: CollisionPipeline, options: tuple[Any, ...], start: jax.Array, end: jax.Array) -> jax.Array:
    return calls.callable_of(pipeline, calls.write_shortened, options, start, 1)(start, end, output_dims=len(end))[0]


def _line_search_forward(
    pipeline: CollisionPipeline, options: tuple[Any, ...], start: jax.Array, end: jax.Array
) -> Any:
    return _line_search(pipeline, options, start, end), (start, end)


def _line_search_backward(
    pipeline: CollisionPipeline, options: tuple[Any, ...], ends: tuple[jax.Array, ...], gradient: jax.Array
) -> Any:
    call = calls.callable_of(pipeline, calls.write_gradient_of_shortened, options, ends[0], 2)
    return tuple(call(*ends, gradient, output_dims=len(ends[0])))


_line_search.defvjp(_line_search_forward, _line_search_backward)


@partial(jax.custom_vjp, nondiff_argnums=(0, 1, 2))
def _rigid_toi(
    pipeline: CollisionPipeline, pivot: NDArray[np.float64] | None, is_twist: bool, start: jax.Array, end: jax.Array
) -> jax.Array:
    def on_host(*ends: jax.Array) -> Any:
        return RigidTois(pipeline, pivot, is_twist, *map(np.asarray, ends)).toi

    return jax.pure_callback(on_host, _tois_of_worlds(start), start, end, vmap_method="broadcast_all")


def _tois_of_worlds(start: jax.Array) -> Any:
    return jax.ShapeDtypeStruct(start.shape[:-2], "float64")


def _rigid_toi_forward(
    pipeline: CollisionPipeline, pivot: NDArray[np.float64] | None, is_twist: bool, start: jax.Array, end: jax.Array
) -> Any:
    def on_host(*ends: jax.Array) -> Any:
        tois = RigidTois(pipeline, pivot, is_twist, *map(np.asarray, ends))
        return tois.toi, *(x.astype(end.dtype) for x, end in zip(tois.gradients, ends, strict=True))

    shapes = _tois_of_worlds(start), *(jax.ShapeDtypeStruct(x.shape, x.dtype) for x in (start, end))
    toi, *gradients = jax.pure_callback(on_host, shapes, start, end, vmap_method="broadcast_all")
    return toi, gradients


def _rigid_toi_backward(
    pipeline: CollisionPipeline,
    pivot: NDArray[np.float64] | None,
    is_twist: bool,
    gradients: list[jax.Array],
    of_toi: jax.Array,
) -> Any:
    of_worlds = of_toi[..., None, None]
    return tuple(jax.numpy.where(x == 0.0, x, (of_worlds * x).astype(x.dtype)) for x in gradients)


_rigid_toi.defvjp(_rigid_toi_forward, _rigid_toi_backward)
