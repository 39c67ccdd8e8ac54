"""Steps that the solver takes for a pair on arcs, by the turn: a kernel of the benchmark around the solver of a pair.

The results of a mesh have no iterations. Here each pair is solved by `arc_solver` alone, slice by slice, from positions
and velocities that NumPy computes; the lanes of the narrow phase take about as many.
"""

from __future__ import annotations

import itertools

import numpy as np
import warp as wp
from ccd_warp.benchmarks.rigid_turns import TURNS, Pairs
from ccd_warp.kernels.pair.norm import ARC_BOX_NORM
from ccd_warp.kernels.pair.query import Options
from ccd_warp.kernels.pair.single_points import points_of
from ccd_warp.kernels.pair.turns import Turns
from ccd_warp.kernels.pair_kind import EDGE_EDGE, VERTEX_FACE
from ccd_warp.kernels.template import specialised

from ccd_warp._input.options import Options as HostOptions

solver = specialised("pair.arc_solver", norm=ARC_BOX_NORM, real=wp.float64)
solve_on_arcs = solver.solve_on_arcs
# Turn of a slice, as in a step of a mesh.
_SLICE = 0.2

wp.set_module_options({"enable_backward": False, "fuse_fp": False})


@wp.kernel
def solve_in_slice(
    # in
    kind: int,
    options: Options,
    vertices_t0: wp.array[wp.vec3d],
    vertices_t1: wp.array[wp.vec3d],
    # out
    toi: wp.array[wp.float64],
    iterations: wp.array[wp.int32],
):
    """Solve the pairs, of four vertices and two bodies each, that no slice before has ended."""
    k = wp.tid()
    if toi[k] < wp.float64(wp.inf):
        return
    i = 4 * k
    first = wp.vec3i(i, i, i)
    second = wp.vec3i(i + 1, i + 2, i + 3)
    if kind == EDGE_EDGE:
        first = wp.vec3i(i, i + 1, i + 1)
        second = wp.vec3i(i + 2, i + 3, i + 3)
    a = points_of(kind, first, second, vertices_t0)
    b = points_of(kind, first, second, vertices_t1)
    begin = options.turns.t_begin
    outcome = solve_on_arcs(kind, first, second, begin, 0, a, b, options, options.max_iterations)
    toi[k] = outcome.toi
    iterations[k] += outcome.iterations


def iterations_of(pairs: Pairs) -> tuple[np.ndarray, np.ndarray]:
    """The toi and the number of steps of each pair."""
    count = len(pairs.poses)
    toi = wp.full(count, np.inf, dtype=wp.float64, device="cpu")
    iterations = wp.zeros(count, dtype=wp.int32, device="cpu")
    turn = np.linalg.norm(pairs.twist[..., 3:], axis=-1).max()
    ends = np.linspace(0.0, 1.0, max(1, int(np.ceil(turn / _SLICE))) + 1)
    stop = wp.zeros(1, dtype=wp.int32, device="cpu")
    kind = VERTEX_FACE if pairs.kind == "vertex-face" else EDGE_EDGE
    sizes = [len(body) for body in pairs.parts]
    bodies = 2 * np.arange(count)[:, None] + np.repeat([0, 1], sizes)
    for begin, end in itertools.pairwise(ends):
        turns = Turns()
        turns.t_begin, turns.t_length = begin, end - begin
        spin = (end - begin) * pairs.twist[..., 3:]
        start, last = pairs.positions_at(begin), pairs.positions_at(end)
        pivots = pairs.poses[..., :3] + begin * pairs.twist[..., :3]
        velocity = np.cross(np.repeat(spin, sizes, axis=1), start - np.repeat(pivots, sizes, axis=1))
        turns.omega = wp.array(pairs.twist[..., 3:].reshape(-1, 3), dtype=wp.vec3d, device="cpu")
        turns.velocity = wp.array(velocity.reshape(-1, 3), dtype=wp.vec3d, device="cpu")
        turns.slack = wp.full(velocity.size // 3, 1e-14 * (1.0 + turn), dtype=wp.float64, device="cpu")
        turns.vertex_body = wp.array(bodies.ravel(), dtype=wp.int32, device="cpu")
        options = HostOptions().for_kernel(None, stop=stop, turns=turns)
        positions = [wp.array(x.reshape(-1, 3), dtype=wp.vec3d, device="cpu") for x in (start, last)]
        wp.launch(
            solve_in_slice, count, inputs=[int(kind), options, *positions], outputs=[toi, iterations], device="cpu"
        )
    return toi.numpy(), iterations.numpy()


def measure(kind: str, count: int, turns: tuple[float, ...] = TURNS) -> list[dict]:
    """A row for each turn: steps of a pair in the mean and of the slowest, of free ones and of those that touch."""
    rows = []
    for turn in turns:
        toi, steps = iterations_of(Pairs.random(kind, turn, count))
        row: dict = {"turn": turn}
        for name, which in (("free", toi == np.inf), ("hit", toi < np.inf)):
            row[name] = {"pairs": int(which.sum()), "mean": float(steps[which].mean()), "most": int(steps[which].max())}
        rows.append(row)
    return rows
