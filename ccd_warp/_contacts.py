"""Contacts of a step: solved batch by batch, kept together, and gathered in order at the end."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._buffers import Buffers
from ccd_warp._launch import Execution
from ccd_warp._pair_search import Found
from ccd_warp._results import Contacts
from ccd_warp._status import CCDStatus, PairKind
from ccd_warp._topology import CORNER_ARRAYS
from ccd_warp.kernels import contacts as kernels

if TYPE_CHECKING:
    from ccd_warp._step import Step

_FIELDS = {
    "pair": wp.int64,
    "toi": wp.float64,
    "status": wp.int32,
    "parameters": wp.vec2d,
    "gap": wp.float64,
    "width": wp.float64,
}
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
_NUM_COUNTS = 8
_LAST = np.iinfo(np.int32).max


@dataclass(frozen=True)
class Gathered:
    """Contacts in order, and the earliest of every vertex and body."""

    contacts: Contacts
    vertex_toi: NDArray[np.float64]
    body_toi: NDArray[np.float64]
    vertex_contact: NDArray[np.int32]
    body_contact: NDArray[np.int32]


class ContactStore:
    """Contacts of the batches so far."""

    BYTES_PER_CONTACT = sum(map(wp.types.type_size_in_bytes, _FIELDS.values()))
    # kept, in arrays that double and are copied to grow; their order; and what is returned
    BYTES_KEPT = (
        3 * BYTES_PER_CONTACT + 8 + sum(wp.types.type_size_in_bytes(dtype) for dtype in CONTACT_DTYPES.values())
    )

    def __init__(self, buffers: Buffers, execution: Execution, largest: int) -> None:
        """``largest`` is the number of contacts that there is room for; beyond it they are only counted."""
        self.count: dict[PairKind, int] = {}
        self._buffers = buffers
        self._execution = execution
        self._largest = largest

    def solve(self, step: "Step", kernel: Any, batch: list[Found], room: int, max_iterations: int) -> None:
        """Run the narrow phase on a batch that lies in so much room, and keep the pairs with a finite toi."""
        options = step.options.for_kernel(step.length_scale, max_iterations, step.workspace.flag.array)
        scratch = kernels.Contacts()
        for name, dtype in _FIELDS.items():
            setattr(scratch, name, self._buffers.get(f"contact {name}", room, dtype))
        parts = step.parts_of(batch)
        counts = self._buffers.rows("contact counts", len(parts), _NUM_COUNTS, wp.int64)
        counts.zero_()
        step.launch_on_pairs(
            kernel,
            parts,
            lambda part, slot: ([options, slot, part.found.begin + part.first], [counts, scratch]),
            is_long=max_iterations > step.options.first_iterations,
        )
        host = counts.numpy()[:, 0]
        for slot, part in enumerate(parts):
            self._keep(part.found.kind, scratch, part.found.begin + part.first, int(host[slot]))

    def solve_open(self, step: "Step", kernel: Any) -> None:
        """The second round: solve the pairs that the first has left open, each with its share of ``max_work``."""
        for kind in sorted(self.count) if self.is_complete else ():
            count = self.count[kind]
            arrays = {
                name: self._buffers.get(f"{kind.name} contact {name}", 0, dtype) for name, dtype in _FIELDS.items()
            }
            is_open = arrays["status"].numpy()[:count] == CCDStatus.ITERATION_LIMIT
            num_open = int(np.count_nonzero(is_open))
            share = step.options.share_of_work(num_open)
            if num_open == 0 or share <= step.options.first_iterations:
                continue
            pairs = self._buffers.get("open keys", num_open, wp.int64)
            pairs[:num_open].assign(arrays["pair"].numpy()[:count][is_open])
            self.count[kind] = count - num_open
            for array in arrays.values():
                if self.count[kind]:
                    array[: self.count[kind]].assign(array.numpy()[:count][~is_open])
            self.solve(step, kernel, [Found(kind, pairs, 0, num_open)], num_open, share)

    def _keep(self, kind: PairKind, scratch: Any, begin: int, count: int) -> None:
        kept = self.count.get(kind, 0)
        self.count[kind] = kept + count
        if count == 0 or sum(self.count.values()) > self._largest:
            return
        for name, dtype in _FIELDS.items():
            target = self._buffers.grown(f"{kind.name} contact {name}", kept, kept + count, dtype)
            source = getattr(scratch, name)
            if self._execution.is_cuda:
                wp.copy(target, source, dest_offset=kept, src_offset=begin, count=count)
            else:
                target.numpy()[kept : kept + count] = source.numpy()[begin : begin + count]

    @property
    def is_complete(self) -> bool:
        """Whether all contacts were kept."""
        return sum(self.count.values()) <= self._largest

    def _in_order(self, kind: PairKind, count: int) -> wp.array:
        """Places of the contacts of a kind by ascending pair."""
        device = self._execution.device
        pairs = self._buffers.get(f"{kind.name} contact pair", 0, wp.int64)
        if not self._execution.is_cuda:
            return wp.array(
                np.argsort(pairs.numpy()[:count]).astype(np.int32), dtype=wp.int32, device=device, copy=False
            )
        keys = wp.empty(2 * count, dtype=wp.int64, device=device)
        wp.copy(keys, pairs, count=count)
        places: wp.array = wp.array(np.arange(2 * count, dtype=np.int32), dtype=wp.int32, device=device)
        wp.utils.radix_sort_pairs(keys, places, count)
        return places

    def gather(self, step: "Step") -> Gathered:
        """All contacts, by kind and pair, with normals, and whose they are."""
        mesh, topology, device = step.mesh, step.topology, self._execution.device
        total = sum(self.count.values())
        outputs = {name: wp.empty(total, dtype=dtype, device=device) for name, dtype in CONTACT_DTYPES.items()}
        if total == 0:
            contacts = _as_contacts({name: array.numpy() for name, array in outputs.items()})
            toi = [np.full(n, np.inf) for n in (mesh.num_vertices, mesh.num_bodies)]
            none = [np.full(n, -1, dtype=np.int32) for n in (mesh.num_vertices, mesh.num_bodies)]
            return Gathered(contacts, *toi, *none)
        infinity = int(np.array(np.inf).view(np.int64))
        toi_bits = [
            wp.full(n, value=infinity, dtype=wp.int64, device=device) for n in (mesh.num_vertices, mesh.num_bodies)
        ]
        first_of = [
            wp.full(n, value=_LAST, dtype=wp.int32, device=device) for n in (mesh.num_vertices, mesh.num_bodies)
        ]
        serial = Execution(device, 1)
        passes = []
        begin = 0
        for kind in sorted(self.count):
            count = self.count[kind]
            if count == 0:
                continue
            corners = [topology.corners[name] for name in CORNER_ARRAYS[kind]]
            solved = kernels.Contacts()
            for name, dtype in _FIELDS.items():
                setattr(solved, name, self._buffers.get(f"{kind.name} contact {name}", 0, dtype))
            self._execution.launch(
                kernels.describe_contacts,
                count,
                inputs=[int(kind), self._in_order(kind, count), solved, *corners, step.x_t0, step.x_t1, begin],
                outputs=list(outputs.values()),
            )
            shared = [int(kind), begin, outputs["primitives"], outputs["toi"], *corners, topology.vertex_body]
            passes.append((count, shared))
            begin += count
        for count, shared in passes:
            serial.launch(kernels.lower_toi, count, inputs=shared, outputs=toi_bits)
        for count, shared in passes:
            serial.launch(kernels.first_contacts, count, inputs=[*shared, *toi_bits], outputs=first_of)
        contacts = _as_contacts({name: array.numpy() for name, array in outputs.items()})
        toi = [bits.numpy().view(np.float64) for bits in toi_bits]
        first = [array.numpy() for array in first_of]
        return Gathered(contacts, *toi, *(np.where(f == _LAST, np.int32(-1), f) for f in first))


def _as_contacts(arrays: dict[str, NDArray[Any]]) -> Contacts:
    shapes = {"primitives": (-1, 2), "parameters": (-1, 2), "normal": (-1, 3)}
    return Contacts(**{name: array.reshape(shapes.get(name, (-1,))) for name, array in arrays.items()})
