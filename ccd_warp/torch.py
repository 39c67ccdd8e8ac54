"""Times of impact and line searches as differentiable functions of PyTorch, which is in the extra ``interop``.

Tensors are float32 or float64, contiguous, on the device of the pipeline. They are read in the memory where they are,
and on the CPU gradients are handed over in that in which they were computed; the shortened positions of a line search
begin as a copy. On CUDA what is handed over is memory of PyTorch, and a call comes after all that its current stream
has been given, and before what it is given next, also in ``torch.cuda.graph``. ``torch.compile`` does not look into
these functions, but calls them between two parts of its graph. :func:`rigid_toi`, of poses, reads its tensors to the
host, wherever they are.

What has a gradient, and what has 0 in its place, is told in the guide to gradients (docs/gradients.md).
"""

from __future__ import annotations  # ArrayLike, written out, would fill a screen of help()

from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from typing import Any

import warp as wp
from numpy.typing import ArrayLike

from ccd_warp._calls.pipeline import DEFAULT_NUM_ROUNDS, CollisionPipeline
from ccd_warp._calls.rigid_tois import RigidTois, checked_end
from ccd_warp._engine.host.line_search import DEFAULT_SAFETY
from ccd_warp._gradients.own_tape import launched, play_back
from ccd_warp._results.device_results import TOIS
from ccd_warp._runtime.streams import in_order_of_library
from ccd_warp._runtime.texts import text_completed_by
from ccd_warp._scene.input.arguments import EVERY_PER, Per, check_choice, check_instance
from ccd_warp._scene.input.interop import as_warp

try:
    import torch
except ImportError as error:
    raise ImportError("ccd_warp.torch needs PyTorch; install with: pip install 'ccd-warp[interop]'") from error

__all__ = ["collision_free_step", "line_search", "line_search_is_regular", "rigid_toi", "toi", "toi_is_regular"]


@torch.compiler.disable
def toi(
    pipeline: CollisionPipeline, vertices_t0: torch.Tensor, vertices_t1: torch.Tensor, *, per: Per = "scene"
) -> torch.Tensor:
    """Earliest times of impact of a step, as :meth:`ccd_warp.CollisionPipeline.launch` finds them.

    Args:
        pipeline: The pipeline, on the device of the tensors. Its capacities are those of its ``reserve()``.
        vertices_t0: Start positions, a tensor of float32 or float64, shape [V, 3] or [W, V / W, 3], as of ``launch``.
        vertices_t1: End positions, of the same type.
        per: ``"scene"``, ``"world"``, ``"body"`` or ``"vertex"``.

    Returns:
        A tensor of float64, of the scene of shape [], of worlds, bodies or vertices with one each; inf where there is
        certainly no collision.

    Raises:
        ValueError: If a tensor is not as described.
        RuntimeError: If a capacity was too small, so that gradients would be incomplete.

    Guarantee: that of ``launch``; gradients have no part in it.
    """
    check_instance("pipeline", pipeline, CollisionPipeline)
    check_choice("per", per, EVERY_PER)
    found = _Toi.apply(pipeline, per, vertices_t0, vertices_t1)
    return found[0] if per == "scene" else found


@text_completed_by(toi)
def collision_free_step(
    pipeline: CollisionPipeline, vertices_t0: torch.Tensor, vertices_t1: torch.Tensor
) -> torch.Tensor:
    """Largest fraction of a step that is certain to be free of collisions: the toi, or t_max where there is none.

    Returns:
        A tensor of float64 of shape [], in [0, t_max].

    Guarantee: no pair touches before the returned fraction of the step.
    """
    return toi(pipeline, vertices_t0, vertices_t1).clamp(max=pipeline._options.t_max)


@torch.compiler.disable
@text_completed_by(toi)
def line_search(
    pipeline: CollisionPipeline,
    vertices_t0: torch.Tensor,
    vertices_t1: torch.Tensor,
    *,
    per: Per = "scene",
    safety: float = DEFAULT_SAFETY,
    num_rounds: int = DEFAULT_NUM_ROUNDS,
) -> torch.Tensor:
    """Shorten a step until it is certain to be free, as :meth:`ccd_warp.CollisionPipeline.launch_line_search` does.

    Args:
        vertices_t1: Wished end positions, which stay as they are.
        per: As of ``launch_line_search``, and so are ``safety`` and ``num_rounds``.
        safety: Fraction of its toi by which a vertex in contact may move.
        num_rounds: Number of passes.

    Returns:
        The positions at the end of the shortened step, a tensor like ``vertices_t1``.

    Raises:
        ValueError: As of ``launch_line_search``.

    Guarantee: that of ``launch_line_search``; gradients have no part in it.
    """
    check_instance("pipeline", pipeline, CollisionPipeline)
    return _LineSearch.apply(
        pipeline, {"per": per, "safety": safety, "num_rounds": num_rounds}, vertices_t0, vertices_t1
    )


def toi_is_regular(
    pipeline: CollisionPipeline, vertices_t0: torch.Tensor, vertices_t1: torch.Tensor, *, per: Per = "scene"
) -> torch.Tensor:
    """Which of the tois of :func:`toi` have a gradient; the others, as those of inf, give 0. It makes the launch again.

    Args:
        pipeline: As of :func:`toi`, and so are all other arguments.
        vertices_t0: Start positions.
        vertices_t1: End positions.
        per: Of which tois.

    Returns:
        A tensor of bool of the shape of the tois.

    Raises:
        ValueError: As :func:`toi`.
        RuntimeError: As :func:`toi`.
    """
    check_instance("pipeline", pipeline, CollisionPipeline)
    found = _regular(pipeline.launch, per, pipeline, vertices_t0, vertices_t1)
    return found[0] if per == "scene" else found


def line_search_is_regular(
    pipeline: CollisionPipeline,
    vertices_t0: torch.Tensor,
    vertices_t1: torch.Tensor,
    *,
    per: Per = "scene",
    safety: float = DEFAULT_SAFETY,
    num_rounds: int = DEFAULT_NUM_ROUNDS,
) -> torch.Tensor:
    """Which positions of :func:`line_search` have a derivative. It makes the launch again.

    Args:
        pipeline: As of :func:`line_search`, and so are all other arguments.
        vertices_t0: Start positions.
        vertices_t1: Wished end positions.
        per: What moves by one fraction.
        safety: Fraction of its toi by which a vertex in contact may move.
        num_rounds: Number of passes.

    Returns:
        A tensor of bool for each vertex, shape [V], as :meth:`ccd_warp.LaunchResult.is_regular` says it.

    Raises:
        ValueError: As :func:`line_search`.
        RuntimeError: As :func:`toi`.
    """
    check_instance("pipeline", pipeline, CollisionPipeline)
    launch = partial(pipeline.launch_line_search, per=per, safety=safety, num_rounds=num_rounds)
    end = vertices_t1.detach().clone() if isinstance(vertices_t1, torch.Tensor) else vertices_t1
    return _regular(launch, "vertex", pipeline, vertices_t0, end)


@torch.compiler.disable
def rigid_toi(
    pipeline: CollisionPipeline,
    poses_t0: torch.Tensor,
    poses_t1: torch.Tensor | None = None,
    *,
    twist: torch.Tensor | None = None,
    pivot: ArrayLike | None = None,
) -> torch.Tensor:
    """Earliest time of impact of rigid bodies that turn, in each world: what ``mesh_ccd`` finds with a ``motion``.

    The vertices of the mesh stand in the frames of its rigid bodies, and all others rest. Bodies move on the linear
    paths of :class:`ccd_warp.RigidMotion`; screws have no gradients, nor has a motion with ``within``. Of each world
    little more than its first contact is searched, and the gradient is that of this contact, on the host.

    Args:
        pipeline: The pipeline of a mesh with ``rigid`` bodies: of one world, or of as many as there are poses of.
        poses_t0: Poses of the rigid bodies at t = 0, position and quaternion **x y z w** of any length but 0, a tensor
            of float32 or float64, shape [B, 7], or with one or more axes of worlds in front [W, B, 7].
        poses_t1: Poses at t = 1, of the same shape; between them is the shortest turn.
        twist: In place of ``poses_t1``, motion in the whole step, **linear part first, then angular** in radians,
            [B, 6] or [W, B, 6].
        pivot: Points about which the bodies turn, in their own frames, [3], [B, 3] or [W, B, 3], numbers without a
            gradient.

    Returns:
        A tensor of float64, of shape [W], or [] where poses have no axis of worlds; inf where there is certainly no
        collision. Its gradients by ``poses_t0`` and ``poses_t1`` or ``twist`` are 0 of worlds in which nothing touches
        or whose contact is not regular, as where toi is 0; of several contacts with one toi it is that of the first in
        the order of :class:`ccd_warp.Contacts`. Along a quaternion they are 0.

    Raises:
        ValueError: If a tensor is not as described, both or neither of ``poses_t1`` and ``twist`` are given, ``pivot``
            requires a gradient, or as :class:`ccd_warp.RigidMotion` and :func:`ccd_warp.mesh_ccd` do.

    Guarantee: that of :func:`ccd_warp.mesh_ccd` with a motion; gradients have no part in it.
    """
    check_instance("pipeline", pipeline, CollisionPipeline)
    for name, tensor in {"poses_t0": poses_t0, "poses_t1": poses_t1, "twist": twist}.items():
        if not isinstance(tensor, torch.Tensor | None):
            raise ValueError(f"{name} is a {type(tensor).__name__}; expected a tensor")
    if isinstance(pivot, torch.Tensor):
        if pivot.requires_grad:
            raise ValueError("pivot requires a gradient; expected numbers, as there is none by pivots")
        pivot = pivot.cpu().numpy()
    return _RigidToi.apply(pipeline, pivot, twist is not None, poses_t0, checked_end(poses_t0, poses_t1, twist))


@torch.compiler.disable
def _regular(launch: Any, per: Per, pipeline: CollisionPipeline, *vertices: torch.Tensor) -> torch.Tensor:
    """The flags of a launch on a tape."""
    with _in_order(pipeline._topology.device):
        arrays = _arrays(vertices)
        for array in arrays:
            array.requires_grad = True
        _, result = launched(launch, arrays)
        return _handed_over(result.is_regular(per))


class _Toi(torch.autograd.Function):
    """Tois of a launch."""

    @staticmethod
    def forward(ctx: Any, pipeline: CollisionPipeline, per: str, *vertices: torch.Tensor) -> torch.Tensor:
        """Launch, on a tape where a gradient is asked for."""
        with _in_order(pipeline._topology.device):
            ctx.arrays, needs = _arrays(vertices), ctx.needs_input_grad[2:]
            for array, needs_gradient in zip(ctx.arrays, needs, strict=True):
                array.requires_grad = needs_gradient
            ctx.tape, result = launched(pipeline.launch, ctx.arrays)
            ctx.toi = getattr(result, TOIS[per])
            found = _handed_over(ctx.toi)
            # without a tape the next launch overwrites the arrays of the result
            return found.clone() if ctx.tape is None and ctx.toi.device.is_cpu else found

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, of_toi: torch.Tensor) -> Any:
        """Play the tape backwards."""
        return None, None, *_played_back(ctx, ctx.toi, of_toi.contiguous())


class _LineSearch(torch.autograd.Function):
    """Shortened positions of a line search."""

    @staticmethod
    def forward(
        ctx: Any, pipeline: CollisionPipeline, options: dict[str, Any], start: torch.Tensor, end: torch.Tensor
    ) -> torch.Tensor:
        """Launch, on a tape where a gradient is asked for."""
        shortened = end.detach().clone()
        with _in_order(pipeline._topology.device):
            ctx.arrays, needs = _arrays((start, shortened)), ctx.needs_input_grad[2:]
            for array, needs_gradient in zip(ctx.arrays, (needs[0], any(needs)), strict=True):
                array.requires_grad = needs_gradient
            launch = partial(pipeline.launch_line_search, **options)
            ctx.tape, _ = launched(launch, ctx.arrays)
            return shortened

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, of_shortened: torch.Tensor) -> Any:
        """Play the tape backwards, which turns the gradient of the shortened positions into that of the wished ones."""
        own_gradient = of_shortened.clone(memory_format=torch.contiguous_format)
        return None, None, *_played_back(ctx, ctx.arrays[1], own_gradient)


class _RigidToi(torch.autograd.Function):
    """Tois of worlds of rigid bodies."""

    @staticmethod
    def forward(
        ctx: Any, pipeline: CollisionPipeline, pivot: ArrayLike | None, is_twist: bool, *ends: torch.Tensor
    ) -> torch.Tensor:
        """Search, and keep the contacts."""
        ctx.like = [(end.dtype, end.device) for end in ends]
        ctx.tois = RigidTois(pipeline, pivot, is_twist, *(end.detach().cpu().numpy() for end in ends))
        return torch.tensor(ctx.tois.toi, device=ends[0].device)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, of_toi: torch.Tensor) -> Any:
        """The gradients of the contacts, once; 0 of worlds without one, whatever the gradient by their tois."""
        found: list[Any] = [None, None]
        for k in range(2):
            if ctx.needs_input_grad[3 + k]:
                dtype, device = ctx.like[k]
                of_end = torch.tensor(ctx.tois.gradients[k], device=of_toi.device)
                of_end = torch.where(of_end == 0.0, of_end, of_toi[..., None, None] * of_end)
                found[k] = of_end.to(device=device, dtype=dtype)
        return None, None, None, *found


def _in_order(device: Any) -> AbstractContextManager[Any]:
    """A block whose launches, on CUDA, are in the order of PyTorch's current stream; no tensor is computed in it."""
    if not device.is_cuda:
        return nullcontext()
    return in_order_of_library(device, torch.cuda.current_stream(device.ordinal).cuda_stream)


def _arrays(vertices: Sequence[torch.Tensor]) -> list[Any]:
    """Tensors as arrays of Warp in the same memory."""
    for k, tensor in enumerate(vertices):
        if not isinstance(tensor, torch.Tensor):
            raise ValueError(f"vertices_t{k} is a {type(tensor).__name__}; expected a tensor")
    return [as_warp(tensor.detach(), f"vertices_t{k}") for k, tensor in enumerate(vertices)]


def _handed_over(array: Any) -> Any:
    """An array as a tensor: in its own memory on the CPU, and in memory of PyTorch on CUDA.

    Warp would free its own before a stream of PyTorch, which does not block, has read it; and what it allocates while a
    graph is captured is no memory that PyTorch can ask CUDA about.
    """
    if array.device.is_cpu:
        return wp.to_torch(array, requires_grad=False)
    dtype, device = wp.dtype_to_torch(array.dtype), wp.device_to_torch(array.device)
    tensor = torch.empty(array.shape, dtype=dtype, device=device)
    copy: Any = wp.from_torch(tensor)
    wp.copy(copy, array)
    return tensor


def _played_back(ctx: Any, result: wp.array, gradient: torch.Tensor) -> list[Any]:
    """The gradients of the arrays of a launch from that of its result, in tensors that no later call writes to."""
    with _in_order(result.device):
        of_result: Any = wp.from_torch(gradient, dtype=result.dtype)
        play_back(ctx.tape, ctx.arrays, result, of_result)
        needs = ctx.needs_input_grad[2:]
        return [_handed_over(x.grad) if is_needed else None for x, is_needed in zip(ctx.arrays, needs, strict=True)]
