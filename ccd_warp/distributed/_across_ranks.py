"""What a step and a line search on the part of one rank ask of all ranks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ccd_warp._engine.boxes.body_boxes import bodies_near_boxes, swept_boxes
from ccd_warp._engine.host.one_process import OneProcess
from ccd_warp._engine.host.plan import Batch, HostPlan
from ccd_warp._engine.host.step import Step
from ccd_warp._engine.mesh.topology import Positions, Topology
from ccd_warp._runtime.launch import Execution
from ccd_warp._runtime.status import PairKind
from ccd_warp.distributed._mesh import DistributedMesh
from ccd_warp.distributed._part import Part, PartTopology
from ccd_warp.kernels.step.minima import FOUND


class AcrossRanks(OneProcess):
    """All ranks, about the primitives of a part, copies of which are on several."""

    is_alone = False

    def __init__(self, whole: DistributedMesh, part: Part, topology: PartTopology, is_home: NDArray[np.bool_]) -> None:
        """Ask the ranks of a mesh, of whose part those vertices that are at ``home`` lie in the region."""
        self.part, self.topology = part, topology
        self._whole, self._ranks = whole, whole.ranks
        wanted = np.concatenate([whole.sample_vertices, whole.sample_primitives.ravel()])
        numbers = part.vertex_numbers
        place = np.minimum(np.searchsorted(numbers, wanted), max(len(numbers) - 1, 0))
        self._rows = self._samples = np.zeros(0, dtype=np.intp)
        if len(numbers):
            self._samples = np.flatnonzero((numbers[place] == wanted) & is_home[place])
            self._rows = place[self._samples]
        self._num_samples = len(wanted)

    def share_positions(self, positions: Positions) -> None:
        """Bring the samples of the whole mesh, from which its quantized coordinates follow, to all ranks.

        Each comes from the one rank whose region it lies in.
        """
        with self.timed("reductions"):
            samples = np.zeros((2, self._num_samples, 3))
            samples[:, self._samples] = [x[self._rows] for x in positions]
            if self._ranks.size > 1:  # as integers, so that the sum with zeros keeps every bit
                samples = self._ranks.total(samples.view(np.int64)).view(np.float64)
            shape = 2, 3, 1 + len(self._whole.sample_primitives), -1
            self.topology.samples_of_all = samples.transpose(0, 2, 1).reshape(shape)

    def bodies_near(
        self,
        topology: Topology,
        positions: Positions,
        inflation: float,
        execution: Execution,
        vertex_radius: NDArray[np.float64] | None,
    ) -> NDArray[np.bool_]:
        """Which bodies that move may collide, wherever their vertices are."""
        mesh = topology.mesh
        both = np.full((2, mesh.num_bodies, 3), np.inf)
        here = np.flatnonzero(np.diff(mesh.body_vertex_range))
        if len(here):
            lower, upper = swept_boxes(positions, mesh.body_vertex_range[here])
            both[0, here], both[1, here] = lower, -upper
        both = self._ranks.least(both)
        lower, upper = both[0], -both[1]
        filled = np.flatnonzero((lower <= upper).all(axis=1))
        radius = self._whole.body_radius
        if vertex_radius is not None:  # of the vertices here, as the pairs of this rank have no others
            radius = np.zeros(mesh.num_bodies)
            np.maximum.at(radius, mesh.vertex_body, vertex_radius)
        of_filled = None if radius is None else radius[filled]
        return bodies_near_boxes(topology, filled, (lower[filled], upper[filled]), of_filled, inflation, execution)

    def own_batch(self, plan: HostPlan, batch: Batch) -> Batch:
        """What is left of a batch without the pairs that belong to other ranks."""
        num_kept = {kind: self._keep_own(plan, kind, count) for kind, count in batch.num_pairs.items()}
        plan.counters.set_column(
            FOUND, {kind: count for kind, count in num_kept.items() if count != batch.num_pairs[kind]}
        )
        return Batch(num_kept, batch.is_only)

    def _keep_own(self, plan: HostPlan, kind: PairKind, count: int) -> int:
        """Keep the keys of this rank's pairs among the ``count`` of a kind; returns their number."""
        if count == 0:
            return 0
        keys = plan.memory.keys(kind, count).numpy()
        selection = self.topology.own_pairs(kind, keys >> 32, keys & 0xFFFFFFFF)
        if isinstance(selection, slice):
            return count
        kept = keys[selection]
        if len(kept):
            plan.memory.keys(kind, len(kept)).assign(kept)
        return len(kept)

    def all_open(self, num_open: dict[PairKind, int]) -> dict[PairKind, int]:
        """How many pairs of each kind are open on all ranks."""
        mine = np.array([num_open.get(kind, 0) for kind in PairKind], dtype=np.int64)
        with self.timed("reductions"):
            of_all = dict(zip(PairKind, self._ranks.total(mine).tolist(), strict=True))
        return {kind: of_all[kind] for kind in num_open}

    def least_number(self, number: float) -> float:
        """The least of a number over all ranks."""
        with self.timed("reductions"):
            return self._ranks.agree(number)[0]

    def all(self, flag: bool) -> bool:
        """Whether a flag is set on all ranks; asked between steps, so no time of theirs."""
        return self._ranks.agree(float(flag))[0] > 0.0

    def least(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """The least of each number over all ranks."""
        return self._ranks.least(values)

    def least_of_vertices(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """The least value of each vertex over all ranks that have a copy, or values, of several columns."""
        if values.ndim > 1:
            return np.stack([self.least_of_vertices(column.copy()) for column in values.T], axis=1)
        everything = self.part.everything
        owned = np.full(len(self._whole.vertex_ids), np.inf)
        everything.back(values, owned, np.minimum)
        result = np.empty_like(values)
        everything.forward([(owned, result)])
        return result


def work_by_vertex(step: Step, num_vertices: int, of_candidate: float, of_pair: float) -> NDArray[np.float64]:
    """Work of the last search: that of a pair at a vertex of its first primitive, that of candidates spread evenly.

    Which candidates there were is not known any more, and pairs neither if they came in parts.
    """
    plan, topology = step.plan, step.topology
    result = np.full(num_vertices, of_candidate * sum(step.counts.num_candidates.values()) / max(num_vertices, 1))
    if plan.num_batches != 1:
        return result
    for kind, num_pairs in zip(PairKind, plan.counters.counts()[:, FOUND].tolist(), strict=True):
        if num_pairs == 0:
            continue
        keys = plan.memory.keys(kind, num_pairs).numpy()
        corners = topology.corners[topology.corner_arrays(kind)[0]].numpy()
        # of an edge that is searched for in faces by its point, the vertices come after that
        column = int(kind == PairKind.VERTEX_FACE)
        vertices = corners[np.where(keys < 0, ~keys, keys) >> 32, column]
        result += of_pair * np.bincount(vertices, minlength=num_vertices)
    return result
