"""Bodies whose boxes meet: the same search, among one box a body."""

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._engine.search import PairSearch, tree_pairs_of
from ccd_warp._engine.workspace import Workspace
from ccd_warp._runtime.launch import Execution
from ccd_warp._status import PairKind

_MOST_PAIRS = 1 << 24  # at a time


def bodies_near(
    workspace: Workspace, host: tuple[NDArray[np.float64], NDArray[np.float64]], inflation: float, execution: Execution
) -> NDArray[np.bool_]:
    """Bodies that may collide with themselves or whose swept box meets that of another they may collide with.

    A mesh of points, one a body, that move from the lower to the upper corner of the body's box: their swept boxes are
    those of the bodies.
    """
    mesh = workspace.topology.mesh
    first = mesh.body_vertex_range[:-1].astype(np.int64)
    filled = np.flatnonzero(np.diff(mesh.body_vertex_range))
    lower, upper = np.zeros((2, mesh.num_bodies, 3))
    if len(filled):
        lower[filled] = np.minimum.reduceat(np.minimum(*host), first[filled], axis=0)
        upper[filled] = np.maximum.reduceat(np.maximum(*host), first[filled], axis=0)
    hull = workspace.body_hull()
    vertices_t0: wp.array = wp.array(lower, dtype=wp.vec3d, device=execution.device, copy=False)
    vertices_t1: wp.array = wp.array(upper, dtype=wp.vec3d, device=execution.device, copy=False)
    hull.boxes.begin((lower, upper), vertices_t0, vertices_t1, 1.0, inflation, execution, num_aabbs=1)
    search = PairSearch(
        hull.boxes,
        execution,
        hull.buffers,
        with_cull=False,
        t_end=1.0,
        separation=0.0,
        largest_capacity=max(_MOST_PAIRS, execution.num_threads * mesh.num_bodies),
    )
    near = mesh.self_collision & ~mesh.static
    for batch in search.batches(tree_pairs_of(hull.boxes, (PairKind.POINT_POINT,), skip_moving=False)):
        for found in batch:
            keys = found.keys[found.begin : found.begin + found.count].numpy()
            a, b = keys >> 32, keys & 0xFFFFFFFF
            one_moves = ~(mesh.static[a] & mesh.static[b])
            near[a[one_moves]] = near[b[one_moves]] = True
    return near
