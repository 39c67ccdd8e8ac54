"""The narrow phase of CUDA, three kernels with a queue between them, gives the answers of the CPU in every bit.

Here the CPU runs its kernels; `tests/emulated` runs their CUDA source.
"""

import numpy as np
import pytest
import warp as wp
from pairs import FIELDS, results
from scenes import crowd

import ccd_warp as ccd
from ccd_warp._runtime.launch import Execution


@pytest.fixture
def as_on_cuda(monkeypatch):
    """A function after which the host takes its path for CUDA."""
    return lambda: monkeypatch.setattr(Execution, "is_cuda", True)


def assert_equal_bits(found, expected):
    for name in FIELDS:
        of_found, of_expected = (np.asarray(getattr(x, name)) for x in (found, expected))
        assert of_found.tobytes() == of_expected.tobytes(), name


def on_device(points):
    """Arrays of Warp: few pairs of NumPy arrays have a launch of their own."""
    return [wp.array(x, dtype=wp.vec3d, device="cpu") for x in points]


def as_numpy(result):
    return type(result)(*(getattr(result, name).numpy() for name in FIELDS))


# A limit below the first rounds, within the later ones, and within the solver for single pairs.
LIMITS = [{"max_iterations": n} for n in (1, 5, 14)]


def test_pairs_through_the_queue_get_equal_bits(precision, as_on_cuda):
    cases = list(results(precision, each=8))
    for limit in LIMITS:
        for solve, points, options, _ in cases[: len(cases) : 3]:
            few = {**options, **limit}
            cases.append((solve, points, few, solve(*points, precision=precision, **few)))
    as_on_cuda()
    for solve, points, options, expected in cases:
        assert_equal_bits(as_numpy(solve(*on_device(points), precision=precision, **options)), expected)


def test_boxes_of_the_bisection_go_through_the_queue(as_on_cuda):
    solve, points, _, _ = next(iter(results("float64", each=2)))
    expected = solve(*points, method="bisection", max_iterations=300)
    as_on_cuda()
    assert_equal_bits(as_numpy(solve(*on_device(points), method="bisection", max_iterations=300)), expected)


@pytest.mark.parametrize(
    "options", [{}, {"minimum_separation": 1e-2}, {"max_iterations": 12, "minimum_separation": 1e-3}, {"t_max": 0.4}]
)
def test_contacts_of_a_mesh_through_the_queue_have_equal_bits(options, precision, as_on_cuda):
    mesh, start, end = crowd(np.random.default_rng(3), 60, 0.1)
    expected = ccd.mesh_ccd(mesh, start, end, precision=precision, **options)
    step = ccd.collision_free_step(mesh, start, end, precision=precision, **options)
    assert len(expected.contacts) > 0
    as_on_cuda()
    other = ccd.CollisionMesh.from_arrays([(start, mesh.faces)])
    found = ccd.mesh_ccd(other, start, end, precision=precision, **options)
    assert found.toi == expected.toi and found.vertex_toi.tobytes() == expected.vertex_toi.tobytes()
    for name in ("kind", "primitives", "toi", "status", "parameters", "gap", "width", "normal"):
        of_found, of_expected = (np.asarray(getattr(x.contacts, name)) for x in (found, expected))
        assert of_found.tobytes() == of_expected.tobytes(), name
    assert ccd.collision_free_step(other, start, end, precision=precision, **options) == step


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
        (128, 0, 0),
        (128, 3, 1),
        (128, 5, 2),
        (128, 127, 32),
        (128, 1000, 32),
        (32, 40, 32),
    ):
        taken, used = wp.zeros(max(count, 1), dtype=wp.int32, device="cpu"), wp.zeros(1, dtype=wp.int32, device="cpu")
        wp.launch(take, dim=num_solvers, inputs=[num_solvers, count], outputs=[taken, used], device="cpu")
        assert taken.numpy()[:count].tolist() == [1] * count and used.numpy()[0] == lanes
