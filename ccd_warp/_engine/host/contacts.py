"""Contacts and minima of a step, collected batch by batch in one list that is sorted at the end."""

import itertools
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._engine.host.buffers import Buffers
from ccd_warp._engine.host.counters import Counters
from ccd_warp._engine.mesh.planes import planes_of
from ccd_warp._engine.mesh.topology import Topology
from ccd_warp._results.contacts import Contacts
from ccd_warp._runtime.launch import Execution, Recording, Slot
from ccd_warp._runtime.quick import of_values
from ccd_warp._runtime.structs import dtypes_of, on_host, struct_of
from ccd_warp.kernels.step import contacts as kernels
from ccd_warp.kernels.step.minima import Minima
from ccd_warp.kernels.step.step import ContactList

CONTACT_DTYPES = dtypes_of(ContactList)
# The type and the shape of an element of each in NumPy.
_ON_HOST = {name: on_host(dtype) for name, dtype in CONTACT_DTYPES.items()}
# Bytes of an entry of the list; and the most that a contact takes: an entry of the list while it is copied to one of
# twice the size, or an entry of the list and one of the result, with its key and its position in the order.
BYTES_PER_CONTACT = sum(map(wp.types.type_size_in_bytes, CONTACT_DTYPES.values()))
BYTES_KEPT = 3 * BYTES_PER_CONTACT + 16
_LAST, _NO_CONTACT = int(kernels.NO_CONTACT), np.int32(-1)
# Number of contacts above which threads share the sorting.
_WORTH_THREADS = 1 << 15
_SAMPLES = 1 << 10
# Every array of an allocation that CUDA reads at once begins at a multiple of so many bytes.
_ALIGNMENT = 256
# Up to the last of these, contacts are few: their launches are recorded for the least of these that holds them.
_FEW = 1 << 10, 1 << 11, 1 << 12, 1 << 13
# How many places there are for each contact after a batch that had too few.
_GROWTH = 1.25
# What there is of vertices, bodies and worlds: the names of their toi and first contact in a result.
_OWNERS = ("vertex_toi", "vertex_contact"), ("body_toi", "body_contact"), ("world_toi", "world_contact")


def new_minima(topology: Topology, **arrays: wp.array) -> Any:
    """The struct of atomic minima: toi as bits, which order like the non-negative numbers, and flags."""
    of_mesh = {name: getattr(topology, name) for name in ("vertex_body", "vertex_world", "body_kinematic")}
    bits = {name: array if "flags" in name else array.view(wp.int64) for name, array in arrays.items()}
    return struct_of(Minima, of_mesh | bits)


new_contact_list = partial(struct_of, ContactList)


class _Ordered:
    """Arrays for sorted contacts, and for the first contact of every vertex, body and world.

    They are parts of one allocation, which CUDA reads at once.

    Attributes:
        keys: Keys by which the contacts are sorted; on CUDA this array and the next have capacity for twice as many.
        order: Positions of the contacts in the list, in ascending order of their keys.
    """

    def __init__(self, topology: Topology, count: wp.array, minima: Minima, capacity: int, is_cuda: bool) -> None:
        """Make arrays for the contacts of a list, whose number is ``count``, and which have these minima."""
        device, mesh = topology.device, topology.mesh
        self._topology, self._minima, self._capacity = topology, minima, capacity
        self._bounds = [0, *itertools.accumulate((mesh.num_vertices, mesh.num_bodies, mesh.num_worlds))]
        sizes = [capacity * wp.types.type_size_in_bytes(dtype) for dtype in CONTACT_DTYPES.values()]
        padded = [-(-size // _ALIGNMENT) * _ALIGNMENT for size in sizes]
        self._places = [0, *itertools.accumulate(padded)]
        self._all: wp.array = wp.empty(self._places[-1] + 4 * self._bounds[-1], dtype=wp.uint8, device=device)
        *at, at_first = (self._all.ptr + place for place in self._places)
        arrays: dict[str, wp.array] = {
            name: wp.array(ptr=place, dtype=dtype, shape=capacity, device=device)
            for place, (name, dtype) in zip(at, CONTACT_DTYPES.items(), strict=True)
        }
        self._all_first: wp.array = wp.array(ptr=at_first, dtype=wp.int32, shape=self._bounds[-1], device=device)
        self._contacts = new_contact_list({"count": count, **arrays})
        self.keys: wp.array = wp.empty(2 * capacity if is_cuda else capacity, dtype=wp.int64, device=device)
        self.order: wp.array = wp.empty(len(self.keys), dtype=wp.int32, device=device)
        self._first = [self._all_first[i:j] for i, j in itertools.pairwise(self._bounds)]
        self._views = None if is_cuda else self._views_of(self._all.numpy())
        self._owners = [slice(i, j) for i, j in itertools.pairwise(self._bounds)]

    def _views_of(self, memory: NDArray[np.uint8]) -> tuple[dict[str, NDArray[Any]], NDArray[np.int32]]:
        """The columns of the contacts in the allocation on the host, and the first ones."""
        columns = {
            name: np.ndarray((self._capacity, *shape), dtype, memory, place)
            for place, (name, (dtype, shape)) in zip(self._places, _ON_HOST.items(), strict=False)
        }
        return columns, memory[self._places[-1] :].view(np.int32)

    def read(self, count: int) -> tuple[dict[str, NDArray[Any]], list[NDArray[np.int32]]]:
        """The columns of the contacts, and the first of ``count`` of every vertex, body and world, -1 for none."""
        views = self._views
        if views is None:
            views = self._views_of(self._all.numpy() if count else np.empty(len(self._all), np.uint8))
        columns, first = views
        if count:
            first = np.where(first == _LAST, _NO_CONTACT, first)
        else:
            first = np.full(len(first), _NO_CONTACT)
        return columns, [first[rows] for rows in self._owners]

    def fill_keys(self, launcher: Execution | Recording, contacts: ContactList) -> None:
        """Compute the keys of the contacts of a list."""
        launcher.launch(kernels.contact_keys, self._capacity, inputs=[contacts], outputs=[self.keys])

    def sort(self, count: int, execution: Execution) -> None:
        """Find the order of ``count`` contacts from their keys."""
        sort_places(self.keys, self.order, count, execution)

    def fill(self, launcher: Execution | Recording, contacts: ContactList) -> None:
        """Copy the contacts in order, and find the first of every vertex, body and world."""
        launcher.launch(kernels.reset_first, len(self._all_first), inputs=[], outputs=[self._all_first])
        inputs = [self.order, contacts]
        launcher.launch(kernels.order_contacts, self._capacity, inputs=inputs, outputs=[self._contacts])
        corners = [self._topology.corners[name] for name in ("vertex", "edge", "face")]
        inputs = [self._contacts, *corners, self._minima]
        launcher.launch(kernels.first_contacts, self._capacity, inputs=inputs, outputs=self._first)
        if len(self._topology.mesh.planes):
            from ccd_warp.kernels.narrow_phase import meet_planes  # not before a scene needs it

            inputs = [self._contacts, planes_of(self._topology).body, self._minima]
            launcher.launch(meet_planes.first_plane_contacts, self._capacity, inputs=inputs, outputs=[self._first[1]])


class ContactStore:
    """Contacts of the batches of a step, and the minima over them; its arrays stay for the next step.

    Attributes:
        minima: The minima that the narrow phase updates; a step begins by setting them to infinity.
        total: Number of contacts found.
        num_with_planes: Number of contacts of vertices and planes for which steps begin with capacity.
    """

    def __init__(self, topology: Topology, buffers: Buffers, counters: Counters) -> None:
        mesh, self._counters = topology.mesh, counters
        self.total, self.num_with_planes = 0, _FEW[0]
        self._topology, self._buffers, self._is_cuda = topology, buffers, topology.device.is_cuda
        sizes = {"vertex": mesh.num_vertices, "body": mesh.num_bodies, "world": mesh.num_worlds, "scene": 1}
        self._ranges = list(itertools.pairwise([0, *itertools.accumulate(sizes.values())]))
        toi = {name: counters.toi[begin:end] for name, (begin, end) in zip(sizes, self._ranges, strict=True)}
        # flags tell of too little capacity alone, and here the counts do
        flags, world_flags = (wp.zeros(sizes[of], dtype=wp.int32, device=topology.device) for of in ("scene", "world"))
        self.minima = new_minima(topology, **toi, flags=flags, world_flags=world_flags)
        self._list: Any = None
        self._capacity = 0
        self._few: dict[int, _FewOrdered] = {}

    def begin(self, execution: Execution, largest: int) -> None:
        """Begin a step; ``largest`` is the number of contacts that may be kept, beyond it they are only counted."""
        self.total = 0
        self._execution, self._largest = execution, largest

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
            self._list = new_contact_list({"count": self._counters.num_contacts, **arrays})
            self._capacity = min(map(len, arrays.values()))
            self._views = None if self._is_cuda else {name: array.numpy() for name, array in arrays.items()}
        self._counters.set_contacts(kept)
        return self._list

    def end_batch(self, appended: int | None = None) -> None:
        """Count what the batch has appended, unless that is given."""
        if appended is not None:
            self.total += appended
            return
        self.total += self._counters.count_contacts() - min(self.total, self._capacity)

    def ends_complete(self) -> bool:
        """Count what the only batch has appended; whether there was a place for each, as the next one has if not."""
        self.end_batch()
        is_complete = self.total <= self._capacity
        if not is_complete:
            total, self.total = self.total, 0
            self.begin_batch(int(_GROWTH * total))
        return is_complete

    def with_toi(self, toi: float) -> Contacts | None:
        """The contacts of one batch that have this toi, in any order; None if not all of the batch were kept."""
        self.end_batch()
        if not self.is_complete:
            return None
        columns = self._columns()
        chosen = columns["toi"] == toi
        contacts: Contacts = of_values(Contacts, {name: values[chosen] for name, values in columns.items()})
        return contacts

    def keep_earliest(self) -> None:
        """Keep of each pair its earliest contact, where a step was searched slice by slice."""
        if self.total == 0:
            return  # where no pair came near any other in any slice, there is no list
        columns = self._columns()
        pairs = columns["primitives"]
        order = np.lexsort((columns["toi"], pairs[:, 1], pairs[:, 0], columns["kind"]))
        alike = np.ones(len(order), dtype=bool)
        for values in (columns["kind"], pairs[:, 0], pairs[:, 1]):
            alike[1:] &= values[order[1:]] == values[order[:-1]]
        alike[:1] = False
        kept = order[~alike]
        if len(kept) == self.total:
            return
        self.total = len(kept)
        for name, values in columns.items():
            getattr(self._list, name)[: self.total].assign(values[kept])
        self._counters.set_contacts(self.total)

    def _columns(self) -> dict[str, NDArray[Any]]:
        """The columns of the contacts in the list, of which there are some; on the CPU the list's own memory."""
        if self._views is None:
            return {name: getattr(self._list, name)[: self.total].numpy() for name in CONTACT_DTYPES}
        return {name: view[: self.total] for name, view in self._views.items()}

    def gather(self, *, is_ordered: bool = True) -> dict[str, Any]:
        """All contacts, sorted by kind and pair, and the first of every vertex, body and world: fields of `MeshResult`.

        Those that are not ordered are as they were found, and of the first ones nothing is known.
        """
        count, is_cuda = self.total, self._is_cuda
        if not is_ordered and count:
            contacts = {name: values.copy() for name, values in self._columns().items()}
            return self._gathered(contacts, [np.full(j - i, _NO_CONTACT) for i, j in self._ranges[:-1]])
        if count <= _FEW[-1]:
            capacity = next(most for most in _FEW if count <= most)
            if capacity not in self._few:
                ordered = _Ordered(self._topology, self._counters.num_contacts, self.minima, capacity, is_cuda)
                self._few[capacity] = _FewOrdered(ordered)
            if count > 0:
                self._few[capacity].order(self._list, count, self._execution)
            contacts, first = self._few[capacity].ordered.read(count)
            # the arrays stay
            return self._gathered({name: values[:count].copy() for name, values in contacts.items()}, first)
        ordered = _Ordered(self._topology, self._counters.num_contacts, self.minima, count, is_cuda)
        if count > 0:
            ordered.fill_keys(self._execution, self._list)
            ordered.sort(count, self._execution)
            ordered.fill(self._execution, self._list)
        return self._gathered(*ordered.read(count))

    def _gathered(self, contacts: dict[str, NDArray[Any]], first: list[NDArray[np.int32]]) -> dict[str, Any]:
        toi = self._counters.read_all()
        if not self._is_cuda:
            toi = toi.copy()
        results: dict[str, Any] = {"contacts": of_values(Contacts, contacts), "toi": float(toi[self._ranges[-1][0]])}
        for (of_toi, of_contact), (begin, end), of_owners in zip(_OWNERS, self._ranges, first, strict=False):
            results[of_toi], results[of_contact] = toi[begin:end], of_owners
        return results


class _FewOrdered:
    """Arrays for few contacts that stay, and a recording that orders these, as its launches cost a third of others.

    Attributes:
        ordered: The arrays.
    """

    def __init__(self, ordered: _Ordered) -> None:
        self.ordered, self._count = ordered, 0
        self._recording: Recording | None = None

    def order(self, contacts: ContactList, count: int, execution: Execution) -> None:
        """Order the contacts of a list, of which there are so many; recorded at its first use."""
        self._count, recording = count, self._recording
        if recording is None or recording.num_threads != execution.num_threads:
            self._recording = recording = self._recorded(contacts, execution)
        recording.bind("found", contacts)
        recording.play("ordered")

    def _recorded(self, contacts: ContactList, execution: Execution) -> Recording:
        recording, ordered, of_step = Recording(execution, {"found": contacts}), self.ordered, Slot("found")
        with recording.section("ordered"):
            ordered.fill_keys(recording, of_step)
            recording.call(self._sort_on_cuda() if execution.is_cuda else self._sort_on_host())
            ordered.fill(recording, of_step)
        return recording

    def _sort_on_host(self) -> Callable[[], None]:
        keys, order = self.ordered.keys.numpy(), self.ordered.order.numpy()

        def sort() -> None:
            order[: self._count] = keys[: self._count].argsort()

        return sort

    def _sort_on_cuda(self) -> Callable[[], None]:
        keys, order = self.ordered.keys, self.ordered.order
        numbers: wp.array = wp.array(np.arange(len(order)), dtype=wp.int32, device=order.device)

        def sort() -> None:
            wp.copy(order, numbers, count=self._count)
            wp.utils.radix_sort_pairs(keys, order, self._count)

        return sort


def sort_places(keys: wp.array, order: wp.array, count: int, execution: Execution, place_bits: int = 0) -> None:
    """Write the permutation that sorts the first ``count`` keys; on CUDA they have capacity for twice as many.

    On the CPU keys may end with their places, in so many bits; they are not kept then.
    """
    if execution.is_cuda:
        places: wp.array = wp.array(np.arange(2 * count, dtype=np.int32), dtype=wp.int32, device=keys.device)
        wp.utils.radix_sort_pairs(keys, places, count)
        wp.copy(order, places, count=count)
    else:
        order.numpy()[:count] = _sorted_places(keys.numpy()[:count], execution, place_bits)


def _sorted_places(keys: NDArray[np.int64], execution: Execution, place_bits: int) -> NDArray[np.int64]:
    """The permutation that sorts the keys; threads sort ranges between pivots taken from a sample."""
    if len(keys) < _WORTH_THREADS or execution.num_threads == 1:
        return _in_order(keys, None, place_bits)
    sample = np.sort(keys[:: len(keys) // _SAMPLES])
    pieces = execution.num_threads
    pivots = sample[[len(sample) * k // pieces for k in range(1, pieces)]]
    bounds = [None, *pivots.tolist(), None]

    def sort(low: int | None, high: int | None) -> NDArray[np.int64]:
        is_in_piece = np.ones(len(keys), dtype=bool) if low is None else keys >= low
        if high is not None:
            is_in_piece &= keys < high
        return _in_order(keys, is_in_piece, place_bits)

    tasks = [lambda low=low, high=high: sort(low, high) for low, high in itertools.pairwise(bounds)]  # type: ignore[misc]
    return np.concatenate(execution.run(tasks))


def _in_order(keys: NDArray[np.int64], chosen: NDArray[np.bool_] | None, place_bits: int) -> NDArray[np.int64]:
    """The places of chosen keys, or of all, in the order of these."""
    of_chosen = keys if chosen is None else keys[chosen]
    if place_bits == 0:
        order = of_chosen.argsort()
        return order if chosen is None else np.flatnonzero(chosen)[order]
    of_chosen.sort()
    of_chosen &= (1 << place_bits) - 1
    return of_chosen
