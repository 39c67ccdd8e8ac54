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
from ccd_warp._results.shared_features import SharedFeatures, index_bits
from ccd_warp._runtime.launch import Execution
from ccd_warp._runtime.structs import dtypes_of, on_host, struct_of
from ccd_warp._runtime.written import Written
from ccd_warp.kernels.at_one_time import proximity as kernels
from ccd_warp.kernels.at_one_time.unique import FeaturePairs

PROXIMITY_DTYPES = dtypes_of(kernels.ProximityList)
BYTES_PER_PROXIMITY = sum(map(wp.types.type_size_in_bytes, PROXIMITY_DTYPES.values()))

# Pairs for which a list has places at least, and how many more than there were it has in the next call.
LEAST_PLACES, _GROWTH = 1 << 10, 1.25
# Pairs up to which a result has copies of them, as other arrays for the next list take longer.
_FEW = 1 << 13
_Columns = dict[str, Callable[[], NDArray[Any]]]

new_proximity_list = partial(struct_of, kernels.ProximityList)


def largest_bound(search_radius: float, is_alone: bool) -> float:
    """The largest bound of a displacement: two sides share the search radius; one that moves alone has all of it."""
    return search_radius if is_alone else max(0.5 * search_radius - 2.0**-1070, 0.0)  # rounding, step 16


class ProximityStore:
    """The pairs that batches of a search find, in one list, which stays for the next call.

    Attributes:
        total: Number of pairs found.
        expected: Number of pairs for which a list begins with places.
    """

    def __init__(self, topology: Topology, buffers: Buffers) -> None:
        self.total, self.expected, self._capacity = 0, LEAST_PLACES, 0
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
            is_cpu = self._topology.device.is_cpu
            self._views = {name: array.numpy() for name, array in arrays.items()} if is_cpu else None
        self._count.write(np.int32(self.total))
        return self._list

    def end_batch(self) -> None:
        """Count what the batch has appended."""
        self.total = int(self._count.array.numpy()[0])
        self.expected = max(LEAST_PLACES, int(_GROWTH * self.total))

    def ends_complete(self) -> bool:
        """Count what the only batch has appended; whether there was a place for each, as the next one has if not."""
        self.end_batch()
        return self.total <= self._capacity

    def gather(self, *, unique: bool) -> tuple[int, _Columns]:
        """The number of all pairs, or of the first of each two features alone, and their columns by name.

        A column is computed when it is asked for, sorted by kind and pair.
        """
        if self.total == 0:
            return 0, _NOTHING | ({"shared_by": partial(np.zeros, 0, np.int32)} if unique else {})
        if self._views is not None and self.total <= _FEW and not unique:
            return self.total, self._copied(self._views)
        return self._given_away(unique=unique)

    def _copied(self, views: dict[str, NDArray[Any]]) -> _Columns:
        """The columns of few pairs on the host, from copies."""
        copies = {name: view[: self.total].copy() for name, view in views.items()}
        first, second = copies["primitives"].T
        order = cache(lambda: np.lexsort((second, first, copies["kind"])))
        return {name: partial(_in_order, values, order) for name, values in copies.items()}

    def _given_away(self, *, unique: bool) -> tuple[int, _Columns]:
        """The same from the list, which is then no one else's."""
        device, count, pairs = self._execution.device, self.total, self._list
        keys: wp.array = wp.empty(2 * count if device.is_cuda else count, dtype=wp.int64, device=device)
        rows = shared_by = None
        if unique:
            rows, shared_by = self._unique_rows(keys)
            keys.assign(np.resize(keys.numpy()[rows], len(keys)))
            count, place_bits = len(rows), 0
        else:
            of_index, place_bits = self._key_bits()
            inputs = [pairs, of_index, place_bits]
            self._execution.launch(kernels.proximity_keys, count, inputs, [keys])
        self._list, self._capacity = None, 0
        for name in PROXIMITY_DTYPES:
            self._buffers.release(f"pair {name}")
        alone = Execution(device, self._execution.num_threads)  # what is read later is no part of this call
        order = cache(lambda: _order(keys, count, alone, place_bits))

        def column(name: str) -> NDArray[Any]:
            places = order() if rows is None else rows.take(order())
            values: NDArray[Any] = getattr(pairs, name).numpy().take(places, axis=0)
            return values

        columns = {name: partial(column, name) for name in PROXIMITY_DTYPES}
        return count, columns | ({} if shared_by is None else {"shared_by": lambda: shared_by.take(order())})

    def _key_bits(self) -> tuple[int, int]:
        """Bits of an index in a key, and of the place behind it: 0 on CUDA, and where all do not fit into a number."""
        mesh = self._topology.mesh
        of_index = index_bits(max(mesh.num_vertices, len(mesh.edges), len(mesh.faces), len(mesh.planes)))
        of_place = index_bits(self.total)
        fits = not self._execution.is_cuda and 3 + 2 * of_index + of_place < 64
        return of_index, of_place if fits else 0

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


_NOTHING: _Columns = {
    name: partial(np.zeros, (0, *shape), dtype)
    for name, (dtype, shape) in zip(PROXIMITY_DTYPES, map(on_host, PROXIMITY_DTYPES.values()), strict=True)
}


def _in_order(values: NDArray[Any], order: Callable[[], NDArray[np.intp]]) -> NDArray[Any]:
    """A column of pairs, sorted."""
    return values.take(order(), axis=0)


def _order(keys: wp.array, count: int, execution: Execution, place_bits: int) -> NDArray[np.intp]:
    """The places of so many keys in ascending order."""
    places: wp.array = wp.empty(count, dtype=wp.int32, device=execution.device)
    sort_places(keys, places, count, execution, place_bits)
    return places.numpy().astype(np.intp)
