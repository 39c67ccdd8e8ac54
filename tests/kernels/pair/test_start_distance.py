"""What starts within its distance parts and slides freely, and comes no closer."""

import numpy as np
import pytest
import warp as wp
from laws.calls import EVERY_PER
from oracle import exact_gap
from scenes import FACE, NO_FACES, TRIANGLE, sheet
from slides import FACES, GROUND, slides_of

import ccd_warp as ccd

DISTANCE = 1e-3
NORMS = {
    "ball": {"minimum_distance": DISTANCE},
    "box": {"minimum_separation": DISTANCE, "length_scale": 1.0},
}
# In sizes of a pair, whose coordinates are no larger here: what a search may lose is a third of it.
LOST = 400 * 2.0**-53
every_norm = pytest.mark.parametrize("norm", NORMS)


def shortened_by_launch(pipeline, start, end, **arguments):
    """The end positions of a line search on the device, which is not to overflow."""
    given, reached = (wp.array(x.reshape(-1, 3), dtype=wp.vec3d) for x in (start, end))
    assert not pipeline.launch_line_search(given, reached, **arguments).flags.numpy().any()
    return reached.numpy().reshape(end.shape)


def ways(pipeline, start, end):
    """The end positions of a step by every call that shortens it, by name."""
    fraction = pipeline.collision_free_step(start, end)
    yield "step", end if fraction == 1.0 else start + fraction * (end - start)
    for per in EVERY_PER:
        yield f"line_search, {per}", pipeline.line_search(start, end, per=per).vertices
        yield f"launch_line_search, {per}", shortened_by_launch(pipeline, start, end, per=per)


def check_reached(pipeline, start, end, expected, *, but_not_by=()):
    """Every call reaches the expected positions, every number of which is the same."""
    for way, reached in ways(pipeline, start, end):
        if way not in but_not_by:
            np.testing.assert_array_equal(reached, expected, err_msg=way)


def of_second(start, motion):
    """The end positions where the second of two triangles moves, in all worlds."""
    return start + np.tile(np.repeat([[0.0, 0.0, 0.0], motion], 3, axis=0), (len(start) // 6, 1))


def two_triangles(*gaps, **options):
    """Two parallel triangles, the upper one above the lower one by a gap, a world for each gap: pipeline and start."""
    mesh = ccd.CollisionMesh.from_arrays([(TRIANGLE, FACE), (TRIANGLE + [0.0, 0.0, gaps[0]], FACE)])
    start = np.concatenate([x for gap in gaps for x in (TRIANGLE, TRIANGLE + [0.0, 0.0, gap])])
    return ccd.CollisionPipeline(mesh.replicate(len(gaps)), **options), start


@every_norm
def test_triangle_at_its_distance_parts_and_slides_and_does_not_approach(norm, precision):
    shares, options = (
        np.array([1.0, 0.9, 1e-3, 1 - 1e-12, 1 + 1e-15, 1 + 1e-7]),
        {"precision": precision, **NORMS[norm]},
    )
    pipeline, start = two_triangles(*shares * DISTANCE, **options)
    for motion in ([0.0, 0.0, 10 * DISTANCE], [0.3, 0.1, 0.0], [-0.7, 0.2, 1e-9]):
        end = of_second(start, motion)
        assert ((pipeline.mesh_ccd(start, end).world_toi == 0.0) | (shares > 1 + 1e-8)).all()  # it stays strict
        check_reached(pipeline, start, end, end)
    within, beyond = (two_triangles(*shares[at] * DISTANCE, **options) for at in (shares <= 1.0, shares > 1.0))
    for motion in ([0.0, 0.0, -10 * DISTANCE], [0.3, 0.0, -DISTANCE]):
        (pipeline, start), end = within, of_second(within[1], motion)
        check_reached(pipeline, start, end, start)
        assert {*pipeline.line_search(start, end, per="vertex").touching.world.tolist()} == {0, 1, 2, 3}
        for way, reached in ways(*beyond, of_second(beyond[1], motion)):
            # beyond the distance, the gap that is left may shrink by 90 %
            assert reached.reshape(-1, 6, 3)[:, 3:, 2].min() >= DISTANCE - LOST, f"{way}, by {motion}"


@every_norm
def test_tilted_triangle_that_float32_cannot_tell_from_its_distance_is_lifted(norm):
    sharp, start = two_triangles(0.3, **NORMS[norm])
    rng, worlds, fall = np.random.default_rng(0), [], of_second(0.0 * start, [0.0, 0.0, -0.6])
    for tilt in (1e-3, 0.1):
        above = start + np.repeat([0.0, tilt], 3)[:, None] * rng.normal(size=(6, 1)) * [0.0, 0.0, 1.0]
        above[3:, :2] += 0.05 * rng.normal(size=2)
        met = above + sharp.mesh_ccd(above, above + fall).toi * fall
        worlds += [met - beyond / 0.6 * fall for beyond in (3e-9, 3e-8, 3e-7)]
    pipeline, x = two_triangles(*[0.3] * 6, precision="float32", **NORMS[norm])[0], np.concatenate(worlds)
    end = of_second(x, [0.0, 0.0, 0.6])
    check_reached(pipeline, x, end, end)


@pytest.mark.parametrize("is_static", [True, pytest.param(False, marks=pytest.mark.long)])
def test_patch_slides_over_a_mesh_with_parallel_edges_in_any_direction_without_losing_height(is_static):
    ground, patch = sheet(40), sheet(5, 0.125)  # of sides of one length
    turns = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3, 3)))[0]
    for share, turn in zip((0.3, 0.999, 1.0), turns, strict=True):
        bodies = [(ground[0] @ turn, ground[1]), ((patch[0] + [0.1, 0.1, share * 0.01]) @ turn, patch[1])]
        mesh = ccd.CollisionMesh.from_arrays(bodies, static=[0] if is_static else [], radius=0.005)
        pipeline = ccd.CollisionPipeline(mesh, max_pairs=1 << 20, max_contacts=1 << 16)
        start = mesh.vertices
        for _ in range(3):
            end = start + (mesh.vertex_body == 1)[:, None] * ([0.21, 0.13, 0.0] @ turn)
            # a step does not know what it stops at, so a rounding beyond the distance may shorten it (`hold`)
            check_reached(pipeline, start, end, end, but_not_by=("step",))
            start = end


def test_edges_that_are_nearly_parallel_lose_no_more_than_rounding_in_the_maximum_norm():
    """Their normal is that of two sides, whose product is off by rounding over the sine of their angle."""
    rng, count = np.random.default_rng(0), 60
    angle = 10.0 ** -rng.uniform(4, 9, (count, 1))
    x = np.zeros((count, 4, 3))
    x[:, :, 0] = [-1, 1, -1, 1]
    x[:, 2:, 1], x[:, 2:, 2] = angle * [-1, 1], 0.01 * angle
    y = x.copy()
    y[:, 2:] += np.concatenate([rng.choice([-0.5, 0.1], (count, 2)), -0.4 * angle], axis=1)[:, None]
    turn = np.linalg.qr(rng.normal(size=(count, 3, 3)))[0]
    x, y = x @ turn, y @ turn
    cables = [(x[0, k : k + 2], NO_FACES, [[0, 1]]) for k in (0, 2)]
    mesh = ccd.CollisionMesh.from_arrays(cables, self_collision=False).replicate(count)
    pipeline = ccd.CollisionPipeline(mesh, minimum_separation=0.01, length_scale=1.0)
    reached = pipeline.line_search(x, y, per="world").vertices.reshape(x.shape)
    for world in range(count):
        before, after = (float(exact_gap("edge-edge", rows[world], rows[world], 0.0)) for rows in (x, reached))
        assert after >= before - 3 * LOST, world  # of a pair whose sides are 2 long


def test_segments_that_turn_as_they_part_are_decided_to_rounding_and_not_to_the_tolerance():
    """Of four thousand slides that are disturbed, some that part, exactly, and a tolerance takes for contacts."""
    _, start, end = slides_of(5, 4000, "segment", "radius")
    rng = np.random.default_rng(1)
    end[:, GROUND:] += rng.normal(size=(4000, 2, 3)) * 10.0 ** -rng.uniform(0, 9, (4000, 1, 1))
    for x, y in zip(start[[79, 532, 578, 837]], end[[79, 532, 578, 837]], strict=True):
        bodies = [(x[:GROUND], FACES), (x[GROUND:], NO_FACES, [[0, 1]])]
        mesh = ccd.CollisionMesh.from_arrays(bodies, static=[0], self_collision=False, radius=0.01)
        np.testing.assert_array_equal(ccd.line_search(mesh, x, y, tolerance=1e-2).vertices, y)


@pytest.mark.parametrize("precision", ["float64", pytest.param("float32", marks=pytest.mark.long)])
def test_ten_thousand_presses_lose_less_than_a_hundred_thousandth_of_the_thickness(precision):
    mesh = ccd.CollisionMesh.from_arrays([(TRIANGLE, FACE), (TRIANGLE + [0, 0, 1], FACE)]).replicate(100)
    pipeline = ccd.CollisionPipeline(mesh, precision=precision, **NORMS["ball"])
    rng = np.random.default_rng(0)
    x = np.tile(np.concatenate([TRIANGLE, TRIANGLE + [0, 0, DISTANCE]]), (100, 1, 1))
    before = x[:, 3:, 2].min()
    for _ in range(100):
        y = x.copy()
        y[:, 3:] += rng.normal(size=(100, 1, 3)) * [0.01, 0.01, 0.0] - [0.0, 0.0, 0.005]
        y[:, 3:] += 1e-4 * rng.normal(size=(100, 3, 3))
        x = pipeline.line_search(x, y, per="vertex").vertices.reshape(x.shape)
    assert x[:, 3:, 2].min() > before - 1e-5 * DISTANCE


def test_what_starts_deep_within_a_thick_body_stays_out_of_a_thin_one():
    """At a fiftieth of the thick one's distance, between it and a thin sheet that is pressed on."""
    thick, thin, rise = 0.1, 1e-3, [0.0, 0.0, 1.0]
    heights = np.array([0.0, 0.02 * thick, 0.02 * thick + 3 * thin])
    bodies = [(TRIANGLE + height * np.array(rise), FACE) for height in heights]
    radius = np.repeat([thick - thin / 2, thin / 2, thin / 2], 3)
    mesh = ccd.CollisionMesh.from_arrays(bodies, static=[0], exclude_pairs={"bodies": [(0, 2)]}, radius=radius)
    pipeline, x = ccd.CollisionPipeline(mesh), mesh.vertices
    down = np.where(mesh.vertex_body[:, None] == 2, -thick, 0.0) * rise
    for search in range(20):
        if search % 2:
            x = shortened_by_launch(pipeline, x, x + down, per="body")
        else:
            x = pipeline.line_search(x, x + down, per="body").vertices
    assert (x[3:6] == mesh.vertices[3:6]).all()
    assert thin - LOST <= (x[6:, 2] - x[3:6, 2]).min() < 1.01 * thin


@every_norm
def test_cable_slides_from_one_cable_to_the_next_without_losing_height(norm):
    """It is the second edge of both pairs, and takes along what it kept of the first."""
    across = np.array([[0.0, -1.0, 0.0], [0.0, 1.0, 0.0]])
    above = np.array([[-0.2, 0.0, 0.9 * DISTANCE], [0.2, 0.0, 0.9 * DISTANCE]])
    cables = [(x, NO_FACES, [[0, 1]]) for x in (across, across + [1.0, 0.0, 0.0], above)]
    mesh = ccd.CollisionMesh.from_arrays(cables)
    end = mesh.vertices + [1.0, 0.1, 0.0] * (mesh.vertex_body == 2)[:, None]
    pipeline = ccd.CollisionPipeline(mesh, **NORMS[norm])
    check_reached(pipeline, mesh.vertices, end, end)


# ---- Half-spaces -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("normal", [[0.0, 0.0, 1.0], [0.3, -0.4, 2.0]])
@pytest.mark.parametrize("gap", [0.0, 0.5 * DISTANCE, DISTANCE])
def test_vertex_over_a_half_space_leaves_it_and_slides_even_from_a_gap_of_0(normal, gap):
    unit = np.array(normal) / np.linalg.norm(normal)
    across = np.cross(unit, [1.0, 0.0, 0.0])
    mesh = ccd.CollisionMesh.from_arrays([(TRIANGLE, FACE), ccd.HalfSpace([0, 0, 0], normal)], self_collision=False)
    # with a gap of 0 all three vertices lie on the plane exactly, in one point
    start = np.outer([0.0, 1.0, 2.0], across) + gap * unit if gap else np.zeros((3, 3))
    is_flat = normal[:2] == [0.0, 0.0]
    for distance in (DISTANCE,) if gap else (0.0, DISTANCE):
        pipeline = ccd.CollisionPipeline(mesh, minimum_distance=distance)
        for motion in (unit, 0.1 * unit + across, *([[1.0, 0.5, 0.0]] if is_flat else [across] if gap else [])):
            check_reached(pipeline, start, start + motion, start + motion)
        check_reached(pipeline, start, start - unit, start)


@pytest.mark.parametrize("share", [1.0, 0.5])
def test_vertices_at_their_distance_over_a_tilted_half_space_slide_by_their_whole_step(share):
    rng = np.random.default_rng(3)
    unit = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    point, across = rng.normal(size=3), rng.normal(size=(2, 2000, 2)) @ unit[:2]
    start = point + across[0] + share * DISTANCE * unit[2]  # to within rounding, above and below
    mesh = ccd.CollisionMesh.from_arrays([(start, NO_FACES), ccd.HalfSpace(point, unit[2])])
    pipeline = ccd.CollisionPipeline(mesh, minimum_distance=DISTANCE)
    end = start + 0.3 * across[1]
    np.testing.assert_array_equal(pipeline.line_search(start, end, per="vertex").vertices, end)
    np.testing.assert_array_equal(shortened_by_launch(pipeline, start, end, per="vertex"), end)


def test_edge_beyond_the_capacity_at_the_start_does_not_let_a_point_come_closer_to_the_face_it_leaves():
    # Two edges slide at 0.9 of the distance. A third one, which leaves a face from beyond it, is among the pairs at the
    # start alone, for which there is no capacity.
    edge = np.array([[-0.5, 0.0, 0.0], [0.5, 0.0, 0.0]])
    across, point = edge[:, [1, 0, 2]], np.array([[0.0, -0.5, 0.5]])
    cables = [edge - [10, 0, 0], across + [-10, 0, 0.9 * DISTANCE], across + [0.05, -1, -(1 + 2e-7) * DISTANCE]]
    first, second, third = ((x, NO_FACES, [[0, 1]]) for x in cables)
    bodies = [first, second, (TRIANGLE, FACE), third, (point, NO_FACES)]
    mesh = ccd.CollisionMesh.from_arrays(bodies, codimensional_points=True)
    end = mesh.vertices.copy()
    end[2:4, 0] += 0.01
    end[7:9, 2] -= 0.5
    end[9, 2] = 0.3 * DISTANCE
    for max_pairs in (1, 100):
        pipeline = ccd.CollisionPipeline(mesh, max_pairs=max_pairs, **NORMS["ball"])
        reached = wp.array(end, dtype=wp.vec3d)
        pipeline.launch_line_search(wp.array(mesh.vertices, dtype=wp.vec3d), reached, per="vertex")
        assert reached.numpy()[9, 2] > DISTANCE
