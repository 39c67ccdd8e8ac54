"""A launch on a tape: what its backward pass needs is kept, and one function is recorded."""

from dataclasses import replace
from typing import Any

import warp as wp

from ccd_warp._device_results import TOIS, LaunchResult
from ccd_warp._engine.device.given import Given
from ccd_warp._engine.device.input import PreparedLaunch
from ccd_warp._engine.device.kept_check import KeptCheck, as_flags
from ccd_warp._engine.device.step import DeviceStep
from ccd_warp._runtime.tape import active_tape


class TapedLaunch:
    """A launch whose tois get gradients by the positions at both ends and by radii.

    Attributes:
        result: After the launch its result, with tois of its own that later launches do not overwrite.
    """

    result: LaunchResult

    def __init__(
        self, step: DeviceStep, prepared: PreparedLaunch, given: tuple[Any, Any], radius: wp.array | None
    ) -> None:
        """Of the arguments of a launch, with the positions as the caller has given them.

        Raises:
            ValueError: If the distance of a pair follows from its start.
        """
        self._step, self._radius = step, radius
        rows = len(prepared.vertices_t0), len(prepared.vertices_t1)
        self._given = Given.of(given, radius, prepared.form, rows)
        self._query = step.touch().query(is_planar=step.topology.mesh.dimension == 2)

    def launch(self, prepared: PreparedLaunch) -> None:
        """Launch, keep what was found, and record the backward pass on the active tape."""
        step = self._step
        step.launch(prepared)
        check = KeptCheck(step, self._query, step.positions_of(prepared), self._radius)
        tois: dict[str, Any] = {name: wp.empty_like(x, requires_grad=True) for name, x in check.tois.items()}
        for name, array in tois.items():
            wp.copy(array, check.tois[name])
        if step.result.world_toi is step.result.toi:
            tois["world_toi"] = tois["toi"]
        minima = {name: tois[of] for name, of in TOIS.items() if name != "world" or tois[of] is not tois["toi"]}

        def backward() -> None:
            of_minima = {name: x.grad for name, x in minima.items()}
            check.add_gradients(of_minima, self._given, self._given.gradients(step.topology))

        active_tape().record_func(backward, [*minima.values(), *self._given.arrays])
        self._check = check
        self.result = replace(step.result, **tois, _taped=self)

    def is_regular(self, per: str) -> wp.array:
        """Whether each toi of the scene, of worlds, bodies or vertices has a gradient, bool."""
        check = self._check
        return as_flags(self._step.execution, check.ratings(per, check.attaining(check.all_ones(per))))
