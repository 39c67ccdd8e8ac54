"""What is searched in a step and what for: of the driver on the host, and of that on the device."""

from collections.abc import Mapping
from typing import Any, Literal

import warp as wp

from ccd_warp._engine.boxes.box_sets import BoxSet
from ccd_warp._engine.boxes.grids import Grid
from ccd_warp._engine.boxes.trees import Tree, sampled_pairs_of, tree_pairs_of, trees_of
from ccd_warp._engine.mesh.scene import possible_kinds
from ccd_warp._engine.mesh.topology import Topology
from ccd_warp._runtime.lanes import narrow_phase_on
from ccd_warp._runtime.launch import Execution
from ccd_warp._runtime.status import PairKind
from ccd_warp._scene.input.options import Options
from ccd_warp.kernels.narrow_phase.sinks import BOUND, CONTACTS
from ccd_warp.kernels.step.minima import NUM_COUNTS

# What a call looks for: all contacts, the least toi alone, candidate pairs; or at one time what intersects, what
# is near, how far vertices may move, or how near they are to anything.
Goal = Literal["contacts", "bound", "candidates", "intersections", "proximities", "displacements", "start distances"]
AT_ONE_TIME = ("proximities", "displacements", "start distances")
# What finds the boxes that overlap, by the name of the option.
_BROAD_PHASES: dict[str, type[Tree] | type[Grid]] = {"tree": Tree, "hash": Grid}
COUNTS_SHAPE = len(PairKind), int(NUM_COUNTS)
NUM_ALL_COUNTS = len(PairKind) * int(NUM_COUNTS)


class Plan:
    """A step of one goal, by what is searched and counted; its driver gives the stages their arrays.

    The driver on the device records all stages at once. The one on the host plays them one by one: it chooses the
    quantization and the order of the trees for each step, and sees after the search how many pairs there are.

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
        norm: str,
        kept: Mapping[Any, dict[str, BoxSet]] | None = None,
    ) -> None:
        """Choose what is searched; ``kept`` are sets of boxes that stay from plan to plan, by their broad phase."""
        self.topology, self.execution = topology, execution
        self.norm, self._goal, self._real = norm, goal, options.real
        self.is_clipping = options.is_clipping
        mesh = topology.mesh
        self.kinds = possible_kinds(mesh, options) if topology.kinds is None else topology.kinds
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
        # the counts of each kind, and then the bits of the least toi: one array, which CUDA reads at once
        self._counters: wp.array = wp.zeros(NUM_ALL_COUNTS + 1, dtype=wp.int64, device=topology.device)
        self._counts = self._counters[:NUM_ALL_COUNTS].reshape(COUNTS_SHAPE)

    @property
    def has_planes(self) -> bool:
        """Whether vertices meet half-spaces."""
        return PairKind.VERTEX_PLANE in self.kinds

    @property
    def _narrow_phase(self) -> Any:
        """The kernels of the narrow phase; None where the goal has none."""
        if not self._has_narrow_phase:
            return None
        return narrow_phase_on(self.topology.device, self._real, self.norm)
