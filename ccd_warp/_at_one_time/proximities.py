"""Lists of pairs that are near at one time, and what kernels are told of how near that is."""

from functools import partial
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._engine.host.buffers import Buffers
from ccd_warp._engine.host.contacts import sort_places
from ccd_warp._engine.mesh.topology import Topology
from ccd_warp._runtime.launch import Execution
from ccd_warp._runtime.structs import dtypes_of, on_host, struct_of
from ccd_warp.kernels.at_one_time import proximity as kernels

PROXIMITY_DTYPES = dtypes_of(kernels.ProximityList)
BYTES_PER_PROXIMITY = sum(map(wp.types.type_size_in_bytes, PROXIMITY_DTYPES.values()))


new_proximity_list = partial(struct_of, kernels.ProximityList)


def largest_bound(search_radius: float, is_alone: bool) -> float:
    """The largest bound of a displacement: two sides share the search radius; one that moves alone has all of it."""
    return search_radius if is_alone else 0.5 * search_radius


class ProximityStore:
    """The pairs that batches of a search find, in one list, which stays for the next call.

    Attributes:
        total: Number of pairs found.
    """

    def __init__(self, topology: Topology, buffers: Buffers, execution: Execution) -> None:
        self.total = 0
        self._buffers, self._execution = buffers, execution
        self._count: wp.array = wp.zeros(1, dtype=wp.int32, device=topology.device)
        self._list: Any = None

    def begin_batch(self, num_pairs: int) -> Any:
        """The list that a batch of so many pairs appends to, with a place for each of them."""
        arrays = {
            name: self._buffers.grown(f"pair {name}", self.total, self.total + num_pairs, dtype)
            for name, dtype in PROXIMITY_DTYPES.items()
        }
        self._count.fill_(self.total)
        self._list = new_proximity_list({"count": self._count, **arrays})
        return self._list

    def end_batch(self) -> None:
        """Count what the batch has appended."""
        self.total = int(self._count.numpy()[0])

    def gather(self) -> dict[str, NDArray[Any]]:
        """All pairs, sorted by kind and pair, in new arrays."""
        device, count = self._execution.device, self.total
        arrays = {name: self._new(count, dtype) for name, dtype in PROXIMITY_DTYPES.items()}
        if count > 0:
            keys: wp.array = wp.empty(2 * count if device.is_cuda else count, dtype=wp.int64, device=device)
            order: wp.array = wp.empty(count, dtype=wp.int32, device=device)
            launch = self._execution.launch
            launch(kernels.proximity_keys, count, inputs=[self._list], outputs=[keys])
            sort_places(keys, order, count, self._execution)
            ordered = new_proximity_list({"count": self._count, **arrays})
            launch(kernels.order_proximities, count, inputs=[order, self._list], outputs=[ordered])
        return {name: array.numpy() for name, array in arrays.items()}

    def _new(self, count: int, dtype: Any) -> wp.array:
        """A new array; on the CPU from NumPy, which asks for large pages, so that they are not cleared one by one."""
        device = self._execution.device
        if device.is_cuda:
            return wp.empty(count, dtype=dtype, device=device)
        of_numpy, shape = on_host(dtype)
        return wp.array(np.empty((count, *shape), of_numpy), dtype=dtype, device=device, copy=False)
