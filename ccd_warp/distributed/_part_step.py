"""A step on one rank, which shares with the others what one process knows of all pairs."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ccd_warp._engine.boxes.body_boxes import bodies_near_boxes
from ccd_warp._engine.host.line_search import OneProcess
from ccd_warp._engine.host.plan import Batch, HostPlan
from ccd_warp._engine.host.step import Step
from ccd_warp._status import PairKind
from ccd_warp.distributed._part import TogetherIn
from ccd_warp.distributed._ranks import Ranks
from ccd_warp.kernels.step.minima import FOUND


class StepOnPart(Step):
    """A step of any kind on the primitives of a part."""

    def __init__(self, together: TogetherIn, *arguments: Any, **options: Any) -> None:
        """Begin a step; the other arguments are those of its kind."""
        self.together = together
        self.ranks: Ranks = together.ranks
        super().__init__(*arguments, **options)

    def _warn_of_size(self) -> None:
        """Nothing is said: the vertices of a part have other numbers than those of the mesh."""

    def work_by_vertex(self, of_candidate: float, of_pair: float) -> NDArray[np.float64]:
        """Work of the last search: that of a pair at a vertex of its first primitive, that of candidates spread evenly.

        Which candidates there were is not known any more, and pairs neither if they came in parts.
        """
        count = self.together.topology.mesh.num_vertices
        result = np.full(count, of_candidate * sum(self.counts.num_candidates.values()) / max(count, 1))
        if self.plan.num_batches != 1:
            return result
        for kind, found in enumerate(self.plan.counts()[:, FOUND].tolist()):
            if found == 0:
                continue
            keys = self.plan.found_keys(PairKind(kind), found).numpy()
            vertices = self.first_vertices(PairKind(kind), np.where(keys < 0, ~keys, keys) >> 32)
            result += of_pair * np.bincount(vertices, minlength=count)
        return result

    def first_vertices(self, kind: PairKind, first: NDArray[np.int64]) -> NDArray[np.integer]:
        """A vertex of each of these primitives, the first ones of pairs of a kind."""
        return self.mesh.edges[first, 0] if kind == PairKind.EDGE_EDGE else first


class StepTogether(StepOnPart):
    """What steps share with those of the other ranks: the quantization, and which bodies are near."""

    def share_positions(self) -> None:
        """Bring the samples of the whole mesh, from which its quantized coordinates follow, to all ranks."""
        with self.timed("reductions"):
            self.together.collect_samples(self.positions)

    def _bodies_near(self) -> NDArray[np.bool_] | None:
        if not self.topology.may_have_inactive_bodies:
            return None
        lower, upper = self.together.body_boxes(self.positions)
        filled = np.flatnonzero((lower <= upper).all(axis=1))
        radius = self.together.whole.body_radius
        if self.arcs is not None:
            radius = np.zeros(self.mesh.num_bodies)  # of the vertices here, as the pairs of this rank have no others
            np.maximum.at(radius, self.mesh.vertex_body, self.arcs.radius.numpy())
        of_filled = None if radius is None else radius[filled]
        boxes = lower[filled], upper[filled]
        near = bodies_near_boxes(self.topology, filled, boxes, of_filled, self.inflation, self.execution)
        self._num_active_bodies = int((near | self.mesh.static).sum())
        return near

    def is_idle(self, near: NDArray[np.bool_] | None) -> bool:
        """Never: bodies that are near here need not be so on other ranks, and all go the same way."""
        return False

    def timed_batches(self, batches: Iterator[Any]) -> Iterator[Any]:
        """The batches of a search, each without the pairs that belong to other ranks.

        Candidates, which are no batches of keys, lose theirs where they are given out.
        """
        for batch in super().timed_batches(batches):
            if isinstance(batch, Batch):
                with self.timed("pairs"):
                    found = {kind: self._keep_own(kind, count) for kind, count in batch.found.items()}
                batch = Batch(found, batch.is_only)
            yield batch

    def _keep_own(self, kind: PairKind, count: int) -> int:
        """Keep the keys of this rank's pairs among the ``count`` of a kind; returns their number."""
        if count == 0:
            return 0
        keys = self.plan.found_keys(kind, count).numpy()
        own = self.together.topology.own_pairs(kind, keys >> 32, keys & 0xFFFFFFFF)
        if isinstance(own, slice):
            return count
        kept = keys[own]
        self.plan.replace_keys(kind, kept)
        return len(kept)


class PartStep(StepTogether):
    """A step on one rank, which shares with the others what one process knows of all pairs."""

    def least_of_all(self, toi: float) -> float:
        """The least toi of all ranks."""
        with self.timed("reductions"):
            return self.ranks.agree(toi)[0]

    def most_of_all(self, value: float) -> float:
        """The largest value of all ranks."""
        with self.timed("reductions"):
            return -self.ranks.agree(-value)[0]

    def open_in_all(self, num_open: dict[PairKind, int]) -> dict[PairKind, int]:
        """How many pairs of each kind are open on all ranks."""
        mine = np.array([num_open.get(kind, 0) for kind in PairKind], dtype=np.int64)
        with self.timed("reductions"):
            return dict(zip(PairKind, self.ranks.total(mine).tolist(), strict=True))

    def share_work(self, plan: HostPlan) -> None:
        """Let the open pairs of a batch share the work with those of the other ranks."""
        own = plan.num_open()
        of_all = self.open_in_all(own)
        plan.set_number_open({kind: of_all[kind] for kind in own})


class AcrossRanks(OneProcess):
    """What a line search asks of all ranks, about the vertices of a part, copies of which are on several."""

    def __init__(self, together: TogetherIn) -> None:
        self._ranks, self._part = together.ranks, together.part
        self._num_rows = len(together.whole.vertex_ids)

    def all(self, flag: bool) -> bool:
        """Whether a flag is set on all ranks."""
        return self._ranks.agree(float(flag))[0] > 0.0

    def least(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """The least of each number over all ranks."""
        return self._ranks.least(values)

    def least_of_vertices(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """The least value of each vertex over all ranks that have a copy."""
        owned = np.full(self._num_rows, np.inf)
        self._part.everything.back(values, owned, np.minimum)
        result = np.empty_like(values)
        self._part.everything.forward([(owned, result)])
        return result
