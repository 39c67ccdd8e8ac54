"""A mesh that stands in one process for the parts of many ranks, and what a plan sends to each of them.

The functions of `ccd_warp.distributed` that make a plan ask a mesh for its primitives and its ranks for sums. Here one
rank has handed in everything, so that sums are what it has, and the number of ranks is what one likes.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
from ccd_warp.benchmarks.scenes import Scene

from ccd_warp._input.half_spaces import planes_of
from ccd_warp._input.worlds import move_alone, worlds_of_bodies
from ccd_warp.distributed import _partition as partition
from ccd_warp.distributed import _planning as planning
from ccd_warp.distributed._plan import Bounds, destinations, united
from ccd_warp.distributed._primitives import Primitives

# Primitives at a time, so that their boxes take some hundred megabytes.
_CHUNK = 1 << 21


class VirtualRanks:
    """So many ranks, all but the first of which have nothing to add."""

    rank = 0

    def __init__(self, size: int) -> None:
        self.size = size

    def every(self, values: np.ndarray) -> np.ndarray:
        return values

    total = least = most = every

    def agree(self, *values: float) -> list[float]:
        return list(values)


class VirtualMesh:
    """What a plan asks of a `DistributedMesh`; attributes are those of that class.

    Attributes:
        start: Start positions, shape [V, 3].
        end: End positions.
        faces: Faces in the order of their sorted vertices, int32, shape [F, 3].
        edges: Edges by (max, min) of their vertices, int32, shape [E, 2].
    """

    def __init__(self, scene: Scene) -> None:
        self.start, self.end = scene.vertices_t0, scene.vertices_t1
        count = self.num_vertices = len(self.start)
        self.faces = _ordered(scene.faces, count)
        self.edges = _edges_of(self.faces, count)
        ends = _vertex_ends(scene)
        self.num_bodies, self.num_worlds, self.dimension = len(ends), 1, 3
        self.num_edges, self.num_faces = len(self.edges), len(self.faces)
        self.numbers = self.vertex_ids = np.arange(count)
        self.bodies = np.searchsorted(ends, self.numbers, side="right")
        self.worlds = np.zeros(count, dtype=np.int64)
        self.owned_rows = self.numbers
        self.is_owned, self.is_unused = np.ones(count, dtype=bool), np.zeros(count, dtype=bool)
        self.owner = np.zeros(count, dtype=np.int64)
        self.radius, self.box_radius, self.is_thick = None, np.zeros(count), False
        self.static = np.zeros(self.num_bodies, dtype=bool)
        self.static[list(scene.static)] = True
        self.kinematic = np.zeros(self.num_bodies, dtype=bool)
        self.rigid = self.kinematic
        self.end = np.where(self.static[self.bodies][:, None], self.start, self.end)
        self.self_collision = np.full(self.num_bodies, scene.self_collision)
        first, last = worlds_of_bodies(self.bodies, self.worlds, self.num_bodies)
        self.moves_alone = move_alone(~self.static, self.self_collision, first, last)
        self.body_pairs, self.exclusion_rings, self.exclude_pairs = None, 1, {}
        self.planes = planes_of([], 3)
        self.names = tuple(f"body {b}" for b in range(self.num_bodies))
        self.length_scale = float((self.start.max(axis=0) - self.start.min(axis=0)).max())
        self.primitives = {
            "vertex": Primitives(self.numbers, self.numbers[:, None], np.zeros(count, dtype=bool)),
            "edge": Primitives(np.arange(self.num_edges), self.edges, np.zeros(self.num_edges, dtype=bool)),
            "face": Primitives(np.arange(self.num_faces), self.faces, np.zeros(self.num_faces, dtype=bool)),
        }
        self.rings = None
        self.copies = SimpleNamespace(forward=lambda pairs: None)  # nothing is on two ranks
        self.ranks = VirtualRanks(1)

    def _exchange_to(self, *_: Any) -> None:
        """Positions are not sent: they are here."""

    def owners(self, num_ranks: int) -> np.ndarray:
        """Rank that owns each vertex where a simulation has divided its mesh by place, into as many vertices each."""
        points = np.concatenate([self.start.T, np.zeros((1, self.num_vertices))])
        chosen = partition.even_samples(self.num_vertices, max(1 << 16, 64 * num_ranks))
        regions = partition.bisected(np.ascontiguousarray(points[:, chosen]), np.ones(len(chosen)), num_ranks)
        return partition.region_of(regions, points)


def _ordered(faces: np.ndarray, count: int) -> np.ndarray:
    """Faces by their sorted vertices."""
    low, middle, high = np.sort(faces, axis=1).T.astype(np.int64)
    order = np.lexsort((middle * count + high, low))
    return faces[order].astype(np.int32)


def _edges_of(faces: np.ndarray, count: int) -> np.ndarray:
    """The edges of faces, as `_numbering.edges_of_faces` has them, by one sort of numbers."""
    a, b = faces[:, [0, 1, 2]].ravel().astype(np.int64), faces[:, [1, 2, 0]].ravel().astype(np.int64)
    keys = unique(np.maximum(a, b) * count + np.minimum(a, b))
    high, low = np.divmod(keys, count)
    return np.stack([low, high], axis=1).astype(np.int32)


def _vertex_ends(scene: Scene) -> np.ndarray:
    """One past the last vertex of each body."""
    if not scene.body_faces:
        return np.array([len(scene.vertices_t0)])
    begin = np.cumsum((0, *scene.body_faces[:-1]))
    ends = np.maximum.reduceat(scene.faces.max(axis=1), begin) + 1
    ends[-1] = len(scene.vertices_t0)
    return ends


@dataclass
class VirtualPlan:
    """The regions of ranks, and how much each gets.

    Attributes:
        bounds: The numbers from which the boxes follow.
        lower: Lower corners of the boxes of the vertices, shape [4, V].
        upper: Upper corners.
        regions: The regions.
        num_primitives: Primitives that meet each region, shape [P].
        num_home: Those of them that lie in it, which are counted nowhere else.
        num_faces: Faces that meet it.
        num_home_faces: Those of them that lie in it.
        vertices: The vertices of each region's primitives, as region · V + vertex, ascending.
        message_bytes: Bytes of the primitives that are sent to each region.
        items: The primitives of each kind that meet it, for each region.
    """

    bounds: Bounds
    lower: np.ndarray
    upper: np.ndarray
    regions: partition.Regions
    num_primitives: np.ndarray
    num_home: np.ndarray
    num_faces: np.ndarray
    num_home_faces: np.ndarray
    vertices: np.ndarray
    message_bytes: np.ndarray
    items: list[dict[str, np.ndarray]]

    @staticmethod
    def of(
        mesh: VirtualMesh, num_ranks: int, work: np.ndarray | None, owner: np.ndarray, inflation: float = 0.0
    ) -> VirtualPlan:
        """The plan of so many ranks, given the work by vertices of an earlier search, and the owners of vertices."""
        mesh.ranks = VirtualRanks(num_ranks)
        bounds = planning._bounds(mesh, mesh.start, mesh.end, inflation)
        lower, upper = bounds.boxes(mesh.start, mesh.end, mesh.worlds, mesh.box_radius)
        regions = planning._regions(mesh, lower, upper, work)
        # there all primitives were those of one rank; their owners choose among the regions
        held = _flows(owner, partition.region_of(regions, lower), num_ranks, with_own=True)
        regions = partition.assigned(regions, held.astype(np.float64))
        empty = np.zeros(num_ranks, dtype=np.int64)
        met, home, used = {}, {}, []
        items: list[dict[str, np.ndarray]] = [{} for _ in range(num_ranks)]
        for kind, each in mesh.primitives.items():
            met[kind], home[kind] = empty.copy(), empty.copy()
            lists: list[list[np.ndarray]] = [[np.zeros(0, dtype=np.int32)] for _ in range(num_ranks)]
            for begin in range(0, len(each.numbers), _CHUNK):
                corners = each.corners[begin : begin + _CHUNK]
                found = destinations(regions, lower, upper, {kind: corners})[kind]
                met[kind] += [len(items) for items in found]
                places = partition.region_of(regions, united(lower, upper, corners)[0])
                home[kind] += np.bincount(places, minlength=num_ranks)
                if kind != "edge":  # the face of an edge goes wherever the edge goes
                    used.append(_used(found, corners, mesh.num_vertices))
                for r, each_found in enumerate(found):
                    lists[r].append((each_found + begin).astype(np.int32))
            for r in range(num_ranks):
                items[r][kind] = np.concatenate(lists[r])
        vertices = unique(np.concatenate(used))
        num_used = np.bincount(vertices // mesh.num_vertices, minlength=num_ranks)
        numbers = 3 + planning._VERTEX * num_used + planning._EDGE * met["edge"] + planning._FACE * met["face"]
        return VirtualPlan(
            bounds,
            lower,
            upper,
            regions,
            sum(met.values()),
            sum(home.values()),
            met["face"],
            home["face"],
            vertices,
            8 * numbers * (num_used > 0),
            items,
        )


def _used(found: list[np.ndarray], corners: np.ndarray, num_vertices: int) -> np.ndarray:
    keys = [corners[items].astype(np.int64).ravel() + r * num_vertices for r, items in enumerate(found) if len(items)]
    return unique(np.concatenate(keys)) if keys else np.zeros(0, dtype=np.int64)


def unique(numbers: np.ndarray) -> np.ndarray:
    """Each number once, ascending; by a sort, which is faster than the table of `np.unique` for millions."""
    numbers.sort()
    return numbers[np.append(True, numbers[1:] != numbers[:-1])[: len(numbers)]]


@dataclass(frozen=True)
class Traffic:
    """What each rank sends in a step whose plan is kept, shape [P] each; small reductions left out.

    Attributes:
        num_sent: Bytes.
        num_messages: Messages.
        num_neighbours: Ranks to which it sends positions.
    """

    num_sent: np.ndarray
    num_messages: np.ndarray
    num_neighbours: np.ndarray

    @staticmethod
    def of(mesh: VirtualMesh, plan: VirtualPlan, owner: np.ndarray) -> Traffic:
        """What `mesh_ccd` sends, given the owners; a face is handed in by the owner of its first vertex.

        Positions go to the regions, minima of vertices come back, and go on to the ghosts of the ranks.
        """
        num_ranks, count = plan.regions.count, mesh.num_vertices
        region, vertex = np.divmod(plan.vertices, count)
        moves = ~mesh.static[mesh.bodies[vertex]]
        positions = _flows(owner[vertex][moves], region[moves], num_ranks)
        minima = _flows(region, owner[vertex], num_ranks)
        holder = owner[mesh.faces[:, 0]].astype(np.int64)
        ghosts = [holder[at] * count + c[at] for c in mesh.faces.T for at in [np.flatnonzero(owner[c] != holder)]]
        holder, vertex = np.divmod(unique(np.concatenate(ghosts)), count)
        copies = _flows(owner[vertex], holder, num_ranks)
        return Traffic(
            6 * 8 * positions.sum(axis=1) + 8 * minima.sum(axis=1) + 8 * copies.sum(axis=1),
            sum((flow > 0).sum(axis=1) for flow in (positions, minima, copies)),
            (_flows(owner[plan.vertices % count], region, num_ranks) > 0).sum(axis=1),
        )


def _flows(source: np.ndarray, target: np.ndarray, num_ranks: int, *, with_own: bool = False) -> np.ndarray:
    """How many go from each rank to each other one, shape [P, P], and to itself if that counts."""
    crosses = slice(None) if with_own else source != target
    keys = source[crosses].astype(np.int64) * num_ranks + target[crosses]
    return np.bincount(keys, minlength=num_ranks**2).reshape(num_ranks, num_ranks)
