"""The CUDA side of the library, run without a GPU: every call gives on an emulated device what it gives on the CPU.

`tests/emulated` compiles the CUDA source that Warp generates with the C++ compiler and runs it on threads of the CPU,
in scrambled order, and the host takes its path for CUDA. Arrays are compared in every bit.
"""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import scenes
import warp as wp
from ccd_warp.kernels.step.minima import CANDIDATES
from daily import marked
from expected_warnings import OF_ROUNDING
from hard_cases import FAMILIES
from launches import host, on_device
from laws.outputs import different, outputs_of

import ccd_warp as ccd
from ccd_warp._engine import stages
from emulated.build import compiler
from emulated.comparison import DAILY, PAIRS, PLAN, answer_of_cpu, shared
from emulated.device import MULTIPROCESSORS, Emulation, emulation

pytestmark = [
    pytest.mark.skipif(compiler() is None, reason="no C++ compiler found: apt-get install g++, or set CXX"),
    OF_ROUNDING,
]


@pytest.fixture(scope="module", autouse=True)
def sanitized(request, tmp_path_factory):
    """The pass with AddressSanitizer, if it is asked for, and where it writes; it runs beside the other tests."""
    if not any(item.function is test_no_access_out_of_bounds for item in request.session.items):
        yield None
        return
    from emulated.sanitized import environment

    script = Path(__file__).with_name("sanitized.py")
    output = tmp_path_factory.mktemp("sanitized") / "output.txt"
    with output.open("w") as file:
        process = subprocess.Popen([sys.executable, script], env=environment(), stdout=file, stderr=subprocess.STDOUT)
    yield process, output
    process.kill()
    process.wait()


def on_both(call):
    """What a call returns on the CPU and on the emulated device, with as many threads as on a large one."""
    expected = call()
    shared().build()
    with emulation(shared().emulated, MULTIPROCESSORS):
        return expected, call()


@pytest.mark.parametrize(("call", "step", "precision"), marked(PLAN, DAILY))
def test_calls_on_a_step_return_the_bits_of_the_cpu(call, step, precision):
    assert shared().of_step(call, step, precision) == []


@pytest.mark.parametrize(("kind", "dimension", "options", "precision"), PAIRS)
def test_pair_functions_return_the_bits_of_the_cpu(kind, dimension, options, precision):
    assert shared().of_pairs(kind, dimension, options, precision) == []


def test_every_kernel_for_cuda_is_run():
    """Otherwise a kernel would be missed above; what is not run yet, when this test runs alone, is run now."""
    assert shared().of_every_kernel() == []
    assert shared().not_run() == []


@pytest.mark.parametrize("max_pairs", [1, 37, 300])
def test_pairs_beyond_the_capacity_stop_the_scene(max_pairs):
    """Which pairs find a place depends on the order of threads, and with it whose toi is 0; nothing is late."""

    def launch():
        _, mesh, start, end = scenes.cloth_and_ball_in_worlds(4)
        pipeline = ccd.CollisionPipeline(mesh, max_pairs=max_pairs)
        return pipeline.launch(*(on_device(x.reshape(-1, 3)) for x in (start, end))), mesh, start, end

    (expected, *_), (result, mesh, start, end) = on_both(launch)
    truth = ccd.mesh_ccd(mesh.replicate(1), start.reshape(-1, 3), end.reshape(-1, 3))
    ours, theirs = host(result), host(expected)
    assert ours["flags"] == theirs["flags"] == ccd.LaunchFlag.PAIRS_OVERFLOW
    assert ours["toi"] == theirs["toi"] == 0
    assert np.array_equal(result.num_pairs.numpy(), expected.num_pairs.numpy())
    for name in ("vertex_toi", "body_toi", "world_toi"):
        assert (ours[name] <= getattr(truth, name)).all()
    stopped = ours["world_flags"] == ccd.LaunchFlag.PAIRS_OVERFLOW
    assert stopped.any() and (ours["world_toi"][stopped] == 0).all()
    assert np.array_equal(ours["world_toi"][~stopped], truth.world_toi[~stopped])


def test_contacts_beyond_the_capacity_are_missing_from_the_list_alone():
    def launch(max_contacts=5):
        mesh, start, end = scenes.sheet_over_ball()
        return ccd.CollisionPipeline(mesh, max_contacts=max_contacts).launch(on_device(start), on_device(end))

    expected, result = on_both(launch)
    ours, theirs = host(result), host(expected)
    for name in ours:
        assert np.array_equal(ours[name], theirs[name])
    assert ours["flags"] == ccd.LaunchFlag.CONTACTS_OVERFLOW
    everything = {tuple(map(bytes, row)) for row in rows_of(launch(10_000).contacts.to_host())}
    stored = [tuple(map(bytes, row)) for row in rows_of(result.contacts.to_host())]
    assert len(set(stored)) == len(stored) == 5 and set(stored) <= everything


def rows_of(contacts):
    """The fields of each contact."""
    return zip(*vars(contacts).values(), strict=True)


# Of a launch and of line searches of every kind.
_WITHOUT_NUMBERS = [
    (per, dtype, "tree") for per in (None, "scene", "world", "body", "vertex") for dtype in (wp.vec3d, wp.vec3f)
]


@pytest.mark.parametrize(
    ("per", "dtype", "broad_phase"),
    [(None, wp.vec3d, "hash"), *marked(_WITHOUT_NUMBERS, [*_WITHOUT_NUMBERS[::4], *_WITHOUT_NUMBERS[3::4]])],
)
def test_coordinate_that_is_no_number_stops_its_world(per, dtype, broad_phase):
    def launch():
        _, mesh, start, end = scenes.cloth_and_ball_in_worlds(5)
        start, end = start.reshape(-1, 3).copy(), end.reshape(-1, 3).copy()
        count = mesh.num_vertices // 5
        end[3, 1], start[count + 1, 0], start[2 * count - 1, 2] = np.nan, np.inf, -np.inf
        if broad_phase == "hash":  # boxes in no bucket come after all others
            end[: 2 * count, 1] = np.nan
        pipeline = ccd.CollisionPipeline(mesh, broad_phase=broad_phase)
        t0, t1 = (on_device(x, dtype=dtype) for x in (start, end))
        result = pipeline.launch(t0, t1) if per is None else pipeline.launch_line_search(t0, t1, per=per)
        return outputs_of(result, "result") | outputs_of(t1, "positions")

    expected, found = on_both(launch)
    assert different(found, expected) == []
    assert (found["result.world_flags"][:2] & ccd.LaunchFlag.INVALID_INPUT).all()
    assert (found["result.world_toi"][:2] == 0).all()


def test_steps_of_a_pipeline_whose_capacities_grow():
    """Each step finds more pairs than the one before, and searches again."""

    def steps():
        mesh, start, end = scenes.crowd(np.random.default_rng(41), 150, 0.05)
        pipeline = ccd.CollisionPipeline(mesh)
        found = {}
        for k, share in enumerate((0.05, 1.0, 4.0, 0.5)):
            result = pipeline.mesh_ccd(start, start + share * (end - start))
            found |= outputs_of(result, f"step {k}")
        return found

    expected, found = on_both(steps)
    assert different(found, expected) == []


def arrays_on_both(case, call):
    """The arrays that a call returns on the CPU and on the emulated device."""
    expected = answer_of_cpu(case, call)
    shared().build()
    with emulation(shared().emulated):
        return expected, call()


@pytest.mark.parametrize("broad_phase", ["tree", "hash"])
def test_searches_culls_and_solvers_do_not_race(broad_phase):
    """Contacts of a scene in which every write of these to memory is looked at."""
    mesh, start, end = scenes.crowd(np.random.default_rng(44), 40, 0.2)
    with emulation(Emulation(watches_all=True)):
        pipeline = ccd.CollisionPipeline(mesh, precision="float32", broad_phase=broad_phase)
        result = pipeline.launch(on_device(start), on_device(end))
    assert result.contacts.count.numpy()[0] > 10


def test_needles_that_cross_at_many_speeds():
    """Each is solved by a whole warp, as it takes long."""

    def step():
        options = {"tolerance": 1e-15, "length_scale": 1.0}
        start, end = FAMILIES["needle_against_needle"]("edge-edge", 400, np.random.default_rng(0))
        solved = ccd.edge_edge_ccd(start, end, **options)
        hardest = np.argmax(solved.iterations * np.isfinite(solved.toi))
        speeds = np.random.default_rng(5).permutation(np.linspace(0.5, 1, 8))[:, None, None]
        start = np.repeat(start[hardest : hardest + 1], 8, axis=0)
        mesh, start, end = scenes.pairs_in_worlds("edge-edge", start, start + speeds * (end[hardest] - start[0]))
        return outputs_of(ccd.mesh_ccd(mesh, start, end, **options), "mesh_ccd")

    expected, found = arrays_on_both("needles at many speeds", step)
    assert different(found, expected) == []


@pytest.mark.parametrize("count", [15, 16, 17, 31, 32, 33, 47, 48, 49, 255, 256, 257])
def test_searches_of_so_many_boxes(count):
    """As many faces as places in some blocks, one more, and one less; each overlaps its neighbours in the order."""

    def search():
        start, faces = scenes.soup(np.random.default_rng(count), count, 0.12, spread=(count / 40) ** (1 / 3))
        mesh = scenes.single(start, faces)
        end = start + 0.05 * np.random.default_rng(3).standard_normal(start.shape)
        result = ccd.CollisionPipeline(mesh, max_pairs=9000).launch(on_device(start), on_device(end))
        return outputs_of(result, "launch")

    expected, found = arrays_on_both(("boxes", count), search)
    assert different(found, expected) == []


def with_short_lists(monkeypatch):
    """A candidate has a place for each pair, not four; returns a scene whose candidates are more, and its pairs."""
    monkeypatch.setattr("ccd_warp._engine.device.step.CANDIDATES_EACH", 1)
    mesh, start, end = scenes.crowd(np.random.default_rng(43), 60, 0.25, 0.3)
    result = ccd.mesh_ccd(mesh, start, end)
    most = max(result.counts.num_after_cull.values())
    assert max(result.counts.num_candidates.values()) > most
    return mesh, start, end, most


def test_replays_with_lists_too_short_for_the_candidates(monkeypatch):
    """What does not fit is culled in a branch of the graph, which a replay may take or not."""

    def replays():
        mesh, start, end, most = with_short_lists(monkeypatch)
        mesh = scenes.single(start, mesh.faces)
        pipeline = ccd.CollisionPipeline(mesh, max_pairs=most)
        t0, t1 = on_device(start), on_device(end)
        pipeline.launch(t0, t1)
        with wp.ScopedCapture(device="cpu") as capture:
            result = pipeline.launch(t0, t1)
        found = {}
        for share in (0.0, 1.0, 0.1, 0.9):
            t1.assign(start + share * (end - start))
            wp.capture_launch(capture.graph)
            found |= outputs_of(result, f"replay {share}")
        assert found["replay 1.0.flags"][0] == 0 and np.isfinite(found["replay 1.0.toi"][0])
        return found

    expected, found = arrays_on_both("short lists", replays)
    assert different(found, expected) == []


@wp.kernel(enable_backward=False, module="unique")
def count_from(begin: int, count: wp.int64, counts: wp.array2d[wp.int64]):
    counts[begin + wp.tid(), CANDIDATES] = count


@pytest.mark.parametrize("first", [1 << 31, 1 << 32])
def test_more_candidates_than_32_bits_count(first, monkeypatch):
    """Their count begins there, as after so many: none finds a place, and a second search culls them all."""
    reset = stages.Stages.reset

    def reset_to_many(self, launcher, *arguments, **options):
        reset(self, launcher, *arguments, **options)
        if launcher.is_cuda:
            counts = self.step.counts
            launcher.launch(count_from, len(counts), inputs=[first], outputs=[counts])

    monkeypatch.setattr(stages.Stages, "reset", reset_to_many)

    def launch():
        mesh, start, end = scenes.crowd(np.random.default_rng(43), 150, 0.1)
        return outputs_of(ccd.CollisionPipeline(mesh).launch(on_device(start), on_device(end)), "launch")

    expected, found = arrays_on_both("many candidates", launch)
    assert 0 < expected["launch.toi"][0] < 1
    assert different(found, expected) == []


@pytest.mark.long
def test_no_access_out_of_bounds(sanitized):
    """One pass with AddressSanitizer, in a process of its own that loads it first."""
    process, output = sanitized
    assert process.wait() == 0, output.read_text()[-6000:]
