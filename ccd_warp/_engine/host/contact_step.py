"""All contacts of a step: the toi of every pair that the cull leaves."""

from dataclasses import replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ccd_warp._engine.host.contacts import BYTES_KEPT, BYTES_PER_CONTACT, ContactStore
from ccd_warp._engine.host.impact_step import ImpactStep
from ccd_warp._engine.host.oddities import hidden_sentence
from ccd_warp._engine.host.pair_memory import MOST_PAIRS
from ccd_warp._engine.host.plan import HostPlan
from ccd_warp._engine.motion import Slice
from ccd_warp._results.contact_place import located
from ccd_warp._results.contacts import Contacts
from ccd_warp._results.pairs import pair_vertices
from ccd_warp._results.results import MeshResult
from ccd_warp._results.touch import Touch
from ccd_warp._runtime.quick import of_values
from ccd_warp._runtime.status import CCDStatus, PairKind


class ContactStep(ImpactStep):
    """The contacts.

    Attributes:
        known: Contacts of the step of which those without such a vertex are part of the result.
    """

    goal = "contacts"
    known: Contacts | None = None
    result_bytes = BYTES_PER_CONTACT
    counts_survivors = True

    def of_vertices(self, among: NDArray[np.bool_] | None, known: Contacts | None = None) -> Self:
        """This step, of which only the contacts are wanted that have one of these vertices; others may be known.

        Contacts of float32 are none of a step that is made again in float64.
        """
        if known is None or self.options.precision == "float64":
            self.among, self.known = among, known
        return self

    def _with_known(self, contacts: Contacts) -> Contacts:
        """Contacts with one of the vertices, and the known ones without any."""
        among, known = self.among, self.known
        if among is None or known is None:
            return contacts
        of_step = np.flatnonzero(among[pair_vertices(self.mesh, contacts)].any(axis=1))
        known = known[np.flatnonzero(~among[pair_vertices(self.mesh, known)].any(axis=1))]
        parts = contacts[of_step], replace(known, normal=self.mesh._in_space(known.normal))
        columns = {name: np.concatenate([getattr(part, name) for part in parts]) for name in vars(contacts)}
        return Contacts(**columns)

    def contacts(self, *, is_ordered: bool = True, is_placed: bool = True) -> MeshResult:
        """Compute the toi of every pair that the cull leaves, and gather the result.

        Where contacts need no order, the result has no first ones; unless they are placed, they do not know where they
        are.
        """
        store = self.workspace.contacts
        if self.played_whole() is None:
            for time_slice in self.motion.slices:
                self._find(time_slice, store)
        if not store.is_complete:
            least = self.fixed_bytes + 2 * store.total * BYTES_KEPT
            raise ValueError(
                f"memory_limit is {self.options.memory_limit} bytes; expected at least {least} for the {store.total} "
                f"contacts of this step, or collision_free_step, which keeps none"
            )
        with self.timed("gather"):
            if self.paths is not None and len(self.motion.slices) > 1:
                store.keep_earliest()
            gathered = store.gather(is_ordered=is_ordered)
            place = self._place() if is_placed else ()
            contacts = located(self._with_known(gathered["contacts"]), self.mesh, *place)
        # NumPy would ask an enumeration for attributes, and lose an interrupt that arrives meanwhile
        of_kind = np.bincount(contacts.kind, minlength=len(PairKind)).tolist()
        of_status = np.bincount(contacts.status, minlength=len(CCDStatus)).tolist()
        self.finish(
            num_contacts={kind: of_kind[int(kind)] for kind in self.plan.kinds},
            num_contacts_at_start=of_status[int(CCDStatus.INITIAL_CONTACT)],
            num_contacts_at_limit=sum(of_status[int(CCDStatus.ITERATION_LIMIT) :]),
        )
        num_hidden = of_status[int(CCDStatus.ROUNDING_LIMIT)] if gathered["toi"] <= 0.0 else 0
        self.oddities.is_stuck = num_hidden > 0
        self.oddities.touches_at_start = of_status[int(CCDStatus.INITIAL_CONTACT)] > 0
        within = 0.0 if self.paths is None else float(self.paths.excess.max(initial=0.0))
        hidden = hidden_sentence(num_hidden, self.mesh, self.positions, within)
        gathered |= {"contacts": contacts, "counts": self.counts, "timings": self.timings, "hidden_gaps": hidden}
        return of_values(MeshResult, gathered | {"start": None})

    def _find(self, time_slice: Slice, store: ContactStore) -> None:
        """Add the contacts of a slice, or of the whole step."""
        plan = self.begin(time_slice)
        with self.timed("pairs"):
            if time_slice is self.motion.slices[0]:
                limit = self.options.memory_limit
                store.begin(
                    self.execution, MOST_PAIRS if limit is None else (limit - self.fixed_bytes) // 2 // BYTES_KEPT
                )
                plan.reset_minima()
            if self.is_idle():
                return
            self.bind_options(time_slice)
            plan.set_search(self.motion.t_end, self.inflation, self.separation)
            # a search of some queries takes a copy of the boxes, and is not shared
            among = self.among if self.options.memory_limit is None else None
            batches = plan.batches(self.capacity(), among=among)
        if self.planes is not None:
            with self.timed("planes"):
                expected = store.num_with_planes
                num_contacts = self.planes.listed(expected, lambda count: plan.bind(contacts=store.begin_batch(count)))
                store.end_batch(num_contacts)
                store.num_with_planes = max(expected, num_contacts)
                self.survivors[PairKind.VERTEX_PLANE] += num_contacts
        open_keys: dict[PairKind, list[NDArray[np.int64]]] = {}
        for batch in self.batches(batches):
            with self.timed("narrow phase"):
                self.oddities.note_pairs(plan, sum(self.survivors.values()), batch.num_pairs)
                plan.bind(contacts=store.begin_batch(sum(batch.num_pairs.values())))
                plan.solve(is_second=False)
                for kind in plan.num_open():
                    keys = plan.memory.keys(kind, batch.num_pairs[kind]).numpy()
                    open_keys.setdefault(kind, []).append(keys[keys < 0])
                store.end_batch()
        with self.timed("narrow phase"):
            keys_left = {kind: np.concatenate(keys) for kind, keys in open_keys.items()}
            for kind, keys in keys_left.items():
                plan.set_open_pairs(kind, keys)
                plan.bind(contacts=store.begin_batch(len(keys)))
                plan.solve(is_second=True)
                store.end_batch()

    def plays_whole(self, plan: HostPlan) -> bool:
        """Whether a step is played as a whole: not where few of the queries of a large mesh are needed."""
        return super().plays_whole(plan) and not (self.among is not None and plan.may_leave_out_queries)

    def begin_found(self) -> None:
        """Begin a list of contacts, with places for those of the last step."""
        store = self.workspace.contacts
        store.begin(self.execution, MOST_PAIRS)
        self.plan.bind(contacts=store.begin_batch(0))

    def fits(self) -> bool:
        """Whether the list holds all contacts; a longer one is made if not."""
        return self.workspace.contacts.ends_complete()

    def _place(self) -> tuple[Any, ...]:
        """Where contacts are, what counts as touching, if it is one thing for all pairs, and what is how thick."""
        radius, radii = self.mesh.radius, None
        if radius is not None:
            radii = radius, self.topology.box_radius.numpy() if len(self.mesh.planes) else radius
        is_euclidean = self.plan.norm.is_ball
        of_touch = self.options, self.length_scale
        touch = self.workspace.packed_once(
            ("touch", *of_touch), lambda: Touch.of(*of_touch, is_euclidean=is_euclidean, radius=radius)
        )
        return *self.ends, self.paths, None if self.lets_part else touch, radii
