"""What is searched in a step and what for: of the driver on the host, and of that on the device."""

from collections.abc import Callable, Mapping
from typing import Any, Literal

import warp as wp

from ccd_warp._engine.boxes.box_sets import BoxSet
from ccd_warp._engine.boxes.grids import Grid
from ccd_warp._engine.boxes.trees import Tree, sampled_pairs_of, tree_pairs_of, trees_of
from ccd_warp._engine.mesh.scene import possible_kinds
from ccd_warp._engine.mesh.topology import Topology
from ccd_warp._engine.stages import Stages
from ccd_warp._runtime.lanes import narrow_phase_on
from ccd_warp._runtime.launch import Execution, Recording
from ccd_warp._runtime.status import PairKind
from ccd_warp._scene.input.options import Options
from ccd_warp.kernels.narrow_phase.sinks import BOUND, CONTACTS
from ccd_warp.kernels.pair.norm import Norm
from ccd_warp.kernels.step.minima import ANY_OPEN, NUM_COUNTS

# What a call looks for: all contacts, the least toi alone, candidate pairs; or at one time what intersects, what
# is near, how far vertices may move, or how near they are to anything.
Goal = Literal["contacts", "bound", "candidates", "intersections", "proximities", "displacements", "start distances"]
AT_ONE_TIME = ("proximities", "displacements", "start distances")
# What finds the boxes that overlap, by the name of the option.
_BROAD_PHASES: dict[str, type[Tree] | type[Grid]] = {"tree": Tree, "hash": Grid}
COUNTS_SHAPE = len(PairKind), int(NUM_COUNTS)
NUM_ALL_COUNTS = len(PairKind) * int(NUM_COUNTS)


class Plan:
    """A step of one goal: what is searched and counted, and the order of its stages, as they are recorded.

    Its driver gives the stages their arrays. That on the device plays all stages of a step as one section, without a
    look at what they find. The one on the host chooses the quantization and the order of the trees for each step, and
    sees afterwards whether all that was found did fit: until it has, it plays a section for each stage.

    Attributes:
        topology: The mesh on its device.
        execution: Where the stages run.
        kinds: Kinds of pairs that the mesh can form and the options select.
        tree_pairs: The tree pairs, or the pairs of spatial hashes, that are searched.
        sampled_pairs: The same with a sample of their queries, where that is searched first.
        trees: The trees or spatial hashes of all of them, each once.
        static_trees: Those of static bodies.
        slender_trees: Those for pairs within slender bodies.
        moving_trees: The others.
        has_planes: Whether vertices meet half-spaces.
        norm: The norm of separations, by its name (``kernels.pair.norm``).
        is_clipping: Whether pairs are solved by clips of time.
        sink: Where what the narrow phase finds goes.
    """

    def __init__(
        self,
        topology: Topology,
        options: Options,
        execution: Execution,
        goal: Goal,
        norm: Norm,
        kept: Mapping[Any, dict[str, BoxSet]] | None = None,
        counters: wp.array | None = None,
    ) -> None:
        """Choose what is searched.

        ``kept`` are sets of boxes that stay from plan to plan, by their broad phase, and ``counters`` begin with the
        memory for the counts; by default the plan has its own.
        """
        self.topology, self.execution = topology, execution
        self.norm, self._goal, self._real = norm, goal, options.real
        self.is_clipping = options.is_clipping
        mesh = topology.mesh
        self.kinds = possible_kinds(mesh, options) if topology.kinds is None else topology.kinds
        self.has_planes = PairKind.VERTEX_PLANE in self.kinds
        broad_phase = _BROAD_PHASES["tree" if goal == "intersections" else options.broad_phase]
        sets = ({} if kept is None else kept[broad_phase]), broad_phase
        self._has_narrow_phase = goal in ("contacts", "bound")
        # the search of CUDA lists candidates in trees of endpoint AABBs alone
        is_culled = self._has_narrow_phase or goal in AT_ONE_TIME or (execution.is_cuda and goal == "intersections")
        self._num_aabbs = 2 if is_culled else 1
        with_slender = is_culled and topology.slender is not None
        is_alone = topology.is_free_alone if with_slender else mesh._is_free_alone
        tree_pairs = tree_pairs_of(topology, self.kinds, is_alone, *sets, with_slender=with_slender)
        is_sampled = goal == "bound" and topology.samples_queries
        sampled = sampled_pairs_of(tree_pairs, topology, *sets) if is_sampled else []
        self.tree_pairs, self.sampled_pairs = broad_phase.searches(tree_pairs), broad_phase.searches(sampled)
        self.trees = trees_of(self.tree_pairs + self.sampled_pairs)
        self.static_trees = [tree for tree in self.trees if tree.primitives.is_static]
        self.slender_trees = [tree for tree in self.trees if tree.primitives.role == "slender"]
        self.moving_trees = [tree for tree in self.trees if tree.primitives.role not in ("static", "slender")]
        self._searched_kinds = list(dict.fromkeys(tree_pair.kind for tree_pair in self.tree_pairs))
        self.sink = int(BOUND if goal == "bound" else CONTACTS)
        if counters is None:
            counters = wp.zeros(NUM_ALL_COUNTS, dtype=wp.int64, device=topology.device)
        self._counts: wp.array = counters[:NUM_ALL_COUNTS].reshape(COUNTS_SHAPE)
        self._is_open = low_half(self._counts, int(ANY_OPEN))

    def record_boxes(
        self,
        recording: Recording,
        stages: Stages,
        active: wp.array,
        *,
        sort: Callable[[], None] | None = None,
    ) -> None:
        """Record the boxes of the bodies that are active; a call may ``sort`` trees: on CUDA before they are filled."""
        if self.moving_trees:
            stages.fill_vertex_aabbs(recording, self.topology.boxed_vertices, active)
        if sort is not None and recording.is_cuda:
            recording.call(sort)
        stages.fill_boxes(recording, self.moving_trees)
        if sort is not None and not recording.is_cuda:
            recording.call(sort)
        stages.fill_slender(recording, self.slender_trees, active)

    def record_narrow_phase(
        self,
        recording: Recording,
        stages: Stages,
        active: wp.array,
        *,
        only_moving: bool = False,
        gaps_moved: float = 0.0,
    ) -> None:
        """Record what vertices and half-spaces do, and both rounds of the narrow phase."""
        if self.has_planes:
            stages.meet_planes(recording, self.sink, active, only_moving=only_moving, gaps_moved=gaps_moved)
        self.record_rounds(recording, stages, only_moving=only_moving, gaps_moved=gaps_moved)

    def record_rounds(self, recording: Recording, stages: Stages, **solved: Any) -> None:
        """Record both rounds of the narrow phase.

        The second round of the goal of a bound is of the pairs that are earlier than all others, which the host finds.
        """
        stages.solve(recording, self.sink, is_second=False, **solved)
        if self.sink == CONTACTS:
            with recording.only_if(self._is_open):
                stages.solve(recording, self.sink, is_second=True, **solved)

    @property
    def _narrow_phase(self) -> Any:
        """The kernels of the narrow phase; None where the goal has none."""
        if not self._has_narrow_phase:
            return None
        return narrow_phase_on(self.topology.device, self._real, self.norm)


def low_half(counts: wp.array, column: int) -> wp.array:
    """The low half of a count in the first row, int32, shape [1]: a flag, as there are fewer than 2³² pairs."""
    return _int32_at(counts, column * counts.strides[1])  # the bytes of a number are in ascending order on all devices


def high_half(least_bits: wp.array) -> wp.array:
    """The high half of the bits of a toi, int32, shape [1]: a flag, as it is 0 for 0 and numbers as good as that."""
    return _int32_at(least_bits, 4)


def _int32_at(array: wp.array, place: int) -> wp.array:
    return wp.array(ptr=array.ptr + place, dtype=wp.int32, shape=1, device=array.device)
