"""What laws do not reach of the CUDA side: lists that are too short, counts beyond 32 bits, races, whole warps, blocks.

`laws/test_other_ways.py` compares all calls on the emulated device with those on the CPU.
"""

import os
import subprocess
import sys
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
import warp as wp
from ccd_warp.kernels.step.minima import CANDIDATES
from expected_warnings import OF_ROUNDING
from hard_cases import FAMILIES
from helpers import clock
from laws.calls import on_device
from laws.outputs import different, kept_outputs, outputs_of
from scenes import crowd, pairs_in_worlds, soup

import ccd_warp as ccd
from ccd_warp._engine import stages
from ccd_warp._engine.mesh import topology
from emulated import MARKS
from emulated.build import sanitizer_library
from emulated.device import MULTIPROCESSORS, Emulation, emulation

pytestmark = [*MARKS, OF_ROUNDING]


def assert_equal_on_both(case, call, num_multiprocessors=4):
    """What a call returns on the CPU and on the emulated device is equal in every bit; returns it."""
    expected = kept_outputs(case, call)
    with emulation(num_multiprocessors=num_multiprocessors):
        found = call()
    assert different(found, expected) == []
    return expected


def test_contacts_beyond_the_capacity_are_missing_from_the_list_alone():
    def contacts(max_contacts):
        mesh, start, end = crowd(np.random.default_rng(43), 40, 0.15)
        result = ccd.CollisionPipeline(mesh, max_contacts=max_contacts).launch(on_device(start), on_device(end))
        stored = outputs_of(result.contacts.to_host()).values()
        return outputs_of(result), [tuple(map(bytes, row)) for row in zip(*stored, strict=True)]

    truth, everything = kept_outputs("contacts", lambda: contacts(10_000))
    with emulation(num_multiprocessors=MULTIPROCESSORS):
        found, stored = contacts(5)
    names = [".toi", ".vertex_toi", ".body_toi", ".world_toi", ".num_pairs", ".contacts.count"]
    assert different(*({name: each[name] for name in names} for each in (found, truth))) == []
    assert found[".flags"] == ccd.LaunchFlag.CONTACTS_OVERFLOW
    assert len(set(stored)) == len(stored) == 5 and set(stored) <= set(everything)


@pytest.mark.parametrize("broad_phase", ["tree", "hash"])
def test_searches_culls_and_solvers_do_not_race(broad_phase):
    """Contacts of a scene in which every write of these to memory is looked at."""
    mesh, start, end = crowd(np.random.default_rng(44), 40, 0.2)
    with emulation(Emulation(watches_all=True)):
        pipeline = ccd.CollisionPipeline(mesh, precision="float32", broad_phase=broad_phase)
        result = pipeline.launch(on_device(start), on_device(end))
    assert result.contacts.count.numpy()[0] > 10


@pytest.mark.parametrize("distance", [0.0, 1e-3])
def test_needles_that_cross_at_many_speeds(distance):
    """Each is solved by a whole warp, as it takes long; with a distance nothing is shared but the stack."""
    options = {"tolerance": 1e-15, "length_scale": 1.0, "minimum_distance": distance}
    start, end = FAMILIES["needle_against_needle"]("edge-edge", 400, np.random.default_rng(0))
    solved = kept_outputs(("hardest", distance), lambda: outputs_of(ccd.edge_edge_ccd(start, end, **options)))
    hardest = np.argmax(solved[".iterations"] * np.isfinite(solved[".toi"]))

    def step():
        speeds = np.random.default_rng(5).permutation(np.linspace(0.5, 1, 8))[:, None, None]
        x = np.repeat(start[hardest : hardest + 1], 8, axis=0)
        y = x + speeds * (end[hardest] - x)
        return outputs_of(ccd.mesh_ccd(*pairs_in_worlds("edge-edge", x, y), **options))

    assert np.isfinite(assert_equal_on_both(("needles", distance), step)[".world_toi"]).sum() > 4


@pytest.mark.parametrize("count", [15, 16, 17, 31, 32, 33, 47, 48, 49, 255, 256, 257])
def test_searches_of_so_many_boxes(count):
    """As many faces as places in some blocks, one more, and one less; each overlaps its neighbours in the order."""

    def search():
        mesh, start, end = crowd(np.random.default_rng(count), count, 0.12 * (40 / count) ** (1 / 3), 0.05)
        return outputs_of(ccd.CollisionPipeline(mesh, max_pairs=9000).launch(on_device(start), on_device(end)))

    assert_equal_on_both(("boxes", count), search)


def test_replays_with_lists_too_short_for_the_candidates(monkeypatch):
    """What does not fit is culled in a branch of the graph, which a replay may take or not."""
    monkeypatch.setattr("ccd_warp._engine.device.step.CANDIDATES_EACH", 1)  # a place for each pair, not four
    start, end = crowd(np.random.default_rng(43), 60, 0.25, 0.3)[1:]

    def replays():
        mesh = crowd(np.random.default_rng(43), 60, 0.25)[0]
        counts = ccd.CollisionPipeline(mesh)
        counts.mesh_ccd(start, end)
        most = max(counts.counts.num_after_cull.values())
        assert max(counts.counts.num_candidates.values()) > most
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

    assert_equal_on_both("short lists", replays)


@wp.kernel(enable_backward=False, module="unique")
def count_from(begin: int, count: wp.int64, counts: wp.array2d[wp.int64]):
    counts[begin + wp.tid(), CANDIDATES] = count


@pytest.mark.parametrize("worth_sampling", [1 << 14, 1])
def test_triangles_that_change_places_are_sorted_in_the_call_after_that_in_which_they_have(worth_sampling, monkeypatch):
    """Contacts are those of the CPU in each step: before it is known that an order is bad, with a new one, later."""
    monkeypatch.setattr(topology, "WORTH_SAMPLING", worth_sampling)
    rng, count = np.random.default_rng(50), 1500
    mesh = ccd.CollisionMesh.from_arrays([soup(rng, count, 0.02)])
    motion, places = 0.01 * rng.standard_normal(mesh.vertices.shape), np.arange(3 * count).reshape(-1, 3)
    shuffled = mesh.vertices[rng.permutation(places).ravel()]

    def steps(pipeline):
        for start in (shuffled, shuffled, mesh.vertices, mesh.vertices, shuffled):
            least = pipeline.collision_free_step(start, start + motion)
            num_sorted = pipeline.counts.num_sorted_sets
            result = pipeline.mesh_ccd(start, start + motion)
            yield {**outputs_of(result.contacts), "least": np.array(least)}, (num_sorted, result.counts.num_sorted_sets)

    expected, _ = zip(*steps(ccd.CollisionPipeline(mesh)), strict=True)
    with emulation():
        found, num_sorted = zip(*steps(ccd.CollisionPipeline(mesh)), strict=True)
    assert num_sorted == ((3, 0), (0, 0), (0, 3), (0, 0), (0, 3))
    for outputs, of_cpu in zip(found, expected, strict=True):
        assert different(outputs, of_cpu) == []
        assert len(outputs[".toi"]) > 100


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
        mesh, start, end = crowd(np.random.default_rng(43), 150, 0.1)
        return outputs_of(ccd.CollisionPipeline(mesh).launch(on_device(start), on_device(end)))

    assert 0 < assert_equal_on_both("many candidates", launch)[".toi"][0] < 1


@pytest.mark.parametrize(
    ("ground", "self_collision", "most"),
    [([], True, (2, 1)), ([], False, (3, 2)), ([ccd.HalfSpace([0, 0, 0.1], [0.1, 0, 2])], True, (2, 1))],
)
def test_counters_of_all_kinds_are_read_at_once(ground, self_collision, most):
    """The counts and every toi, and then the contacts, each after all launches, and which bodies were near others."""
    _, start, end = crowd(np.random.default_rng(43), 60, 0.15)
    bodies = [(x, np.arange(len(x)).reshape(-1, 3)) for x in np.split(start, 4)]
    mesh = ccd.CollisionMesh.from_arrays([*bodies, *ground], self_collision=[self_collision] * 4 + [True] * len(ground))

    def counted(array):
        caller = sys._getframe(1)
        if caller.f_globals.get("__name__", "").startswith("ccd_warp"):
            readers.append(caller.f_code.co_qualname)
        return numpy(array)

    with emulation():
        pipeline = ccd.CollisionPipeline(mesh)
        for name, expected in zip(("mesh_ccd", "collision_free_step"), most, strict=True):
            getattr(pipeline, name)(start, end)  # the first one enlarges what is too small, and looks again
            numpy, readers = wp.array.numpy, []
            with mock.patch.object(wp.array, "numpy", counted):
                getattr(pipeline, name)(start, end)
            assert 0 < len(readers) <= expected, readers


@pytest.mark.long
def test_no_access_out_of_bounds():
    """Calls under AddressSanitizer, in a process that loads it first; what Python itself never frees is no matter."""
    environment = {**os.environ, "LD_PRELOAD": sanitizer_library(), "ASAN_OPTIONS": "detect_leaks=0"}
    laws = Path(__file__).resolve().parents[1] / "laws" / "test_other_ways.py"
    chosen = ["-m", "emulated", "-k", "test_the_device_changes_no_bit and not levels and not needles"]
    run = clock.stands_still(subprocess.run)  # while its own clock goes
    done = run(
        [sys.executable, "-m", "pytest", "-q", "-x", laws, *chosen], env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, (done.stdout + done.stderr)[-6000:]
