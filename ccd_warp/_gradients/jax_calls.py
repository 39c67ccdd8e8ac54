"""Launches as functions that JAX calls by Warp's bridge: those of `ccd_warp.jax`, and of their backward passes."""

from collections.abc import Callable
from functools import partial
from typing import Any
from weakref import WeakKeyDictionary, ref

import warp as wp

from ccd_warp._gradients.own_tape import launched, play_back
from ccd_warp._results.device_results import TOIS
from ccd_warp._runtime.launch import load
from ccd_warp._runtime.streams import in_current_order
from ccd_warp.kernels.step import device_step

_VECTORS = {
    ("float64", 3): wp.vec3d,
    ("float32", 3): wp.vec3f,
    ("float64", 2): wp.vec2d,
    ("float32", 2): wp.vec2f,
}
_callables: WeakKeyDictionary[Any, dict[Any, Any]] = WeakKeyDictionary()


def callable_of(pipeline: Any, write: Any, options: tuple[Any, ...], like: Any, num_outputs: int) -> Any:
    """One of the functions below as JAX calls it, for positions of a type; made once for a pipeline."""
    callables = _callables.setdefault(pipeline, {})
    key = write, options, str(like.dtype)
    if key not in callables:
        # Warp keeps it for ever, and so must not keep the pipeline, which who calls it has
        call = write(ref(pipeline), *options)
        positions: Any = wp.array(dtype=_VECTORS[key[2], pipeline.mesh.dimension])
        numbers: Any = wp.array(dtype=wp.float64)
        names = call.__code__.co_varnames[: call.__code__.co_argcount]
        types: Any = {"toi": numbers, "of_toi": numbers, "flags": wp.array(dtype=wp.bool)}
        # Warp loads the module that a function names, and says so: one that every launch has loaded
        load(device_step.reset, pipeline._topology.device)
        call.__module__ = device_step.reset.module.name
        call.__annotations__ = {name: types.get(name, positions) for name in names}
        callables[key] = wp.jax_callable(call, num_outputs, wp.JaxCallableGraphMode.NONE, vmap_method="broadcast_all")
    return callables[key]


def write_toi(pipeline: Callable[[], Any], per: str) -> Any:
    def call(start, end, toi):  # type: ignore[no-untyped-def]
        with in_current_order(start.device):
            _, result = launched(pipeline().launch, (start, end))
            wp.copy(toi, _tois_of(result, per, toi))

    return call


def write_gradient_of_toi(pipeline: Callable[[], Any], per: str) -> Any:
    def call(start, end, of_toi, of_start, of_end):  # type: ignore[no-untyped-def]
        with in_current_order(start.device):
            start.requires_grad = end.requires_grad = True
            tape, result = launched(pipeline().launch, (start, end))
            play_back(tape, (start, end), _tois_of(result, per, of_toi), of_toi)
            wp.copy(of_start, start.grad)
            wp.copy(of_end, end.grad)

    return call


def write_toi_is_regular(pipeline: Callable[[], Any], per: Any) -> Any:
    def call(start, end, flags):  # type: ignore[no-untyped-def]
        with in_current_order(start.device):
            start.requires_grad = end.requires_grad = True
            _, result = launched(pipeline().launch, (start, end))
            wp.copy(flags, result.is_regular(_per_of(per, flags)))

    return call


def _tois_of(result: Any, per: str, like: wp.array) -> Any:
    """The tois of a result of which an array of this length is asked."""
    return getattr(result, TOIS[_per_of(per, like)])


def _per_of(per: str, like: wp.array) -> Any:
    """Of which tois an array of this length is asked: those of the scene are by world where all worlds are mapped."""
    return "world" if per == "scene" and len(like) > 1 else per


def write_shortened(pipeline: Callable[[], Any], per: Any, safety: float, num_rounds: int) -> Any:
    def call(start, end, shortened):  # type: ignore[no-untyped-def]
        with in_current_order(start.device):
            wp.copy(shortened, end)
            launch = partial(pipeline().launch_line_search, per=per, safety=safety, num_rounds=num_rounds)
            launched(launch, (start, shortened))

    return call


def write_gradient_of_shortened(pipeline: Callable[[], Any], per: Any, safety: float, num_rounds: int) -> Any:
    def call(start, end, gradient, of_start, of_end):  # type: ignore[no-untyped-def]
        with in_current_order(start.device):
            shortened = wp.clone(end)
            start.requires_grad = shortened.requires_grad = True
            launch = partial(pipeline().launch_line_search, per=per, safety=safety, num_rounds=num_rounds)
            tape, _ = launched(launch, (start, shortened))
            play_back(tape, (start, shortened), shortened, wp.clone(gradient))
            wp.copy(of_start, start.grad)
            wp.copy(of_end, shortened.grad)

    return call


def write_shortened_is_regular(pipeline: Callable[[], Any], per: Any, safety: float, num_rounds: int) -> Any:
    def call(start, end, flags):  # type: ignore[no-untyped-def]
        with in_current_order(start.device):
            shortened = wp.clone(end)
            start.requires_grad = shortened.requires_grad = True
            launch = partial(pipeline().launch_line_search, per=per, safety=safety, num_rounds=num_rounds)
            _, result = launched(launch, (start, shortened))
            wp.copy(flags, result.is_regular("vertex"))

    return call
