"""Steps whose input and results stay on the device: capacities, captures, what is read when, and what is left out."""

import gc
import weakref
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
import warp as wp
from expected_warnings import OF_ROUNDING
from laws.calls import on_device
from laws.outputs import assert_shared_bits
from scenes import falling, named_cloth_and_ball

import ccd_warp as ccd
from ccd_warp import LaunchFlag
from ccd_warp._runtime.launch import Execution, Recording, leaves_out_launches

pytestmark = OF_ROUNDING


def check_same(result, expected):
    """A launch says what the call on the host says, bit by bit."""
    assert result.to_host().flags == 0
    assert_shared_bits(result.to_host(), expected, ".toi", ".vertex_toi", ".body_toi", ".contacts.points")


# --- capacities ---


def test_capacities_for_which_there_is_no_memory_are_named_and_the_pipeline_goes_on(monkeypatch):
    mesh, start, end = falling()
    pipeline, empty = ccd.CollisionPipeline(mesh), wp.empty
    expected = pipeline.launch(start, end).to_host().toi

    def out_of_memory(shape, *arguments, **options):
        if np.prod(shape) > 1e9:
            raise RuntimeError("Failed to allocate 34359738352 bytes on device 'cpu'")
        return empty(shape, *arguments, **options)

    monkeypatch.setattr(wp, "empty", out_of_memory)
    monkeypatch.setattr(wp, "zeros", out_of_memory)
    sentence = "max_pairs is 4,096 and max_contacts is 2,147,483,647, which take 171,79[89],.* bytes on "
    with pytest.raises(MemoryError, match=sentence):
        pipeline.reserve(max_contacts=2**31 - 1)
    assert pipeline.launch(start, end).to_host().toi == expected
    with pytest.raises(MemoryError, match=sentence):
        ccd.CollisionPipeline(mesh, max_contacts=2**31 - 1).launch(start, end)


# --- what stops ---


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize(
    ("of", "value"),
    [
        *((of, value) for of in ("start", "end", "static") for value in (np.nan, np.inf, -np.inf)),
        *(("radius", value) for value in (-1.0, -5e-324, np.nan, np.inf)),
        *(("moved", value) for value in (1e-7, -0.0)),
    ],
)
def test_what_cannot_be_stops_its_world_alone_and_once(of, value, dtype):
    mesh, start, end = falling(static=[0], radius=0.125)
    mesh, moving = mesh.replicate(3), mesh.replicate(3).moving_vertices
    x, y = frames = [np.tile(positions, (3, 1)).astype(dtype) for positions in (start, end)]
    pipeline, (x, y), radius, row = ccd.CollisionPipeline(mesh), (x.copy(), y.copy()), mesh.radius.copy(), 6 + 5
    expected = pipeline.launch(*frames).to_host()
    if of == "radius":
        radius[row] = value
    elif of == "moved":  # a static body; another sign of a zero is no motion
        y[6, 2] = value
    else:
        (y if of == "end" else x)[row if of != "static" else 7] = [value, 0.0, 1.0]
    pipeline.radius.assign(radius)
    flag = LaunchFlag.STATIC_MOVED if of == "moved" else LaunchFlag.INVALID_INPUT
    flag, is_stopped = (flag, mesh.vertex_world == 1) if value != 0 else (0, mesh.vertex_world > 2)
    for vertices_t0 in (x, x[moving]) if of == "moved" else (x,):
        found = pipeline.launch(vertices_t0, y).to_host()
        assert found.flags == flag and found.world_flags.tolist() == [0, flag, 0]
        np.testing.assert_array_equal(found.vertex_toi, np.where(is_stopped, 0.0, expected.vertex_toi))
        assert (found.world_toi[1] == found.toi == 0.0) == bool(flag)
    if of == "moved":
        by = pipeline.launch(on_device(x), displacements=on_device(y.astype(float) - x)).world_toi.numpy()
        assert (by == 0).tolist() == [False, bool(flag), False]
    wished = y.copy()
    assert pipeline.launch_line_search(x, wished, per="world").world_flags.numpy().tolist() == [0, flag, 0]
    is_stopped &= ~mesh.static[mesh.vertex_body]
    np.testing.assert_array_equal(wished[is_stopped], x[is_stopped])
    assert (wished[moving[~is_stopped[moving]], 2] < 1.0).all()
    pipeline.radius.assign(mesh.radius)  # a static body is where it was before
    np.testing.assert_array_equal(
        pipeline.launch(*(f[moving] for f in frames)).to_host().vertex_toi, expected.vertex_toi
    )


@pytest.mark.parametrize("vertex", range(6))
def test_a_coordinate_that_is_no_number_is_seen_in_any_vertex(vertex):
    mesh, start, end = falling()
    end[vertex, vertex % 3] = np.nan
    for vertices in ((start, end), (on_device(start), on_device(end))):
        found = ccd.CollisionPipeline(mesh).launch(*vertices).to_host()
        assert found.flags == LaunchFlag.INVALID_INPUT and found.toi == found.vertex_toi[vertex] == 0.0


# --- captures ---


@pytest.mark.parametrize("broad_phase", ["tree", "hash"])
def test_graphs_and_launches_of_what_moves_follow_a_static_body_and_its_radius(broad_phase):
    mesh, start, end = falling(static=[0], radius=0.0)
    pipeline = ccd.CollisionPipeline(mesh, broad_phase=broad_phase)
    whole, moving = ([on_device(x[rows]) for x in (start, end)] for rows in (slice(None), mesh.moving_vertices))
    graphs = []
    for frames in (whole, moving):
        result = pipeline.launch(*frames)  # which has to come before the capture on CUDA
        with wp.ScopedCapture() as capture:
            pipeline.launch(*frames)
        graphs.append(capture.graph)
    replays = [lambda graph=graph: wp.capture_launch(graph) for graph in graphs]  # the first one puts the static body
    for shift, radius in ((0.0, 0.75), (-0.5, 0.0), (0.25, 0.625), (-3.0, 0.125), (0.5, 0.0)):
        for of_frame, x in zip(whole, (start, end), strict=True):
            of_frame.assign(x + [0, 0, shift] * (mesh.vertex_body == 0)[:, None])
        pipeline.radius.assign([radius] * 3 + [0.0] * 3)
        toi = (1.0 - shift - radius) / 2 if shift > -1 else np.inf
        for replay in (*replays, lambda: pipeline.launch(*moving)):
            replay()
            assert result.toi.numpy()[0] == pytest.approx(toi, rel=1e-12)
    pipeline.reserve(max_pairs=10_000)  # which lets static bodies stay where they are
    assert pipeline.launch(*moving).toi.numpy()[0] == pytest.approx(toi)
    pipeline.reserve(vertices=mesh.vertices)
    assert pipeline.launch(*moving).toi.numpy()[0] == pytest.approx(0.5)


@pytest.mark.parametrize("options", [{}, {"static": [0]}, {"body_pairs": ~np.eye(2, dtype=bool), "exclusion_rings": 2}])
def test_first_launch_in_a_capture_of_the_cpu(options):
    """The arrays of a mesh on the device are made before the capture; otherwise only the graph would own the copies."""
    mesh, start, end = falling(**options)
    pipeline = ccd.CollisionPipeline(mesh, device="cpu")
    result, expected = pipeline.reserve(), ccd.mesh_ccd(*falling(**options), device="cpu")
    assert result.toi.numpy()[0] == 0.0 == result.vertex_toi.numpy().max()  # before a launch nothing may move
    frames = [wp.array(x, dtype=wp.vec3d, device="cpu") for x in (start, end)]
    with wp.ScopedCapture(device="cpu") as capture:
        pipeline.launch(*frames)
    wp.capture_launch(capture.graph)
    check_same(result, expected)
    check_same(pipeline.launch(*frames), expected)
    assert ccd.mesh_ccd(mesh, start, end, device="cpu").toi == expected.toi < 1


def test_result_keeps_what_a_graph_uses():
    gc.freeze()  # so that the collector goes through what follows alone
    mesh, start, end = falling()
    pipeline = ccd.CollisionPipeline(mesh)
    result = pipeline.launch(start, end)
    step = weakref.ref(result._step)
    pipeline.reserve()
    gc.collect()
    assert step() is not None
    del result
    gc.collect()
    assert step() is None


# --- what is read when ---


@pytest.mark.skipif("not wp.get_device().is_cuda", reason="the CPU takes them; with a GPU: pytest --device cuda:0")
def test_on_a_gpu_arrays_of_the_host_are_refused():
    mesh, start, end = falling()
    pipeline, launch = ccd.CollisionPipeline(mesh), ccd.CollisionPipeline.launch.__wrapped__  # without `uploads.py`
    for x, y in ((start, end), (wp.array(start, device="cpu"), wp.array(end, device="cpu"))):
        with pytest.raises(ValueError, match=r"^vertices_t0 is on cpu; expected cuda:\d, where the pipeline is$"):
            launch(pipeline, x, y)


def test_nothing_is_allocated_copied_or_waited_for(monkeypatch):
    mesh, start, end = named_cloth_and_ball()
    pipeline, arrays = ccd.CollisionPipeline(mesh), [on_device(start), on_device(end), on_device(end)]
    pipeline.launch(*arrays[:2])

    def forbidden(*args, **kwargs):
        raise AssertionError("not in the loop")

    monkeypatch.setattr(type(wp.get_device().get_allocator()), "allocate", forbidden)
    for name in ("copy", "synchronize", "synchronize_device", "synchronize_stream", "clone"):
        monkeypatch.setattr(wp, name, forbidden)
    monkeypatch.setattr(wp.array, "numpy", forbidden)
    with pytest.raises(AssertionError, match="not in the loop"):
        wp.empty(1)
    for k in (1, 2, 1, 2):
        pipeline.launch(arrays[0], arrays[k])


def test_few_positions_of_numpy_are_copied_but_by_a_graph_of_the_cpu():
    """So the caller may change them after a launch; the next one reads them anew."""
    mesh, start, end = named_cloth_and_ball()
    pipeline = ccd.CollisionPipeline(mesh, device="cpu", max_contacts=60_000)
    a, b = start.copy(), end.copy()
    pipeline.reserve()
    with wp.ScopedCapture(device="cpu") as capture:
        pipeline.launch(a, b)
    for shift in (0.0, 0.1, -0.2):
        a[:], b[:] = start + [0, 0, shift], end + [0, 0, shift]
        expected = ccd.mesh_ccd(mesh, a, b, device="cpu")
        result = pipeline.launch(a, b)
        a[:], b[:] = np.nan, np.nan
        check_same(result, expected)
        np.testing.assert_array_equal(result.contacts.to_host().points, expected.contacts.points)
        pipeline.launch(start + [0, 0, 5], end + [0, 0, 5])
        a[:], b[:] = start + [0, 0, shift], end + [0, 0, shift]
        wp.capture_launch(capture.graph)
        check_same(result, expected)


@pytest.mark.parametrize(
    ("is_cpu", "is_ours", "is_supported", "expected"),
    [(True, False, False, True), (False, True, True, True), (False, True, False, False), (False, False, True, False)],
)
def test_a_graph_leaves_out_launches_where_warp_captures_it_and_the_driver_can(
    is_cpu, is_ours, is_supported, expected, monkeypatch
):
    """torch captures without Warp, which would then wait for the flag, and a driver before 12.4 has no such nodes."""
    monkeypatch.setattr(wp, "is_conditional_graph_supported", lambda: is_supported)
    device = SimpleNamespace(is_cpu=is_cpu, stream="stream", captures={"stream": "graph"} if is_ours else {})
    assert leaves_out_launches(device) is expected
    if is_ours and expected:  # a capture on CUDA records the branch and not the launches
        branches, flag = [], wp.array([0], dtype=wp.int32, device="cpu")
        monkeypatch.setattr(wp, "capture_if", lambda condition, on_true: branches.append(condition))
        device = SimpleNamespace(is_cuda=True, is_capturing=True, **vars(device))
        recording = Recording(Execution(device, 1), {})
        with recording.section("step"), recording.only_if(flag):
            pass
        recording.play("step")
        assert branches == [flag]


@pytest.mark.parametrize("form", [{"radius": 0.1}, {"minimum_distance": 0.2}])
def test_of_many_bodies_those_touch_that_do_so_by_their_thickness_alone(form):
    """The boxes of the bodies without it are apart, and one body is apart with it."""
    ball, places = trimesh.creation.icosphere(1, radius=0.5), np.arange(20)[:, None, None] * [1.1, 0, 0]
    places[19] += [1.0, 0, 0]
    of_mesh, options = ({}, form) if "minimum_distance" in form else (form, {})
    bodies = [(ball.vertices + place, ball.faces) for place in places]
    mesh = ccd.CollisionMesh.from_arrays(bodies, self_collision=False, **of_mesh)
    launched = ccd.CollisionPipeline(mesh, device="cpu", **options).launch(mesh.vertices, mesh.vertices)
    expected = ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices, **options)
    assert expected.body_toi.tolist() == [0.0] * 19 + [np.inf]
    check_same(launched, expected)
