"""The narrow phase of CUDA, three kernels with a queue between them: here the CPU runs its kernels."""

import numpy as np
import pytest
import warp as wp
from distance_queries import SOLVE
from hard_cases import FAMILIES

from ccd_warp._runtime.launch import Execution

FIELDS = ["toi", "status", "parameters", "gap", "width", "iterations"]
OPTIONS = [{}, {"minimum_separation": 1e-3}, {"minimum_separation": 1e-2, "start_gap_fraction": 0.3}, {"t_max": 0.6}]

# A limit below the first rounds, within the later ones, and within the solver for single pairs; and boxes of bisection.
LIMITS = [{}, {"max_iterations": 1}, {"max_iterations": 5}, {"max_iterations": 14}]
LIMITS += [{"method": "bisection", "max_iterations": 300}]


def sets_of_pairs():
    """Kinds and pairs of all kinds, some of every family of hard cases, and points so close that separations matter."""
    for kind in ("vertex-face", "edge-edge"):
        families = [family(kind, 8, np.random.default_rng(5)) for family in FAMILIES.values()]
        yield kind, [np.concatenate(frames) for frames in zip(*families, strict=True)]
    for kind, corners in (("point-segment", 3), ("point-point", 2)):
        start, noise = np.random.default_rng(3).standard_normal((2, 300, corners, 3))
        yield kind, (start, noise * 0.1 - start)


@pytest.mark.parametrize("limit", LIMITS)
def test_pairs_through_the_queue_get_equal_bits(precision, limit, monkeypatch):
    cases = [(SOLVE[kind], points, given) for kind, points in sets_of_pairs() for given in OPTIONS]
    cases = [(*case, {"precision": precision, **given, **limit}) for *case, given in cases[:: 3 if limit else 1]]
    expected = [solve(*points, **options) for solve, points, options in cases]
    monkeypatch.setattr(Execution, "is_cuda", True)  # the host takes its path for CUDA
    for (solve, points, options), truth in zip(cases, expected, strict=True):
        # arrays of Warp: few pairs of NumPy arrays have a launch of their own
        found = solve(*(wp.array(x, dtype=wp.vec3d, device="cpu") for x in points), **options)
        for name in FIELDS:
            assert getattr(found, name).numpy().tobytes() == getattr(truth, name).tobytes(), name


def test_threads_get_few_pairs_spread_over_all_warps():
    from ccd_warp.kernels.narrow_phase.queued_pairs import items_of

    @wp.kernel(module="unique", enable_backward=False)
    def take(num_solvers: int, count: int, taken: wp.array[wp.int32], lanes_used: wp.array[wp.int32]):
        items = items_of(wp.tid(), num_solvers, count, False)
        lanes_used[0] = items.stride / (num_solvers / 32)
        following = items.first
        while following < count:
            wp.atomic_add(taken, following, 1)
            following += items.stride

    for num_solvers, count, lanes in (
        *((128, count, lanes) for count, lanes in ((0, 0), (3, 1), (5, 2), (127, 32), (1000, 32))),
        (32, 40, 32),
    ):
        taken, used = (wp.zeros(n, dtype=wp.int32, device="cpu") for n in (max(count, 1), 1))
        wp.launch(take, dim=num_solvers, inputs=[num_solvers, count], outputs=[taken, used], device="cpu")
        assert np.array_equal(taken.numpy()[:count], np.ones(count)) and used.numpy()[0] == lanes
