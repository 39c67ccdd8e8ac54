"""Bodies that move as they are told, and static bodies that must not: who is tested, and what a line search says."""

import pickle

import numpy as np
import pytest
import trimesh
import warp as wp
from exact_proximity import check_proximities, exact_bounds
from launches import CAPACITIES, check_same, on_device
from oracles import brute_force, check_candidates, exact_pairs, rows
from scenes import FACE, TRIANGLE, cables_and_particles, crowd_of_all_kinds, sheet

import ccd_warp as ccd

EVERY_PER = ("scene", "world", "body", "vertex")


def wall_sweeps_over_a_ball(**arguments):
    """A wall sweeps two metres over a ball at rest: mesh, start and end positions."""
    ball, wall = trimesh.creation.icosphere(subdivisions=1, radius=0.1), trimesh.creation.box(extents=(0.02, 1, 1))
    mesh = ccd.CollisionMesh.from_trimesh([ball, wall], names=["ball", "wall"], **arguments)
    start = np.concatenate([ball.vertices, wall.vertices - [1, 0, 0]])
    return mesh, start, start + np.array([2.0, 0, 0]) * (mesh.vertex_body == 1)[:, None]


def crowd(seed, **options):
    """Bodies of all kinds that move at random: free ones, and those of `options`."""
    return crowd_of_all_kinds(np.random.default_rng(seed), count=6, **options)


# --- static bodies that move ---


def test_a_static_body_that_moves_is_refused():
    mesh, start, end = wall_sweeps_over_a_ball(static=["wall"])
    message = (
        r"vertices_t1 moves vertex 0 of body 1 \(wall\), which is static, by 2 \(row 42\); expected its position in "
        r"vertices_t0, or kinematic=\['wall'\] in place of static=\['wall'\]"
    )
    pipeline = ccd.CollisionPipeline(mesh)
    calls = [pipeline.mesh_ccd, pipeline.collision_free_step, pipeline.is_step_collision_free, pipeline.line_search]
    for call in [*calls, pipeline.find_candidates]:
        with pytest.raises(ValueError, match=message):
            call(start, end)
    nearly = start.copy()
    nearly[-1, 1] = np.nextafter(nearly[-1, 1], 1)
    with pytest.raises(ValueError, match=r"vertices_t1 moves vertex 7 of body 1 \(wall\), which is static, by 1.1"):
        pipeline.mesh_ccd(start, nearly)
    assert pipeline.collision_free_step(start, start) == 1.0  # the same array
    assert pipeline.collision_free_step(start, end[: mesh.body_vertex_range[1]]) == 1.0  # rows of what moves


@pytest.mark.parametrize("dtype", [wp.vec3d, wp.vec3f])
def test_a_static_body_that_moves_in_a_launch_stops_its_world(device, dtype):
    one, start, _ = wall_sweeps_over_a_ball(static=["wall"])
    mesh = one.replicate(3)
    pipeline = ccd.CollisionPipeline(mesh, device=device)
    still = np.tile(start, (3, 1, 1))
    moved, signed = still.copy(), np.where(still == 0, -0.0, still)
    moved[1, -1] = np.nextafter(np.float32(moved[1, -1]), np.float32(9))
    t0 = on_device(still.reshape(-1, 3), device, dtype)

    def flags_of(vertices_t1):
        result = pipeline.launch(t0, on_device(vertices_t1.reshape(-1, 3), device, dtype))
        flag = result.flags.numpy()[0]
        assert result.world_flags.numpy().tolist() == [0, flag, 0]
        assert (result.world_toi.numpy() == 0).tolist() == [False, flag != 0, False]
        return flag

    assert flags_of(moved) == ccd.LaunchFlag.STATIC_MOVED
    assert flags_of(signed) == 0 == pipeline.launch(t0, t0).flags.numpy()[0]
    # rows of static bodies that are not given, a launch before has placed
    rows_of_ball = on_device(still[:, : one.body_vertex_range[1]].reshape(-1, 3), device, dtype)
    of_moving = pipeline.launch(rows_of_ball, on_device(moved.reshape(-1, 3), device, dtype))
    assert of_moving.flags.numpy()[0] == ccd.LaunchFlag.STATIC_MOVED
    assert pipeline.launch(rows_of_ball, rows_of_ball).flags.numpy()[0] == 0
    assert pipeline.launch(rows_of_ball, t0).flags.numpy()[0] == 0
    by_displacement = pipeline.launch(t0, displacements=on_device((moved - still).reshape(-1, 3), device, dtype))
    assert by_displacement.world_toi.numpy().tolist() == [np.inf, 0.0, np.inf]
    # a line search leaves that world where it is, and the others move on
    wished = moved.copy()
    wished[:, : one.body_vertex_range[1], 1] += 3.0
    y = on_device(wished.reshape(-1, 3), device, dtype)
    result = pipeline.launch_line_search(t0, y, per="world")
    assert result.world_flags.numpy().tolist() == [0, ccd.LaunchFlag.STATIC_MOVED, 0]
    rise = (y.numpy() - t0.numpy()).reshape(3, -1, 3)[:, : one.body_vertex_range[1], 1]
    assert np.allclose(rise, np.array([3.0, 0.0, 3.0])[:, None])


# --- kinematic bodies ---


def test_a_wall_that_sweeps_meets_a_ball_at_rest():
    mesh, start, end = wall_sweeps_over_a_ball(kinematic=["wall"])
    assert mesh.kinematic.tolist() == [False, True] and not mesh.static.any()
    assert ccd.mesh_ccd(mesh, start, end).toi == pytest.approx(0.445, abs=1e-12)
    assert ccd.collision_free_step(mesh, start, end) == ccd.mesh_ccd(mesh, start, end).toi
    assert not ccd.is_step_collision_free(mesh, start, end)


def test_kinematic_bodies_are_told_like_static_ones():
    bodies = [(TRIANGLE, FACE), (TRIANGLE + [0, 0, 1], FACE), (TRIANGLE + [0, 0, 2], FACE)]
    mesh = ccd.CollisionMesh.from_arrays(bodies, static=[0], kinematic=["body 2"])
    assert mesh.kinematic.tolist() == [False, False, True] and mesh.moving_vertices.tolist() == [3, 4, 5, 6, 7, 8]
    assert pickle.loads(pickle.dumps(mesh)).kinematic.tolist() == [False, False, True]
    assert mesh.replicate(2).kinematic.tolist() == [False, False, True] * 2
    assert mesh.excluding({"bodies": [(0, 1)]}).kinematic.tolist() == [False, False, True]
    table = mesh._repr_html_()
    assert all(f"<td>{word}</td>" in table for word in ("static", "moving", "kinematic"))
    with pytest.raises(ValueError, match="static and kinematic both hold body 0; expected it in one of them"):
        ccd.CollisionMesh.from_arrays(bodies, static=[0], kinematic=[0])
    with pytest.raises(ValueError, match=r"kinematic holds 'lid'; expected body indices in \[0, 3\) or names"):
        ccd.CollisionMesh.from_arrays(bodies, kinematic=["lid"])


@pytest.mark.parametrize(
    "options",
    [
        {"kinematic": ["rope"]},
        {"kinematic": ["rope"], "static": ["net"]},
        {"kinematic": ["net", "dust"], "self_collision": False},
        {"kinematic": ["net", "rope", "dust"]},
    ],
)
def test_pairs_are_those_with_a_free_body(options, device):
    mesh, start, end = crowd(3, **options)
    count = check_candidates(mesh, start, end, 0.01, device)
    assert (count > 0) == (len(options["kinematic"]) < 3)
    result = ccd.mesh_ccd(mesh, start, end, device=device)
    exact = exact_pairs(mesh, start, end)
    found = rows(result.contacts)
    assert set(exact) <= set(found) and all(not e.late(found[pair]) for pair, e in exact.items())
    assert ccd.collision_free_step(mesh, start, end, device=device) == min(result.toi, 1.0)
    free = ~(mesh.static | mesh.kinematic)
    assert free[result.contacts.bodies].any(axis=1).all()
    for broad_phase in ("tree", "hash"):
        pipeline = ccd.CollisionPipeline(mesh, device=device, broad_phase=broad_phase, **CAPACITIES)
        check_same(pipeline.launch(on_device(start, device), on_device(end, device)), result)


@pytest.mark.parametrize("in_plane", [False, True])
def test_at_one_time_a_kinematic_body_counts_as_one_that_moves(in_plane):
    rng = np.random.default_rng(5)
    if in_plane:
        k = np.arange(12).reshape(-1, 2)
        bodies = [(rng.random((12, 2)), k) for _ in range(3)]
    else:
        bodies = [cables_and_particles(rng, 3, 0.4) for _ in range(3)]
    mesh = ccd.CollisionMesh.from_arrays(bodies, static=[0], kinematic=[1], codimensional_points=True)
    x = mesh.vertices
    assert check_proximities(mesh, x, 0.1, ccd.find_proximity(mesh, x, 0.1)) > 10
    bounds, (exact, largest) = ccd.displacement_bounds(mesh, x, 0.3), exact_bounds(mesh, x, 0.3)
    assert ((bounds <= exact) & (bounds >= exact - 1e-13 * largest)).all() and (bounds[mesh.vertex_body == 1] > 0).any()
    every = ccd.CollisionMesh.from_arrays(bodies, codimensional_points=True)
    inside = ccd.find_intersections(every, x)
    expected = (inside.bodies == 2).any(axis=1)
    assert expected.any() and not expected.all()
    assert ccd.find_intersections(mesh, x).primitives.tolist() == inside.primitives[expected].tolist()


def test_a_kinematic_body_alone_with_one_that_ignores_itself_shares_the_search_radius():
    bodies = [(TRIANGLE, FACE), (TRIANGLE + [0, 0, 1], FACE)]
    mesh = ccd.CollisionMesh.from_arrays(bodies, kinematic=[1], self_collision=False)
    assert ccd.displacement_bounds(mesh, mesh.vertices, 0.5) == pytest.approx([0.25] * 6)


# --- line searches ---


def check_search(mesh, start, wished, found, per):
    """What the guarantee says, by exact arithmetic on the end positions."""
    kinematic = mesh.kinematic[mesh.vertex_body]
    assert np.array_equal(found.vertices[kinematic], wished[kinematic])
    assert (found.vertex_fraction[kinematic] == 1).all() and not found.is_limited
    stays = (found.vertices == start).all(axis=1)
    exact = set(exact_pairs(mesh, start, found.vertices))
    touching, struck = (set(rows(contacts)) for contacts in (found.touching, found.struck))
    assert not touching & struck
    for pair in exact:
        kind, first, second = pair
        corners = [first, *mesh.faces[second]] if kind == 0 else [*mesh.edges[first], *mesh.edges[second]]
        corners = np.array(corners)
        assert stays[corners[~kinematic[corners]]].all()
        assert pair in struck or stays[corners].all()
    assert mesh.kinematic[found.struck.bodies].any(axis=1).all()


@pytest.mark.parametrize("per", EVERY_PER)
def test_a_line_search_ends_and_says_what_is_struck(per):
    num_struck = num_moved = 0
    for seed in range(6):
        rng = np.random.default_rng(seed)
        places = rng.uniform(-1, 1, (5, 1, 3)) + 0.4 * rng.standard_normal((5, 9, 3))
        bodies = [(place, np.arange(9).reshape(-1, 3)) for place in places]
        world = np.repeat([0, 0, 0, 1, 1], 9)
        mesh = ccd.CollisionMesh.from_arrays(bodies, kinematic=[1, 3], self_collision=False, vertex_world=world)
        start = mesh.vertices
        wished = start + rng.choice([0.1, 0.5]) * rng.standard_normal((5, 3))[mesh.vertex_body]
        wished[mesh.vertex_body == 0] += 0.1 * rng.standard_normal((9, 3))
        found = ccd.line_search(mesh, start, wished, per=per)
        check_search(mesh, start, wished, found, per)
        num_struck += len(found.struck)
        num_moved += int((found.vertices != start)[mesh.vertex_body % 2 == 0].any())
        if len(found.struck):
            share = 0.9 * float(found.struck.toi.min())
            cut = ccd.line_search(mesh, start, start + share * (found.vertices - start), per=per)
            assert len(cut.struck) == 0 or found.struck.toi.min() == 0
        # the device: the same is certain, and the flag is set where something is struck
        y = on_device(wished)
        result = ccd.CollisionPipeline(mesh).launch_line_search(on_device(start), y, per=per)
        launched = y.numpy()
        stopped_worlds = {int(w) for w in np.flatnonzero(result.world_flags.numpy() & ccd.LaunchFlag.STRUCK)}
        contacts = result.contacts.to_host()
        exact = exact_pairs(mesh, start, launched)
        in_list = set(rows(contacts))
        kinematic = mesh.kinematic[mesh.vertex_body]
        assert np.array_equal(launched[kinematic], wished[kinematic])
        for kind, first, second in exact:
            corners = np.array([first, *mesh.faces[second]] if kind == 0 else [*mesh.edges[first], *mesh.edges[second]])
            assert (launched == start)[corners[~kinematic[corners]]].all()
            if (launched != start)[corners].any():
                assert (kind, first, second) in in_list and int(world[corners[0]]) in stopped_worlds
    assert num_struck > 0 and num_moved > 0


def test_what_shortening_helps_is_shortened_and_not_struck():
    """A ball flies into the path of a wall, and would not be in it where it is: it stops a little before."""
    mesh, start, end = wall_sweeps_over_a_ball(kinematic=["wall"])
    of_ball = mesh.vertex_body == 0
    start[of_ball] += [0, 2.0, 0]  # beside the path
    end[of_ball] = start[of_ball] - [0, 2.9, 0]
    for per in EVERY_PER:
        found = ccd.line_search(mesh, start, end, per=per)
        assert len(found.struck) == len(found.touching) == 0 and 0 < found.fraction < 1 and not found.is_limited
        y = on_device(end)
        result = ccd.CollisionPipeline(mesh).launch_line_search(on_device(start), y, per=per)
        assert result.flags.numpy()[0] == 0 and np.isinf(result.toi.numpy()[0])
        assert (y.numpy()[of_ball] != start[of_ball]).any()


def test_what_is_at_rest_and_struck_does_not_keep_the_others_from_moving():
    ball, wall = trimesh.creation.icosphere(subdivisions=1, radius=0.1), trimesh.creation.box(extents=(0.02, 1, 1))
    mesh = ccd.CollisionMesh.from_trimesh([ball, wall, ball], kinematic=[1])
    start = np.concatenate([ball.vertices, wall.vertices - [1, 0, 0], ball.vertices + [0, 9, 0]])
    end = start + np.array([[0.0, 0, 0], [2, 0, 0], [0, 1, 0]])[mesh.vertex_body]
    found = ccd.line_search(mesh, start, end, per="scene")
    assert found.fraction == 1.0 and np.array_equal(found.vertices, end) and found.num_rounds == 1
    assert found.struck.toi.min() == pytest.approx(0.445, abs=1e-12)
    y = on_device(end)
    result = ccd.CollisionPipeline(mesh).launch_line_search(on_device(start), y, per="scene")
    assert np.array_equal(y.numpy(), end) and result.flags.numpy()[0] == ccd.LaunchFlag.STRUCK
    assert len(result.contacts.to_host().toi) == len(found.struck)


# --- a program ---


def test_a_scripted_plate_presses_a_sheet_for_a_hundred_frames():
    """The plate comes down and goes up again; a sheet on a ground yields to it; nothing passes."""
    points, faces = sheet(6)
    plate = trimesh.creation.box(extents=(3, 3, 0.1))
    bodies = [(points, faces), (plate.vertices, plate.faces), ccd.HalfSpace([0, 0, 0], [0, 0, 1])]
    names = ["sheet", "plate", "ground"]
    mesh = ccd.CollisionMesh.from_arrays(bodies, names=names, kinematic=["plate"], self_collision=False)
    of_sheet = mesh.vertex_body == 0
    x = np.where(of_sheet[:, None], mesh.vertices + [0, 0, 0.5], mesh.vertices + [0, 0, 1.0])
    pipeline, num_cut = ccd.CollisionPipeline(mesh, minimum_distance=1e-3), 0
    for frame in range(100):
        wished = x + np.where(of_sheet[:, None], [0, 0, -2e-3], [0, 0, -0.02 if frame < 60 else 0.04])
        found = pipeline.line_search(x, wished, per="vertex")
        if len(found.struck):  # the sheet yields first: the response moves what the plate would pass through
            num_cut += 1
            lowest = wished[mesh.vertex_body == 1, 2].min()
            wished[of_sheet, 2] = np.minimum(wished[of_sheet, 2], max(lowest - 2e-3, 2e-3))
            found = pipeline.line_search(x, wished, per="vertex")
            if len(found.struck):  # there is no way out: the whole step is cut, that of the plate, too
                share = 0.9 * float(found.struck.toi.min())
                found = pipeline.line_search(x, x + share * (wished - x), per="vertex")
        assert len(found.struck) == 0
        x = found.vertices
        assert x[of_sheet, 2].min() > 0 and x[of_sheet, 2].max() < x[mesh.vertex_body == 1, 2].min()
    assert num_cut > 10


def test_ground_truth_of_the_oracle_leaves_out_what_is_prescribed():
    mesh, start, end = crowd(4, kinematic=["rope"], static=["net"])
    for kind, pairs in enumerate(brute_force(mesh, start, end, 1.0)[:2]):
        body = mesh.vertex_body if kind == 0 else mesh.edge_body
        other = mesh.face_body if kind == 0 else mesh.edge_body
        assert all(2 in (body[a], other[b]) for a, b in pairs)
