"""What is near at one time: steps whose two ends are the same positions, with distances in place of times."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._at_one_time.proximities import BYTES_PER_PROXIMITY, ProximityStore, largest_bound
from ccd_warp._engine.host.oddities import DistanceInEdges
from ccd_warp._engine.host.plan import Batch, HostPlan
from ccd_warp._engine.host.step import HostStep
from ccd_warp._engine.host.workspace import Workspace
from ccd_warp._engine.mesh.lengths import add_rounded_up, half_rounded_up
from ccd_warp._engine.mesh.scene import packed_reach
from ccd_warp._engine.mesh.topology import Positions
from ccd_warp._engine.stages import Stages, measure_pairs_in
from ccd_warp._results.proximities import Proximities
from ccd_warp._runtime.launch import Recording, Slot, load_all
from ccd_warp._runtime.status import PairKind
from ccd_warp.kernels.at_one_time import proximity as kernels
from ccd_warp.kernels.narrow_phase.sinks import DISPLACEMENT, NEAR
from ccd_warp.kernels.pair.norm import Norm

# Pairs of vertices and planes for which a call begins with capacity.
_FEW = 1 << 10


class StepAtOneTime(HostStep):
    """A step with a workspace of its own, in which boxes have the size of its goal."""

    counts_survivors = True

    def __init__(self, workspace: Workspace, positions: Positions, *arguments: Any) -> None:
        """Begin at the first of these positions; the other arguments are those of every step."""
        super().__init__(workspace.at_one_time(self.goal), (positions[0], positions[0]), *arguments)

    def norm(self) -> Norm:
        """The norm of distances."""
        return Norm.EUCLIDEAN

    def search(self, distance: float) -> HostPlan:
        """Make the boxes in which pairs within a distance overlap, radii besides, and set up the search for them."""
        plan = self.begin(1.0, half_rounded_up(distance))
        self.timings.setdefault("distances", 0.0)
        plan.set_search(1.0, half_rounded_up(distance), distance)
        return plan

    def note_distance(self, distance: float) -> None:
        """Note that a distance which the caller has given is many edges long, if it is; asked seldom in a loop."""
        if self.workspace.is_due(("distance", distance)):
            rings = self.mesh.exclusion_rings
            of_search = DistanceInEdges.of(self.topology, self.positions[0], distance, rings=rings)
            self.oddities.distance = of_search and of_search._replace(is_searched=True)

    def reach(self, distance: float, kept: float = 0.0) -> Any:
        """What is near, as the struct of the kernels, and what pairs keep besides their radii."""
        radius, stop = self.topology.radius, self.workspace.flag.array
        return self.workspace.packed_once(("reach", distance, kept), lambda: packed_reach(radius, distance, stop, kept))

    def least_of_vertices(
        self, plan: HostPlan, batches: Iterator[Batch], sink: int, found: wp.array
    ) -> NDArray[np.float64]:
        """Measure the pairs, end the call, and return what is ``found`` of the vertices, numbers or their bits."""
        for _ in self.batches(batches):
            with self.timed("distances"):
                plan.measure_pairs(sink)
        with self.timed("gather"):
            result = found.numpy().view(np.float64).copy()
        self.finish()
        return result


class ProximityStep(StepAtOneTime):
    """The pairs within a distance."""

    goal = "proximities"
    result_bytes = BYTES_PER_PROXIMITY

    def proximities(self, distance: float, *, unique: bool = False) -> Proximities:
        """All pairs within a distance and their radii, or each two closest features once."""
        plan = self.search(distance)
        self.note_distance(distance)
        with self.timed("pairs"):
            store = self.workspace.kept(ProximityStore, lambda: ProximityStore(self.topology, self.workspace.buffers))
            store.begin(self.execution)
            plan.bind(reach=self.reach(distance))
            batches = plan.batches(self.capacity())
        if self.planes is not None:
            begin = lambda count: plan.bind(proximities=store.begin_batch(count))  # noqa: E731
            with self.timed("planes"):
                self.survivors[PairKind.VERTEX_PLANE] = self.planes.listed(_FEW, begin, Stages.list_near_planes)
                store.end_batch()
        for batch in self.batches(batches):
            with self.timed("distances"):
                plan.bind(proximities=store.begin_batch(sum(batch.num_pairs.values())))
                plan.measure_pairs(NEAR)
                store.end_batch()
        with self.timed("gather"):
            count, columns = store.gather(unique=unique)
            dimension, direction = self.mesh.dimension, columns["direction"]
            if dimension == 2:
                columns["direction"] = lambda: direction()[:, :2].copy()
            x = self.positions[0][:, :dimension].copy()
        self.finish()
        return Proximities._of_list(count, columns, mesh=self.mesh, positions=x, radius=self.mesh.radius)


class DisplacementStep(StepAtOneTime):
    """How far vertices may move."""

    goal = "displacements"

    def bounds(self, search_radius: float) -> NDArray[np.float64]:
        """For each vertex the length by which it may move."""
        kept = self.options.minimum_distance
        distance = add_rounded_up(search_radius, kept)
        plan = self.search(distance)
        self.note_distance(distance)
        minima = self.workspace.contacts.minima
        with self.timed("pairs"):
            plan.bind(largest_bound=largest_bound(search_radius, self.mesh._moves_alone))
            plan.play("reset bounds", self._record_reset)
            plan.bind(reach=self.reach(distance, kept))
            batches = plan.batches(self.capacity())
        if self.planes is not None:
            with self.timed("planes"):
                self.survivors[PairKind.VERTEX_PLANE] = self.planes.meet(Stages.bound_by_half_spaces)
        bounds = self.least_of_vertices(plan, batches, DISPLACEMENT, minima.vertex)
        bounds[self.mesh.unused_vertices] = np.inf
        return bounds

    def _record_reset(self, stages: Stages, recording: Recording) -> None:
        both = measure_pairs_in(Norm.EUCLIDEAN, self.topology.device), kernels.reset_bounds
        load_all(both, self.topology.device, self.execution.progress)  # side by side
        inputs, outputs = [Slot("largest_bound"), self.topology.body_static], [self.workspace.contacts.minima]
        recording.launch(kernels.reset_bounds, self.mesh.num_vertices, inputs=inputs, outputs=outputs)
