"""No result depends on how it is computed: a table of calls and scenes, each in every way that must change no bit.

The ways are threads, memory, the broad phase, what was called before, launches in place of calls on the host, graphs in
place of launches, arrays of Warp in place of NumPy's, the place of a pair among others, and the width of lanes. The
same table is run on the emulated device (`tests/emulated`); ranks are compared in `tests/distributed`.
"""

import hashlib
import os
import subprocess
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import scenes
import warp as wp
from daily import marked
from emulated.comparison import DAILY, PAIR_OPTIONS, PAIRS, PLAN, PRECISIONS
from emulated.steps import STEPS, THICK
from expected_warnings import OF_ROUNDING
from laws import calls
from laws.calls import StepCase
from laws.outputs import different, outputs_of
from pairs import FIELDS, SOLVE, hard_pairs, results

import ccd_warp as ccd

pytestmark = OF_ROUNDING

# Scenes so large that threads share them in many parts, and batches are many.
LARGE = {
    "large crowd": StepCase(lambda: scenes.crowd(np.random.default_rng(9), 1000, 0.035, 0.03), {}, 60_000),
    "three bodies, one static": StepCase(lambda: scenes.three_bodies(4, (300, 100, 200), 0.15, static=[2]), {}, 60_000),
    "all in one place": StepCase(lambda: scenes.all_in_one_place(2), {}, 400_000),
}
CASES = STEPS | THICK | LARGE
_OF_LARGE = [*(("on_the_host", step, "float64") for step in LARGE), ("launches", "large crowd", "float32")]
EVERY = [case for case in PLAN if case[0] not in ("batches", "replays")] + _OF_LARGE
_DAILY = [case for case in EVERY if case in DAILY or case in _OF_LARGE]
every = pytest.mark.parametrize(("call", "step", "precision"), marked(EVERY, _DAILY))


def with_options(case, **options):
    """The same step with other options."""
    return replace(case, options=case.options | options)


@cache
def expected(call, step, precision, **flags):
    """What a call returns on one thread."""
    return getattr(calls, call)(with_options(CASES[step], num_threads=1), precision, **flags)


@every
def test_threads_change_no_bit(call, step, precision):
    found = getattr(calls, call)(with_options(CASES[step], num_threads=8 if step in LARGE else 3), precision)
    assert different(found, expected(call, step, precision)) == []


@every
def test_the_broad_phase_changes_no_bit(call, step, precision):
    other = "tree" if CASES[step].options.get("broad_phase") == "hash" else "hash"
    found = getattr(calls, call)(with_options(CASES[step], broad_phase=other), precision)
    assert different(found, expected(call, step, precision)) == []


@pytest.mark.parametrize(
    ("call", "step", "precision"), marked(EVERY[::2], [case for case in EVERY[::2] if case in _DAILY])
)
def test_earlier_calls_change_no_bit(call, step, precision):
    """The mesh has been used in a step that goes elsewhere and back, and in the same one."""
    case = CASES[step]
    made = case.make()
    case = replace(case, make=lambda: made)
    mesh, start, end = made
    elsewhere = replace(case, make=lambda: (mesh, start + 0.3, scenes.with_static_at_rest(mesh, start + 0.3, end)))
    getattr(calls, call)(elsewhere, precision)
    assert different(getattr(calls, call)(case, precision), expected(call, step, precision)) == []


# Steps whose pairs, worlds, bodies and filters differ, not only their options.
OF_ALL_KINDS = ["crowd", "excluded pairs", "every kind, one body static", "worlds in one place", "half-spaces"]
OF_ALL_KINDS += ["in the plane", "in the plane, one body static", "kinematic bodies", "sheet over a static ball"]


@pytest.mark.parametrize(
    ("step", "broad_phase"),
    [
        *((step, ("tree", "hash")[k % 2]) for k, step in enumerate(OF_ALL_KINDS)),
        *((step, "tree") for step in (*LARGE, "little work", "little work for the bisection")),
        *((step, "hash") for step in ("crowd", "all in one place")),
    ],
)
def test_memory_changes_no_bit(step, broad_phase):
    """Nor the order of candidates."""
    case = with_options(CASES[step], broad_phase=broad_phase)
    enough = calls.batches(with_options(case, num_threads=1), "float64", is_limited=False, with_order=True)
    limited = calls.batches(with_options(case, num_threads=3), "float64", with_order=True)
    assert different(limited, enough) == []


@pytest.mark.parametrize(
    ("step", "precision"),
    [
        *((step, "float64") for step in (*OF_ALL_KINDS, "radii", "contact at the start")),
        *((step, "float32") for step in ("spatial hash", "worlds", "a static giant face")),
    ],
)
def test_a_graph_changes_no_bit(step, precision):
    """Replays with other positions give what launches give."""
    assert different(*(calls.replays(CASES[step], precision, is_captured=k) for k in (True, False))) == []


@pytest.mark.parametrize("step", STEPS)
def test_a_launch_gives_the_bits_of_the_call_on_the_host(step):
    """Also one of displacements, of moving vertices, and of positions in float32."""
    case = CASES[step]
    mesh, start, end = case.make()
    options = {**case.options, "precision": PRECISIONS[list(STEPS).index(step) % 2]}
    pipeline = ccd.CollisionPipeline(mesh, **case.capacities, **options)
    for dtype in (np.float64, np.float32):
        x, moves = start.astype(dtype), (end - start).astype(dtype)
        # what is added on the device is added in float64
        y = (x.astype(float) + moves.astype(float)).astype(dtype)
        vector = calls.VECTORS[np.dtype(dtype).name, x.shape[1]]
        t0, t1, displacements = (wp.array(a, dtype=vector, device="cpu") for a in (x, y, moves))
        rows = (x[mesh.moving_vertices], y[mesh.moving_vertices])
        forms = [((x, y), {}), ((t0, t1), {}), (rows, {}), ((t0,), {"displacements": displacements})]
        for arrays, given in forms:
            ends = x.astype(float) + moves.astype(float) if given else y.astype(float)
            host = outputs_of(ccd.mesh_ccd(mesh, x.astype(float), ends, **options))
            launched = outputs_of(pipeline.launch(*arrays, **given).to_host())
            shared = launched.keys() & host.keys()
            assert {".toi", ".vertex_toi", ".body_toi", ".world_toi", ".contacts.toi", ".contacts.points"} <= shared
            assert different(*({name: each[name] for name in shared} for each in (launched, host))) == []


@pytest.mark.parametrize("step", OF_ALL_KINDS)
def test_launches_at_one_time_give_the_bits_of_the_calls_on_the_host(step):
    """The distance, the static bodies and the type of the positions change from launch to launch."""
    mesh, start, end = CASES[step].make()
    pipeline = ccd.CollisionPipeline(mesh, minimum_distance=0.002, **CASES[step].capacities)
    for x, distance, dtype in ((start, 0.05, "float64"), (end + 0.3, 0.02, "float32"), (start, 0.1, "float32")):
        x = x.astype(dtype)
        array = wp.array(x, dtype=calls.VECTORS[dtype, x.shape[1]], device="cpu")
        near, bounds = pipeline.launch_proximity(array, distance), pipeline.launch_displacement_bounds(array, distance)
        launched = outputs_of(vars(near.to_host())) | outputs_of(bounds.to_host(), "bounds")
        x = x.astype(float)
        host = outputs_of(vars(ccd.find_proximity(mesh, x, distance)))
        host |= outputs_of(ccd.displacement_bounds(mesh, x, distance, minimum_distance=0.002), "bounds")
        assert different(launched, host) == []


# --- pairs ---


@cache
def many_pairs(kind, dimension, seed=0):
    """So many pairs that threads share them."""
    return scenes.random_pairs(kind, 4000, seed, dimension)


every_pair = pytest.mark.parametrize(("kind", "dimension", "options", "precision"), PAIRS)


@every_pair
def test_threads_and_graphs_and_arrays_of_warp_change_no_bit_of_pairs(kind, dimension, options, precision):
    call, given = getattr(ccd, f"{kind}_ccd"), {**PAIR_OPTIONS[options], "precision": precision, "device": "cpu"}
    vector = calls.VECTORS["float64", dimension]
    truth = outputs_of(call(*many_pairs(kind, dimension), num_threads=1, **given))
    assert np.isfinite(truth[".toi"]).sum() > 20
    for num_threads in (2, 3):
        assert different(outputs_of(call(*many_pairs(kind, dimension), num_threads=num_threads, **given)), truth) == []
        arrays = [wp.array(x, dtype=vector, device="cpu") for x in many_pairs(kind, dimension, 1)]
        with wp.ScopedCapture(device="cpu") as capture:
            result = call(*arrays, num_threads=num_threads, **given)
        for array, values in zip(arrays, many_pairs(kind, dimension), strict=True):
            array.assign(values)
        wp.capture_launch(capture.graph)
        assert different(outputs_of(result), truth) == []
        assert different(outputs_of(call(*arrays, num_threads=num_threads, **given)), truth) == []


def assert_equal_bits(found, together, rows):
    for name in FIELDS:
        assert getattr(found, name).tobytes() == getattr(together, name)[rows].tobytes(), name


@pytest.mark.parametrize("precision", PRECISIONS)
def test_the_lane_of_a_pair_and_its_neighbours_change_no_bit(precision):
    rng = np.random.default_rng(1)
    for solve, points, options, together in results(precision):
        count = len(together.toi)
        alone = [[i] for i in range(0, count, 29)]
        for rows in (rng.permutation(count), np.repeat(rng.integers(0, count, 5), 7), np.arange(count - 3), *alone):
            assert_equal_bits(solve(*(x[rows] for x in points), precision=precision, **options), together, rows)


def digest_of_lanes():
    """A hash of the bits of pairs of all kinds and of steps."""
    found = hashlib.sha256()
    for precision in PRECISIONS:
        of_all = [result for *_, result in results(precision)]
        options = {"minimum_distance": 0.05, "start_gap_fraction": 0.5, "precision": precision}
        of_all += [SOLVE[kind](*hard_pairs(kind, 4), **options) for kind in SOLVE]
        for result in of_all:
            for name in FIELDS:
                found.update(np.ascontiguousarray(getattr(result, name)).tobytes())
    for step in ("every kind, one body static", "in the plane"):
        for name, array in sorted(calls.steps(CASES[step], "float64").items()):
            found.update(name.encode() + array.tobytes())
    return found.hexdigest()


# Plain numbers, and vectors of 256 bits compiled for a processor without AVX-512. The default of this machine is the
# other side of the comparison.
@pytest.mark.parametrize(
    ("lanes", "flags"), [("1", None), pytest.param("4", "-target-cpu haswell", marks=pytest.mark.long)]
)
def test_the_width_of_lanes_changes_no_bit(lanes, flags):
    from ccd_warp._runtime.lanes import cpu_lanes

    if flags and cpu_lanes() < 4:
        pytest.skip("this processor has no AVX2")
    script = "import conftest, test_invariance, warp\n"
    script += f"warp.config.cpu_compiler_flags = {flags!r}\n" if flags else ""
    script += "print(test_invariance.digest_of_lanes())"
    folder = Path(__file__).resolve().parent
    environment = {**os.environ, "CCD_WARP_LANES": lanes, "PYTHONPATH": f"{folder.parent}{os.pathsep}{folder}"}
    done = subprocess.run([sys.executable, "-P", "-c", script], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split()[-1] == digest_of_lanes()
