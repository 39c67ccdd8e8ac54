"""Contacts and minima of a step, collected batch by batch in one list that is sorted at the end."""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._contacts import Contacts
from ccd_warp._engine.buffers import Buffers
from ccd_warp._engine.topology import Topology
from ccd_warp._runtime.launch import Execution
from ccd_warp.kernels import contacts as kernels
from ccd_warp.kernels.minima import Minima

CONTACT_DTYPES = {
    "kind": wp.int32,
    "primitives": wp.vec2i,
    "toi": wp.float64,
    "status": wp.int32,
    "parameters": wp.vec2d,
    "gap": wp.float64,
    "width": wp.float64,
    "normal": wp.vec3d,
}
_BYTES = sum(map(wp.types.type_size_in_bytes, CONTACT_DTYPES.values()))
# Bytes of an entry of the list; and the most that a contact takes: an entry of the list while it is copied to one of
# twice the size, or an entry of the list and one of the result, with its key and its position in the order.
BYTES_PER_CONTACT = _BYTES
BYTES_KEPT = 3 * _BYTES + 16
_LAST = np.iinfo(np.int32).max
# Number of contacts from which on threads share the sorting.
_WORTH_THREADS = 1 << 15
_SAMPLES = 1 << 10


def new_minima(topology: Topology, **arrays: wp.array) -> Any:
    """The struct of atomic minima: toi as bits, which order like the non-negative numbers, and flags."""
    minima = Minima()
    minima.vertex_body, minima.vertex_world = topology.vertex_body, topology.vertex_world
    for name, array in arrays.items():
        setattr(minima, name, array if "flags" in name else array.view(wp.int64))
    return minima


def new_contact_list(arrays: Mapping[str, wp.array]) -> Any:
    """The struct that kernels append to: the arrays of a list of contacts, and their count."""
    contacts = kernels.ContactList()
    for name, array in arrays.items():
        setattr(contacts, name, array)
    return contacts


@dataclass(frozen=True)
class Gathered:
    """Sorted contacts, and the earliest of every vertex and body."""

    contacts: Contacts
    toi: float
    vertex_toi: NDArray[np.float64]
    body_toi: NDArray[np.float64]
    world_toi: NDArray[np.float64]
    vertex_contact: NDArray[np.int32]
    body_contact: NDArray[np.int32]


class ContactStore:
    """Contacts of the batches of a step, and the minima over them; its arrays stay for the next step.

    Attributes:
        minima: The minima that the narrow phase updates.
        total: Number of contacts found.
    """

    def __init__(self, topology: Topology, buffers: Buffers) -> None:
        mesh = topology.mesh
        self.total = 0
        self._topology, self._buffers = topology, buffers
        sizes = {"vertex": mesh.num_vertices, "body": mesh.num_bodies, "world": mesh.num_worlds, "scene": 1}
        self._bounds = [0, *itertools.accumulate(sizes.values())]
        self._toi = wp.empty(self._bounds[-1], dtype=wp.float64, device=topology.device)
        toi = {
            name: self._toi[begin:end]
            for name, (begin, end) in zip(sizes, itertools.pairwise(self._bounds), strict=True)
        }
        # flags tell of too little capacity alone, and here the counts do
        flags, world_flags = (wp.zeros(sizes[of], dtype=wp.int32, device=topology.device) for of in ("scene", "world"))
        self.minima = new_minima(topology, **toi, flags=flags, world_flags=world_flags)
        self._counter: wp.array = wp.zeros(1, dtype=wp.int32, device=topology.device)
        self._list: Any = None
        self._capacity = 0

    def begin(self, execution: Execution, largest: int) -> None:
        """Begin a step; ``largest`` is the number of contacts that may be kept, beyond it they are only counted."""
        self.total = 0
        self._execution, self._largest = execution, largest
        self._toi.fill_(np.inf)

    @property
    def is_complete(self) -> bool:
        """Whether all contacts were kept."""
        return self.total <= self._largest

    def begin_batch(self, num_pairs: int) -> Any:
        """The list that a batch of so many pairs appends to, with a place for each of them."""
        kept, wanted = min(self.total, self._capacity), min(self.total + num_pairs, self._largest)
        if wanted > self._capacity or self._list is None:
            arrays = {
                name: self._buffers.grown(f"contact {name}", kept, wanted, dtype)
                for name, dtype in CONTACT_DTYPES.items()
            }
            self._list = new_contact_list({"count": self._counter, **arrays})
            self._capacity = min(map(len, arrays.values()))
        self._counter.fill_(kept)
        return self._list

    def end_batch(self) -> None:
        """Count what the batch has appended."""
        self.total += int(self._counter.numpy()[0]) - min(self.total, self._capacity)

    def gather(self) -> Gathered:
        """All contacts, sorted by kind and pair, and the first contact of every vertex and body."""
        mesh, topology = self._topology.mesh, self._topology
        device, count = topology.device, self.total
        arrays = {name: wp.empty(count, dtype=dtype, device=device) for name, dtype in CONTACT_DTYPES.items()}
        first_of = [np.full(n, -1, dtype=np.int32) for n in (mesh.num_vertices, mesh.num_bodies)]
        if count > 0:
            found = self._list
            ordered = new_contact_list({"count": self._counter, **arrays})
            self._execution.launch(kernels.order_contacts, count, inputs=[self._order(found), found], outputs=[ordered])
            corners = [topology.corners[name] for name in ("vertex", "edge", "face")]
            places = [wp.full(len(first), value=_LAST, dtype=wp.int32, device=device) for first in first_of]
            self._execution.launch(
                kernels.first_contacts, count, inputs=[ordered, *corners, self.minima], outputs=places
            )
            first_of = [np.where(f == _LAST, np.int32(-1), f) for f in (place.numpy() for place in places)]
        toi = self._toi.numpy().copy()
        vertex_toi, body_toi, world_toi, scene_toi = (toi[i:j] for i, j in itertools.pairwise(self._bounds))
        vertex_contact, body_contact = first_of
        return Gathered(
            Contacts(**{name: array.numpy() for name, array in arrays.items()}),
            float(scene_toi[0]),
            vertex_toi,
            body_toi,
            world_toi,
            vertex_contact,
            body_contact,
        )

    def _order(self, found: Any) -> wp.array:
        """Positions of the contacts in the list, by ascending kind and pair."""
        device, count = self._execution.device, self.total
        keys = wp.empty(2 * count if device.is_cuda else count, dtype=wp.int64, device=device)
        self._execution.launch(kernels.contact_keys, count, inputs=[found], outputs=[keys])
        if not device.is_cuda:
            return wp.array(self._sorted_places(keys.numpy()), dtype=wp.int32, device=device, copy=False)
        places: wp.array = wp.array(np.arange(2 * count, dtype=np.int32), dtype=wp.int32, device=device)
        wp.utils.radix_sort_pairs(keys, places, count)
        return places

    def _sorted_places(self, keys: NDArray[np.int64]) -> NDArray[np.int32]:
        """The permutation that sorts the keys; threads sort ranges between pivots taken from a sample."""
        if len(keys) < _WORTH_THREADS or self._execution.num_threads == 1:
            return np.argsort(keys).astype(np.int32)
        sample = np.sort(keys[:: len(keys) // _SAMPLES])
        pieces = self._execution.num_threads
        pivots = sample[[len(sample) * k // pieces for k in range(1, pieces)]]
        bounds = [None, *pivots.tolist(), None]

        def sort(low: int | None, high: int | None) -> NDArray[np.int32]:
            chosen = np.ones(len(keys), dtype=bool) if low is None else keys >= low
            if high is not None:
                chosen &= keys < high
            places = np.flatnonzero(chosen)
            return places[np.argsort(keys[places])].astype(np.int32)

        tasks = [lambda low=low, high=high: sort(low, high) for low, high in itertools.pairwise(bounds)]  # type: ignore[misc]
        return np.concatenate(self._execution.run(tasks))
