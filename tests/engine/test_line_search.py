"""The step of a line search: certain to be free for the scene, for bodies and for vertices, by exact arithmetic."""

import numpy as np
import pytest
import trimesh
import warp as wp
from daily import marked
from oracles import exact_contacts, num_touching
from scenes import FACE, TRIANGLE, stacked, triangles, with_static_at_rest

import ccd_warp as ccd
from ccd_warp._engine.device import line_search as device_line_search
from ccd_warp._engine.device.step import DeviceStep
from ccd_warp._runtime.launch import Slot

EVERY_PER = ("scene", "world", "body", "vertex")
every_per = pytest.mark.parametrize("per", EVERY_PER)


def _launched(mesh, start, end, dtype=wp.vec3d, device="cpu", **options):
    """Start and end positions of a line search on the device, as they are there, and its result."""
    real = np.float64 if dtype is wp.vec3d else np.float32
    vertices_t0, vertices_t1 = (wp.array(x.astype(real), dtype=dtype, device=device) for x in (start, end))
    result = ccd.CollisionPipeline(mesh, length_scale=1.0, device=device).launch_line_search(
        vertices_t0, vertices_t1, **options
    )
    return vertices_t0.numpy().astype(np.float64), vertices_t1.numpy().astype(np.float64), result


@every_per
def test_nothing_in_the_way_moves_all_the_way(per):
    mesh, start = stacked(0.0, 1.0)
    end = start + [0.3, 0.2, 0.1]
    step = ccd.line_search(mesh, start, end, per=per)
    assert step.num_rounds == 1 and step.fraction == 1.0 and not step.is_limited
    assert np.array_equal(step.vertices, end)
    assert len(step.touching) == 0


@every_per
@pytest.mark.parametrize("safety", [0.5, 0.9, 0.999])
def test_one_body_falls_on_another(per, safety, device):
    mesh, start = stacked(0.0, 1.0)
    end = start.copy()
    end[3:, 2] -= 2.0
    step = ccd.line_search(mesh, start, end, per=per, safety=safety)
    assert exact_contacts(mesh, start, step.vertices) == []
    assert step.fraction == pytest.approx(0.5 * safety, rel=1e-9)  # the toi is a half, up to rounding
    if per != "vertex":  # one fraction for all that moves together
        for vertices in (slice(0, 3), slice(3, 6)) if per == "body" else (slice(0, 6),):
            assert len(set(step.vertex_fraction[vertices])) == 1
    begin, reached, _ = _launched(mesh, start, end, device=device, per=per, safety=0.5)
    assert exact_contacts(mesh, begin, reached) == []
    assert reached[3:, 2].min() == pytest.approx(0.5, rel=1e-9)


def test_a_vertex_that_is_stopped_stops_the_one_behind_it(device):
    """The first moves into a wall and the second follows it; the second alone has no contact in the original motion.

    Shortening each vertex by its own toi would leave the first in the way of the second.
    """
    mesh, start = stacked(0.0, 1.0, 2.0)
    end = start.copy()
    end[3:6, 2] = -0.9  # through the wall
    end[6:, 2] = 0.05  # ends between the wall and where the first is stopped, at a tenth above it
    naive = ccd.mesh_ccd(mesh, start, end).vertex_toi
    assert np.isinf(naive[6:]).all(), "the second touches nothing in the original motion"
    shortened = start + np.minimum(0.9 * naive, 1.0)[:, None] * (end - start)
    assert exact_contacts(mesh, start, shortened), "so the fractions of the tois alone do not do"
    for per in EVERY_PER:
        step = ccd.line_search(mesh, start, end, per=per)
        assert exact_contacts(mesh, start, step.vertices) == []
        assert step.fraction > 0
        _, reached, result = _launched(mesh, start, end, device=device, per=per)
        assert exact_contacts(mesh, start, reached) == []
        assert np.isinf(result.toi.numpy()[0]) and (reached[3:] != start[3:]).any(axis=1).all()


@every_per
@pytest.mark.parametrize("seed", range(6))
def test_random_soup_is_free_by_exact_arithmetic(per, seed, device):
    rng = np.random.default_rng(seed)
    mesh, start = triangles(rng, 6)
    end = start + rng.uniform(-1, 1, start.shape)
    step = ccd.line_search(mesh, start, end, per=per)
    assert exact_contacts(mesh, start, step.vertices) == []
    assert ((step.vertex_fraction >= 0) & (step.vertex_fraction <= 1)).all()
    for dtype in (wp.vec3d, wp.vec3f):
        begin, reached, result = _launched(mesh, start, end, dtype, device, per=per)
        assert exact_contacts(mesh, begin, reached) == []
        assert np.isinf(result.toi.numpy()[0]) and (begin != reached).all(axis=1).any()


def test_finer_fractions_move_more():
    mesh, start = stacked(0.0, 1.0, 5.0, 9.0)
    end = start.copy()
    end[3:6, 2] -= 2.0
    end[6:] += [1.0, 0, 0]
    moved = {per: ccd.line_search(mesh, start, end, per=per).vertex_fraction.sum() for per in EVERY_PER}
    assert moved["scene"] < moved["body"] <= moved["vertex"]


@every_per
def test_touching_at_the_start_holds_those_that_touch(per):
    bodies, start, end = _pushed_while_touching()
    mesh = ccd.CollisionMesh.from_arrays(bodies)
    step = ccd.line_search(mesh, start, end, per=per)
    assert len(step.touching) > 0 and not step.is_limited
    assert step.vertex_fraction[3] == 0.0
    assert np.array_equal(step.vertices[3], start[3])
    assert exact_contacts(mesh, start, step.vertices) == []
    if per in ("body", "vertex"):
        assert (step.vertex_fraction[6:] == 1.0).all()


def test_touching_at_the_start_and_leaving_is_stopped_too():
    """Contact at t = 0 counts even where the motion opens it, so such a pair is stopped and named."""
    bodies = [(TRIANGLE, FACE), (np.array([[0, 0, 0.0], [0.5, 0.2, 1], [-0.5, 0.2, 1]]), FACE)]
    start = np.concatenate([vertices for vertices, _ in bodies])
    mesh = ccd.CollisionMesh.from_arrays(bodies)
    end = start + np.where(np.arange(6)[:, None] >= 3, [0, 0, 1.0], 0.0)
    step = ccd.line_search(mesh, start, end, per="vertex")
    assert len(step.touching) > 0
    assert (step.vertices[3] == start[3]).all()


def test_static_bodies_stay_and_are_not_counted():
    ball = trimesh.creation.icosphere(subdivisions=1, radius=0.3)
    ground = trimesh.creation.box(extents=(4, 4, 0.2))
    mesh = ccd.CollisionMesh.from_trimesh([ball, ground], static=[1])
    start = np.concatenate([ball.vertices + [0, 0, 1], ground.vertices])
    end = with_static_at_rest(mesh, start, start + [0, 0, -1.0])
    step = ccd.line_search(mesh, start, end, per="body")
    assert np.array_equal(step.vertices[len(ball.vertices) :], start[len(ball.vertices) :])
    assert 0.5 < step.fraction < 0.9
    assert (step.vertex_fraction[len(ball.vertices) :] == 1.0).all()


def test_a_search_that_takes_too_long_moves_by_one_fraction_or_not_at_all():
    rng = np.random.default_rng(3)
    mesh, start = triangles(rng, 8)
    end = start + rng.uniform(-2, 2, start.shape)
    step = ccd.line_search(mesh, start, end, per="vertex", max_rounds=3)
    assert step.is_limited and step.num_rounds <= 3
    assert len(set(step.vertex_fraction)) == 1
    assert exact_contacts(mesh, start, step.vertices) == []


def test_a_world_whose_search_takes_too_long_does_not_hold_others():
    rng = np.random.default_rng(3)
    one, start = triangles(rng, 8)
    mesh = one.replicate(2)
    end = start + rng.uniform(-2, 2, start.shape)
    both = np.stack([start, start]), np.stack([end, start + 0.25])
    step = ccd.line_search(mesh, *both, per="vertex", max_rounds=3, length_scale=1.0)
    assert step.is_limited and len(set(step.vertex_fraction[: len(start)])) == 1
    assert step.vertex_fraction[0] < 1.0 and (step.vertex_fraction[len(start) :] == 1.0).all()


def test_the_held_object_gives_the_same():
    mesh, start = stacked(0.0, 1.0)
    end = start - [0, 0, 2.0] * (np.arange(6)[:, None] >= 3)
    pipeline = ccd.CollisionPipeline(mesh)
    one_shot, kept = ccd.line_search(mesh, start, end, per="vertex"), pipeline.line_search(start, end, per="vertex")
    assert np.array_equal(one_shot.vertices, kept.vertices)
    with pytest.raises(ValueError, match=r"t_max is 0\.5; expected 1"):
        ccd.CollisionPipeline(mesh, t_max=0.5).line_search(start, end)


@every_per
def test_stationary_coordinates_do_not_move_by_a_rounding(per):
    mesh, start = stacked(0.0, 1.0)
    start += np.random.default_rng(0).uniform(0.1, 0.3, start.shape) * [1, 1, 0]
    end = start.copy()
    end[3:, 2] -= 2.0
    for safety in (0.3, 0.7, 0.9):
        step = ccd.line_search(mesh, start, end, per=per, safety=safety)
        np.testing.assert_array_equal(step.vertices[:3], start[:3])
        np.testing.assert_array_equal(step.vertices[:, :2], start[:, :2])
        for dtype in (wp.vec3d, wp.vec3f):
            before, after, _ = _launched(mesh, start, end, dtype, per=per, safety=safety)
            np.testing.assert_array_equal(after[:3], before[:3])
            np.testing.assert_array_equal(after[:, :2], before[:, :2])


# --- on the device ---


def _pushed_while_touching():
    """A vertex lies exactly on a face and is pushed into it; a third body is free."""
    bodies = [(TRIANGLE, FACE), (np.array([[0, 0, 0.0], [0.5, 0.2, 1], [-0.5, 0.2, 1]]), FACE), (TRIANGLE + 5, FACE)]
    start = np.concatenate([vertices for vertices, _ in bodies])
    end = start.copy()
    end[3:6, 2] -= 0.5
    end[6:] += 1.0
    return bodies, start, end


def test_stationary_pairs_on_the_device_may_touch(device):
    bodies, start, wished = _pushed_while_touching()
    mesh = ccd.CollisionMesh.from_arrays(bodies)
    for per, free in (("scene", False), ("world", False), ("body", True), ("vertex", True)):
        _, end, result = _launched(mesh, start, wished, device=device, per=per)
        assert exact_contacts(mesh, start, end) == []
        np.testing.assert_array_equal(end[3], start[3])
        np.testing.assert_array_equal(end[6:], wished[6:] if free else start[6:])
        assert np.isinf(result.toi.numpy()[0])


def test_a_world_that_touches_does_not_stop_another(device):
    bodies, start, wished = _pushed_while_touching()
    mesh = ccd.CollisionMesh.from_arrays(bodies * 2, vertex_world=np.repeat([0, 1], 9))
    start, wished = np.concatenate([start, start]), np.concatenate([wished, wished])
    start[12:15, 2] += 0.01  # in the second world it is a little above, and goes up
    wished[12:15, 2] = start[12:15, 2] + 0.5
    for per, stops_both in (("scene", True), ("world", False)):
        _, end, _ = _launched(mesh, start, wished, device=device, per=per)
        np.testing.assert_array_equal(end[:9], start[:9])
        np.testing.assert_array_equal(end[9:], start[9:] if stops_both else wished[9:])


@pytest.mark.parametrize("per", ["world", "body", "vertex"])
def test_worlds_are_shortened_as_each_alone(per, device):
    rng = np.random.default_rng(5)
    bodies, starts, ends = [], [], []
    for _ in range(12):
        faces = [(rng.uniform(-1, 1, (3, 3)), FACE) for _ in range(2)]
        bodies.append(faces)
        starts.append(np.concatenate([vertices for vertices, _ in faces]))
        ends.append(starts[-1] + rng.uniform(-0.5, 0.5, starts[-1].shape))
    mesh = ccd.CollisionMesh.from_arrays([b for world in bodies for b in world], vertex_world=np.repeat(range(12), 6))
    _, together, result = _launched(mesh, np.concatenate(starts), np.concatenate(ends), device=device, per=per)
    assert np.isinf(result.world_toi.numpy()).all()
    num_shortened = 0
    for world, (start, end) in enumerate(zip(starts, ends, strict=True)):
        alone = ccd.CollisionMesh.from_arrays(bodies[world])
        _, expected, _ = _launched(alone, start, end, device=device, per=per)
        np.testing.assert_array_equal(together[6 * world : 6 * (world + 1)], expected)
        num_shortened += not np.array_equal(expected, end)
    assert 0 < num_shortened < 12


@pytest.fixture
def of_last_pass(monkeypatch):
    """Have ``num_pairs`` be those of the last pass, which shows what it has searched."""
    monkeypatch.setattr(DeviceStep, "_record_most_found", lambda *_: None)


def test_what_a_look_finds_free_has_no_pairs_in_the_next(device, of_last_pass):
    for seed in range(100):
        rng = np.random.default_rng(seed)
        mesh, _ = triangles(rng, 2)
        end = mesh.vertices + rng.uniform(-1, 1, mesh.vertices.shape)
        vertices_t0, vertices_t1 = (wp.array(x, dtype=wp.vec3d, device=device) for x in (mesh.vertices, end))
        pipeline = ccd.CollisionPipeline(mesh, length_scale=1.0, device=device)
        result = pipeline.launch(vertices_t0, vertices_t1)
        num_pairs = result.num_pairs.numpy().sum()
        if np.isinf(result.toi.numpy()[0]) and num_pairs > 0:
            break
    else:
        pytest.fail("no free step has pairs that the cull leaves open")
    pipeline.launch_line_search(vertices_t0, vertices_t1)
    assert np.isinf(result.toi.numpy()[0]) and result.num_pairs.numpy().sum() == 0
    np.testing.assert_array_equal(vertices_t1.numpy(), end)
    pipeline.launch(vertices_t0, vertices_t1)
    assert result.num_pairs.numpy().sum() == num_pairs


def _two_worlds_of_one_body():
    """In one world a body is stopped by a face; in the other it would then stand in the way of what follows it."""
    layers = [TRIANGLE + [0.1 * k, 0.07 * k, z] for k, z in enumerate((1.0, 0.0, 1.0, 1.5))]
    bodies = [(np.vstack([layers[0], layers[2]]), [[0, 1, 2], [3, 4, 5]]), (layers[1], FACE), (layers[3], FACE)]
    mesh = ccd.CollisionMesh.from_arrays(bodies, vertex_world=[0] * 3 + [1] * 3 + [0] * 3 + [1] * 3)
    wished = mesh.vertices.copy()
    wished[:6, 2] -= 2.0
    wished[9:, 2] -= 2.3
    return mesh, wished


@every_per
def test_a_body_of_two_worlds_that_one_stops_is_looked_at_in_the_other(per, device):
    mesh, wished = _two_worlds_of_one_body()
    free = ccd.mesh_ccd(mesh, mesh.vertices, wished, length_scale=1.0).world_toi
    assert np.isfinite(free[0]) and np.isinf(free[1])
    start, end, _ = _launched(mesh, mesh.vertices, wished, device=device, per=per)
    assert (start != end).any() and num_touching(mesh, start, end, length_scale=1.0) == 0


def test_a_world_that_another_shortens_is_checked_again(device, monkeypatch, of_last_pass):
    """One fraction for the scene moves worlds that were found free, too, and rounds them anew."""
    # without the pass between, so that the last pass finds the pairs of the motion that the first has shortened
    monkeypatch.setattr(device_line_search, "passes_of", lambda _: [("scene", Slot("safety")), ("world", 0.0)])
    for seed in range(100):
        rng = np.random.default_rng(seed)
        mesh, _ = triangles(rng, 4, vertex_world=np.repeat([0, 1], 6))
        vertices_t0 = wp.array(mesh.vertices, dtype=wp.vec3d, device=device)
        vertices_t1 = wp.array(mesh.vertices + rng.uniform(-1, 1, mesh.vertices.shape), dtype=wp.vec3d, device=device)
        pipeline = ccd.CollisionPipeline(mesh, length_scale=1.0, device=device)
        touched = np.isfinite(pipeline.launch(vertices_t0, vertices_t1).world_toi.numpy()).sum() == 1
        result = pipeline.launch_line_search(vertices_t0, vertices_t1, per="scene")
        looked_at = result.num_pairs.numpy().copy()
        there = pipeline.launch(vertices_t0, vertices_t1).num_pairs.numpy()
        if touched and there.sum() > 0:
            np.testing.assert_array_equal(looked_at, there)
            break
    else:
        pytest.fail("no such scene")


def _random_scene(rng):
    """Worlds of a few bodies, some of them static: the mesh and the desired end positions."""
    num_worlds, num_bodies = rng.integers(1, 5), rng.integers(1, 6)
    size, offset = 10.0 ** rng.uniform(-2, 0.5), rng.choice([0.0, 0.0, 10.0, 1000.0])
    bodies, ends, worlds = [], [], []
    for world in np.repeat(range(num_worlds), num_bodies):
        count = 3 * int(rng.integers(1, 4))
        vertices = rng.uniform(-1, 1, (1, 3)) + size * rng.normal(size=(count, 3)) + offset
        if rng.random() < 0.2:
            vertices = np.round(4 * vertices) / 4
        end = vertices + rng.normal(size=(1, 3)) * rng.choice([0, 0.1, 1])
        end = end + rng.normal(size=vertices.shape) * rng.choice([0, 0.05, 0.5])
        if rng.random() < 0.2:
            end[:, 2] = vertices[:, 2]
        bodies.append((vertices, np.arange(count).reshape(-1, 3)))
        ends.append(end)
        worlds += [world] * count
    mesh = ccd.CollisionMesh.from_arrays(
        bodies,
        static=np.flatnonzero(rng.random(len(bodies)) < 0.15).tolist(),
        self_collision=bool(rng.random() < 0.7),
        vertex_world=worlds if rng.random() < 0.7 else None,
    )
    return mesh, with_static_at_rest(mesh, mesh.vertices, np.concatenate(ends))


_OF_SEARCH = [(per, dtype) for per in EVERY_PER for dtype in (wp.vec3d, wp.vec3f)]


@pytest.mark.parametrize(("per", "dtype"), marked(_OF_SEARCH, [*_OF_SEARCH[::4], *_OF_SEARCH[3::4]]))
def test_random_scenes_are_free_whatever_the_capacity(per, dtype, device):
    rng = np.random.default_rng(EVERY_PER.index(per))
    num_moved = 0
    for _ in range(30):
        mesh, wished = _random_scene(rng)
        options = {"minimum_separation": rng.choice([0, 1e-6, 1e-3, 0.05]), "device": device}
        capacity = {"max_pairs": int(rng.choice([5, 100_000]))}
        pipeline = ccd.CollisionPipeline(mesh, length_scale=1.0, start_gap_fraction=None, **options, **capacity)
        real = np.float64 if dtype is wp.vec3d else np.float32
        vertices_t0, vertices_t1 = (
            wp.array(x.astype(real), dtype=dtype, device=device) for x in (mesh.vertices, wished)
        )
        pipeline.launch_line_search(vertices_t0, vertices_t1, per=per, num_rounds=int(rng.integers(3, 9)))
        start, end = (x.numpy().astype(np.float64) for x in (vertices_t0, vertices_t1))
        assert num_touching(mesh, start, end, length_scale=1.0, **options) == 0
        num_moved += (start != end).any()
    assert num_moved > 10


def test_coordinates_that_are_no_numbers_stop_their_world(device):
    mesh, start = stacked(0.0, 1.0)
    wished = start + [0.1, 0, 0]
    wished[4, 1] = np.nan
    _, end, result = _launched(mesh, start, wished, device=device, per="vertex")
    np.testing.assert_array_equal(end, start)
    assert result.flags.numpy()[0] == ccd.LaunchFlag.INVALID_INPUT and result.toi.numpy()[0] == 0.0


def test_without_capacity_for_pairs_nothing_moves_into_another(device):
    rng = np.random.default_rng(0)
    mesh, start = triangles(rng, 6)
    wished = start + rng.uniform(-1, 1, start.shape)
    vertices_t0, vertices_t1 = (wp.array(x, dtype=wp.vec3d, device=device) for x in (start, wished))
    pipeline = ccd.CollisionPipeline(mesh, length_scale=1.0, max_pairs=1, device=device)
    result = pipeline.launch_line_search(vertices_t0, vertices_t1, per="vertex")
    assert exact_contacts(mesh, start, vertices_t1.numpy()) == []
    assert result.flags.numpy()[0] == ccd.LaunchFlag.PAIRS_OVERFLOW
    pipeline.reserve(max_pairs=1000)
    vertices_t1.assign(wished)
    assert pipeline.launch_line_search(vertices_t0, vertices_t1, per="vertex").flags.numpy()[0] == 0


def _until_it_fits(pipeline, launch):
    """What a launch finds after the remedy of its flags, and how often that was needed."""
    for num_rounds in range(9):
        result = launch(pipeline)
        flags = ccd.LaunchFlag(int(result.flags.numpy()[0]))
        if ccd.LaunchFlag.PAIRS_OVERFLOW in flags:
            pipeline.reserve(max_pairs=2 * int(result.num_pairs.numpy().max()))
        elif ccd.LaunchFlag.CONTACTS_OVERFLOW in flags:
            is_launch = isinstance(result, ccd.LaunchResult)
            count = result.to_host().num_contacts if is_launch else int(result.count.numpy()[0])
            pipeline.reserve(max_contacts=2 * count)
        else:
            return result, num_rounds
    pytest.fail("the remedy does not end")


@pytest.mark.parametrize("radius", [None, [0.02, 0.0]], ids=["thin", "thick"])
@pytest.mark.parametrize("name", [*EVERY_PER, "launch", "proximity", "bounds"])
def test_twice_what_was_counted_is_enough_after_two_rounds(name, radius):
    cloth, ball = trimesh.creation.box((1, 1, 0.1)).subdivide().subdivide(), trimesh.creation.icosphere(radius=0.3)
    mesh = ccd.CollisionMesh.from_trimesh([cloth, ball], static=[1], radius=radius, self_collision=False)
    start = mesh.vertices + [0, 0, 0.36] * (mesh.vertex_body == 0)[:, None]  # within the radii
    wished = start - [0, 0, 0.5] * (mesh.vertex_body == 0)[:, None]
    ends = []

    def search(pipeline):
        ends.append(wished.copy())
        return pipeline.launch_line_search(start, ends[-1], per=name)

    launch = {
        "launch": lambda pipeline: pipeline.launch(start, wished),
        "proximity": lambda pipeline: pipeline.launch_proximity(start, 0.1),
        "bounds": lambda pipeline: pipeline.launch_displacement_bounds(start, 0.1),
    }.get(name, search)
    small, large = (ccd.CollisionPipeline(mesh, device="cpu", max_pairs=n, max_contacts=n) for n in (16, 1 << 18))
    result, num_rounds = _until_it_fits(small, launch)
    assert num_rounds in (1, 2)
    if name == "bounds":
        assert np.array_equal(result.to_host(), launch(large).to_host())
        return
    found, expected = result.to_host(), launch(large).to_host()
    assert repr(found) == repr(expected)
    if launch is search:
        # the first pass checks the step as a launch does
        first = large.launch(start, wished).to_host()
        assert np.array_equal(ends[-2], ends[-1]) and (radius is not None or not np.array_equal(ends[-1], start))
        assert found.num_contacts >= first.num_contacts > len(found.contacts)
        assert all(found.num_pairs[kind] >= count for kind, count in first.num_pairs.items())


def _triangle_over_a_face() -> tuple[ccd.CollisionMesh, np.ndarray, float]:
    """A triangle above a static face, where float32 has steps of 6e-5 and the face lies between two of them."""
    level = 1000.0 + 2e-5
    face = np.array([[-9, -9, level], [9, -9, level], [0, 9, level]])
    start = np.array([[0, 0, 1000.0625], [0.5, 0, 1000.0625], [0, 0.5, 1000.0625]], dtype=np.float32)
    return ccd.CollisionMesh.from_arrays([(start, FACE), (face, FACE)], static=[1]), start, level


def test_pushes_again_and_again_do_not_round_through_a_face(device):
    mesh, start, level = _triangle_over_a_face()
    vertices_t0, vertices_t1 = (wp.array(start, dtype=wp.vec3f, device=device) for _ in range(2))
    pipeline = ccd.CollisionPipeline(mesh, minimum_separation=1e-7, length_scale=1.0, device=device)
    for _ in range(8):
        vertices_t1.assign(start - np.float32([0, 0, 1]))  # rows of the moving vertices alone
        pipeline.launch_line_search(vertices_t0, vertices_t1, per="vertex")
        vertices_t0.assign(vertices_t1)
        assert (vertices_t0.numpy()[:, 2].astype(np.float64) > level).all()
    assert vertices_t0.numpy()[:, 2].min() < level + 2e-4


def test_a_vertex_one_rounding_from_a_face_does_not_stop_its_world(device):
    """Shortened by any share, its step of one rounding is that step again, so it has to be stopped."""
    mesh, start, _ = _triangle_over_a_face()
    face = mesh.vertices[3:]
    mesh = ccd.CollisionMesh.from_arrays([(start, FACE), (face, FACE), (start + 50, FACE)], static=[1])
    begin = np.concatenate([start, start + np.float32(50)])
    vertices_t0, vertices_t1 = (wp.array(begin, dtype=wp.vec3f, device=device) for _ in range(2))
    pipeline = ccd.CollisionPipeline(mesh, minimum_separation=1e-7, length_scale=1.0, device=device)
    for _ in range(12):
        before = vertices_t0.numpy().copy()
        vertices_t1.assign(np.concatenate([start - np.float32([0, 0, 1]), before[3:] + np.float32([0.25, 0, 0])]))
        result = pipeline.launch_line_search(vertices_t0, vertices_t1, per="vertex")
        assert np.isinf(result.toi.numpy()[0])
        np.testing.assert_array_equal(vertices_t1.numpy()[3:, 0] - before[3:, 0], 0.25)
        vertices_t0.assign(vertices_t1)


def test_rounding_afterwards_goes_through_the_face():
    """So the one above can fail: the line search on the host answers in float64, and float32 is another way."""
    mesh, start, level = _triangle_over_a_face()
    x = mesh.vertices.copy()
    for _ in range(8):
        wished = np.concatenate([start - np.float32([0, 0, 1]), mesh.vertices[3:]])
        x = ccd.line_search(mesh, x, wished, per="vertex", minimum_separation=1e-7, length_scale=1.0).vertices
        assert (x[:3, 2] > level).all()
        x[:3] = x[:3].astype(np.float32)
        if (x[:3, 2] <= level).any():
            return
    pytest.fail("rounding never crossed the face")


def test_part_of_a_step_is_no_line_search_on_the_device():
    mesh, start = stacked(0.0, 1.0)
    with pytest.raises(ValueError, match=r"t_max is 0.5; expected 1"):
        ccd.CollisionPipeline(mesh, t_max=0.5).launch_line_search(start, start)
