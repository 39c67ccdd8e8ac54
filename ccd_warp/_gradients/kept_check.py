"""A check of a step on the device, kept with all that the gradients of its minima need."""

import ctypes
from typing import Any

import numpy as np
import warp as wp

from ccd_warp._engine.host.contacts import new_contact_list
from ccd_warp._gradients.tape_memory import TapeMemory
from ccd_warp._results.device_results import TOIS
from ccd_warp._runtime.structs import struct_of
from ccd_warp.kernels.gradients import attained

_CONTACT_COLUMNS = ("count", "kind", "primitives", "toi", "status")
_MOST_UNUSED = 4  # as many as most line searches have passes


class KeptCheck:
    """The contacts and the tois of a step that has been checked, and its input: copies, as all of it is overwritten.

    Attributes:
        step: The ``DeviceStep``.
        memory: What it keeps for launches on tapes.
        may_touch: Whether it may have a finite toi: on CUDA, and in a capture, always. Otherwise nothing is kept.
        count: How many contacts it may have.
        has_radius: Whether vertices have radii.
        copies: The copies.
    """

    copies: "_Copies"

    def __init__(self, step: Any, positions: tuple[wp.array, wp.array], radius: wp.array | None) -> None:
        """Keep what a step has now, which was checked between these positions."""
        self.step, self.memory = step, TapeMemory.of(step)
        self.may_touch, self.has_radius = True, radius is not None
        self.count = len(step.result.contacts.kind)
        self._is_reused = is_read = self.is_read
        if is_read:
            toi, count = self.memory.found_on_host
            self.may_touch = toi[0] < np.inf
            self.count = min(self.count, int(count[0])) if self.may_touch else 0
        if not self.may_touch:
            return
        copies = self.memory.copies.pop() if is_read and self.memory.copies else None
        if copies is None or copies.capacity < self.count:
            capacity = 1 << (self.count - 1).bit_length() if is_read and self.count else self.count
            copies = _Copies(step, self.memory, capacity, has_radius=self.has_radius)
        self.copies = copies
        copies.fill(positions, radius, self.count, is_direct=is_read)

    def __del__(self) -> None:
        """Let another check have the memory, unless CUDA may still read it, or a graph owns it."""
        copies = vars(self).get("copies")
        if copies is not None and self._is_reused and len(self.memory.copies) < _MOST_UNUSED:
            self.memory.copies.append(copies)

    @property
    def is_read(self) -> bool:
        """Whether the host may read what a launch has written: on the CPU, where no graph is captured."""
        device = self.step.topology.device
        return bool(device.is_cpu and not device.is_capturing)


class _Copies:
    """Copies of the arrays of a check.

    Attributes:
        capacity: For how many contacts there is space.
        arrays: The copies: tois by the names of a result, and the start and end positions of all vertices.
        as_struct: All of it as the struct of the kernels.
    """

    def __init__(self, step: Any, memory: TapeMemory, capacity: int, *, has_radius: bool) -> None:
        """Allocate them."""
        result, device = step.result, step.topology.device
        names = (*_CONTACT_COLUMNS, "normal") if step.has_planes else _CONTACT_COLUMNS
        of_contacts = {name: getattr(result.contacts, name) for name in names}
        self.capacity = capacity
        contacts = {
            name: wp.empty(1 if name == "count" else capacity, dtype=x.dtype, device=device)
            for name, x in of_contacts.items()
        }
        self.arrays = {name: wp.empty_like(getattr(result, name)) for name in TOIS.values()}
        num_vertices = step.topology.mesh.num_vertices
        self.arrays |= {name: wp.empty(num_vertices, dtype=wp.vec3d, device=device) for name in ("start", "end")}
        if has_radius:
            self.arrays["radius"] = wp.empty(num_vertices, dtype=wp.float64, device=device)
        self.as_struct = struct_of(attained.Check, self.arrays)
        self.as_struct.contacts = new_contact_list(contacts)
        self.as_struct.separation = memory.query.separation
        self._contacts = [(contacts[name], x) for name, x in of_contacts.items()]
        self._tois = [(self.arrays[name], getattr(result, name), len(self.arrays[name])) for name in TOIS.values()]
        self._of_vertices = [self.arrays[name] for name in ("start", "end", "radius") if name in self.arrays]
        self._num_vertices = num_vertices

    def fill(
        self, positions: tuple[wp.array, wp.array], radius: wp.array | None, count: int, *, is_direct: bool
    ) -> None:
        """Copy what a step has now, with so many contacts: at once, or in the order of launches."""
        of_vertices = zip(self._of_vertices, (*positions, radius), strict=False)
        whole = ((copy, x, self._num_vertices) for copy, x in of_vertices)
        rows = ((copy, x, min(count, x.shape[0])) for copy, x in self._contacts)
        for copy, array, num_rows in (*rows, *self._tois, *whole):
            if is_direct:
                ctypes.memmove(copy.ptr, array.ptr, num_rows * array.strides[0])
            elif num_rows:
                wp.copy(copy, array, count=num_rows)
