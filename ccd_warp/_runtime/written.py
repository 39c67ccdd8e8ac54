"""An array of a device that is written from the host, on the CPU through a view: a tenth of what Warp takes."""

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray


class Written:
    """An array of a device that is written from the host.

    Attributes:
        array: The array.
    """

    def __init__(self, array: wp.array) -> None:
        self.array = array
        self._view = array.numpy() if array.device.is_cpu else None  # type: ignore[union-attr]

    def write(self, values: NDArray[Any] | np.number) -> None:
        """Write values of its shape, or one for all."""
        if self._view is None:
            self.array.assign(np.broadcast_to(values, self.array.shape + np.shape(values)[1:]))
        else:
            self._view[...] = values

    def write_first(self, values: NDArray[Any]) -> None:
        """Write its first rows."""
        if self._view is None:
            self.array[: len(values)].assign(values)
        else:
            self._view[: len(values)] = values
