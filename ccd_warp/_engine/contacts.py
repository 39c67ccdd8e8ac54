"""Contacts and minima of a step, collected batch by batch in one list that is sorted at the end."""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._engine.buffers import Buffers
from ccd_warp._engine.topology import Topology
from ccd_warp._results import Contacts
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
    """Contacts of the batches so far, and the minima over them.

    Attributes:
        minima: The minima that the narrow phase updates.
        total: Number of contacts found.
    """

    def __init__(self, topology: Topology, buffers: Buffers, execution: Execution, largest: int) -> None:
        """``largest`` is the number of contacts that are kept; further ones are only counted."""
        mesh = topology.mesh
        self.total = 0
        self._topology, self._buffers, self._execution = topology, buffers, execution
        self._largest = largest
        self._counter = buffers.get("contact counter", 1, wp.int32)
        sizes = {"vertex": mesh.num_vertices, "body": mesh.num_bodies, "world": mesh.num_worlds, "scene": 1}
        every = wp.full(sum(sizes.values()), value=np.inf, dtype=wp.float64, device=execution.device)
        ends = itertools.accumulate(sizes.values())
        self._toi = {name: every[end - sizes[name] : end] for name, end in zip(sizes, ends, strict=True)}
        # flags report only overflows, which the counts show here
        flags, world_flags = buffers.get("flags", 1, wp.int32), buffers.get("world flags", mesh.num_worlds, wp.int32)
        self.minima = new_minima(topology, **self._toi, flags=flags, world_flags=world_flags)

    def _full(self, count: int, value: int) -> wp.array:
        return wp.full(count, value=value, dtype=wp.int32, device=self._execution.device)

    @property
    def is_complete(self) -> bool:
        """Whether all contacts were kept."""
        return self.total <= self._largest

    def begin_batch(self, num_pairs: int) -> Any:
        """The list to which a batch of this many pairs appends, with capacity for each of them."""
        wanted = min(self.total + num_pairs, self._largest)
        kept = min(self.total, self._largest)
        self._counter.fill_(kept)
        arrays = {
            name: self._buffers.grown(f"contact {name}", kept, wanted, dtype)[:wanted]
            for name, dtype in CONTACT_DTYPES.items()
        }
        return new_contact_list({"count": self._counter, **arrays})

    def end_batch(self) -> None:
        """Count the contacts that the batch has appended."""
        self.total += int(self._counter.numpy()[0]) - min(self.total, self._largest)

    def gather(self) -> Gathered:
        """All contacts, sorted by kind and pair, and the first contact of every vertex and body."""
        mesh, topology = self._topology.mesh, self._topology
        device, count = self._execution.device, self.total
        arrays = {name: wp.empty(count, dtype=dtype, device=device) for name, dtype in CONTACT_DTYPES.items()}
        first_of = [self._full(n, _LAST if count else -1) for n in (mesh.num_vertices, mesh.num_bodies)]
        if count > 0:
            found = new_contact_list({"count": self._counter, **self._kept()})
            ordered = new_contact_list({"count": self._counter, **arrays})
            self._execution.launch(kernels.order_contacts, count, inputs=[self._order(found), found], outputs=[ordered])
            corners = [topology.corners[name] for name in ("vertex", "edge", "face")]
            self._execution.launch(
                kernels.first_contacts, count, inputs=[ordered, *corners, self.minima], outputs=first_of
            )
        toi = {name: array.numpy() for name, array in self._toi.items()}
        vertex_contact, body_contact = (np.where(f == _LAST, np.int32(-1), f) for f in (a.numpy() for a in first_of))
        return Gathered(
            Contacts(**{name: array.numpy() for name, array in arrays.items()}),
            float(toi["scene"][0]),
            toi["vertex"],
            toi["body"],
            toi["world"],
            vertex_contact,
            body_contact,
        )

    def _kept(self) -> dict[str, wp.array]:
        return {name: self._buffers.get(f"contact {name}", 0, dtype) for name, dtype in CONTACT_DTYPES.items()}

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
