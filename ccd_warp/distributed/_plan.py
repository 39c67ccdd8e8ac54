"""A plan: the regions of the ranks, and the part of the mesh that a rank has until the plan no longer holds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ccd_warp._calls.pipeline import CollisionPipeline
from ccd_warp._results.pairs import pair_corners
from ccd_warp._runtime.status import IntersectionKind, PairKind
from ccd_warp._scene.input.excluded_pairs import ExcludedPairs
from ccd_warp._scene.mesh import CollisionMesh
from ccd_warp.distributed._exchange import Exchange
from ccd_warp.distributed._regions import Regions, bisected

if TYPE_CHECKING:
    from ccd_warp.distributed._mesh import DistributedMesh

# Samples of all ranks from which the regions are made, and for each rank; and the work of a primitive that stays.
_LEAST_SAMPLES, _SAMPLES_EACH, _WORK_OF_STATIC = 1 << 14, 128, 0.25
# Steps for which a vertex may go on as it moves in the step for which a plan is made.
_STEPS_AHEAD = 3.0
# By how much a vertex may leave that, in mean extents of a primitive.
_MARGIN = 0.5
# Far more than the rounding of a step in float32 is of the scene, and that of a few lengths of these.
_RESOLUTION = 2.0**-19
# What a part has of the whole mesh as it is; its own number of worlds and length scale would be others.
_OF_WHOLE = ("static", "kinematic", "self_collision", "body_pairs", "names", "planes", "num_worlds", "length_scale")

_Floats = NDArray[np.float64]
_Ends = tuple[_Floats, _Floats]


def _hull(values: _Floats, corners: NDArray[np.integer]) -> _Ends:
    """The least and the largest values of the vertices of each primitive."""
    low = high = values[corners[:, 0]]
    for column in corners.T[1:]:
        others = values[column]
        low, high = np.minimum(low, others), np.maximum(high, others)
    return low, high


@dataclass(frozen=True)
class Boxes:
    """Where vertices may be while a plan is kept, their boxes, and how thick the primitives at them are.

    A pair that comes within its distance in a step has overlapping boxes: each holds the motion of its primitive,
    enlarged by half the distance and by its radius, and all of this is rounded outward.

    Attributes:
        limits: The least and the largest positions, shape [n, d] each.
        lower: Lower corners of the boxes, the world last, shape [n, d + 1].
        upper: Upper corners.
        radius: The radius of each vertex; None where there is none.
    """

    limits: _Ends
    lower: _Floats
    upper: _Floats
    radius: _Floats | None

    @staticmethod
    def of(
        whole: DistributedMesh,
        ends: _Ends,
        inflation: float,
        worlds: NDArray[np.integer],
        radius: _Floats | None,
    ) -> Boxes:
        """The boxes of vertices that go on as in a step, or stay near; every rank gets the same bits."""
        with np.errstate(over="ignore", invalid="ignore"):
            start, end = ends
            ahead, margin = end + _STEPS_AHEAD * (end - start), _MARGIN * whole.mean_extent
            low = np.minimum(np.minimum(start, end), ahead) - margin
            high = np.maximum(np.maximum(start, end), ahead) + margin
            more = (1.0 + _RESOLUTION) * (inflation + _RESOLUTION * whole.length_scale)
            lower, upper = _outward(low, high, np.array(more))
        return Boxes((low, high), np.column_stack([lower, worlds]), np.column_stack([upper, worlds]), radius)

    def around(self, corners: NDArray[np.integer]) -> _Ends:
        """The box of each primitive, given its vertices, shape [m, 1 to 3]: shapes [m, d + 1]."""
        lower, upper = _hull(self.lower, corners)[0], _hull(self.upper, corners)[1]
        if self.radius is not None:
            more = (1.0 + _RESOLUTION) * _hull(self.radius, corners)[1][:, None]
            lower[:, :-1], upper[:, :-1] = _outward(lower[:, :-1], upper[:, :-1], more)
        return lower, upper


def _outward(lower: _Floats, upper: _Floats, more: _Floats) -> _Ends:
    """Corners moved outward by no less than a length."""
    with np.errstate(over="ignore"):
        return np.nextafter(lower - more, -np.inf), np.nextafter(upper + more, np.inf)


@dataclass
class RankPlan:
    """What stays from step to step.

    Attributes:
        inflation: Enlargement of the boxes.
        limits: Between which the vertices on this rank have to stay, shapes [n, d]; ghosts may be anywhere.
        regions: The regions of the ranks.
        rank: Number of this rank.
        ids: Id of each vertex of the part, ascending in each body, int64, shape [m].
        exchange: That of these vertices with their owners.
        boxes: Their boxes.
        pipeline: The part as a mesh of its own, with all bodies and worlds of the whole one, and the calls on it.
        num_ghosts: Vertices of the part that lie in other regions.
    """

    inflation: float
    limits: _Ends
    regions: Regions
    rank: int
    ids: NDArray[np.int64]
    exchange: Exchange
    boxes: Boxes
    pipeline: CollisionPipeline
    num_ghosts: int

    def serves(self, start: _Floats, end: _Floats, inflation: float) -> bool:
        """Whether the plan holds for a step, as far as this rank can tell."""
        low, high = self.limits
        is_within = not any((x < low).any() or (x > high).any() for x in (start, end))
        return inflation <= self.inflation and is_within

    def brought(self, start: _Floats, end: _Floats) -> _Ends:
        """The positions of the part at both ends of a step, given those of this rank's vertices; collective."""
        ends = [start] if end is start else [start, end]
        brought = [np.empty((len(self.ids), start.shape[1])) for _ in ends]
        self.exchange.forward(ends, brought)
        return brought[0], brought[-1]

    def are_own(self, kind: PairKind | IntersectionKind, pairs: NDArray[np.int32]) -> NDArray[np.bool_]:
        """Which pairs of primitives of the part count on this rank, given their indices, shape [m, 2].

        Those do whose boxes have an intersection with its lower corner in this region. The corner lies in both boxes,
        so that this rank has both primitives; and it lies in one region, so that no other rank counts them.
        """
        first, second = pair_corners(self.pipeline.mesh, kind, pairs)
        lower = self.boxes.around(first)[0]
        if second.shape[1]:  # a half-space is everywhere
            lower = np.maximum(lower, self.boxes.around(second)[0])
        return self.regions.holds(self.rank, lower)


def make_plan(
    whole: DistributedMesh, start: _Floats, end: _Floats, inflation: float, options: dict[str, Any]
) -> RankPlan:
    """Choose regions, and send every primitive to the ranks whose regions its box meets; collective.

    It is for a step with these positions of the vertices on this rank, of which ghosts are ignored, for boxes that are
    enlarged by no less, and for calls with these options.
    """
    ranks = whole.ranks
    start, end = start.copy(), end.copy()
    whole.copies.forward([start, end], [start, end])
    inflation *= 1.0001  # as that of a separation grows a little with rounding, and needs no new plan then
    boxes = Boxes.of(whole, (start, end), inflation, whole.worlds, whole.radius)
    regions = _regions(whole, start)
    sent: dict[str, list[NDArray[np.int64]]] = {kind: [] for kind in (*whole.primitives, "vertex")}
    of_kinds = {kind: boxes.around(corners) for kind, corners in whole.primitives.items()}
    for region in range(ranks.size):
        is_used = np.zeros(len(start), dtype=bool)
        for kind, corners in whole.primitives.items():
            chosen = corners[regions.meets(region, *of_kinds[kind])]
            is_used[chosen] = True
            sent[kind].append(whole.vertex_ids[chosen])
        sent["vertex"].append(whole.table[is_used])
    received = {kind: np.concatenate(ranks.swap(arrays)) for kind, arrays in sent.items()}
    table = received["vertex"][np.unique(received["vertex"][:, 0], return_index=True)[1]]  # all say the same
    table = table[np.argsort(table[:, 2], kind="stable")]
    ids, by_id = table[:, 0], np.argsort(table[:, 0])
    place = lambda wanted: by_id[np.searchsorted(ids, wanted, sorter=by_id)]  # noqa: E731
    exchange = whole._exchange_to(ids, table[:, 1])
    first, last = (np.empty((len(ids), whole.dimension)) for _ in range(2))
    exchange.forward([start, end], [first, last])
    mesh = _part(whole, table, first, _each_once(place(received["face"])), place(received["edge"]), place)
    pipeline = CollisionPipeline(mesh, **options)
    for what in ("doubled", "size"):  # which name vertices by numbers of the part
        pipeline._warn_once(what, str)
    part_boxes = Boxes.of(whole, (first, last), inflation, table[:, 3], mesh.radius)
    for limits, farthest in zip(boxes.limits, (-np.inf, np.inf), strict=True):
        limits[~whole.is_owned | whole.is_unused] = farthest
    num_ghosts = len(ids) - int(regions.holds(ranks.rank, part_boxes.lower).sum())
    return RankPlan(inflation, boxes.limits, regions, ranks.rank, ids, exchange, part_boxes, pipeline, num_ghosts)


def _regions(whole: DistributedMesh, start: _Floats) -> Regions:
    """Regions of nearly equal work, from samples of the middles of all primitives; collective."""
    ranks = whole.ranks
    kinds = [corners for corners in whole.primitives.values() if len(corners)]
    total = int(ranks.total(np.array(sum(map(len, kinds)))))
    most, rows = max(_LEAST_SAMPLES, _SAMPLES_EACH * ranks.size), [np.empty((0, whole.dimension + 3))]
    for corners in kinds:
        sampled = corners[:: max(1, total // most)]
        low, high = _hull(start, sampled)
        work = np.where(whole.static[whole.bodies[sampled[:, 0]]], _WORK_OF_STATIC, 1.0)
        here = np.full(len(sampled), float(ranks.rank))
        rows.append(np.column_stack([0.5 * low + 0.5 * high, whole.worlds[sampled[:, 0]], work, here]))
    samples = ranks.every(np.concatenate(rows))
    points, work, rank = samples[:, :-2], samples[:, -2], samples[:, -1].astype(np.intp)
    regions = bisected(points, work, ranks.size)
    num_samples = [np.bincount(rank[regions.holds(r, points)], minlength=ranks.size) for r in range(ranks.size)]
    return regions.assigned(np.stack(num_samples, axis=1))


def _part(
    whole: DistributedMesh,
    table: NDArray[np.int64],
    vertices: _Floats,
    faces: NDArray[np.integer],
    edges: NDArray[np.integer],
    place: Callable[[NDArray[np.int64]], NDArray[np.integer]],
) -> CollisionMesh:
    """The mesh of given primitives, with what is known of the whole one; `place` says where ids are in the table."""
    excluded = {"bodies": whole.excluded_bodies}
    if len(whole.excluded_ids):
        here = whole.excluded_ids[np.isin(whole.excluded_ids, table[:, 0]).all(axis=1)]
        excluded["vertices"] = place(here).astype(np.int32)
    return CollisionMesh._of_parts(
        listed_edges=edges.astype(np.int32),
        with_codimensional_points=whole.with_points,
        with_inner_vertices=np.zeros(whole.num_bodies, dtype=bool),
        vertices=vertices,
        faces=faces.astype(np.int32),
        body_vertex_range=np.searchsorted(table[:, 2], np.arange(whole.num_bodies + 1)).astype(np.int32),
        rigid=np.zeros(whole.num_bodies, dtype=bool),
        exclusion_rings=1,
        vertex_world=table[:, 3].astype(np.int32),
        exclude_pairs=ExcludedPairs(excluded),
        radius=None if whole.radius is None else table[:, 4].copy().view(np.float64),
        _moves_alone=whole.moves_alone,
        _largest_radius=whole.largest_radius,
        **{name: getattr(whole, name) for name in _OF_WHOLE},
    )


def _each_once(rows: NDArray[np.integer]) -> NDArray[np.integer]:
    """The faces, rows of vertices, without copies; of those the first in lexicographic order counts."""
    ordered = np.sort(rows, axis=1)
    order = np.lexsort((*rows.T[::-1], *ordered.T[::-1]))
    is_new = np.append(True, (np.diff(ordered[order], axis=0) != 0).any(axis=1))[: len(order)]
    return rows[order[is_new]]
