"""Line searches: how far each unit goes, what stops whom and is named, and gaps that are lost in rounding."""

import numpy as np
import pytest
import trimesh
import warp as wp
from exact import exact_contacts
from laws.calls import EVERY_PER
from scenes import FACE, TRIANGLE, stacked, triangles

import ccd_warp as ccd
from ccd_warp._engine.device.input import LineSearch
from ccd_warp._engine.device.line_search import passes_of
from ccd_warp._results.pairs import pair_vertices

every_per = pytest.mark.parametrize("per", EVERY_PER)


def launched(mesh, start, end, dtype=wp.vec3d, **options):
    """Start and end positions of a line search on the device, as they are there, and its result."""
    real = np.float64 if dtype is wp.vec3d else np.float32
    x, y = (wp.array(positions.astype(real), dtype=dtype) for positions in (start, end))
    of_pipeline = {name: options.pop(name) for name in ("precision", "max_pairs") if name in options}
    result = ccd.CollisionPipeline(mesh, **of_pipeline).launch_line_search(x, y, **options)
    return x.numpy().astype(np.float64), y.numpy().astype(np.float64), result.to_host()


def num_touching(mesh, start, end, **options):
    """Contacts of vertices that move, by `mesh_ccd` on the host."""
    corners = pair_vertices(mesh, ccd.mesh_ccd(mesh, start, end, **options).contacts)
    return int((start[corners] != end[corners]).any(axis=(1, 2)).sum())


# --- how far each unit goes ---


@every_per
@pytest.mark.parametrize("safety", [0.5, 0.9, 0.999])
def test_one_body_falls_on_another(per, safety):
    mesh, start = stacked(0.0, 1.0)
    end = start - [0, 0, 2.0] * (mesh.vertex_body == 1)[:, None]
    step = ccd.line_search(mesh, start, end, per=per, safety=safety)
    assert exact_contacts(mesh, start, step.vertices) == {}
    assert step.fraction == pytest.approx(0.5 * safety, rel=1e-9)  # the toi is a half, up to rounding
    for dtype in (wp.vec3d, wp.vec3f):
        before, after, _ = launched(mesh, start, end, dtype, per=per, safety=safety)
        assert exact_contacts(mesh, before, after) == {}
        assert after[3:, 2].min() == pytest.approx(1.0 - safety, rel=1e-6 if safety < 0.99 else 1e-3)
        assert np.array_equal(after[:3], before[:3]) and np.array_equal(after[:, :2], before[:, :2])  # in all bits
    free = ccd.line_search(mesh, start, start + 0.1, per=per)
    assert free.num_rounds == 1 and free.fraction == 1.0 and not free.is_limited and len(free.touching) == 0


@every_per
def test_a_body_of_two_worlds_that_one_stops_is_looked_at_in_the_other(per):
    """In one world a body is stopped by a face; in the other it would then stand in the way of what follows it."""
    layers = [TRIANGLE + [0.1 * k, 0.07 * k, z] for k, z in enumerate((1.0, 0.0, 1.0, 1.5))]
    bodies = [(layers[1], FACE), (np.vstack(layers[::2]), [[0, 1, 2], [3, 4, 5]]), (layers[3], FACE)]
    mesh = ccd.CollisionMesh.from_arrays(bodies, vertex_world=[0] * 6 + [1] * 6)
    wished = mesh.vertices - np.repeat([[0, 0, 0], [0, 0, 2.0], [0, 0, 2.3]], [3, 6, 3], axis=0)
    assert np.isinf(ccd.mesh_ccd(mesh, mesh.vertices, wished).world_toi).tolist() == [False, True]
    frames = mesh, mesh.vertices, wished
    for reached in (ccd.line_search(*frames, per=per).vertices, launched(*frames, per=per)[1]):
        assert (mesh.vertices != reached).any() and num_touching(mesh, mesh.vertices, reached) == 0


# --- with too few rounds, or pairs ---


def test_a_world_whose_search_takes_too_long_moves_by_one_fraction_and_does_not_hold_others():
    rng = np.random.default_rng(3)
    one, start = triangles(rng, 8)
    end, count = start + rng.uniform(-2, 2, start.shape), len(start)
    both = np.stack([start, start]), np.stack([end, start + 0.25])
    step = ccd.line_search(one.replicate(2), *both, per="vertex", max_rounds=3)
    assert step.is_limited and step.num_rounds <= 3 and len(set(step.vertex_fraction[:count])) == 1
    assert step.vertex_fraction[0] < 1.0 and (step.vertex_fraction[count:] == 1.0).all()
    assert exact_contacts(one, start, step.vertices[:count]) == {}


def test_a_search_that_takes_too_long_leaves_bodies_of_free_worlds_where_they_were_found_free():
    """A is stopped in world 0, so in world 1 E runs into it, which holds A back in world 0, where B runs into it; B has
    a part in world 2, where D follows it: held back there in the last round, it would be in the way of D."""
    layers = [  # body, world, height at the start, at the end
        *(("wall", 0, 0.0, 0.0), ("A", 0, 1.0, -1.0), ("A", 1, 1.0, -1.0), ("B", 0, 1.1, 0.05), ("B", 2, 1.0, -1.0)),
        *(("E", 1, 1.5, -0.8), ("D", 2, 1.5, -0.8)),
    ]
    names, world, low, high = map(np.array, zip(*layers, strict=True))
    parts = [TRIANGLE + [0.05 * k, 0.04 * k, height] for k, height in enumerate(low)]
    bodies = [np.vstack([part for part, of in zip(parts, names, strict=True) if of == n]) for n in dict.fromkeys(names)]
    bodies = [(x, np.arange(len(x)).reshape(-1, 3)) for x in bodies]
    mesh = ccd.CollisionMesh.from_arrays(bodies, vertex_world=np.repeat(world, 3))
    end = np.column_stack([mesh.vertices[:, :2], np.repeat(high, 3)])
    step = ccd.line_search(mesh, mesh.vertices, end, per="body", max_rounds=3)
    assert step.is_limited and num_touching(mesh, mesh.vertices, step.vertices) == 0
    assert (step.vertices != mesh.vertices).any()


@pytest.mark.parametrize("per", ["body", "vertex"])
def test_a_line_search_on_the_device_has_as_many_passes_as_it_is_given(per):
    for num_rounds in (3, 4, 5, 20):
        passes = passes_of(LineSearch.of(per, num_rounds))
        assert len(passes) == num_rounds and [of for of, _ in passes[-2:]] == ["world", "world"]


def test_without_capacity_for_pairs_nothing_moves_into_another():
    rng = np.random.default_rng(0)
    mesh, start = triangles(rng, 6)
    wished = start + rng.uniform(-1, 1, start.shape)
    for per in EVERY_PER:
        for max_pairs, flag in ((1, ccd.LaunchFlag.PAIRS_OVERFLOW), (1000, 0)):
            _, reached, result = launched(mesh, start, wished, per=per, max_pairs=max_pairs)
            assert exact_contacts(mesh, start, reached) == {} and result.flags == flag


@pytest.mark.parametrize("name", [*EVERY_PER, "launch", "proximity", "bounds"])
def test_twice_what_was_counted_is_enough_after_two_rounds(name):
    cloth, ball = trimesh.creation.box((1, 1, 0.1)).subdivide().subdivide(), trimesh.creation.icosphere(radius=0.3)
    for radius in (None, [0.02, 0.0]):
        mesh = ccd.CollisionMesh.from_trimesh([cloth, ball], static=[1], radius=radius, self_collision=False)
        start = mesh.vertices + [0, 0, 0.36] * (mesh.vertex_body == 0)[:, None]  # within the radii
        wished = start - [0, 0, 0.5] * (mesh.vertex_body == 0)[:, None]
        call = {
            "launch": lambda pipeline, x=start, y=wished: pipeline.launch(x, y),
            "proximity": lambda pipeline, x=start: pipeline.launch_proximity(x, 0.1),
            "bounds": lambda pipeline, x=start: pipeline.launch_displacement_bounds(x, 0.1),
        }.get(name, lambda pipeline, x=start, y=wished: pipeline.launch_line_search(x, y.copy(), per=name))
        small, large = (ccd.CollisionPipeline(mesh, max_pairs=n, max_contacts=n) for n in (16, 1 << 18))
        num_rounds, result = 0, call(small)
        while (flags := ccd.LaunchFlag(int(result.flags.numpy()[0]))) and num_rounds < 3:
            of_pairs = ccd.LaunchFlag.PAIRS_OVERFLOW in flags
            counted = getattr(result, "contacts", result).count if not of_pairs else result.num_pairs
            small.reserve(**{"max_pairs" if of_pairs else "max_contacts": 2 * int(counted.numpy().max())})
            num_rounds, result = num_rounds + 1, call(small)
        assert not flags and num_rounds in (1, 2) and repr(result.to_host()) == repr(call(large).to_host())


# --- gaps that are lost in rounding ---


def cloth_on_a_ball(gap):
    """A cap of the ball as a cloth, one to two gaps outside it, that wishes to go into it by 0.1 and a little aside."""
    ball = trimesh.creation.icosphere(subdivisions=3)
    vertices, faces = np.asarray(ball.vertices), np.asarray(ball.faces)
    used, of_cloth = np.unique(faces[(vertices[faces][:, :, 2] > 0.75).all(axis=1)], return_inverse=True)
    cloth = vertices[used] * (1 + gap * np.random.default_rng(0).uniform(1, 2, (len(used), 1)))
    mesh = ccd.CollisionMesh.from_arrays([(cloth, of_cloth.reshape(-1, 3)), (vertices, faces)], static=[1])
    return mesh, mesh.vertices, mesh.vertices + np.outer(mesh.vertex_body == 0, [0.03, 0.006, -0.1])


@every_per
@pytest.mark.parametrize("gap", [1e-6, 1e-7, 1e-8])
def test_cloth_that_is_close_to_a_ball_moves_on(per, gap):
    mesh, start, end = cloth_on_a_ball(gap)
    exact = ccd.mesh_ccd(mesh, start, end).toi
    assert exact > 0 and ccd.mesh_ccd(mesh, start, end, precision="float32").toi == 0
    step = ccd.line_search(mesh, start, end, per=per, precision="float32")
    assert step.fraction > (0.1 * exact if per != "vertex" else 0.0)
    assert step.vertex_fraction[mesh.moving_vertices].mean() > 0.1 * exact
    assert len(step.touching) == 0 and not step.is_limited and step.num_rounds <= 6
    if gap > 1e-8:
        _, reached, result = launched(mesh, start, end, per=per, precision="float32", max_pairs=100_000)
        moved = np.linalg.norm(reached - start, axis=1)[mesh.moving_vertices]
        assert moved.min() > 0 and moved.mean() > 0.05 * exact * 0.1 and num_touching(mesh, start, reached) == 0
        assert result.toi == np.inf and result.flags == 0
    if gap == 1e-6:  # in float64 a step of a million times that length, and a gap of a ten-thousandth
        mesh, start, end = cloth_on_a_ball(1e-4 * gap)
        far = end + 1e6 * (end - start)
        step = ccd.line_search(mesh, start, far, per=per)
        assert ccd.mesh_ccd(mesh, start, far).toi == 0 < step.fraction and len(step.touching) == 0
        mesh, start, end = cloth_on_a_ball(1e3 * gap)  # a toi above 0 costs no round more
        step = ccd.line_search(mesh, start, end, per=per, precision="float32")
        assert 0 < step.fraction < 1 and (step.num_rounds == 2 or per in ("world", "body"))


@every_per
def test_a_search_without_rounds_to_shorten_says_what_stopped_it(per):
    mesh, start, end = cloth_on_a_ball(1e-8)
    step = ccd.line_search(mesh, start, end, per=per, precision="float32", max_rounds=3)
    corners = step.touching.vertices
    assert step.fraction == 0 and len(corners) > 0 and (start[corners] == step.vertices[corners]).all()
    assert (step.vertex_fraction[corners] == 0).any(axis=1).all()
    keys = np.column_stack([step.touching.kind, step.touching.primitives])  # each is named once, in order
    np.testing.assert_array_equal(keys, np.unique(keys, axis=0))


def test_pushes_again_and_again_neither_round_through_a_face_nor_stop_what_is_elsewhere():
    """Where float32 has steps of 6e-5 and the face lies between two of them: the step of one rounding is that again."""
    level = 1000.0 + 2e-5
    face = np.array([[-9, -9, level], [9, -9, level], [0, 9, level]])
    start = np.array([[0, 0, 1000.0625], [0.5, 0, 1000.0625], [0, 0.5, 1000.0625]], dtype=np.float32)
    mesh = ccd.CollisionMesh.from_arrays([(start, FACE), (face, FACE), (start + 50, FACE)], static=[1])
    x, y = (wp.array(np.concatenate([start, start + np.float32(50)]), dtype=wp.vec3f) for _ in range(2))
    pipeline = ccd.CollisionPipeline(mesh, minimum_separation=1e-7, length_scale=1.0)
    for _ in range(12):
        before = x.numpy().copy()  # rows of the moving vertices alone
        y.assign(np.concatenate([start - np.float32([0, 0, 1]), before[3:] + np.float32([0.25, 0, 0])]))
        assert pipeline.launch_line_search(x, y, per="vertex").toi.numpy()[0] == np.inf
        x.assign(y)
        assert (x.numpy()[:3, 2].astype(np.float64) > level).all()
        np.testing.assert_array_equal(x.numpy()[3:, 0] - before[3:, 0], 0.25)
    assert x.numpy()[:3, 2].min() < level + 2e-4
