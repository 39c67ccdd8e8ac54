"""A plan: the regions of the ranks, and what has been sent there to stay until the plan no longer fits."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ccd_warp._rigid.rotations import in_space
from ccd_warp.distributed import _partition as partition
from ccd_warp.distributed._across_ranks import AcrossRanks
from ccd_warp.distributed._mesh import DistributedMesh
from ccd_warp.distributed._part import Part, PartTopology, part_mesh
from ccd_warp.distributed._plan import Bounds, axes_below, destinations, scene_box, united, used_rows

# Samples of all ranks from which the regions are made, and for each rank.
LEAST_SAMPLES = 1 << 14
SAMPLES_EACH = 128
# Columns of a vertex in a message, of an edge, of a face.
_VERTEX, _EDGE, _FACE = 8, 4, 4
_IS_TESTED, _IS_POINT = 1, 2
# Work of a primitive, of a candidate and of a pair that the cull leaves, in units of about ten nanoseconds.
WORK_OF_PRIMITIVE, WORK_OF_CANDIDATE, WORK_OF_PAIR = 4.0, 1.0, 12.0
_PRIMITIVES_A_VERTEX = 6.0


@dataclass
class Plan:
    """What stays from step to step.

    Attributes:
        bounds: The numbers from which the boxes follow.
        limits: Between which the vertices on this rank have to stay, shapes [n, 3] or [n, 2]; ghosts may be anywhere.
        regions: The regions of the ranks.
        part: The primitives of this rank's region.
        topology: Their data on the device.
        everywhere: What steps and line searches ask of all ranks.
        start: Start positions of the vertices of the part in the present step, shape [n, 3] or [n, 2].
        end: End positions.
        static_rows: Rows of the static vertices that this rank owns.
        static_start: Their positions, as they were sent.
        num_primitives: Primitives of the part, and those of them that lie in the region.
        imbalance: That of the work of the first step; None before.
    """

    bounds: Bounds
    limits: tuple[NDArray[np.float64], NDArray[np.float64]]
    regions: partition.Regions
    part: Part
    topology: PartTopology
    everywhere: AcrossRanks
    start: NDArray[np.float64]
    end: NDArray[np.float64]
    static_rows: NDArray[np.intp]
    static_start: NDArray[np.float64]
    num_primitives: tuple[int, int]
    imbalance: float | None = None


def make_plan(
    whole: DistributedMesh,
    start: NDArray[np.float64],
    end: NDArray[np.float64],
    inflation: float,
    work: NDArray[np.float64] | None,
    device: object,
) -> Plan:
    """Choose regions for a step, and send every primitive to the ranks whose regions its box meets; collective.

    Args:
        whole: The mesh.
        start: Start positions of the vertices on this rank; those of ghosts are overwritten.
        end: End positions of these vertices; those of ghosts are overwritten.
        inflation: The least enlargement of the boxes.
        work: Work of an earlier search by the vertices that this rank owns, shape [n]; None if it is not known.
        device: Device of the engine.
    """
    ranks = whole.ranks
    whole.copies.forward([(start, start), (end, end)])
    ends = in_space(start), in_space(end)
    bounds = _bounds(whole, *ends, inflation)
    lower, upper = bounds.boxes(*ends, whole.worlds, whole.box_radius)
    regions = _regions(whole, lower, upper, work)
    corners = {kind: primitives.corners for kind, primitives in whole.primitives.items()}
    items_by_kind = destinations(regions, lower, upper, corners)
    messages = [_message(whole, {kind: items[r] for kind, items in items_by_kind.items()}) for r in range(ranks.size)]
    received = ranks.swap(messages)
    part = _part_of(whole, received)
    count = len(part.vertex_numbers)
    part_start, part_end = (np.empty((count, whole.dimension)) for _ in range(2))
    part.everything.forward([(start, part_start), (end, part_end)])
    vars(part.mesh)["vertices"] = part_start.copy()  # the order of the trees is made for them
    part_ends = in_space(part_start), in_space(part_end)
    part_lower, part_upper = bounds.boxes(*part_ends, part.mesh.vertex_world, part.box_radius)
    region = regions.lower[ranks.rank], regions.upper[ranks.rank]
    topology = PartTopology(
        part,
        device,
        axes_below(part_lower, region[0]),
        None if whole.rings is None else whole.rings.among(part.vertex_numbers),
        whole.num_vertices,
    )
    is_home = _is_in(part_lower, region)
    num_home = int(is_home[part.tested_vertices].sum())
    for c in (part.mesh.edges, part.mesh.faces):
        num_home += int(_is_in(united(part_lower, part_upper, c)[0], region).sum())
    least, most = bounds.limits(lower, upper, whole.box_radius)
    limits = least[:, : whole.dimension], most[:, : whole.dimension]
    for values, farthest in zip(limits, (-np.inf, np.inf), strict=True):
        values[~whole.is_owned | whole.is_unused] = farthest
    static_rows = np.flatnonzero(whole.is_owned & ~whole.is_unused & whole.static[whole.bodies])
    return Plan(
        bounds,
        limits,
        regions,
        part,
        topology,
        AcrossRanks(whole, part, topology, is_home),
        part_start,
        part_end,
        static_rows,
        start[static_rows],
        (len(part.tested_vertices) + part.mesh.num_edges + part.mesh.num_faces, num_home),
    )


def _is_in(points: NDArray[np.float64], region: tuple[NDArray[np.float64], NDArray[np.float64]]) -> NDArray[np.bool_]:
    """Which of the points lie in a region, closed below and open above."""
    result = np.ones(points.shape[1], dtype=bool)
    for values, low, high in zip(points, *region, strict=True):
        result &= (values >= low) & (values < high)
    return result


def _bounds(whole: DistributedMesh, start: NDArray[np.float64], end: NDArray[np.float64], inflation: float) -> Bounds:
    """The numbers from which the boxes of the plan follow."""
    owned_rows = np.flatnonzero(whole.is_owned & ~whole.is_unused)
    lower, upper = scene_box(start[owned_rows], end[owned_rows])
    extent, count = 0.0, 0
    kind = "edge" if whole.num_edges else "face"
    corners = whole.primitives[kind].corners
    with np.errstate(over="ignore"):
        if len(corners):
            sides = np.zeros(len(corners))
            for values in start.T:
                of = [values.take(rows) for rows in corners.T]
                np.maximum(sides, np.maximum.reduce(of) - np.minimum.reduce(of), out=sides)
            largest = np.finfo(np.float64).max / max(whole.num_edges + whole.num_faces, 1)
            extent = float(np.minimum(sides, largest).sum())
            count = len(corners)
        total = whole.ranks.total(np.array([extent, float(count)]))
    box = whole.ranks.least(np.concatenate([lower, -upper]))
    mean_extent = float(total[0] / max(total[1], 1.0))
    return Bounds.of(mean_extent, inflation, box[:3], -box[3:], whole.num_worlds, whole.num_vertices)


def _regions(
    whole: DistributedMesh,
    lower: NDArray[np.float64],
    upper: NDArray[np.float64],
    work: NDArray[np.float64] | None,
) -> partition.Regions:
    """Regions of nearly equal work, from samples of the boxes of all primitives."""
    ranks = whole.ranks
    of_vertex = np.zeros(len(whole.vertex_ids))
    if work is not None:
        of_vertex[whole.owned_rows] = work
        whole.copies.forward([(of_vertex, of_vertex)])
    kinds = [primitives for primitives in whole.primitives.values() if len(primitives.numbers)]
    total = sum(len(primitives.numbers) for primitives in kinds)
    total_of_all = int(ranks.total(np.array(total)))
    most = max(LEAST_SAMPLES, SAMPLES_EACH * ranks.size)
    rows = [np.empty((0, 11))]
    for primitives in kinds:
        num = -(-most * len(primitives.numbers) // max(total_of_all, 1))
        sampled = primitives.corners[partition.even_samples(len(primitives.numbers), num)]
        stands_for = len(primitives.numbers) / len(sampled)
        work_of_home = WORK_OF_PRIMITIVE + of_vertex[sampled].mean(axis=1) / _PRIMITIVES_A_VERTEX
        of_ghost = np.full(len(sampled), WORK_OF_PRIMITIVE)
        box = np.nan_to_num(np.concatenate(united(lower, upper, sampled)))
        here = np.full((1, len(sampled)), float(ranks.rank))
        rows.append(np.concatenate([box, stands_for * np.stack([work_of_home, of_ghost]), here]).T)
    samples = np.ascontiguousarray(ranks.every(np.concatenate(rows)).T)
    regions = partition.bisected(samples[:4], samples[8], ranks.size, samples[4:8], samples[9])
    held = np.zeros((ranks.size, ranks.size))
    np.add.at(held, (samples[10].astype(np.int64), partition.region_of(regions, samples[:4])), samples[8])
    return partition.assigned(regions, held)


def _message(whole: DistributedMesh, items: dict[str, NDArray[np.intp]]) -> NDArray[np.int64]:
    """Primitives for a rank, with the vertices that they use, as one array; empty where there are none."""
    corners = {kind: whole.primitives[kind].corners[rows] for kind, rows in items.items()}
    if not any(map(len, corners.values())):
        return np.zeros(0, dtype=np.int64)
    rows, place = used_rows(len(whole.numbers), list(corners.values()))
    vertices = np.empty((len(rows), _VERTEX), dtype=np.int64)
    radius = whole.box_radius if whole.radius is None else whole.radius
    columns = [whole.numbers, whole.vertex_ids, whole.owner, whole.bodies, whole.worlds]
    for k, values in enumerate([*columns, radius.view(np.int64), whole.box_radius.view(np.int64)]):
        vertices[:, k] = values[rows]
    vertices[:, _VERTEX - 1] = 0
    is_point = whole.primitives["vertex"].is_codimensional[items["vertex"]]
    vertices[place[corners["vertex"][:, 0]], _VERTEX - 1] = _IS_TESTED + _IS_POINT * is_point
    edge, face = whole.primitives["edge"], whole.primitives["face"]
    edges = np.empty((len(items["edge"]), _EDGE), dtype=np.int64)
    edges[:, 0], edges[:, 1:3] = edge.numbers[items["edge"]], place[corners["edge"]]
    edges[:, 3] = edge.is_codimensional[items["edge"]]
    faces = np.empty((len(items["face"]), _FACE), dtype=np.int64)
    faces[:, 0], faces[:, 1:] = face.numbers[items["face"]], place[corners["face"]]
    sizes = np.array([len(vertices), len(edges), len(faces)])
    return np.concatenate([sizes, vertices.ravel(), edges.ravel(), faces.ravel()])


def _part_of(whole: DistributedMesh, received: list[NDArray[np.int64]]) -> Part:
    """The part that consists of the primitives of all messages."""
    vertices, edges, faces = [np.zeros((0, _VERTEX), np.int64)], [np.zeros((0, _EDGE), np.int64)], []
    faces.append(np.zeros((0, _FACE), np.int64))
    first = 0
    for message in filter(len, received):
        num_vertices, num_edges, num_faces = message[:3].tolist()
        ends = np.cumsum([3, _VERTEX * num_vertices, _EDGE * num_edges, _FACE * num_faces])
        parts = [message[i:j] for i, j in itertools.pairwise(ends)]
        vertices.append(parts[0].reshape(-1, _VERTEX))
        edge, face = parts[1].reshape(-1, _EDGE).copy(), parts[2].reshape(-1, _FACE).copy()
        edge[:, 1:3] += first
        face[:, 1:] += first
        edges.append(edge)
        faces.append(face)
        first += num_vertices
    table, edge, face = np.concatenate(vertices), np.concatenate(edges), np.concatenate(faces)
    numbers, at, place = np.unique(table[:, 0], return_index=True, return_inverse=True)
    _, ids, owner, bodies, worlds, radius, box_radius, _ = table[at].T.copy()
    flags = np.zeros(len(numbers), dtype=np.int64)
    is_flagged = table[:, -1] > 0
    flags[place[is_flagged]] = table[is_flagged, -1]  # only the owner of a vertex sets any
    # quick, as those of a rank come in order
    edge, face = edge[np.argsort(edge[:, 0], kind="stable")], face[np.argsort(face[:, 0], kind="stable")]
    mesh = part_mesh(
        whole,
        np.empty((len(numbers), whole.dimension)),
        bodies,
        worlds,
        None if whole.radius is None else radius.view(np.float64),
        place[face[:, 1:]].astype(np.int32),
        place[edge[:, 1:3]].astype(np.int32),
        np.flatnonzero(edge[:, 3]).astype(np.int32),
        np.flatnonzero(flags & _IS_POINT).astype(np.int32),
    )
    everything = whole._exchange_to(numbers, owner)
    moving = everything
    if whole.static.any():
        moves = np.flatnonzero(~whole.static[bodies])
        moving = whole._exchange_to(numbers[moves], owner[moves], moves)
    return Part(
        mesh,
        numbers,
        ids,
        edge[:, 0],
        face[:, 0],
        np.flatnonzero(flags & _IS_TESTED).astype(np.int32),
        box_radius.view(np.float64),
        everything,
        moving,
    )


def work_of_owners(plan: Plan, whole: DistributedMesh, work: NDArray[np.float64]) -> NDArray[np.float64]:
    """Work by the vertices that this rank owns, given that by the vertices of its part; collective."""
    result = np.zeros(len(whole.vertex_ids))
    plan.part.everything.back(work, result, np.add)
    return result[whole.owned_rows]
