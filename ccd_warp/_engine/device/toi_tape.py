"""A launch on a tape: what its backward pass needs is kept, and one function is recorded."""

from dataclasses import replace
from typing import Any

import warp as wp

from ccd_warp._device_results import LaunchResult
from ccd_warp._engine.device.input import PreparedLaunch
from ccd_warp._engine.device.kept_check import Given, KeptCheck
from ccd_warp._engine.device.step import DeviceStep
from ccd_warp._runtime.tape import active_tape

_MINIMA = {"vertex": "vertex_toi", "body": "body_toi", "world": "world_toi", "scene": "toi"}


def record_launch(
    step: DeviceStep, prepared: PreparedLaunch, given: tuple[Any, Any], radius: wp.array | None
) -> LaunchResult:
    """Record the backward pass of the last launch on the active tape.

    Args:
        step: The step that was launched.
        prepared: The arguments as they were launched.
        given: The positions as the caller has given them.
        radius: The radii of the pipeline.

    Returns:
        The result with tois of its own, which later launches do not overwrite, and which require gradients.
    """
    of_input = Given.of(given, radius, prepared.form, (len(prepared.vertices_t0), len(prepared.vertices_t1)))
    positions = step.last_positions()
    assert positions is not None
    check = KeptCheck(step, positions, radius, may_be_raised=False)
    tois: dict[str, Any] = {name: wp.empty_like(x, requires_grad=True) for name, x in check.tois.items()}
    for name, array in tois.items():
        wp.copy(array, check.tois[name])
    if step.result.world_toi is step.result.toi:
        tois["world_toi"] = tois["toi"]
    minima = {name: tois[of] for name, of in _MINIMA.items() if name != "world" or tois[of] is not tois["toi"]}

    def backward() -> None:
        check.add_gradients({name: x.grad for name, x in minima.items()}, of_input, of_input.gradients(step))

    active_tape().record_func(backward, [*minima.values(), *of_input.arrays])
    return replace(step.result, **tois)
