"""Steps whose input and results stay on the device: compared with host calls, captured, with too little capacity."""

import gc
import weakref

import numpy as np
import pytest
import trimesh
import warp as wp
from exact import exact_tois
from expected_warnings import OF_ROUNDING
from hypothesis import given, settings
from hypothesis import strategies as st
from launches import CAPACITIES, check_same, host, on_device
from oracles import corners_of
from scenes import crowd, sheet, sheet_over_ball, single, soup

import ccd_warp as ccd
from ccd_warp import LaunchFlag, PairKind

pytestmark = OF_ROUNDING


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**32),
    size=st.sampled_from([1e-3, 0.1, 1.0]),
    flat=st.booleans(),
    t_max=st.sampled_from([0.3, 1]),
)
def test_random_soups_are_never_late(seed, size, flat, t_max):
    rng = np.random.default_rng(seed)
    vertices, faces = soup(rng, 12, size, 20)
    mesh = single(vertices, faces)
    end = vertices + rng.normal(size=vertices.shape) * 0.3
    if flat:
        vertices[:, 2] = end[:, 2] = 0.25
    pipeline = ccd.CollisionPipeline(mesh, length_scale=1.0, t_max=t_max, num_threads=1)
    result = host(pipeline.launch(on_device(vertices), on_device(end)))
    expected = ccd.mesh_ccd(mesh, vertices, end, length_scale=1.0, t_max=t_max, num_threads=1)
    np.testing.assert_array_equal(result["vertex_toi"], expected.vertex_toi)
    candidates = ccd.find_candidates(mesh, vertices, end)
    for kind, pairs in (("vertex-face", candidates.vertex_face[:40]), ("edge-edge", candidates.edge_edge[:40])):
        if len(pairs) == 0:
            continue
        corners = corners_of(mesh, PairKind[kind.upper().replace("-", "_")], pairs)
        for truth, four in zip(exact_tois(kind, vertices[corners], end[corners], t_max=t_max), corners, strict=True):
            assert not any(truth.late(toi) for toi in [*result["vertex_toi"][four], result["toi"][0]])


@pytest.mark.parametrize("broad_phase", ["tree", "hash"])
def test_capture_follows_a_static_body_that_is_moved(device, broad_phase):
    mesh, start, end = sheet_over_ball()
    pipeline = ccd.CollisionPipeline(mesh, length_scale=1.0, device=device, broad_phase=broad_phase, **CAPACITIES)
    vertices_t0, vertices_t1 = on_device(start, device), on_device(end, device)
    result = pipeline.launch(vertices_t0, vertices_t1)
    with wp.ScopedCapture(device=device) as capture:
        pipeline.launch(vertices_t0, vertices_t1)
    is_static = mesh.static[mesh.vertex_body]
    for shift in (0.05, 0.6, 0.6, 3.0, 0.0):
        a, b = start.copy(), end.copy()
        a[is_static, 0] += shift
        b[is_static, 0] += shift
        vertices_t0.assign(a)
        vertices_t1.assign(b)
        wp.capture_launch(capture.graph)
        check_same(result, ccd.mesh_ccd(mesh, a, b, length_scale=1.0, device=device))


def test_nothing_is_allocated_copied_or_waited_for(device, monkeypatch):
    mesh, start, end = sheet_over_ball()
    pipeline = ccd.CollisionPipeline(mesh, device=device)
    arrays = [on_device(start, device), on_device(end, device), on_device(end, device)]
    pipeline.launch(*arrays[:2])

    def forbidden(*args, **kwargs):
        raise AssertionError("not in the loop")

    allocator = wp.get_device(device).get_allocator()
    monkeypatch.setattr(type(allocator), "allocate", forbidden)
    for name in ("copy", "synchronize", "synchronize_device", "synchronize_stream", "clone"):
        monkeypatch.setattr(wp, name, forbidden)
    monkeypatch.setattr(wp.array, "numpy", forbidden)
    with pytest.raises(AssertionError, match="not in the loop"):
        wp.empty(1, device=device)
    for k in (1, 2, 1, 2):
        pipeline.launch(arrays[0], arrays[k])


@pytest.mark.parametrize("max_pairs", [1, 7, 500])
def test_pairs_beyond_the_capacity_count_as_touching(device, max_pairs):
    mesh, start, end = crowd(np.random.default_rng(3))
    pipeline = ccd.CollisionPipeline(mesh, length_scale=1.0, device=device, max_pairs=max_pairs, max_contacts=60_000)
    vertices_t0, vertices_t1 = on_device(start, device), on_device(end, device)
    result = pipeline.launch(vertices_t0, vertices_t1)
    short = host(result)
    expected = ccd.mesh_ccd(mesh, start, end, length_scale=1.0, device=device)
    assert short["flags"][0] == LaunchFlag.PAIRS_OVERFLOW
    assert short["toi"][0] == 0.0
    for name in ("vertex_toi", "body_toi", "world_toi"):
        assert (short[name] <= getattr(expected, name)).all()
    assert set(np.unique(short["vertex_toi"])) <= {0.0, *expected.vertex_toi}
    needed = result.num_pairs.numpy().max()
    assert needed > max_pairs
    pipeline.reserve(max_pairs=int(needed))
    check_same(pipeline.launch(vertices_t0, vertices_t1), expected)


def test_contacts_beyond_the_capacity_are_missing_from_the_list_alone(device):
    mesh, start, end = crowd(np.random.default_rng(3))
    pipeline = ccd.CollisionPipeline(mesh, length_scale=1.0, device=device, max_pairs=60_000, max_contacts=10)
    vertices_t0, vertices_t1 = on_device(start, device), on_device(end, device)
    result = pipeline.launch(vertices_t0, vertices_t1)
    expected = ccd.mesh_ccd(mesh, start, end, length_scale=1.0, device=device)
    short = host(result)
    assert short["flags"][0] == LaunchFlag.CONTACTS_OVERFLOW
    assert len(result.contacts.to_host()) == 10
    np.testing.assert_array_equal(short["vertex_toi"], expected.vertex_toi)
    count = int(result.contacts.count.numpy()[0])
    assert count == len(expected.contacts)
    check_same((pipeline.reserve(max_contacts=count), pipeline.launch(vertices_t0, vertices_t1))[0], expected)


def worlds_of(scenes):
    """Scenes as worlds of one mesh: the mesh, start and end positions, and where the vertices of each world begin."""
    bodies = [(mesh.vertices, mesh.faces) for mesh, _, _ in scenes]
    counts = [mesh.num_vertices for mesh, _, _ in scenes]
    mesh = ccd.CollisionMesh.from_arrays(bodies, vertex_world=np.repeat(np.arange(len(scenes)), counts))
    frames = (np.concatenate([scene[k] for scene in scenes]) for k in (1, 2))
    return mesh, *frames, np.concatenate([[0], np.cumsum(counts)])


@pytest.mark.parametrize("num_worlds", [2, 9, 65])
def test_worlds_in_one_place_are_scenes_of_their_own(device, num_worlds):
    rng = np.random.default_rng(num_worlds)
    scenes = [crowd(rng, num_faces=int(rng.integers(1, 25)), size=0.3) for _ in range(num_worlds)]
    mesh, start, end, first = worlds_of(scenes)
    options = {"length_scale": 1.0, "device": device}
    result = ccd.CollisionPipeline(mesh, **options, **CAPACITIES).launch(
        on_device(start, device), on_device(end, device)
    )
    on_host = ccd.mesh_ccd(mesh, start, end, **options)
    check_same(result, on_host)
    world_toi = result.world_toi.numpy()
    vertex_toi = result.vertex_toi.numpy()
    for world, scene in enumerate(scenes):
        alone = ccd.mesh_ccd(*scene, **options)
        assert world_toi[world] == alone.toi
        np.testing.assert_array_equal(vertex_toi[first[world] : first[world + 1]], alone.vertex_toi)
    assert np.isfinite(world_toi).any()
    assert result.toi.numpy()[0] == world_toi.min()


def test_world_that_is_no_number_stops_itself_alone(device):
    rng = np.random.default_rng(1)
    scenes = [crowd(rng, num_faces=20, size=0.3) for _ in range(5)]
    mesh, start, end, first = worlds_of(scenes)
    options = {"length_scale": 1.0, "device": device}
    expected = ccd.mesh_ccd(mesh, start, end, **options)
    pipeline = ccd.CollisionPipeline(mesh, **options, **CAPACITIES)
    for value in (np.nan, np.inf, -np.inf):
        for broken in (start, end):
            kept = broken[first[2] + 7].copy()
            broken[first[2] + 7] = [value, 0.0, 1.0]
            result = host(pipeline.launch(on_device(start, device), on_device(end, device)))
            broken[first[2] + 7] = kept
            assert result["flags"][0] == LaunchFlag.INVALID_INPUT
            assert result["world_flags"].tolist() == [0, 0, LaunchFlag.INVALID_INPUT, 0, 0]
            assert result["toi"][0] == result["world_toi"][2] == result["body_toi"][2] == 0.0
            assert (result["vertex_toi"][first[2] : first[3]] == 0.0).all()
            others = mesh.vertex_world != 2
            np.testing.assert_array_equal(result["vertex_toi"][others], expected.vertex_toi[others])
    check_same(pipeline.launch(on_device(start, device), on_device(end, device)), expected)


def test_static_body_that_is_no_number_stops_its_world(device):
    mesh, start, end = sheet_over_ball()
    start[-1] = np.nan
    pipeline = ccd.CollisionPipeline(mesh, device=device, **CAPACITIES)
    result = host(pipeline.launch(on_device(start, device), on_device(end, device)))
    assert result["flags"][0] == LaunchFlag.INVALID_INPUT
    assert (result["vertex_toi"] == 0.0).all()
    assert (result["body_toi"] == 0.0).all()


def test_static_body_that_was_no_number_is_where_it_was_before(device):
    mesh, start, end = sheet_over_ball()
    pipeline = ccd.CollisionPipeline(mesh, length_scale=1.0, device=device, **CAPACITIES)
    expected = ccd.mesh_ccd(mesh, start, end, length_scale=1.0, device=device)
    broken = start.copy()
    broken[-1] = np.nan
    pipeline.launch(on_device(broken, device), on_device(end, device))
    rows = mesh.moving_vertices
    check_same(pipeline.launch(on_device(start[rows], device), on_device(end[rows], device)), expected)


def test_a_thousand_worlds(device):
    vertices, faces = sheet(3)
    ball = trimesh.creation.icosphere(subdivisions=1, radius=0.3)
    count = 1000
    mesh = ccd.CollisionMesh.from_arrays(
        [(vertices, faces), (ball.vertices, ball.faces)] * count,
        static=range(1, 2 * count, 2),
        vertex_world=np.repeat(np.arange(count), len(vertices) + len(ball.vertices)),
    )
    rng = np.random.default_rng(0)
    start = np.tile(np.concatenate([vertices + [0.01, 0.02, 0.5], ball.vertices]), (count, 1))
    end = start.copy()
    end[mesh.moving_vertices, 2] -= np.repeat(rng.uniform(0.0, 1.0, count), len(vertices))
    options = {"length_scale": 1.0, "device": device}
    pipeline = ccd.CollisionPipeline(mesh, **options, max_contacts=200_000)
    result = pipeline.launch(on_device(start, device), on_device(end, device))
    world_toi = result.world_toi.numpy()
    assert result.flags.numpy()[0] == 0
    assert 0.6 < np.isfinite(world_toi).mean() < 0.9
    size = len(vertices) + len(ball.vertices)
    alone = ccd.CollisionMesh.from_arrays([(vertices, faces), (ball.vertices, ball.faces)], static=[1])
    for world in range(0, count, 101):
        rows = slice(size * world, size * (world + 1))
        assert world_toi[world] == ccd.mesh_ccd(alone, start[rows], end[rows], **options).toi


def test_result_before_a_launch_lets_nothing_move(device):
    mesh, _, _ = sheet_over_ball()
    result = ccd.CollisionPipeline(mesh, device=device).reserve()
    assert result.toi.numpy()[0] == 0.0
    assert (result.vertex_toi.numpy() == 0.0).all()


@pytest.mark.parametrize(
    "bodies",
    [
        [(np.zeros((0, 3)), np.zeros((0, 3), dtype=int))],
        [(np.eye(3), np.zeros((0, 3), dtype=int))],
        [(np.eye(3), [[0, 1, 2]]), (np.zeros((0, 3)), np.zeros((0, 3), dtype=int))],
    ],
)
def test_scenes_without_pairs(device, bodies):
    mesh = ccd.CollisionMesh.from_arrays(bodies)
    x = on_device(mesh.vertices, device)
    result = ccd.CollisionPipeline(mesh, length_scale=1.0, device=device).launch(x, x)
    check_same(result, ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices, device=device))


def test_all_static(device):
    mesh = ccd.CollisionMesh.from_arrays([(np.eye(3), [[0, 1, 2]])] * 2, static=[0, 1])
    x = on_device(mesh.vertices, device)
    result = host(ccd.CollisionPipeline(mesh, device=device).launch(x, x))
    assert result["toi"][0] == np.inf


LOW, HIGH = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0.2, 0.2, 1], [1.2, 0.2, 1], [0.2, 1.2, 1]])
ONE_FACE = [[0, 1, 2]]


def falling(**options):
    """A face that falls through another: mesh, start and end positions."""
    mesh = ccd.CollisionMesh.from_arrays([(LOW, ONE_FACE), (HIGH, ONE_FACE)], **options)
    end = mesh.vertices.copy()
    end[3:, 2] -= 2.0
    return mesh, mesh.vertices.copy(), end


def test_capacities_for_which_there_is_no_memory_are_named_and_the_pipeline_goes_on(monkeypatch):
    mesh, start, end = falling()
    pipeline = ccd.CollisionPipeline(mesh, device="cpu")
    expected = pipeline.launch(start, end).to_host().toi
    empty = wp.empty

    def out_of_memory(shape, *arguments, **options):
        if np.prod(shape) > 1e9:
            raise RuntimeError("Failed to allocate 34359738352 bytes on device 'cpu'")
        return empty(shape, *arguments, **options)

    monkeypatch.setattr(wp, "empty", out_of_memory)
    monkeypatch.setattr(wp, "zeros", out_of_memory)
    sentence = "max_pairs is 4,096 and max_contacts is 2,147,483,647, which take 171,798,7.* bytes on cpu"
    with pytest.raises(MemoryError, match=sentence):
        pipeline.reserve(max_contacts=2**31 - 1)
    assert pipeline.launch(start, end).to_host().toi == expected
    pipeline.reserve(max_contacts=10)
    assert pipeline.launch(start, end).to_host().toi == expected
    with pytest.raises(MemoryError, match=sentence):
        ccd.CollisionPipeline(mesh, device="cpu", max_contacts=2**31 - 1).launch(start, end)


@pytest.mark.parametrize(
    "options", [{}, {"static": [0]}, {"body_pairs": ~np.eye(2, dtype=bool)}, {"exclusion_rings": 2}]
)
def test_first_launch_in_a_capture_of_the_cpu(options):
    """The arrays of a mesh on the device are made before the capture; otherwise only the graph would own the copies."""
    mesh, start, end = falling(**options)
    pipeline = ccd.CollisionPipeline(mesh, length_scale=1.0, device="cpu")
    result = pipeline.reserve()
    vertices_t0, vertices_t1 = on_device(start), on_device(end)
    with wp.ScopedCapture(device="cpu") as capture:
        pipeline.launch(vertices_t0, vertices_t1)
    expected = ccd.mesh_ccd(falling(**options)[0], start, end, length_scale=1.0, device="cpu")
    assert expected.hit
    wp.capture_launch(capture.graph)
    check_same(result, expected)
    check_same(pipeline.launch(vertices_t0, vertices_t1), expected)
    assert ccd.mesh_ccd(mesh, start, end, length_scale=1.0, device="cpu").toi == expected.toi


def test_calls_that_a_graph_cannot_hold_say_so():
    mesh, start, end = falling()
    pipeline = ccd.CollisionPipeline(mesh, device="cpu")
    for call in (
        pipeline.reserve,
        lambda: pipeline.mesh_ccd(start, end),
        lambda: ccd.collision_free_step(mesh, start, end, device="cpu"),
        lambda: ccd.CollisionPipeline(falling()[0], device="cpu"),
    ):
        with pytest.raises(RuntimeError, match="a graph is being captured"), wp.ScopedCapture(device="cpu"):
            call()


@pytest.mark.parametrize("far", [1e40, 1e300])
@pytest.mark.parametrize("count", [20, 5_000])
def test_face_whose_box_is_infinite_in_quantized_coordinates(device, count, far):
    rng = np.random.default_rng(0)
    vertices = (rng.uniform(-1, 1, (count, 1, 3)) + 1e-3 * rng.normal(size=(count, 3, 3))).reshape(-1, 3)
    faces = np.arange(3 * count).reshape(-1, 3)
    mesh = ccd.CollisionMesh.from_arrays([(vertices, faces), (np.eye(3), ONE_FACE)], self_collision=False)
    start = mesh.vertices.copy()
    end = start + [0, 0, 0.01]
    pipeline = ccd.CollisionPipeline(mesh, length_scale=1.0, device=device, **CAPACITIES)
    pipeline.reserve(vertices=start)
    start[-2] = end[-2] = far
    start[-1] = end[-1] = -far
    result = host(pipeline.launch(on_device(start, device), on_device(end, device)))
    expected = ccd.mesh_ccd(mesh, start, end, length_scale=1.0, device=device)
    if result["flags"][0] == 0:
        assert (result["vertex_toi"] <= expected.vertex_toi).all()
    assert ccd.collision_free_step(mesh, start, end, length_scale=1.0, device=device) <= min(expected.toi, 1.0)


def test_separation_beyond_the_quantized_coordinates(device):
    mesh, start, end = falling()
    options = {"minimum_separation": 1e40, "length_scale": 1.0, "device": device}
    result = ccd.CollisionPipeline(mesh, **options).launch(on_device(start, device), on_device(end, device))
    assert result.toi.numpy()[0] == ccd.mesh_ccd(mesh, start, end, **options).toi == 0.0


def test_layout_is_kept_as_it_was_given(device):
    mesh, start, end = falling()
    layout = mesh.vertices.copy()
    pipeline = ccd.CollisionPipeline(mesh, length_scale=1.0, device=device)
    pipeline.reserve(vertices=layout)
    layout[:] = np.nan  # the caller's own array
    pipeline.reserve(max_pairs=10_000)
    expected = ccd.mesh_ccd(mesh, start, end, length_scale=1.0, device=device)
    check_same(pipeline.launch(on_device(start, device), on_device(end, device)), expected)


def test_static_bodies_stay_where_a_launch_had_them_when_more_is_reserved(device):
    mesh = ccd.CollisionMesh.from_arrays([(HIGH, ONE_FACE), (LOW, ONE_FACE)], static=[1])
    start = np.concatenate([HIGH - [0, 0, 2.0], LOW - [0, 0, 5.0]])
    end = np.concatenate([HIGH - [0, 0, 10.0], start[3:]])
    pipeline = ccd.CollisionPipeline(mesh, length_scale=1.0, device=device)
    pipeline.launch(on_device(start, device), on_device(end, device))
    pipeline.reserve(max_pairs=10_000)
    moving = pipeline.launch(on_device(start[:3], device), on_device(end[:3], device))
    check_same(moving, ccd.mesh_ccd(mesh, start, end, length_scale=1.0, device=device))
    assert moving.toi.numpy()[0] == pytest.approx(0.5)
    pipeline.reserve(vertices=mesh.vertices)
    assert pipeline.launch(on_device(start[:3], device), on_device(end[:3], device)).toi.numpy()[0] == np.inf


def test_reserve_that_fails_changes_nothing(device):
    mesh, start, end = crowd(np.random.default_rng(3), num_faces=50)
    frames = on_device(start, device), on_device(end, device)
    expected = ccd.mesh_ccd(mesh, start, end, device=device)
    pipeline = ccd.CollisionPipeline(mesh, device=device)
    with pytest.raises(ValueError, match="vertices holds nan in row 0"):
        pipeline.reserve(max_pairs=7, vertices=np.full(start.shape, np.nan))
    pipeline.reserve(max_contacts=CAPACITIES["max_contacts"])
    check_same(pipeline.launch(*frames), expected)
    pipeline.reserve(max_pairs=7)  # the capacity that the failed call requested is too small
    assert host(pipeline.launch(*frames))["flags"][0] & LaunchFlag.PAIRS_OVERFLOW


def test_result_keeps_what_a_graph_uses():
    mesh, start, end = falling()
    pipeline = ccd.CollisionPipeline(mesh, length_scale=1.0, device="cpu")
    vertices_t0, vertices_t1 = on_device(start), on_device(end)
    result = pipeline.launch(vertices_t0, vertices_t1)
    step = weakref.ref(result._step)
    pipeline.reserve()
    gc.collect()
    assert step() is not None
    del result
    gc.collect()
    assert step() is None


def test_no_rows(device):
    empty = np.zeros((0, 3))
    mesh = ccd.CollisionMesh.from_arrays([(empty, np.zeros((0, 3), dtype=int))])
    pipeline = ccd.CollisionPipeline(mesh, device="cpu")
    assert pipeline.launch(empty, empty).toi.numpy()[0] == np.inf
    assert pipeline.launch_line_search(empty, empty).toi.numpy()[0] == np.inf


TRIANGLE = np.eye(3)


def test_capture_without_capacity_says_what_to_do():
    mesh = ccd.CollisionMesh.from_arrays([(TRIANGLE, [[0, 1, 2]])])
    pipeline = ccd.CollisionPipeline(mesh, device="cpu")
    with pytest.raises(RuntimeError, match=r"call reserve\(\) before the capture"), wp.ScopedCapture(device="cpu"):
        pipeline.launch(on_device(TRIANGLE), on_device(TRIANGLE))


def test_few_positions_of_numpy_are_copied():
    """So the caller may change them after a launch; the next one reads them anew."""
    mesh, start, end = sheet_over_ball()
    pipeline = ccd.CollisionPipeline(mesh, length_scale=1.0, device="cpu", **CAPACITIES)
    a, b = start.copy(), end.copy()
    for shift in (0.0, 0.1, -0.2):
        a[:] = start + [0, 0, shift]
        b[:] = end + [0, 0, shift]
        expected = ccd.mesh_ccd(mesh, a, b, length_scale=1.0, device="cpu")
        result = pipeline.launch(a, b)
        a[:], b[:] = np.nan, np.nan
        check_same(result, expected)
        np.testing.assert_array_equal(result.contacts.to_host().points, expected.contacts.points)


def test_many_positions_of_numpy_are_read_where_they_are():
    """More than are copied: contacts that are located later are those of the positions at that time."""
    vertices, faces = sheet(200)
    mesh = ccd.CollisionMesh.from_arrays(
        [(vertices, faces), (0.05 * TRIANGLE + [0, 0, 0.5], ONE_FACE)], self_collision=False
    )
    start, end = mesh.vertices.copy(), mesh.vertices - [0, 0, 2.0] * (mesh.vertex_body == 1)[:, None]
    pipeline = ccd.CollisionPipeline(mesh, length_scale=1.0, device="cpu", **CAPACITIES)
    for _ in range(2):
        result = pipeline.launch(start, end)
        check_same(result, ccd.mesh_ccd(mesh, start, end, length_scale=1.0, device="cpu"))
    count = len(result.contacts.to_host())
    points = result.contacts.points.numpy()[:count].copy()
    start += 1.0
    end += 1.0
    np.testing.assert_allclose(result.contacts.points.numpy()[:count], points + 1.0, rtol=1e-12)


def test_a_graph_of_the_cpu_reads_the_arrays_of_numpy_that_it_was_captured_with():
    """Also if launches before and after the capture copy theirs."""
    mesh, start, end = sheet_over_ball()
    pipeline = ccd.CollisionPipeline(mesh, length_scale=1.0, device="cpu", **CAPACITIES)
    a, b = start.copy(), end.copy()
    result = pipeline.launch(a, b)
    with wp.ScopedCapture(device="cpu") as capture:
        pipeline.launch(a, b)
    pipeline.launch(start + [0, 0, 5], end + [0, 0, 5])
    for shift in (0.1, -0.2):
        a[:], b[:] = start + [0, 0, shift], end + [0, 0, shift]
        wp.capture_launch(capture.graph)
        check_same(result, ccd.mesh_ccd(mesh, a, b, length_scale=1.0, device="cpu"))
