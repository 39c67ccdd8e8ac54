"""A launch on a tape: what its backward pass needs is kept, and one function is recorded."""

import ctypes
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import warp as wp

from ccd_warp._engine.device.input import PreparedLaunch
from ccd_warp._engine.device.step import DeviceStep
from ccd_warp._gradients.attaining import Attaining, all_attaining, as_flags, ratings_of
from ccd_warp._gradients.caller_arrays import CallerArrays
from ccd_warp._gradients.kept_check import KeptCheck
from ccd_warp._gradients.tape_memory import TapeMemory
from ccd_warp._results.device_results import TOIS, LaunchResult
from ccd_warp._runtime.joint_memory import joint_arrays
from ccd_warp._runtime.tape import active_tape


class TapedLaunch:
    """A launch whose tois get gradients by the positions at both ends and by radii.

    Attributes:
        on_backward: Called at the begin of the backward pass, where there is something to say; else None.
    """

    on_backward: Callable[[], None] | None = None

    def __init__(
        self, step: DeviceStep, prepared: PreparedLaunch, positions: tuple[Any, Any], radius: wp.array | None
    ) -> None:
        """Of the arguments of a launch, with the positions as the caller has given them.

        Raises:
            ValueError: If the distance of a pair follows from its start.
        """
        self._step, self._radius = step, radius
        rows = len(prepared.vertices_t0), len(prepared.vertices_t1)
        self._caller_arrays = CallerArrays.of(positions, radius, prepared.form, rows)
        _ = TapeMemory.of(step), step.contact_arrays.moving_row("gradients")  # made now, not in a capture

    def launch(self, prepared: PreparedLaunch) -> LaunchResult:
        """Launch, keep what was found, and record the backward pass on the active tape.

        Returns:
            The result, with tois of its own that later launches do not overwrite.
        """
        step, caller_arrays = self._step, self._caller_arrays
        step.launch(prepared)
        self._check = check = KeptCheck(step, step.positions_of(prepared), self._radius)
        tois = self._new_tois()
        minima = {name: tois[of] for name, of in TOIS.items() if name != "world" or tois[of] is not tois["toi"]}

        def backward() -> None:
            if self.on_backward is not None:
                self.on_backward()
            of_minima = {name: x.grad for name, x in minima.items()}
            if check.is_read:
                of_minima = {name: x for name, x in of_minima.items() if check.may_touch and x.numpy().any()}
            attaining = Attaining.of(check, of_minima)
            if attaining is not None:
                attaining.add_rows(caller_arrays, caller_arrays.gradients(step.topology))
                attaining.release()

        active_tape().record_func(backward, [*minima.values(), *caller_arrays.arrays])
        fields: dict[str, Any] = {**tois, "_taped": self}
        return replace(step.result, **fields)

    def _new_tois(self) -> dict[str, wp.array]:
        """Copies of the tois of the result, which require gradients; those of a single world are those of the scene."""
        result = self._step.result
        tois_of_step = {name: getattr(result, name) for name in TOIS.values()}
        if result.world_toi is result.toi:
            del tois_of_step["world_toi"]
        tois = joint_arrays({name: len(x) for name, x in tois_of_step.items()}, self._step.topology.device)
        for name, array in tois.items():
            if self._check.is_read:
                ctypes.memmove(array.ptr, tois_of_step[name].ptr, 8 * len(array))
            else:
                wp.copy(array, tois_of_step[name])
        tois.setdefault("world_toi", tois["toi"])
        return tois

    def is_regular(self, per: str) -> wp.array:
        """Whether each toi of the scene, of worlds, bodies or vertices has a gradient, bool."""
        check = self._check
        attaining = all_attaining(check, per)
        flags = as_flags(self._step, ratings_of(check, per, attaining))
        if attaining is not None:
            attaining.release()
        return flags
