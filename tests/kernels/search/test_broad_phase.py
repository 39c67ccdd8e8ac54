"""Both broad phases give the same pairs and the same results in every bit, and the pairs are those of brute force.

The tree and the spatial hash find overlapping boxes in ways that have nothing in common, so each tests the other.
"""

import copy
import re

import numpy as np
import pytest
import warp as wp
from daily import marked
from expected_warnings import OF_DISTANCES, OF_ROUNDING
from fine_meshes import sphere
from launches import CAPACITIES, on_device
from laws.outputs import different, outputs_of
from oracles import brute_force
from scenes import (
    FACE,
    NO_FACES,
    TRIANGLE,
    cables_and_particles,
    cloth_and_ball_in_worlds,
    crowd,
    crowd_in_plane,
    leaning_stack,
    sheet,
    sheet_over_ball,
    sheet_over_floor,
    single,
    soup,
    stacked,
    with_static_at_rest,
)

import ccd_warp as ccd
from ccd_warp._engine.mesh import body_groups
from ccd_warp._engine.mesh.topology import Topology

pytestmark = [OF_DISTANCES, OF_ROUNDING]

BOTH = ("tree", "hash")
FIELDS = ("kind", "primitives", "toi", "parameters", "normal", "gap", "status")


# --- what is compared ---


def check_candidates(mesh, start, end, inflation=0.0, *, with_brute_force=False, **options):
    """Assert that both find the same candidates; returns how many."""
    tree, hashed = (ccd.find_candidates(mesh, start, end, inflation, broad_phase=name, **options) for name in BOTH)
    for name, pairs in vars(tree.sorted()).items():
        assert np.array_equal(pairs, getattr(hashed, name))
    if with_brute_force:
        in_space = mesh._in_space(start), mesh._in_space(end)
        for found, expected in zip(vars(hashed).values(), brute_force(mesh, *in_space, inflation), strict=True):
            assert list(map(tuple, found.tolist())) == expected
    return sum(map(len, vars(hashed).values()))


def as_bytes(result):
    """All that `mesh_ccd` returns but timings and how the search went."""
    arrays = [getattr(result.contacts, name) for name in FIELDS]
    arrays += [result.vertex_toi, result.body_toi, result.vertex_contact, result.body_contact, result.world_toi]
    return [np.asarray(array).tobytes() for array in (result.toi, *arrays)]


def check_results(mesh, start, end, **options):
    """Assert that all calls on the host give the same bits; returns how many pairs the cull leaves open."""
    for call in (ccd.mesh_ccd, ccd.collision_free_step, ccd.is_step_collision_free):
        tree, hashed = (call(mesh, start, end, broad_phase=name, **options) for name in BOTH)
        if call is ccd.mesh_ccd:
            assert as_bytes(tree) == as_bytes(hashed)
            assert tree.counts.num_candidates == hashed.counts.num_candidates
            assert tree.counts.num_after_cull == hashed.counts.num_after_cull
            num_open = sum(tree.counts.num_after_cull.values())
        else:
            assert tree == hashed
    return num_open


# --- laid out ---


def two_sheets_that_cross():
    vertices, faces = sheet(8)
    mesh = ccd.CollisionMesh.from_arrays([(vertices, faces), (vertices + [0.05, 0.03, 0.1], faces)])
    end = mesh.vertices.copy()
    end[: len(vertices), 2] += 0.2
    return mesh, mesh.vertices, end


def giant_face_among_small_ones():
    rng = np.random.default_rng(4)
    start, faces = soup(rng, 200, 0.01)
    start[:3] = [[-1e3, -1e3, 0.5], [1e3, -1e3, 0.5], [0, 1e3, 0.55]]
    return single(start, faces), start, start + [0, 0, 0.1]


def giants_of_every_size():
    rng = np.random.default_rng(5)
    start, faces = soup(rng, 120, 0.05)
    scale = 4.0 ** rng.integers(-9, 14, (120, 1, 1))
    start = (start.reshape(-1, 3, 3) * scale).reshape(-1, 3)
    return single(start, faces), start, start + 0.1 * rng.standard_normal(start.shape)


def boxes_on_the_faces_of_cells():
    """Every corner of every box is a multiple of a power of two, as are the cells."""
    rng = np.random.default_rng(6)
    start = np.repeat(rng.integers(0, 16, (80, 1, 3)), 3, axis=1) + rng.integers(0, 3, (80, 3, 3))
    start = start.reshape(-1, 3) / 16.0
    return single(start, np.arange(240).reshape(-1, 3)), start, start + rng.integers(-2, 3, start.shape) / 16.0


def points_alone():
    rng = np.random.default_rng(7)
    points = rng.integers(0, 6, (150, 3)) * 0.5
    mesh = ccd.CollisionMesh.from_arrays([(points, np.zeros((0, 3), dtype=int))], codimensional_points=True)
    return mesh, points, points[::-1]


def all_in_one_point():
    start = np.zeros((45, 3))
    return single(start, np.arange(45).reshape(-1, 3)), start, start


def far_from_the_origin():
    mesh, start, end = crowd(np.random.default_rng(8), num_faces=80, size=0.1)
    return mesh, start + [1e7, -1e7, 1e7], end + [1e7, -1e7, 1e7]


def two_clusters_far_apart():
    rng = np.random.default_rng(9)
    start, faces = soup(rng, 50, 0.05)
    mesh = ccd.CollisionMesh.from_arrays([(start, faces), (start + 1e100, faces)])
    return mesh, mesh.vertices, mesh.vertices + 0.01


def box_that_overflows(small=1.0):
    rng = np.random.default_rng(10)
    start, faces = soup(rng, 60, 0.05)
    start *= small
    start[:3] = [[-1.7e308] * 3, [1.7e308] * 3, [0, 1.7e308, 0]]
    return single(start, faces), start, start


def fast_flight():
    rng = np.random.default_rng(11)
    mesh, start, _ = crowd(rng, num_faces=60, size=0.02)
    return mesh, start, start + rng.uniform(-3, 3, (60, 1, 3)).repeat(3, axis=1).reshape(-1, 3)


def cables():
    rng = np.random.default_rng(12)
    mesh = ccd.CollisionMesh.from_arrays(
        [cables_and_particles(rng, 20, 0.15), cables_and_particles(rng, 10, 0.3)], codimensional_points=True, static=[1]
    )
    end = mesh.vertices + 0.2 * rng.standard_normal(mesh.vertices.shape)
    return mesh, mesh.vertices, with_static_at_rest(mesh, mesh.vertices, end)


def worlds():
    _, mesh, start, end = cloth_and_ball_in_worlds(4)
    return mesh, start, end


def body_far_from_the_others():
    """A body that no other comes near has empty boxes."""
    mesh = ccd.CollisionMesh.from_arrays(
        [(TRIANGLE, FACE), (TRIANGLE + [0, 0, 1], FACE), (TRIANGLE + [100, 0, 0], FACE)], self_collision=False
    )
    return mesh, mesh.vertices, mesh.vertices - [0, 0, 2.0] * (mesh.vertex_body == 1)[:, None]


SCENES = {
    "crowd": lambda: crowd(np.random.default_rng(1), num_faces=150),
    "sheet over ball": sheet_over_ball,
    "sheet over floor": sheet_over_floor,
    "leaning stack": lambda: leaning_stack(25),
    "stack of bodies": lambda: (lambda mesh, start: (mesh, start, start + [0, 0, 0.3]))(*stacked(0.0, 0.1, 0.2, 5.0)),
    **{
        make.__name__.replace("_", " "): make
        for make in (
            two_sheets_that_cross,
            giant_face_among_small_ones,
            giants_of_every_size,
            boxes_on_the_faces_of_cells,
            points_alone,
            all_in_one_point,
            far_from_the_origin,
            two_clusters_far_apart,
            box_that_overflows,
            fast_flight,
            cables,
            worlds,
            body_far_from_the_others,
        )
    },
    "in the plane": lambda: crowd_in_plane(np.random.default_rng(13), static=["segments"]),
    **{f"box that overflows, {small}": lambda s=small: box_that_overflows(s) for small in (5e-324, 1e-100, 1e200)},
}


@pytest.mark.parametrize("name", SCENES)
def test_every_scene_has_the_same_pairs_and_results(name):
    mesh, start, end = SCENES[name]()
    check_results(mesh, start, end, length_scale=1.0)
    check_candidates(mesh, start, end)
    assert check_candidates(mesh, start, end, 1e-3, with_brute_force=mesh.num_worlds == 1) > 0


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_an_edge_over_three_cells_whose_rounded_length_is_that_of_one(axis):
    """It begins by less than a rounding below a face of the cells; at its upper end, two cells on, is a particle."""
    sides = np.float32(2.0) ** np.float32(-np.arange(8) / 4)  # as cells have them, and the floats beside those
    for upper in np.concatenate([np.nextafter(sides, np.float32(0)), sides, np.nextafter(sides, np.float32(2))]):
        edges = np.zeros((40, 3))  # the first one, and short ones far away, by which the cells are small
        edges[2:, (axis + 1) % 3] = np.repeat(np.arange(19) - 9, 2) / 8 + 0.5
        edges[3::2, axis] = 2.0**-10
        edges[0, axis], edges[1, axis] = -(2.0**-60), upper
        particle = np.where(np.arange(3) == axis, upper, 0.0)[None].astype(float)
        bodies = [(edges, NO_FACES, np.arange(40).reshape(-1, 2)), (particle, NO_FACES)]
        mesh = ccd.CollisionMesh.from_arrays(bodies, codimensional_points=True, self_collision=False)
        found = ccd.find_candidates(mesh, mesh.vertices, mesh.vertices, broad_phase="hash")
        assert found.point_segment.tolist() == [[40, 0]]


# --- at random ---


def random_body(rng):
    """Vertices and faces of a body of some odd kind, and perhaps codimensional edges."""
    count = int(rng.integers(1, 16))
    kind = rng.integers(8)
    if kind == 0:  # sizes over many orders of magnitude
        vertices, faces = soup(rng, count, 0.0)
        size = 10.0 ** -rng.uniform(0, rng.choice([2, 6, 20]), (count, 1, 1)) * rng.standard_normal((count, 3, 3))
        return vertices + size.reshape(-1, 3), faces
    if kind == 1:  # on a lattice, so that corners lie on the faces of cells
        vertices = rng.integers(0, 6, (3 * count, 3)) / 2.0 ** rng.integers(0, 8)
        return vertices, np.arange(3 * count).reshape(-1, 3)
    if kind == 2:  # shared vertices, and faces without area
        vertices, faces = soup(rng, count, rng.choice([0.03, 0.3]), num_vertices=int(rng.integers(3, 3 * count + 1)))
        return vertices, faces
    if kind == 3:
        return cables_and_particles(rng, max(1, count // 4), rng.choice([0.05, 0.5]))
    if kind == 4:  # points and needles
        vertices = np.repeat(rng.random((count, 1, 3)), 3, axis=1)
        vertices[:, 2] += rng.choice([0.0, 1e-9, 1.0], (count, 1)) * rng.standard_normal((count, 3))
        return vertices.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)
    if kind == 5:
        vertices, faces = sheet(int(rng.integers(1, 4)), rng.choice([0.2, 1.0]))
        return vertices + rng.random(3) * [0.5, 0.5, 0.2], faces
    vertices, faces = soup(rng, count, rng.choice([1e-3, 0.05, 0.2, 1.0]))
    if kind == 6:  # a giant
        vertices[:3] = rng.choice([10.0, 1e3, 1e9]) * rng.standard_normal((3, 3))
    return vertices, faces


def random_filter(rng, num_bodies):
    """Arguments of a mesh that leave pairs out."""
    options = {"static": [b for b in range(num_bodies) if rng.random() < 0.3]}
    if rng.random() < 0.3:
        options["self_collision"] = (rng.random(num_bodies) < 0.5).tolist()
    if rng.random() < 0.2:
        allowed = rng.random((num_bodies, num_bodies)) < 0.6
        options["body_pairs"] = allowed & allowed.T
    if rng.random() < 0.2:
        options["exclusion_rings"] = int(rng.integers(1, 4))
    if rng.random() < 0.2:
        options["exclude_pairs"] = {"bodies": [(0, num_bodies - 1)], "edge_edge": [(0, 1)], "vertex_face": [(1, 0)]}
    return options


def random_scene(seed):
    """A mesh, start and end positions, and options of `mesh_ccd`."""
    rng = np.random.default_rng(seed)
    bodies = [random_body(rng) for _ in range(rng.integers(1, 4))]
    if rng.random() < 0.15:  # a second body in the place of the first
        bodies.append(bodies[0])
    options = random_filter(rng, len(bodies))
    if min(len(faces) for _, faces, *_ in bodies) == 0 or sum(len(body[0]) for body in bodies) < 6:
        options.pop("exclude_pairs", None)
    if rng.random() < 0.2:
        options["codimensional_points"] = True
    try:
        mesh = ccd.CollisionMesh.from_arrays(bodies, **options)
    except ValueError:  # the listed pairs are not all there
        options.pop("exclude_pairs")
        mesh = ccd.CollisionMesh.from_arrays(bodies, **options)
    start = mesh.vertices.copy()
    if rng.random() < 0.1:
        mesh = mesh.replicate(int(rng.integers(2, 6)))
        start = np.tile(start, (mesh.num_worlds, 1))
    speed = rng.choice([0.0, 0.01, 0.1, 1.0, 20.0])
    end = start + speed * rng.standard_normal(start.shape) + rng.choice([0.0, 3.0]) * rng.standard_normal(3)
    if rng.random() < 0.2:
        end[rng.random(len(end)) < 0.5] = start[0]
    place = rng.random()
    if place < 0.1:
        start, end = start + [1e7, -1e7, 1e6], end + [1e7, -1e7, 1e6]
    elif place < 0.2:
        scale = rng.choice([1e-310, 1e-150, 1e150, 1e298])
        start, end = start * scale, end * scale
    elif place < 0.25:
        end[rng.integers(len(end))] = rng.choice([1e6, 1e100, -1.7e308])
    mesh_options = {"t_max": float(rng.choice([1.0, 1.0, 0.3]))}
    if rng.random() < 0.3:
        mesh_options["minimum_separation"] = float(rng.choice([1e-6, 0.01, 0.5]))
    return mesh, start, with_static_at_rest(mesh, start, end), mesh_options


@pytest.mark.parametrize("seed", range(2000, 2012))
def test_random_scenes_have_the_same_launches(seed):
    mesh, start, end, options = random_scene(seed)
    options["t_max"] = 1.0  # line searches look at whole steps
    tree, grid = (ccd.CollisionPipeline(mesh, broad_phase=name, **CAPACITIES, **options) for name in BOTH)
    for per in (None, "scene", "body", "vertex"):
        left = []
        for pipeline in (tree, grid):
            x, y = on_device(start), on_device(end)
            result = pipeline.launch(x, y) if per is None else pipeline.launch_line_search(x, y, per=per)
            left.append(outputs_of(result, "launch") | {"end": y.numpy()})
        assert different(*left) == []


@pytest.mark.parametrize("block", marked(range(5), [0]))
def test_a_hundred_random_scenes_have_the_same_pairs(block):
    found = 0
    for seed in range(100 * block, 100 * block + 100):
        mesh, start, end, options = random_scene(seed)
        found += check_results(mesh, start, end, **options)
        if seed % 5 == 0:
            check_candidates(mesh, start, end, with_brute_force=mesh.exclusion_rings == 1)
    assert found > 1000


def bodies_in_one_place(rng, num_bodies):
    """Bodies of all kinds and roles in one place, of which few or many may meet."""
    bodies = [random_body(rng) for _ in range(num_bodies)]
    may = rng.random((num_bodies, num_bodies)) < rng.choice([0.0, 0.05, 0.3, 0.9])
    kind = rng.integers(4)
    if kind == 0:  # those of one scene
        of_scene = rng.integers(0, 1 + num_bodies // 2, num_bodies)
        may = of_scene[:, None] == of_scene
    elif kind == 1:  # those of two teams, and what all may meet
        team = rng.integers(0, 3, num_bodies)
        may = (team[:, None] != team) | (team == 2)
    roles = rng.choice(3, num_bodies, p=rng.choice([[1, 0, 0], [0.5, 0.2, 0.3]]))
    ignoring = np.flatnonzero(rng.random(num_bodies) < 0.3)
    listed = np.concatenate([rng.integers(0, num_bodies, (num_bodies // 3, 2)), np.stack([ignoring, ignoring], 1)])
    mesh = ccd.CollisionMesh.from_arrays(
        bodies,
        static=np.flatnonzero(roles == 1).tolist(),
        kinematic=np.flatnonzero(roles == 2).tolist(),
        body_pairs=may | may.T if kind < 3 else None,
        exclude_pairs={"bodies": listed} if rng.random() < 0.5 else None,
        self_collision=(rng.random(num_bodies) < 0.5).tolist(),
        codimensional_points=True,
    )
    end = mesh.vertices + rng.choice([0.0, 0.1, 1.0]) * rng.standard_normal(mesh.vertices.shape)
    return mesh, mesh.vertices, with_static_at_rest(mesh, mesh.vertices, end)


@pytest.mark.parametrize("most_rows", [1 << 10, 3])
def test_bodies_that_may_not_meet_in_one_place(most_rows, monkeypatch):
    """In a table of few rows several groups share one."""
    monkeypatch.setattr(body_groups, "_MOST_ROWS", most_rows)
    rng, found = np.random.default_rng(most_rows), 0
    for _ in range(15):
        found += check_candidates(*bodies_in_one_place(rng, int(rng.integers(2, 30))), with_brute_force=True)
    assert found > 1000


def test_what_may_not_meet_changes_no_result_by_being_skipped(monkeypatch):
    rng = np.random.default_rng(3)

    def results(mesh, start, end, broad_phase):
        pipeline = ccd.CollisionPipeline(mesh, broad_phase=broad_phase, minimum_distance=0.01, **CAPACITIES)
        result = pipeline.mesh_ccd(start, end)
        options = {"broad_phase": broad_phase, "minimum_distance": 0.01, "num_threads": 3}
        limited, limit = None, 1
        while limited is None:
            try:
                limited = ccd.mesh_ccd(mesh, start, end, memory_limit=limit, **options)
            except ValueError as error:
                limit = int(re.search(r"at least (\d+)", str(error))[1])
        y = on_device(end)
        launched = outputs_of(pipeline.launch_line_search(on_device(start), y), "launch") | {"end": y.numpy()}
        near = pipeline.find_proximity(start, 0.05)
        counts = result.counts.num_candidates, result.counts.num_after_cull
        crossing = pipeline.find_intersections(start)
        arrays = [*as_bytes(result), *as_bytes(limited), near.distance.tobytes(), near.primitives.tobytes()]
        arrays += [crossing.kind.tobytes(), crossing.primitives.tobytes()]
        return arrays, counts, launched

    for num_bodies in (5, 60):
        scene = bodies_in_one_place(rng, num_bodies)
        for name in BOTH:
            *skipped, launched = results(*scene, name)
            with monkeypatch.context() as patched:
                patched.setattr(body_groups.BodyGroups, "of", lambda mesh: None)
                *expected, all_launched = results(copy.copy(scene[0]), *scene[1:], name)
            assert skipped == expected and different(launched, all_launched) == []


@pytest.mark.parametrize("name", BOTH)
def test_bodies_that_may_not_meet_in_one_place_are_not_compared(name):
    """Twice as many bodies, each of which meets itself alone or one other, are twice the work, not four times."""
    vertices, faces = sphere(80, 1.0)

    def num_compared(num_bodies, each):
        scene = np.arange(num_bodies) // each
        may = scene[:, None] == scene
        mesh = ccd.CollisionMesh.from_arrays([(vertices, faces)] * num_bodies, body_pairs=may, self_collision=each == 1)
        topology = Topology.of(mesh, wp.get_device("cpu"))
        topology.collision_filter.applies = 0  # so that all pairs are counted of boxes that the search compares
        found = ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices, broad_phase=name)
        return sum(found.counts.num_candidates.values())

    for each in (1, 2):
        assert num_compared(80, each) < 2.4 * num_compared(40, each)


def test_sets_of_bodies_that_may_not_meet_are_not_searched():
    vertices, faces = sphere(80, 1.0)
    may = np.zeros((4, 4), dtype=bool)
    may[3] = may[:, 3] = True
    bodies = [(vertices, faces)] * 3 + [(vertices - [0, 0, 3], faces)]
    mesh = ccd.CollisionMesh.from_arrays(bodies, static=[3], body_pairs=may, self_collision=False)
    result = ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices - [0, 0, 2] * (mesh.vertex_body < 3)[:, None])
    assert result.counts.num_searches[ccd.PairKind.EDGE_EDGE] == 1 and result.body_toi.tolist() == [result.toi] * 4


def test_points_far_beyond_the_ends_of_the_grid_are_searched_one_by_one():
    """They stand in one row of cells there, and the box around them covers any number of coarser ones."""
    rng = np.random.default_rng(0)
    points = 1.7e308 * rng.uniform(-1.0, 1.0, (120, 3))
    motion = 10.0 ** rng.uniform(301, 307, (120, 1)) * rng.standard_normal((120, 3)) * (np.arange(120) % 2)[:, None]
    mesh = ccd.CollisionMesh.from_arrays([(points, np.zeros((0, 3), dtype=int))], codimensional_points=True)
    end = np.clip(points + motion, -1.7e308, 1.7e308)
    tree, grid = (ccd.mesh_ccd(mesh, points, end, broad_phase=name) for name in ("tree", "hash"))
    assert grid.counts.num_candidates == tree.counts.num_candidates and grid.toi == tree.toi


# --- limits, threads, loops ---


def test_a_large_mesh_is_sorted_by_several_threads_and_sampled_first():
    upper, faces = sheet(160)
    lower, lower_faces = sheet(120, 1.1)
    mesh = ccd.CollisionMesh.from_arrays([(upper + [0.003, 0.001, 0.05], faces), (lower, lower_faces)], static=[1])
    end = mesh.vertices - [0, 0, 0.1] * (mesh.vertex_body == 0)[:, None]
    assert mesh.num_vertices > 1 << 14
    step = ccd.collision_free_step(mesh, mesh.vertices, end)
    for num_threads in (1, 4):
        options = {"broad_phase": "hash", "num_threads": num_threads}
        assert ccd.collision_free_step(mesh, mesh.vertices, end, **options) == step < 1


def test_a_loop_in_which_everything_changes():
    """Speeds, places of static bodies, kinds of calls: nothing of an earlier step stays where it should not."""
    mesh, start, end = sheet_over_ball()
    pipeline = ccd.CollisionPipeline(mesh, broad_phase="hash")
    expected = ccd.CollisionPipeline(mesh)
    rng = np.random.default_rng(4)
    for k in range(12):
        a = start * rng.choice([1.0, 1.0, 30.0]) + rng.standard_normal(3) * (mesh.vertex_body == 1)[:, None] * (k % 3)
        b = a + (end - start) * rng.choice([0.01, 1.0, 40.0])
        assert as_bytes(pipeline.mesh_ccd(a, b)) == as_bytes(expected.mesh_ccd(a, b))
        if k % 2:
            assert pipeline.collision_free_step(a, b) == expected.collision_free_step(a, b)
        found = pipeline.find_candidates(a, b), expected.find_candidates(a, b).sorted()
        assert all(map(np.array_equal, *(vars(each).values() for each in found)))


# --- on the device ---
