"""Launches that have nothing to do are left out: of graphs by a flag on the device, on the CPU by the same flag."""

from contextlib import contextmanager
from types import SimpleNamespace

import fine_meshes as scenes
import numpy as np
import pytest
import warp as wp
from hard_cases import FAMILIES
from scenes import pairs_in_worlds

import ccd_warp as ccd
from ccd_warp._input.options import Options
from ccd_warp._runtime import launch
from ccd_warp._runtime.launch import Execution, Recording
from ccd_warp._runtime.packed import PackedLaunch

NAMES = ["toi", "world_toi", "body_toi", "vertex_toi", "flags", "num_pairs"]


def sheet_above_ball(is_static=True):
    """A sheet above a ball: mesh, positions at the start, and a function for those of the sheet pushed down."""
    sheet, faces = scenes.grid(5, 5, 1.0, 1.0)
    ball, ball_faces = scenes.sphere(80, 0.3)
    mesh = ccd.CollisionMesh.from_arrays([(sheet, faces), (ball, ball_faces)], static=[1] if is_static else [])
    start = np.concatenate([sheet + [0.01, 0.02, 0.5], ball])

    def pushed(height):
        end = start.copy()
        end[: len(sheet), 2] -= height
        return end

    return mesh, start, pushed


def on_cpu(positions):
    return wp.array(positions, dtype=wp.vec3d, device="cpu")


def bits_of(result):
    return [getattr(result, name).numpy().tobytes() for name in NAMES]


@contextmanager
def counted(monkeypatch):
    """Count the kernels that are launched."""
    counts = SimpleNamespace(kernels=0)
    parts = PackedLaunch.parts

    def launched(self):
        counts.kernels += 1
        return parts(self)

    with monkeypatch.context() as patch:
        patch.setattr(PackedLaunch, "parts", launched)
        yield counts


@pytest.fixture(params=["all launches", "branches of a graph"])
def left_out(request, monkeypatch):
    """The host takes its path for CUDA: without a capture, and while one is going on.

    The stand-in for ``wp.capture_if`` looks at the flag at once, as a graph does when it is replayed.
    """
    monkeypatch.setattr(Execution, "is_cuda", True)
    taken = []
    if request.param == "branches of a graph":

        def capture_if(condition, on_true):
            taken.append(bool(condition.numpy()[0]))
            if taken[-1]:
                on_true()

        def play_conditional(self, section, group):
            capture_if(group.condition, lambda: self._play_groups(section, group.groups))

        monkeypatch.setattr(Recording, "_play_conditional", play_conditional)
    else:
        monkeypatch.setattr(
            Recording,
            "_play_conditional",
            lambda self, section, group: self._play_groups(section, group.groups),
        )
    return SimpleNamespace(taken=taken, in_graph=request.param == "branches of a graph")


@pytest.mark.parametrize("per", [None, "scene", "body", "vertex"])
@pytest.mark.parametrize("height", [0.1, 1.0])
def test_what_is_left_out_changes_no_bit(per, height, left_out, monkeypatch):
    mesh, start, pushed = sheet_above_ball()

    def run(number):
        pipeline = ccd.CollisionPipeline(mesh, length_scale=1.0)
        for _ in range(number):
            x, wished = on_cpu(start), on_cpu(pushed(height))
            if per is None:
                result = pipeline.launch(x, wished)
            else:
                result = pipeline.launch_line_search(x, wished, per=per)
        return [*bits_of(result), wished.numpy().tobytes()]

    found = run(2)
    monkeypatch.undo()
    assert found == run(2)
    # nothing is moved or open here; passes after the first have something to do only where a contact was found
    has_more_to_do = per is not None and height > 0.5
    expected = {False, True} if has_more_to_do else {False}
    assert set(left_out.taken) == (expected if left_out.in_graph else set())


def test_a_pass_of_a_line_search_that_has_nothing_to_do_is_a_reset(monkeypatch):
    mesh, start, pushed = sheet_above_ball()
    pipeline = ccd.CollisionPipeline(mesh, length_scale=1.0, num_threads=1)
    kernels = []
    for num_rounds in (4, 8):
        for _ in range(2):  # the first call places the ball
            with counted(monkeypatch) as counts:
                pipeline.launch_line_search(on_cpu(start), on_cpu(pushed(0.1)), per="vertex", num_rounds=num_rounds)
        kernels.append(counts.kernels)
    assert kernels[1] - kernels[0] == 4 * 2


def test_a_world_with_a_coordinate_that_is_not_finite_stays_invalid(left_out):
    """Also one that has no moving vertex: no pass after the first finds anything to do."""
    mesh, start, pushed = sheet_above_ball()
    worlds = mesh.replicate(2)
    starts, ends = (np.concatenate([x, x]) for x in (start, pushed(0.1)))
    starts[-1, 0] = np.nan
    pipeline = ccd.CollisionPipeline(worlds, length_scale=1.0)
    result = pipeline.launch_line_search(on_cpu(starts), on_cpu(ends), per="vertex")
    assert result.world_toi.numpy().tolist() == [np.inf, 0.0]
    assert (result.vertex_toi.numpy()[len(start) :] == 0.0).all()


def test_the_second_round_runs_in_a_graph_where_a_pair_is_open():
    """Of needles that cross each other: a graph of the CPU holds the branch."""
    options = {"tolerance": 1e-15, "length_scale": 1.0}
    points = FAMILIES["needle_against_needle"]("edge-edge", 1000, np.random.default_rng(0))
    is_hard = ccd.edge_edge_ccd(*points, **options).iterations > Options().first_iterations
    mesh, start, end = pairs_in_worlds("edge-edge", *(x[is_hard] for x in points))
    expected = bits_of(ccd.CollisionPipeline(mesh, **options).launch(on_cpu(start), on_cpu(end)))
    pipeline = ccd.CollisionPipeline(mesh, **options)
    pipeline.reserve()
    x, y = on_cpu(start), on_cpu(start)
    with wp.ScopedCapture(device="cpu") as capture:
        result = pipeline.launch(x, y)
    for positions, is_open in ((start, False), (end, True)):
        y.assign(positions)
        wp.capture_launch(capture.graph)
        assert bool(result._step._is_open.numpy()[0]) is is_open
    assert bits_of(result) == expected


class FakeDevice(SimpleNamespace):
    """As much of a device as the choice needs."""


@pytest.mark.parametrize(
    ("is_cpu", "is_ours", "is_supported", "expected"),
    [(True, False, False, True), (False, True, True, True), (False, True, False, False), (False, False, True, False)],
)
def test_a_graph_leaves_out_launches_where_warp_captures_it_and_the_driver_can(
    is_cpu, is_ours, is_supported, expected, monkeypatch
):
    """torch captures without Warp, which would then wait for the flag, and a driver before 12.4 has no such nodes."""
    monkeypatch.setattr(wp, "is_conditional_graph_supported", lambda: is_supported)
    device = FakeDevice(is_cpu=is_cpu, stream="stream", captures={"stream": "graph"} if is_ours else {})
    assert launch.leaves_out_launches(device) is expected


@pytest.mark.parametrize("is_set", [0, 1])
def test_a_capture_on_cuda_records_the_branch_and_not_the_launches(is_set, monkeypatch):
    branches = []
    monkeypatch.setattr(wp, "capture_if", lambda condition, on_true: branches.append((condition, on_true)))
    monkeypatch.setattr(launch, "leaves_out_launches", lambda device: True)
    flag = wp.array([is_set], dtype=wp.int32, device="cpu")
    device = SimpleNamespace(is_cuda=True, is_cpu=False, is_capturing=True)
    recording = Recording(Execution(device, 1), {})
    with recording.section("step"), recording.only_if(flag):
        pass
    recording.play("step")
    assert [condition for condition, _ in branches] == [flag]
