"""What starts within its distance parts and slides freely, and comes no closer."""

import numpy as np
import pytest
import trimesh
import warp as wp
from oracle import exact_gap
from scenes import FACE, TRIANGLE, sheet
from slides import FACES, GROUND, SLIDERS, slides_of

import ccd_warp as ccd

DISTANCE = 1e-3
NORMS = {
    "ball": {"minimum_distance": DISTANCE},
    "box": {"minimum_separation": DISTANCE, "length_scale": 1.0},
}
# In sizes of a pair, whose coordinates are no larger here: what a search may lose is a third of it.
LOST = 400 * 2.0**-53
EVERY_PER = ("scene", "world", "body", "vertex")
NO_FACES = np.zeros((0, 3), dtype=int)
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
    """The end positions where the second of two triangles moves."""
    return start + np.repeat([[0.0, 0.0, 0.0], motion], 3, axis=0)


def two_triangles(gap, **options):
    """Two parallel triangles, the upper one above the lower one by a gap: pipeline and start."""
    start = np.concatenate([TRIANGLE, TRIANGLE + [0.0, 0.0, gap]])
    mesh = ccd.CollisionMesh.from_arrays([(start[:3], FACE), (start[3:], FACE)])
    return ccd.CollisionPipeline(mesh, **options), start


@every_norm
def test_triangle_at_its_distance_parts_and_slides_and_does_not_approach(norm, precision):
    pipeline, _ = two_triangles(DISTANCE, precision=precision, **NORMS[norm])
    for share in (1.0, 0.9, 1e-3, 1 - 1e-12, 1 + 1e-15, 1 + 1e-7):
        start = np.concatenate([TRIANGLE, TRIANGLE + [0.0, 0.0, share * DISTANCE]])
        for motion in ([0.0, 0.0, 10 * DISTANCE], [0.3, 0.1, 0.0], [-0.7, 0.2, 1e-9]):
            end = of_second(start, motion)
            assert pipeline.mesh_ccd(start, end).toi == 0.0 or share > 1 + 1e-8  # it stays strict
            check_reached(pipeline, start, end, end)
        for motion in ([0.0, 0.0, -10 * DISTANCE], [0.3, 0.0, -DISTANCE]):
            end = of_second(start, motion)
            if share <= 1.0:
                check_reached(pipeline, start, end, start)
                assert len(pipeline.line_search(start, end, per="vertex").touching)
            for way, reached in ways(pipeline, start, end) if share > 1.0 else ():
                # beyond the distance, the gap that is left may shrink by 90 %
                assert reached[3:, 2].min() >= DISTANCE - LOST, f"{way}, by {motion}"


@every_norm
def test_tilted_triangle_that_float32_cannot_tell_from_its_distance_is_lifted(norm):
    pipeline, start = two_triangles(0.3, precision="float32", **NORMS[norm])
    sharp, _ = two_triangles(0.3, **NORMS[norm])
    rng = np.random.default_rng(0)
    fall = of_second(0.0 * start, [0.0, 0.0, -0.6])
    for tilt in (1e-3, 0.1):
        above = start + np.repeat([0.0, tilt], 3)[:, None] * rng.normal(size=(6, 1)) * [0.0, 0.0, 1.0]
        above[3:, :2] += 0.05 * rng.normal(size=2)
        met = above + sharp.mesh_ccd(above, above + fall).toi * fall
        for beyond in (3e-9, 3e-8, 3e-7):
            x = met - beyond / 0.6 * fall
            check_reached(pipeline, x, x - fall, x - fall)


def test_none_stays_strict_and_a_number_shrinks_the_gap():
    strict, start = two_triangles(0.5 * DISTANCE, start_gap_fraction=None, **NORMS["ball"])
    end = of_second(start, [0.3, 0.0, 0.01])
    check_reached(strict, start, end, start)
    half, _ = two_triangles(0.5 * DISTANCE, start_gap_fraction=0.5, **NORMS["ball"])
    assert np.array_equal(half.line_search(start, end).vertices, end) and half.mesh_ccd(start, end).toi == np.inf


@pytest.mark.parametrize("is_static", [True, pytest.param(False, marks=pytest.mark.long)])
def test_patch_slides_over_a_mesh_with_parallel_edges_in_any_direction_without_losing_height(is_static):
    ground, patch = sheet(40), sheet(8)
    turns = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3, 3)))[0]
    for share, turn in zip((0.3, 0.999, 1.0), turns, strict=True):
        bodies = [(ground[0] @ turn, ground[1]), ((0.2 * patch[0] + [0.1, 0.1, share * 0.01]) @ turn, patch[1])]
        mesh = ccd.CollisionMesh.from_arrays(bodies, static=[0] if is_static else [], radius=0.005)
        pipeline = ccd.CollisionPipeline(mesh, max_pairs=1 << 20, max_contacts=1 << 16)
        start = mesh.vertices
        for _ in range(3):
            end = start + (mesh.vertex_body == 1)[:, None] * ([0.21, 0.13, 0.0] @ turn)
            # a step does not know what it stops at, so a rounding beyond the distance may shorten it (`hold`)
            check_reached(pipeline, start, end, end, but_not_by=("step",))
            start = end


@pytest.mark.parametrize("count", [1000, pytest.param(12000, marks=pytest.mark.long)])
@pytest.mark.parametrize("norm", ["radius", "minimum_distance", "minimum_separation"])
@pytest.mark.parametrize("slider", SLIDERS)
def test_random_slides_and_partings_go_all_the_way_in_any_frame(slider, norm, count):
    cases = {}, {"scale": 1e-3, "offset": 10.0}, {"scale": 1e3, "drifts": True}, {"offset": 10.0}
    for seed, case in enumerate(cases):
        pipeline, start, end = slides_of(seed, count, slider, norm, **case)
        on_host = pipeline.line_search(start, end, per="world").vertices.reshape(end.shape)
        for reached in (on_host, shortened_by_launch(pipeline, start, end, per="world")):
            assert (reached != end).any(axis=(1, 2)).sum() <= count / 10_000, case


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


@pytest.mark.parametrize("exponent", [-40, 0, 40])
@pytest.mark.parametrize("tolerance", [1e-12, 1e-6, 1e-1])
def test_pairs_at_their_distance_are_not_stuck_when_they_are_pulled_apart_at_any_scale(exponent, tolerance, precision):
    rng = np.random.default_rng(abs(exponent))
    count, scale = 50, 2.0**exponent
    # triangles one above the other, turned at random
    turn = np.linalg.qr(rng.normal(size=(count, 3, 3)))[0]
    lower, upper = rng.normal(size=(2, count, 3, 3)) * [1.0, 1.0, 0.0]
    upper[:, :, 2] += DISTANCE * rng.choice([1.0, 0.9, 0.1], size=(count, 1))
    x = scale * (np.concatenate([lower, upper], axis=1) @ turn)
    apart = np.zeros((count, 6, 3))
    apart[:, 3:] = 0.5 * turn[:, 2:3] + rng.normal(size=(count, 1, 2)) @ turn[:, :2]
    mesh = ccd.CollisionMesh.from_arrays([(x[0, :3], FACE), (x[0, 3:], FACE)]).replicate(count)
    options = {"minimum_distance": scale * DISTANCE, "length_scale": scale, "tolerance": tolerance}
    pipeline = ccd.CollisionPipeline(mesh, precision=precision, **options)
    y = x + scale * apart
    np.testing.assert_array_equal(pipeline.line_search(x, y, per="world").vertices.reshape(y.shape), y)
    np.testing.assert_array_equal(shortened_by_launch(pipeline, x, y, per="world"), y)


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


def sliding(name, share, frames):
    """Two bodies, the second of which slides at this share of the distance from the first, and where it is by frame.

    A sheet slides off a tilted table by its weight, and falls once it is past the edge; a rope is pulled through a ring
    as narrow as itself by a constant force; a piston swings on a spring in a bore, with its thickness around it.
    """
    gap, time, fall = share * DISTANCE, np.linspace(0.0, 1.0, frames + 1), 0.0
    if name == "sheet":
        table, cloth = sheet(20, 4.0), sheet(6, 1.2)
        bodies = [table, (cloth[0] + [-1.3, 0.0, gap], cloth[1])]
        along = 5.2 * time**2
        fall = -10.4 * np.maximum(time - time[np.searchsorted(along, 3.9 + 2 * DISTANCE)], 0.0) ** 2
    elif name == "rope":
        inner = gap / np.cos(np.pi / 24)  # the middles of its inner edges are nearer than its vertices
        ring = trimesh.creation.torus(0.1 + inner, 0.1, major_sections=24, minor_sections=12)
        links = np.stack([np.arange(60), np.arange(1, 61)], axis=1)
        rope = np.linspace(-5.5, 0.5, 61)[:, None] * [1.0, 0.0, 0.0]
        bodies = [(ring.vertices[:, [2, 0, 1]], ring.faces), (rope, NO_FACES, links)]
        along = 4.0 * time**2
    else:
        bodies = []
        for radius, half in ((1.0, 3.0), (1.0 - gap / np.cos(np.pi / 12), 0.75)):
            vertices, faces = sheet(12)
            turn = 2 * np.pi * vertices[:, 1]
            side = np.stack([2 * half * vertices[:, 0], radius * np.cos(turn), radius * np.sin(turn)], axis=1)
            first = np.arange(len(side)).reshape(13, 13)
            first[:, -1] = first[:, 0]  # the last column of vertices is the first
            bodies.append((np.delete(side, np.s_[12::13], axis=0), (first - first // 13).ravel()[faces]))
        along = 2.0 * np.sin(6 * np.pi * time)
    return bodies, np.stack([along, 0.0 * time, fall + 0.0 * time], axis=1)


@pytest.mark.parametrize("frames", [20, pytest.param(300, marks=pytest.mark.long)])
@pytest.mark.parametrize("thickness", ["radius", "minimum_distance"])
@pytest.mark.parametrize("name", ["sheet", "rope", pytest.param("piston", marks=pytest.mark.long)])
def test_what_slides_at_its_distance_travels_as_if_nothing_were_near(name, thickness, frames):
    for seed, share in enumerate((1.0, 0.3) if frames < 300 else (1.0, 0.999, 0.3)):
        rng = np.random.default_rng(seed)
        turn, origin = np.linalg.qr(rng.normal(size=(3, 3)))[0], rng.normal(size=3)
        bodies, places = sliding(name, share, frames)
        bodies = [(body[0] @ turn + origin, *body[1:]) for body in bodies]
        radius = [0.5 * DISTANCE] * 2 if name == "sheet" else [0.0, DISTANCE]
        options = {"radius": radius} if thickness == "radius" else {}
        mesh = ccd.CollisionMesh.from_arrays(bodies, static=[0], **options)
        capacities = {"max_pairs": 1 << 17, "max_contacts": 1 << 15}
        pipeline = ccd.CollisionPipeline(mesh, **capacities, **({} if options else NORMS["ball"]))
        x = mesh.vertices
        for displacement in np.diff(places, axis=0) @ turn:
            y = x + displacement * (mesh.vertex_body == 1)[:, None]
            for per in ("scene", "vertex"):
                np.testing.assert_array_equal(pipeline.line_search(x, y, per=per).vertices, y)
            np.testing.assert_array_equal(shortened_by_launch(pipeline, x, y, per="scene"), y)
            x = y
        assert pipeline.find_proximity(x, 0.0).distance.min(initial=DISTANCE) > share * DISTANCE - 1e-12


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
