"""What intersects at one time, on one rank."""

import numpy as np
from numpy.typing import NDArray

from ccd_warp._at_one_time.edge_points import EdgePointTopology, MeshWithEdgePoints
from ccd_warp._at_one_time.intersection_step import IntersectionStep, Keys
from ccd_warp._engine.host.workspace import Workspace
from ccd_warp._engine.mesh.topology import Positions, Topology
from ccd_warp._runtime.status import IntersectionKind, primitives_of
from ccd_warp._scene.input.options import Options
from ccd_warp.distributed._across_ranks import AcrossRanks
from ccd_warp.distributed._part import Part, PartTopology

_INDEX = 0xFFFFFFFF


class PartEdgePointTopology(EdgePointTopology):
    """The topology of a part with a point for each edge.

    A part has edges whose faces it has all, since the box of a face holds those of its edges. So `tested_edges` and
    `close_edges` are those of the whole mesh, among the edges of the part. A vertex whose own box meets the region has
    all its edges there, too; pairs with other vertices belong to other ranks, and these are not searched for.
    """

    def __init__(self, part: Part, of_part: PartTopology) -> None:
        """Given the topology of the part without them."""
        points = MeshWithEdgePoints(part.mesh)
        tested = np.intersect1d(points.tested_vertices, part.tested_vertices, assume_unique=True)
        vars(points)["tested_vertices"] = tested
        super().__init__(points, of_part.device)  # type: ignore[arg-type]
        self._of_part = of_part

    def _excluded_vertices(self) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        begin, rows = self._of_part._excluded_vertices()
        return np.pad(begin, (0, self.mesh.num_edges), mode="edge"), rows  # the points of edges exclude nothing


class PartIntersectionStep(IntersectionStep):
    """The intersections among the primitives of a part.

    A rank tests all pairs that it finds, those of other ranks, too: a vertex in a face, or two edges, are found by way
    of an edge and a face whose own pair may belong to another rank. In the end it keeps its own. Quantization and
    inactive bodies are those of the part alone, since exact tests decide, whatever else the search finds: the boxes of
    two primitives that meet overlap, and so do those of their bodies in the part. So until then a rank asks no other.
    """

    counts_survivors = True  # the plan of the ranks depends on their work

    def __init__(
        self, workspace: Workspace, positions: Positions, options: Options, paths: None, ranks: AcrossRanks
    ) -> None:
        """Begin at the first of these positions."""
        self._across = ranks
        super().__init__(workspace, positions, options)

    def with_edge_points(self, topology: Topology) -> EdgePointTopology:
        """The topology of the part with a point for each edge."""
        return PartEdgePointTopology(self._across.part, self._across.topology)

    def own_keys(self, kind: IntersectionKind, keys: Keys) -> Keys:
        """The pairs, of some given by keys, that belong to this rank."""
        topology, arrays = self._across.topology, primitives_of(kind)
        if arrays[0] == "vertex":
            # the ends of an edge that meets the region need not
            keys = keys[self._across.part.is_tested[keys >> 32]]
        kept: Keys = keys[topology.own_pairs_of(arrays, keys >> 32, keys & _INDEX)]
        return kept
