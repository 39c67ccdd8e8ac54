"""Lists of pairs that are near at one time, and what kernels are told of how near that is."""

from collections.abc import Callable
from functools import cache, partial
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._engine.host.buffers import Buffers
from ccd_warp._engine.host.contacts import sort_places
from ccd_warp._engine.mesh.topology import Topology, sort_in_place
from ccd_warp._results.shared_features import SharedFeatures
from ccd_warp._runtime.launch import Execution
from ccd_warp._runtime.structs import dtypes_of, on_host, struct_of
from ccd_warp._runtime.written import Written
from ccd_warp.kernels.at_one_time import proximity as kernels
from ccd_warp.kernels.at_one_time.unique import FeaturePairs

PROXIMITY_DTYPES = dtypes_of(kernels.ProximityList)
BYTES_PER_PROXIMITY = sum(map(wp.types.type_size_in_bytes, PROXIMITY_DTYPES.values()))


new_proximity_list = partial(struct_of, kernels.ProximityList)


def largest_bound(search_radius: float, is_alone: bool) -> float:
    """The largest bound of a displacement: two sides share the search radius; one that moves alone has all of it."""
    return search_radius if is_alone else max(0.5 * search_radius - 2.0**-1070, 0.0)  # rounding, step 16


class ProximityStore:
    """The pairs that batches of a search find, in one list, which stays for the next call.

    Attributes:
        total: Number of pairs found.
    """

    def __init__(self, topology: Topology, buffers: Buffers) -> None:
        self.total = self._capacity = 0
        self._topology, self._buffers = topology, buffers
        self._count = Written(wp.zeros(1, dtype=wp.int32, device=topology.device))
        self._list: Any = None  # until somebody else has it

    def begin(self, execution: Execution) -> None:
        """Begin a call."""
        self.total, self._execution = 0, execution

    def begin_batch(self, num_pairs: int) -> Any:
        """The list that a batch of so many pairs appends to, with a place for each of them."""
        if self._list is None or self._capacity < self.total + num_pairs:
            arrays = {
                name: self._buffers.grown(f"pair {name}", self.total, self.total + num_pairs, dtype)
                for name, dtype in PROXIMITY_DTYPES.items()
            }
            self._list = new_proximity_list({"count": self._count.array, **arrays})
            self._capacity = min(map(len, arrays.values()))
        self._count.write(np.int32(self.total))
        return self._list

    def end_batch(self) -> None:
        """Count what the batch has appended."""
        self.total = int(self._count.array.numpy()[0])

    def gather(self, *, unique: bool) -> tuple[int, dict[str, Callable[[], NDArray[Any]]]]:
        """The number of all pairs, or of the first of each two features alone, and their columns by name.

        A column is computed when it is asked for, sorted by kind and pair, from the list, which is then no one else's.
        """
        device, count, pairs = self._execution.device, self.total, self._list
        if count == 0:
            arrays = {name: on_host(dtype) for name, dtype in PROXIMITY_DTYPES.items()}
            arrays |= {"shared_by": (np.int32, ())} if unique else {}
            return 0, {name: partial(_nothing, dtype, shape) for name, (dtype, shape) in arrays.items()}
        keys: wp.array = wp.empty(2 * count if device.is_cuda else count, dtype=wp.int64, device=device)
        rows = shared_by = None
        if unique:
            rows, shared_by = self._unique_rows(keys)
            keys.assign(np.resize(keys.numpy()[rows], len(keys)))
            count = len(rows)
        else:
            self._execution.launch(kernels.proximity_keys, count, inputs=[pairs], outputs=[keys])
        self._list, self._capacity = None, 0
        for name in PROXIMITY_DTYPES:
            self._buffers.release(f"pair {name}")
        alone = Execution(device, self._execution.num_threads)  # what is read later is no part of this call
        order = cache(lambda: _order(keys, count, alone))

        def column(name: str) -> NDArray[Any]:
            places = order() if rows is None else rows.take(order())
            values: NDArray[Any] = getattr(pairs, name).numpy().take(places, axis=0)
            return values

        columns = {name: partial(column, name) for name in PROXIMITY_DTYPES}
        return count, columns | ({} if shared_by is None else {"shared_by": lambda: shared_by.take(order())})

    def _unique_rows(self, pair_keys: wp.array) -> tuple[NDArray[np.intp], NDArray[np.int32]]:
        """The first pair of each two features, ascending by their places in the list, and how many pairs have these.

        Computes the keys of all pairs.
        """
        device, count = self._execution.device, self.total
        columns = {name: getattr(self._list, name) for name in ("count", "kind", "primitives", "features")}
        columns |= {f"{kind}_corners": self._topology.corners[kind] for kind in ("edge", "face")}
        columns["face_copies"] = self._topology.face_copies
        size = 2 * count if device.is_cuda else count
        keys: wp.array = wp.empty(size, dtype=wp.int64, device=device)
        others, *of_rows = (wp.empty(count, dtype=dtype, device=device) for dtype in (wp.vec2i, wp.bool, wp.int32))
        shared = SharedFeatures(keys, others, pair_keys, *of_rows)
        sort = partial(sort_in_place, keys, count, self._execution)
        num_vertices = self._topology.mesh.num_vertices
        shared.find(self._execution, struct_of(FeaturePairs, columns), num_vertices, count, sort)
        rows = np.flatnonzero(shared.is_unique.numpy())
        return rows, shared.shared_by.numpy()[rows]


def _nothing(dtype: type, shape: tuple[int, ...]) -> NDArray[Any]:
    """A column of no pairs."""
    return np.zeros((0, *shape), dtype)


def _order(keys: wp.array, count: int, execution: Execution) -> NDArray[np.intp]:
    """The places of so many keys in ascending order."""
    places: wp.array = wp.empty(count, dtype=wp.int32, device=execution.device)
    sort_places(keys, places, count, execution)
    return places.numpy().astype(np.intp)
