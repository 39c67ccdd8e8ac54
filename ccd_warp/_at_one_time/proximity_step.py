"""What is near at one time: steps whose two ends are the same positions, with distances in place of times."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._at_one_time.proximities import BYTES_PER_PROXIMITY, LEAST_PLACES, ProximityStore, largest_bound
from ccd_warp._engine.host.oddities import DistanceInEdges
from ccd_warp._engine.host.plan import Batch
from ccd_warp._engine.host.step import HostStep
from ccd_warp._engine.host.workspace import Workspace
from ccd_warp._engine.mesh.lengths import add_rounded_up, half_rounded_up
from ccd_warp._engine.mesh.scene import packed_reach
from ccd_warp._engine.mesh.topology import Positions
from ccd_warp._engine.motion import Slice
from ccd_warp._engine.stages import Stages, measure_pairs_in
from ccd_warp._results.proximities import Proximities
from ccd_warp._runtime.launch import Recording, Slot, load_all
from ccd_warp._runtime.status import PairKind
from ccd_warp.kernels.at_one_time import proximity as kernels
from ccd_warp.kernels.narrow_phase.sinks import DISPLACEMENT, NEAR
from ccd_warp.kernels.pair.norm import Norm


class StepAtOneTime(HostStep):
    """A step with a workspace of its own, in which boxes have the size of its goal.

    Attributes:
        sink: Where what is found of the pairs goes.
    """

    counts_survivors = True
    sink: int
    stages = "input", "boxes", "pairs", "distances"
    stages_with_planes = "input", "boxes", "pairs", "planes", "distances"

    def __init__(self, workspace: Workspace, positions: Positions, *arguments: Any) -> None:
        """Begin at the first of these positions; the other arguments are those of every step."""
        super().__init__(workspace.at_one_time(self.goal), (positions[0], positions[0]), *arguments)

    def norm(self) -> Norm:
        """The norm of distances."""
        return Norm.EUCLIDEAN

    def search(self, distance: float) -> Iterator[Batch] | None:
        """Search for the pairs within a distance, radii besides.

        Returns:
            The batches of a search that is set up, whose pairs are to be measured; None if the step was played whole.
        """
        self.separation, self.inflation = distance, half_rounded_up(distance)
        if self.played_whole() is not None:
            return None
        plan = self.begin()
        self.timings.setdefault("distances", 0.0)
        with self.timed("pairs"):
            plan.set_search(self.t_end, self.inflation, distance)
            self.bind_options(self.motion.slices[0])
            return plan.batches(self.capacity())

    def record_found(self, stages: Stages, recording: Recording) -> None:
        """Record that vertices meet planes, and that pairs are measured."""
        if self.planes is not None:
            self.record_planes(stages, recording)
            self.plan.mark(recording)
        stages.measure_pairs(recording, self.sink, self.plan.norm)
        self.plan.mark(recording)

    def record_planes(self, stages: Stages, recording: Recording) -> None:
        """Record that vertices meet planes."""

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

    def least_of_vertices(self, batches: Iterator[Batch] | None, found: wp.array) -> NDArray[np.float64]:
        """Measure the pairs, end the call, and return what is ``found`` of the vertices, numbers or their bits."""
        for _ in () if batches is None else self.batches(batches):
            with self.timed("distances"):
                self.plan.measure_pairs(self.sink)
        with self.timed("gather"):
            result = found.numpy().view(np.float64).copy()
        self.finish()
        return result


class ProximityStep(StepAtOneTime):
    """The pairs within a distance."""

    goal = "proximities"
    sink = int(NEAR)
    result_bytes = BYTES_PER_PROXIMITY

    def proximities(self, distance: float, *, unique: bool = False) -> Proximities:
        """All pairs within a distance and their radii, or each two closest features once."""
        self._store = self.workspace.kept(ProximityStore, lambda: ProximityStore(self.topology, self.workspace.buffers))
        batches = self.search(distance)
        if batches is not None:
            self._list(batches)
        self.note_distance(distance)
        with self.timed("gather"):
            count, columns = self._store.gather(unique=unique)
            dimension, direction = self.mesh.dimension, columns["direction"]
            if dimension == 2:
                columns["direction"] = lambda: direction()[:, :2].copy()
            x = self.positions[0][:, :dimension].copy()
        self.finish()
        return Proximities._of_list(count, columns, mesh=self.mesh, positions=x, radius=self.mesh.radius)

    def bind_options(self, time_slice: Slice) -> None:
        """Let the kernels know how near is near."""
        self.plan.bind(reach=self.reach(self.separation))

    def begin_found(self) -> None:
        """Begin a list, with places for what the last call has found."""
        super().begin_found()
        self._store.begin(self.execution)
        self.plan.bind(proximities=self._store.begin_batch(self._store.expected))

    def fits(self) -> bool:
        """Whether the list holds all pairs; the next one does if not."""
        return self._store.ends_complete()

    def record_planes(self, stages: Stages, recording: Recording) -> None:
        """Record that near planes are listed."""
        stages.list_near_planes(recording)

    def _list(self, batches: Iterator[Batch]) -> None:
        """List what is near, batch by batch."""
        plan, store = self.plan, self._store
        store.begin(self.execution)
        if self.planes is not None:
            begin = lambda count: plan.bind(proximities=store.begin_batch(count))  # noqa: E731
            with self.timed("planes"):
                count = self.planes.listed(LEAST_PLACES, begin, Stages.list_near_planes)
                self.survivors[PairKind.VERTEX_PLANE] = count
                store.end_batch()
        for batch in self.batches(batches):
            with self.timed("distances"):
                plan.bind(proximities=store.begin_batch(sum(batch.num_pairs.values())))
                plan.measure_pairs(self.sink)
                store.end_batch()


class DisplacementStep(StepAtOneTime):
    """How far vertices may move."""

    goal = "displacements"
    sink = int(DISPLACEMENT)

    def bounds(self, search_radius: float) -> NDArray[np.float64]:
        """For each vertex the length by which it may move."""
        self._search_radius, distance = search_radius, add_rounded_up(search_radius, self.options.minimum_distance)
        batches = self.search(distance)
        self.note_distance(distance)
        if batches is not None:
            self.plan.play("reset bounds", self._record_reset)
            if self.planes is not None:
                with self.timed("planes"):
                    self.survivors[PairKind.VERTEX_PLANE] = self.planes.meet(self.record_planes)
        bounds = self.least_of_vertices(batches, self.workspace.contacts.minima.vertex)
        bounds[self.mesh.unused_vertices] = np.inf
        return bounds

    def bind_options(self, time_slice: Slice) -> None:
        """Let the kernels know how near is near, what pairs keep, and what is the largest bound."""
        kept = self.options.minimum_distance
        largest = largest_bound(self._search_radius, self.mesh._moves_alone)
        self.plan.bind(reach=self.reach(self.separation, kept), largest_bound=largest)

    def record_found(self, stages: Stages, recording: Recording) -> None:
        """Record that bounds are reset, and lowered by what is near."""
        self._record_reset(stages, recording)
        super().record_found(stages, recording)

    def record_planes(self, stages: Stages, recording: Recording) -> None:
        """Record that near planes lower the bounds."""
        stages.bound_by_half_spaces(recording)

    def _record_reset(self, stages: Stages, recording: Recording) -> None:
        both = measure_pairs_in(Norm.EUCLIDEAN, self.topology.device), kernels.reset_bounds
        load_all(both, self.topology.device, self.execution.progress)  # side by side
        inputs, outputs = [Slot("largest_bound"), self.topology.body_static], [self.workspace.contacts.minima]
        recording.launch(kernels.reset_bounds, self.mesh.num_vertices, inputs=inputs, outputs=outputs)
