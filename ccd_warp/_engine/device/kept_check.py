"""A check of a step on the device, kept with all that the gradients of its minima need."""

from functools import cached_property
from typing import Any

import numpy as np
import warp as wp

from ccd_warp._device_results import TOIS
from ccd_warp._engine.device.step import DeviceStep
from ccd_warp._engine.host.contacts import new_contact_list
from ccd_warp._runtime.block import Copies
from ccd_warp._runtime.structs import struct_of
from ccd_warp.kernels.step import toi_adjoint

_CONTACT_COLUMNS = ("count", "kind", "primitives", "toi", "status")


class KeptCheck:
    """The contacts and the tois of a step that has been checked, and its input: copies, as all of it is overwritten.

    Attributes:
        step: The step.
        may_touch: Whether it may have a finite toi: on CUDA, and in a capture, always. Otherwise nothing is kept.
        count: How many contacts it may have.
        num_tois: How many tois there are of the scene, of worlds, bodies and vertices, by the names of a result.
        has_radius: Whether vertices have radii.
    """

    def __init__(
        self,
        step: DeviceStep,
        positions: tuple[wp.array, wp.array],
        radius: wp.array | None,
        like: "KeptCheck | None" = None,
    ) -> None:
        """Keep what a step has now, which was checked between these positions.

        It may have the start positions and the radii of another check.
        """
        result = step.result
        self.step, self.may_touch, self.has_radius = step, True, radius is not None
        self.num_tois = {name: len(getattr(result, name)) for name in TOIS.values()}
        _ = step.contact_arrays.moving_row("gradients")  # made now, not in a capture of the backward pass
        self.count = len(result.contacts.kind)
        if self.is_read:
            self.may_touch = bool(np.isfinite(result.toi.numpy()[0]))
            self.count = min(self.count, int(result.contacts.count.numpy()[0])) if self.may_touch else 0
        if not self.may_touch:
            return
        names = (*_CONTACT_COLUMNS, "normal") if step.has_planes else _CONTACT_COLUMNS
        columns = ((name, getattr(result.contacts, name)) for name in names)
        device = step.topology.device
        self._contacts = Copies({name: (x, min(self.count, len(x))) for name, x in columns}, device)
        self._contact_names = names
        arrays = {name: getattr(result, name) for name in TOIS.values()} | {"end": positions[1]}
        self._own = Copies({name: (x, len(x)) for name, x in arrays.items()}, device)
        of_start = {"start": positions[0]} if radius is None else {"start": positions[0], "radius": radius}
        self._of_start = (
            Copies({name: (x, len(x)) for name, x in of_start.items()}, device) if like is None else like._of_start
        )

    def copy_of(self, name: str) -> wp.array:
        """The start or end positions of all vertices, float64, their radii, or the tois of this name."""
        return (self._of_start if name in ("start", "radius") else self._own)[name]

    @cached_property
    def as_struct(self) -> Any:
        """What is kept, as the struct of the kernels."""
        names = ("start", "end", *TOIS.values(), *(("radius",) if self.has_radius else ()))
        check = struct_of(toi_adjoint.Check, {name: self.copy_of(name) for name in names})
        check.contacts = new_contact_list({name: self._contacts[name] for name in self._contact_names})
        check.separation = self.step.gradient_query.separation
        return check

    @property
    def is_read(self) -> bool:
        """Whether the host may read what a launch has written: on the CPU, where no graph is captured."""
        device = self.step.topology.device
        return bool(device.is_cpu and not device.is_capturing)
