"""What is odd about a step, and sentences for it: positions that blow up, a distance of many edges, many overlaps."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._engine.mesh.scene import length_scale_of
from ccd_warp._engine.mesh.topology import upper_median
from ccd_warp._results.pairs import pair_corners
from ccd_warp._runtime.display import shortened
from ccd_warp._scene.input.mesh_checks import vertices_without_primitive
from ccd_warp._scene.input.names import body_label
from ccd_warp._scene.replicate import bodies_of_copies
from ccd_warp.kernels.pair.rounding import PROJECTION_ROOT, UNIT_ROUNDOFF
from ccd_warp.kernels.pair.start_gap import LEAST_TOLERANCE

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ccd_warp._engine.host.plan import HostPlan
    from ccd_warp._engine.host.workspace import Workspace
    from ccd_warp._engine.mesh.topology import Positions, Topology
    from ccd_warp._runtime.status import PairKind
    from ccd_warp._scene.input.options import Options
    from ccd_warp._scene.mesh import CollisionMesh

# Distances of so many edges, and of more than exclusion_rings leaves out, have all neighbours of a vertex within them;
# three, whatever the rounding of both.
_MANY_EDGES = 3.0 - 1e-6
# Pairs left by the cull, in total and for each primitive, above which there are suspiciously many overlaps.
_MANY_PAIRS = 1_000_000
_MANY_PAIRS_EACH = 16
# Pairs by which the bodies are found that the warning names, of more than a million: in 2 ms of a second or more.
_MOST_SAMPLED = 1 << 12
# Of these pairs, those of the bodies that it names: fewer say nothing.
_LEAST_SHARE = 0.1
# Odd numbers without a pattern, by which the bits of three coordinates become one number.
_FACTORS = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], dtype=np.uint64)


class Farthest(NamedTuple):
    """The vertex that is farthest from the others in a step.

    Attributes:
        vertex: Its index.
        length: How far it is from the median of the start positions, along an axis.
        is_end: Whether it is there at the end of the step.
    """

    vertex: int
    length: float
    is_end: bool

    @classmethod
    def of(cls, positions: "Positions") -> "Farthest":
        """That of a step, whose mesh has vertices."""
        start, end = positions
        with np.errstate(over="ignore"):
            centre = np.median(start, axis=0)
            largest = np.minimum([np.abs(x - centre).max(axis=1) for x in (start, end)], np.finfo(np.float64).max)
        at, vertex = np.unravel_index(np.argmax(largest), largest.shape)
        return cls(int(vertex), float(largest[at, vertex]), bool(at))

    def hides_gaps(self, tolerance: float, length_scale: float) -> bool:
        """Whether rounding at this size is more than the tolerance, even in float64."""
        most = max(tolerance, LEAST_TOLERANCE[wp.float64]) * length_scale
        return PROJECTION_ROOT * UNIT_ROUNDOFF[wp.float64] * self.length > most

    def described(self, mesh: "CollisionMesh") -> str:
        """Which vertex is how far from the others, and when."""
        when = "end" if self.is_end else "start"
        vertex = self.vertex % mesh._as_given.num_vertices
        return f"vertex {vertex}{mesh._as_given._where(vertex)} is {self.length:.3g} from the others at the {when}"


class DistanceInEdges(NamedTuple):
    """A distance in comparison with the edges of the bodies that collide with themselves.

    Attributes:
        distance: At which a typical pair counts as touching, a length.
        edge: The median length of an edge.
        has_radius: Whether radii are part of it.
        is_searched: Whether pairs within it are asked for, and do not touch.
    """

    distance: float
    edge: float
    has_radius: bool
    is_searched: bool = False

    @classmethod
    def of(
        cls,
        topology: "Topology",
        start: NDArray[np.float64],
        distance: float,
        radius: NDArray[np.float64] | None = None,
        rings: int = 0,
    ) -> "DistanceInEdges | None":
        """That of a mesh at its start positions, from samples of its edges, if it is so many that neighbours are near.

        Args:
            topology: The mesh.
            start: Its start positions.
            distance: What is added to the radii, a length.
            radius: Radii of the vertices in place of those of the mesh, which has some.
            rings: Of neighbours that are excluded; a distance that does not reach beyond these is none, either.
        """
        mesh = topology.mesh
        is_thick = mesh._largest_radius > 0.0 if radius is None else bool((radius > 0.0).any())
        if len(mesh.edges) == 0 or not (distance > 0.0 or is_thick):
            return None
        edges = topology.edges_with_neighbours
        if len(edges) == 0:
            return None
        with np.errstate(over="ignore", invalid="ignore"):
            edge = upper_median(np.linalg.norm(start[edges[:, 1]] - start[edges[:, 0]], axis=1))
        typical_radius = topology.median_edge_radius if radius is None else upper_median(radius[edges].max(axis=1))
        distance += 2.0 * typical_radius
        return cls(distance, edge, is_thick) if distance > max(_MANY_EDGES, rings) * edge > 0.0 else None

    def described(self) -> str:
        """How many edges the distance is, and what to do."""
        name = "distance in which pairs are searched" if self.is_searched else "distance at which pairs touch"
        if self.has_radius:
            name = "distance of a pair, radii included," if not self.is_searched else f"{name}, radii included,"
        return (
            f"the {name} is {self.distance:.6g}, {self.distance / self.edge:.3g} times the median edge of "
            f"{self.edge:.6g}; neighbours are within it: exclusion_rings of the mesh leaves them out, or is the unit "
            "another?"
        )


class Oddities:
    """What a step has found to be odd.

    Attributes:
        distance: The distance of pairs, where it is many edges long.
        overlaps: A sentence on pairs that are so many that parts of the scene seem to lie in each other.
        is_stuck: Whether rounding may be why a toi is 0.
        touches_at_start: Whether something touches at the start.
    """

    distance: DistanceInEdges | None = None
    overlaps = ""
    is_stuck = touches_at_start = False

    def note_pairs(self, plan: "HostPlan", num_pairs: int, batch: "Mapping[PairKind, int]") -> None:
        """Note so many pairs left by the cull, and of which bodies most of those in a batch are, the last one.

        Nothing has to be said of the many pairs that follow from a distance of many edges.
        """
        if num_pairs < _MANY_PAIRS or self.distance is not None or self.overlaps:
            return
        mesh = plan.topology.mesh
        num_primitives = mesh.num_vertices + mesh.num_edges + mesh.num_faces
        if num_pairs < _MANY_PAIRS_EACH * num_primitives:
            return
        keys = {kind: plan.memory.keys(kind, count) for kind, count in batch.items() if count}
        of_bodies = _most_common_bodies(mesh, keys) if mesh.num_bodies > 1 and keys else ""
        self.overlaps = (
            f"{num_pairs:,} pairs of {num_primitives:,} primitives may touch, so parts of the scene seem to lie in "
            "each other, or to be long and thin side by side; pair_kinds, or exclusion_rings of the mesh, leave pairs "
            f"out, and memory_limit bounds the memory{of_bodies}"
        )

    def explain(self, workspace: "Workspace", positions: "Positions", options: "Options") -> None:
        """Warn of each oddity, once for a mesh."""
        mesh = workspace.topology.mesh
        if self.distance is not None:
            key = "distance of a search" if self.distance.is_searched else "distance"
            workspace.warn_once(key, self.distance.described)
        if self.overlaps:
            workspace.warn_once("overlaps", lambda: self.overlaps)
        if self.touches_at_start:
            workspace.warn_once("doubled", lambda: _doubled_sentence(mesh, positions[0]))
        if self.is_stuck:
            farthest = Farthest.of(positions)
            if farthest.hides_gaps(options.tolerance, length_scale_of(mesh, options)):
                said = "rounding at the size of the positions is more than the tolerance and hides gaps at the start"
                workspace.warn_once("size", lambda: f"{said}, so toi is 0: {farthest.described(mesh)}")


def hidden_sentence(count: int, mesh: "CollisionMesh", positions: "Positions", within: float = 0.0) -> str:
    """A sentence on so many pairs whose gaps at the start rounding hides, empty if there are none.

    So does the largest length by which bodies may leave their paths, ``within``.
    """
    if not count:
        return ""
    gaps = "the gap of 1 pair" if count == 1 else f"the gaps of {count:,} pairs"
    if within > 0.0:
        return f"rounding, or within of the motion, up to {within:.3g}, hides {gaps} at the start, with toi 0"
    return f"rounding hides {gaps} at the start, with toi 0: {Farthest.of(positions).described(mesh)}"


def _doubled_sentence(mesh: "CollisionMesh", start: NDArray[np.float64]) -> str:
    """A sentence on vertices of a body in one place, as files of STL have, with which it touches itself; or empty."""
    is_left_out = mesh.exclude_pairs.keys() - {"bodies"}
    touches_itself = (mesh.self_collision & mesh._is_free)[mesh.vertex_body]
    touches_itself[vertices_without_primitive(mesh.num_vertices, mesh.faces, mesh.edges)] = False
    touches_itself[mesh.codimensional_points] = True
    vertices = np.flatnonzero(touches_itself)
    body, x = mesh.vertex_body[vertices], start[vertices] + 0.0  # which has no -0.0
    bits = x.view(np.uint64)
    order = np.argsort((bits ^ bits >> np.uint64(32)) @ _FACTORS + body.astype(np.uint64))  # a tenth of a lexsort
    after, before = order[1:], order[:-1]
    is_same = (body[after] == body[before]) & (x[after] == x[before]).all(axis=1)
    if is_left_out or not is_same.any():
        return ""
    count = np.bincount(body[after[is_same]])
    most = int(np.argmax(count))
    at = int(np.argmax(is_same & (body[after] == most)))
    return (
        f"{body_label(most, mesh.names)} has {count[most]:,} vertices where another of it is, such as "
        f"{vertices[before[at]]} and {vertices[after[at]]}, so it touches itself and toi is 0: merge them, as "
        f"merge_vertices() of trimesh does, or leave pairs out by self_collision or exclude_pairs"
    )


def _most_common_bodies(mesh: "CollisionMesh", keys: "Mapping[PairKind, wp.array]") -> str:
    """Words on the two bodies, or the one, to which the most pairs of a sample belong; none below a tenth of them."""
    total = sum(map(len, keys.values()))
    of_caller, given = mesh._as_given, np.arange(mesh.num_bodies)
    if of_caller is not mesh:
        given = bodies_of_copies(of_caller, mesh.num_worlds // of_caller.num_worlds)
    names = of_caller.names
    sample = []
    for kind, of_kind in keys.items():
        most = max(1, _MOST_SAMPLED * len(of_kind) // total)
        sampled = of_kind[:: max(1, -(-len(of_kind) // most))].numpy()
        pairs = np.stack([sampled >> 32, sampled & 0xFFFFFFFF], axis=1).astype(np.int32)
        bodies = [given[mesh.vertex_body[corners[:, 0]]] for corners in pair_corners(mesh, kind, pairs)]
        sample.append(np.sort(np.stack(bodies, axis=1), axis=1))
    pairs, counts = np.unique(np.concatenate(sample), axis=0, return_counts=True)
    share = counts.max() / counts.sum()
    if share < _LEAST_SHARE:
        return ""
    a, b = pairs[np.argmax(counts)].tolist()
    pair = f"{shortened(names[a])} and {'itself' if a == b else shortened(names[b])}"
    return f"; they are most often of {pair} ({100 * share:.0f} % of a sample)"
