"""All contacts of a step: the toi of every pair that the cull leaves."""

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ccd_warp._contact_place import Radii, located
from ccd_warp._engine.host.contacts import BYTES_KEPT, BYTES_PER_CONTACT, ContactStore
from ccd_warp._engine.host.impact_step import ImpactStep
from ccd_warp._engine.host.oddities import hidden_sentence
from ccd_warp._engine.host.pair_memory import MOST_PAIRS
from ccd_warp._results import Contacts, MeshResult
from ccd_warp._status import CCDStatus, PairKind
from ccd_warp._touch import Touch
from ccd_warp.kernels.pair.norm import is_ball

if TYPE_CHECKING:
    from ccd_warp._engine.host.arcs import Slice


class ContactStep(ImpactStep):
    """The contacts."""

    goal = "contacts"
    bytes_beside = BYTES_PER_CONTACT

    def contacts(self, *, is_ordered: bool = True) -> MeshResult:
        """Compute the toi of every pair that the cull leaves, and gather the result.

        Where contacts need no order, the result has no first ones, and they do not know where they are.
        """
        store = self.workspace.contacts
        for part in self.slices:
            self._find(part, store)
        if not store.is_complete:
            least = self.fixed_bytes + 2 * store.total * BYTES_KEPT
            raise ValueError(
                f"memory_limit is {self.options.memory_limit} bytes; expected at least {least} for the {store.total} "
                f"contacts of this step, or collision_free_step, which keeps none"
            )
        with self.timed("gather"):
            if len(self.slices) > 1:
                store.keep_earliest()
            gathered = vars(store.gather(is_ordered=is_ordered))
            place: Any = (*self.given, self.paths, self._touch(), self._radii()) if is_ordered else ()
            contacts = located(gathered["contacts"], self.mesh, *place)
        num_hidden = self._count(contacts)
        self.oddities.is_stuck = gathered["toi"] <= 0.0 and num_hidden > 0
        hidden = hidden_sentence(num_hidden, self.mesh, self.positions) if self.oddities.is_stuck else ""
        known = {"contacts": contacts, "counts": self.counts, "timings": self.timings, "hidden_gaps": hidden}
        return MeshResult(**(gathered | known))

    def _find(self, part: "Slice | None", store: ContactStore) -> None:
        """Add the contacts of a slice, or of the whole step."""
        plan = self.begin_slice(part)
        with self.timed("pairs"):
            if part is self.slices[0]:
                store.begin(self.execution, self._largest_number)
                plan.reset_minima(store.count)
            if self.is_idle():
                return
            self.bind_options(part)
            plan.set_search(self.options.t_max if part is None else 1.0, self.inflation, self.separation)
            batches = plan.batches(self.most_pairs())
        if self.planes is not None:
            with self.timed("planes"):
                expected = store.num_with_planes
                found = self.planes.listed(expected, lambda count: plan.bind(contacts=store.begin_batch(count)))
                store.end_batch(found)
                store.num_with_planes = max(expected, found)
                self.survivors[PairKind.VERTEX_PLANE] += found
        open_keys: dict[PairKind, list[NDArray[np.int64]]] = {}
        has_shared = False
        for batch in self.batches(batches):
            with self.timed("narrow phase"):
                self.oddities.note_pairs(self.mesh, self.survivors.total(), batch.found, plan.memory.keys)
                plan.bind(contacts=store.begin_batch(sum(batch.found.values())))
                plan.solve(is_second=False)
                if batch.is_only:
                    if not self.ranks.is_alone:
                        plan.set_number_open(self.ranks.all_open(plan.num_open()))
                    has_shared = True
                    plan.solve(is_second=True)
                else:
                    for kind in plan.num_open():
                        open_keys.setdefault(kind, []).append(plan.open_keys(kind, batch.found[kind]))
                store.end_batch()
        with self.timed("narrow phase"):
            keys_left = {kind: np.concatenate(keys) for kind, keys in open_keys.items()}
            num_open = {} if has_shared else self.ranks.all_open({kind: len(keys) for kind, keys in keys_left.items()})
            for kind, keys in keys_left.items():
                plan.set_open_pairs(kind, keys, num_open[kind])
                plan.bind(contacts=store.begin_batch(len(keys)))
                plan.solve(is_second=True)
                store.end_batch()

    @property
    def _largest_number(self) -> int:
        """Largest number of contacts within the memory limit."""
        if self.options.memory_limit is None:
            return MOST_PAIRS
        return (self.options.memory_limit - self.fixed_bytes) // 2 // BYTES_KEPT

    def _count(self, contacts: Contacts) -> int:
        """End the step with its contacts; returns the number of those whose gaps rounding hides."""
        # NumPy would ask an enumeration for attributes, and lose an interrupt that arrives meanwhile
        of_kind = np.bincount(contacts.kind, minlength=len(PairKind)).tolist()
        of_status = np.bincount(contacts.status, minlength=len(CCDStatus)).tolist()
        self.finish(
            num_after_cull=self.survivors_by_kind(),
            num_contacts={kind: of_kind[int(kind)] for kind in self.plan.kinds},
            num_contacts_at_start=of_status[int(CCDStatus.INITIAL_CONTACT)],
            num_contacts_at_limit=sum(of_status[int(CCDStatus.ITERATION_LIMIT) :]),
        )
        num_hidden: int = of_status[int(CCDStatus.ROUNDING_LIMIT)]
        return num_hidden

    def _touch(self) -> Touch | None:
        """What counts as touching; not one thing where pairs are held."""
        if self.holds:
            return None
        radius = self.mesh.radius if self.mesh.is_thick else None
        return Touch.of(self.options, self.length_scale, is_euclidean=is_ball(self.plan.norm), radius=radius)

    def _radii(self) -> Radii | None:
        """Radii of vertices, and of the largest primitive around each where there are planes; None without."""
        radius = self.mesh.radius if self.mesh.is_thick else None
        if radius is None:
            return None
        return radius, self.topology.box_radius.numpy() if len(self.mesh.planes) else radius
