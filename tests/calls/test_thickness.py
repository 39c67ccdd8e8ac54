"""Thickness: a radius for each body or vertex, and distances that grow by it."""

import copy
import math
import pickle
from fractions import Fraction

import numpy as np
import pytest
import trimesh
import warp as wp
from ccd_warp.kernels.boxes.thickness import sum_up
from ccd_warp.kernels.template import specialised
from exact import exact_distance_tois
from expected_warnings import OF_DISTANCES, OF_ROUNDING
from hard_cases import FAMILIES
from launches import host, on_device
from oracles import brute_force, corners_of
from pair_functions import SOLVE
from scenes import NO_FACES, pairs_in_worlds, sheet
from thick_scenes import (
    KIND_NAMES,
    check_contacts,
    crowd,
    crowd_in_plane,
    distances_of,
    exact_contacts,
    found_contacts,
    on_lattice,
)

import ccd_warp as ccd
from ccd_warp._engine.mesh.topology import Topology
from ccd_warp._runtime import lanes

pytestmark = [OF_DISTANCES, OF_ROUNDING]

PRECISIONS = ("float64", "float32")

TRIANGLE = (np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), [[0, 1, 2]])
POINT = (np.array([[0.2, 0.2, 1.0]]), NO_FACES)


@wp.kernel(enable_backward=False)
def add_lengths(
    a: wp.array[wp.float64],
    b: wp.array[wp.float64],
    c: wp.array[wp.float64],
    # out
    s: wp.array[wp.float64],
):
    k = wp.tid()
    s[k] = sum_up(a[k], sum_up(b[k], c[k]))


def triangle_and_point(radius=None, **options):
    return ccd.CollisionMesh.from_arrays(
        [TRIANGLE, POINT], codimensional_points=True, names=["sheet", "bead"], radius=radius, **options
    )


# ---- The argument ----------------------------------------------------------------------------------------------------


def test_radius_of_a_body_is_that_of_its_vertices():
    for given in ([0.1, 0.2], [0.1, 0.1, 0.1, 0.2], np.array([0.1, 0.2]), (0.1, 0.2)):
        assert triangle_and_point(given).radius.tolist() == [0.1, 0.1, 0.1, 0.2]
    for one in (0.1, np.float64(0.1), np.array(0.1)):
        assert triangle_and_point(one).radius.tolist() == [0.1] * 4
    assert triangle_and_point().radius is None
    assert triangle_and_point(0).radius.tolist() == [0.0] * 4
    assert triangle_and_point(np.array([1, 2], dtype=np.float32)).radius.dtype == np.float64


def test_particles_are_bodies_and_vertices_at_once():
    mesh = ccd.CollisionMesh.from_arrays([POINT, POINT], codimensional_points=True, radius=[0.1, 0.2])
    assert mesh.radius.tolist() == [0.1, 0.2]
    empty = (np.zeros((0, 3)), NO_FACES)
    pair = (np.zeros((2, 3)), NO_FACES)
    assert ccd.CollisionMesh.from_arrays([empty, pair], radius=[0.1, 0.1]).radius.tolist() == [0.1, 0.1]
    with pytest.raises(ValueError, match=r"radius has shape \(2,\), as many entries as there are bodies and vertices"):
        ccd.CollisionMesh.from_arrays([empty, pair], radius=[0.1, 0.2])


def test_radius_stays_with_the_mesh():
    mesh = triangle_and_point([0.25, 0.5])
    assert repr(mesh).endswith("radius 0.25 to 0.5)")
    assert repr(triangle_and_point(0.1)).endswith("radius 0.1)")
    assert not mesh.radius.flags.writeable
    given = np.array([1.0, 2.0, 3.0, 4.0])
    of_vertices = triangle_and_point(given)
    given[:] = 0
    assert of_vertices.radius.tolist() == [1.0, 2.0, 3.0, 4.0]
    for copied in (copy.deepcopy(mesh), pickle.loads(pickle.dumps(mesh)), mesh.excluding({"bodies": [[0, 1]]})):
        assert copied.radius.tolist() == mesh.radius.tolist()
    assert mesh.replicate(2).radius.tolist() == [0.25, 0.25, 0.25, 0.5] * 2
    assert triangle_and_point().replicate(2).radius is None


def test_radius_of_objects_of_trimesh():
    ball, box = trimesh.creation.icosphere(0), trimesh.creation.box()
    mesh = ccd.CollisionMesh.from_trimesh([ball, box], radius=[0.5, 0.0])
    assert mesh.radius.tolist() == [0.5] * len(ball.vertices) + [0.0] * len(box.vertices)


def test_boxes_of_vertices_hold_the_thickest_primitive_around_them():
    strip = (np.zeros((5, 3)), [[0, 1, 2], [1, 2, 3]], [[3, 4]])
    mesh = ccd.CollisionMesh.from_arrays([strip], radius=[1.0, 0, 0, 0, 5.0])
    topology = Topology.of(mesh, wp.get_device("cpu"))
    assert topology.radius.numpy().tolist() == mesh.radius.tolist()
    assert topology.box_radius.numpy().tolist() == [1.0, 1.0, 1.0, 5.0, 5.0]
    none = Topology.of(ccd.CollisionMesh.from_arrays([strip]), wp.get_device("cpu"))
    assert len(none.radius) == len(none.box_radius) == 0


# ---- The guarantee ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("make", [crowd, crowd_in_plane])
def test_every_pair_that_comes_within_its_own_distance_is_found_by_every_way(make):
    mesh, start, end = make(91)
    for minimum_distance in (0.0, 2.0**-7):
        exact = exact_contacts(mesh, start, end, minimum_distance)
        assert len(exact) > 20 and len({key[0] for key in exact}) > 1
        for precision in PRECISIONS:
            more = 2e-6 * mesh.length_scale + (1e-5 if precision == "float32" else 0)
            beyond = exact_contacts(mesh, start, end, minimum_distance, more=more)
            options = {"minimum_distance": minimum_distance, "precision": precision, "device": "cpu"}
            result = ccd.mesh_ccd(mesh, start, end, **options)
            check_contacts(mesh, result.contacts, exact, beyond)
            hashed = ccd.mesh_ccd(mesh, start, end, broad_phase="hash", **options)
            assert found_contacts(hashed.contacts) == found_contacts(result.contacts)
            if precision == "float64":
                assert ccd.collision_free_step(mesh, start, end, **options) == result.toi
            launched = ccd.CollisionPipeline(mesh, **options).launch(start, end)
            assert np.array_equal(launched.vertex_toi.numpy(), result.vertex_toi)
            assert found_contacts(launched.to_host().contacts) == found_contacts(result.contacts)


def summed_up(*lengths):
    """The least float64 number that is no less than the exact sum."""
    exact = sum(map(Fraction, lengths))
    nearest = float(exact)
    return nearest if Fraction(nearest) >= exact else math.nextafter(nearest, math.inf)


@pytest.mark.parametrize("kind", KIND_NAMES)
def test_pair_with_radii_has_the_bits_of_one_with_their_sum_as_distance(kind):
    rng = np.random.default_rng(92)
    points = [np.concatenate(x) for x in zip(*(FAMILIES[name](kind, 5, rng) for name in FAMILIES), strict=True)]
    n = len(points[0])
    # one of the two is 0, and so is the minimum distance, so that no sum is rounded twice
    radius = rng.random((n, 2)) * 10.0 ** rng.uniform(-8, -0.5, (n, 2)) * np.eye(2)[rng.integers(0, 2, n)]
    split = 2 if kind == "edge-edge" else 1
    side = (np.arange(points[0].shape[1]) >= split).astype(int)
    mesh, start, end = pairs_in_worlds(kind, *points, radius[:, side].ravel())
    for options in (
        {},
        {"precision": "float32", "start_gap_fraction": 0.5},
        {"t_max": 0.7, "start_gap_fraction": 0.25},
        {"method": "bisection", "max_iterations": 200},
    ):
        options = {"length_scale": 1.0, "device": "cpu", **options}
        contacts = ccd.mesh_ccd(mesh, start, end, pair_kinds=[kind.replace("-", "_")], **options).contacts
        found = {int(contacts.world[k]): contacts[k] for k in range(len(contacts))}
        for i, distance in enumerate(radius.sum(axis=1).tolist()):
            single = SOLVE[kind](*(x[i : i + 1] for x in points), minimum_distance=distance, **options)
            if i not in found:  # the cull of a mesh, in float64, discards what a tolerance accepts
                starts, ends = (x[i : i + 1] for x in points)
                assert not single.hit[0] or not exact_distance_tois(kind, starts, ends, distance)[0].hit
            else:
                one = found[i]
                assert (one.toi, one.status, one.gap) == (single.toi[0], single.status[0], single.gap[0])


def test_sum_of_a_distance_and_two_radii_is_rounded_up_and_exact_where_it_can_be():
    rng = np.random.default_rng(93)
    lengths = rng.random((3, 400)) * 10.0 ** rng.integers(-30, 3, (3, 400))
    lengths = np.hstack([lengths, [[0, 5e-324, 0.1, 1e300, 0], [0, 5e-324, 0.2, 1, 0.3], [0, 0, 0.3, 1e-300, 0]]])
    lengths = np.hstack([lengths, 10.0 ** rng.integers(-320, 300, (3, 200))])
    sums = wp.empty(lengths.shape[1], dtype=wp.float64, device="cpu")
    inputs = [wp.array(x, dtype=wp.float64, device="cpu") for x in lengths]
    wp.launch(add_lengths, lengths.shape[1], inputs=inputs, outputs=[sums], device="cpu")
    for a, b, c, found in zip(*lengths.tolist(), sums.numpy().tolist(), strict=True):
        assert found == summed_up(a, summed_up(b, c))


def test_radius_of_0_changes_no_bit():
    mesh, start, end = crowd(94, largest=0.0)
    plain = ccd.CollisionMesh.from_arrays(
        [(mesh.vertices[mesh.vertex_body == b], *rest) for b, rest in enumerate(bodies_of(mesh))],
        codimensional_points=True,
    )
    for options in ({"minimum_distance": 0.02}, {"minimum_distance": 0.02, "precision": "float32"}):
        pipelines = [ccd.CollisionPipeline(each, device="cpu", **options) for each in (mesh, plain)]
        results = [pipeline.mesh_ccd(start, end).contacts for pipeline in pipelines]
        launched = [pipeline.launch(start, end).to_host().contacts for pipeline in pipelines]
        assert len(results[0]) > 10
        for one, other in (results, launched, (results[0], launched[0])):
            for name in ("kind", "primitives", "toi", "gap", "status", "parameters", "normal"):
                assert np.array_equal(getattr(one, name), getattr(other, name))


def bodies_of(mesh):
    """The faces, or codimensional edges, of the bodies of a crowd."""
    return (mesh.faces,), (NO_FACES, mesh.edges[mesh.codimensional_edges] - 3 * len(mesh.faces)), (NO_FACES,)


# ---- What a radius is ------------------------------------------------------------------------------------------------


def two_sheets(gap, radius, **options):
    """Two triangles above each other, the upper one of which falls by twice the gap; mesh, start and end."""
    lower, faces = TRIANGLE
    mesh = ccd.CollisionMesh.from_arrays([TRIANGLE, (lower + [0.1, 0.1, gap], faces)], radius=radius, **options)
    return mesh, mesh.vertices, mesh.vertices - [0, 0, 2 * gap] * (mesh.vertex_body == 1)[:, None]


def test_sheet_that_lies_at_both_radii_touches_and_one_a_little_higher_does_not():
    mesh, start, _ = two_sheets(0.25, 0.125, static=[0])
    for precision in PRECISIONS:
        options = {"precision": precision, "tolerance": 1e-12, "device": "cpu"}
        assert ccd.mesh_ccd(mesh, start, start, **options).toi == 0.0
        assert ccd.mesh_ccd(mesh, start, start, **options).contacts.status[0] == ccd.CCDStatus.INITIAL_CONTACT
        lifted = start + [0, 0, 1e-4] * (mesh.vertex_body == 1)[:, None]
        assert ccd.is_step_collision_free(mesh, lifted, lifted, **options)


@pytest.mark.parametrize("radius, minimum_distance, kept", [(0.1, 0.0, 0.2), ([0.3, 0.01], 0.0, 0.31), (0.1, 0.2, 0.4)])
def test_gap_that_is_left_is_the_minimum_distance_and_both_radii(radius, minimum_distance, kept):
    mesh, start, end = two_sheets(1.0, radius)
    result = ccd.mesh_ccd(mesh, start, end, minimum_distance=minimum_distance, device="cpu")
    left = 1.0 - 2.0 * result.toi
    assert left == pytest.approx(kept, rel=1e-12) and left >= kept * (1 - 1e-15)


def test_primitive_takes_the_largest_radius_of_its_vertices_and_a_vertex_its_own():
    face = (np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), [[0, 1, 2]])
    above, beside = (np.array([place]) for place in ([0.4, 0.4, 1.0], [2.0, 0, 0]))
    mesh = ccd.CollisionMesh.from_arrays(
        [face, (above, NO_FACES), (beside, NO_FACES)], codimensional_points=True, radius=[0.25, 0, 0, 0.125, 0.0625]
    )
    end = mesh.vertices.copy()
    end[3, 2], end[4, 0] = 0.0, 1.0
    contacts = ccd.mesh_ccd(mesh, mesh.vertices, end, device="cpu").contacts
    # the point above meets the face at 0.375, of its corner far away; that beside a corner of radius 0 meets it, too
    assert contacts.primitives[:, 0].tolist() == [3, 4]
    assert contacts.toi == pytest.approx([1 - 0.375, 1 - 0.3125], rel=1e-12)


# ---- Who pays for it -------------------------------------------------------------------------------------------------


def test_one_thick_body_adds_candidates_of_its_own_alone():
    rng = np.random.default_rng(95)
    bodies = []
    for place in 3.0 * rng.random((60, 3)):
        vertices, faces = sheet(2, 0.4)
        bodies.append((vertices + place, faces))
    radius = np.zeros(60)
    radius[7] = 0.3
    plain, thick = (ccd.CollisionMesh.from_arrays(bodies, radius=r) for r in (None, radius))
    start = plain.vertices
    end = start + 0.05 * rng.standard_normal(start.shape)
    for broad_phase in ("tree", "hash"):
        options = {"broad_phase": broad_phase, "device": "cpu"}
        was, now = (ccd.find_candidates(mesh, start, end, **options) for mesh in (plain, thick))
        added = 0
        for kind in ("vertex_face", "edge_edge"):
            before, after = (set(map(tuple, getattr(each, kind).tolist())) for each in (was, now))
            first = plain.vertex_body if kind == "vertex_face" else plain.edge_body
            second = plain.face_body if kind == "vertex_face" else plain.edge_body
            assert before <= after
            assert all(first[i] == 7 or second[j] == 7 for i, j in after - before)
            added += len(after - before)
        assert added > 50
        # the cull knows the distance of each pair, too: only pairs of the thick body are left to solve
        results = [ccd.mesh_ccd(mesh, start, end, **options) for mesh in (plain, thick)]
        of_others = [(r.contacts.bodies != 7).all(axis=1) for r in results]
        ours, theirs = (
            found_contacts(r.contacts[np.flatnonzero(is_other)]) for r, is_other in zip(results, of_others, strict=True)
        )
        assert ours.keys() == theirs.keys()
        assert not of_others[1].all()


@pytest.mark.parametrize("broad_phase", ["tree", "hash"])
def test_candidates_are_all_pairs_whose_boxes_overlap_when_they_have_grown_by_the_radii(broad_phase):
    # on a coarse lattice many boxes touch exactly, where quantized coordinates do not decide
    rng = np.random.default_rng(96)
    start = 0.25 * rng.integers(0, 16, (90, 3))
    radius = 0.125 * rng.integers(0, 3, 90)
    faces = np.arange(60).reshape(-1, 3)
    bodies = [(start[:60], faces), (start[60:], NO_FACES)]
    mesh = ccd.CollisionMesh.from_arrays(bodies, codimensional_points=True, radius=radius)
    end = start + 0.25 * rng.integers(-1, 2, start.shape)
    for inflation in (0.0, 0.125):
        found = ccd.find_candidates(mesh, start, end, inflation, broad_phase=broad_phase, device="cpu").sorted()
        around = radius.copy()
        for a, b in mesh.edges:
            around[a], around[b] = max(around[a], radius[b]), max(around[b], radius[a])
        lower, upper = np.minimum(start, end), np.maximum(start, end)
        for grown in (inflation, around[:, None]):
            lower = np.where(grown > 0, np.nextafter(lower - grown, -np.inf), lower)
            upper = np.where(grown > 0, np.nextafter(upper + grown, np.inf), upper)
        vertices = np.arange(90)[:, None]
        for kind, first, second in (
            ("vertex_face", vertices, mesh.faces),
            ("edge_edge", mesh.edges, mesh.edges),
            ("point_point", vertices[60:], vertices[60:]),
        ):
            (lower_i, upper_i), (lower_j, upper_j) = (
                (lower[each].min(axis=1), upper[each].max(axis=1)) for each in (first, second)
            )
            expected = [
                (int(i + 60 * (kind == "point_point")), int(j + 60 * (kind == "point_point")))
                for i in range(len(first))
                for j in np.flatnonzero(((lower_i[i] <= upper_j) & (lower_j <= upper_i[i])).all(axis=1))
                if not set(first[i]) & set(second[j]) and (kind == "vertex_face" or j > i)
            ]
            assert list(map(tuple, getattr(found, kind).tolist())) == expected


def test_bodies_and_worlds_and_static_bodies_keep_their_distances():
    rng = np.random.default_rng(97)
    parts = [sheet(1, 0.4) for _ in range(12)]
    bodies = [
        (vertices + place, faces) for (vertices, faces), place in zip(parts, rng.uniform(0, 0.9, (12, 3)), strict=True)
    ]
    radius = on_lattice(0.1 * rng.random(12) * rng.integers(0, 2, 12))
    for options in (
        {"self_collision": False},
        {"static": range(0, 12, 3), "self_collision": [b % 2 == 0 for b in range(12)]},
    ):
        mesh = ccd.CollisionMesh.from_arrays(bodies, radius=radius, **options)
        start = mesh.vertices
        moves = 0.1 * rng.standard_normal((12, 3))[mesh.vertex_body]
        end = np.where(mesh.static[mesh.vertex_body][:, None], start, start + moves)
        exact = exact_contacts(mesh, start, end)
        assert len(exact) > 20
        for broad_phase in ("tree", "hash"):
            contacts = ccd.mesh_ccd(mesh, start, end, broad_phase=broad_phase, device="cpu").contacts
            check_contacts(mesh, contacts, exact, exact_contacts(mesh, start, end, more=4e-6))
        copies = mesh.replicate(3)
        every = [np.tile(x, (3, 1)) for x in (start, end)]
        launched = ccd.CollisionPipeline(copies, max_pairs=1 << 16, max_contacts=1 << 14, device="cpu").launch(*every)
        single = ccd.mesh_ccd(mesh, start, end, device="cpu")
        assert np.array_equal(launched.vertex_toi.numpy(), np.tile(single.vertex_toi, 3))


# ---- Extremes --------------------------------------------------------------------------------------------------------


def test_boxes_that_touch_overlap_though_they_grow_by_a_radius_and_an_inflation_that_rounding_would_drop():
    """Rounded to nearest, neither reaches half way to the other: each half of a last bit is lost twice."""
    half = 2.0**-53
    places = np.array([[1.0, 0, 0], [1.0 + 4 * half, 0, 0]])
    mesh = ccd.CollisionMesh.from_arrays([(places, NO_FACES)], codimensional_points=True, radius=half)
    for broad_phase in ("tree", "hash"):
        found = ccd.find_candidates(mesh, places, places, half, broad_phase=broad_phase, device="cpu")
        assert found.point_point.tolist() == [[0, 1]]


@pytest.mark.parametrize("largest", [5e-324, 1e-300, 1e-160, 1e150, 1.7e308])
def test_tiny_and_huge_radii_are_never_late(largest):
    mesh, start, end = crowd(98, count=6)
    radius = np.where(mesh.radius > 0, largest, 0.0)
    given = ccd.CollisionMesh.from_arrays(
        [(start[mesh.vertex_body == b], *rest) for b, rest in enumerate(bodies_of(mesh))],
        codimensional_points=True,
        radius=radius,
    )
    for precision in PRECISIONS:
        result = ccd.mesh_ccd(given, start, end, precision=precision, device="cpu")
        launched = ccd.CollisionPipeline(given, precision=precision, device="cpu").launch(start, end)
        assert np.array_equal(launched.vertex_toi.numpy(), result.vertex_toi)
        found = found_contacts(result.contacts)
        if largest > 1:  # every pair of a thick primitive is in contact
            for kind, pairs in zip(ccd.PairKind, brute_force(given, 0 * start, 0 * start), strict=True):
                if pairs:
                    is_thick = distances_of(given, kind, pairs) > 0
                    thick = [pair for pair, each in zip(pairs, is_thick, strict=True) if each]
                    assert all(found[int(kind), *pair] == 0.0 for pair in thick)
        else:
            exact = exact_contacts(given, start, end)
            assert exact.keys() <= found.keys() and not any(e.late(found[key]) for key, e in exact.items())


@pytest.mark.parametrize("exponent", [-900, 900])
def test_scene_and_radii_scaled_by_a_power_of_two_give_the_same_bits(exponent):
    mesh, start, end = crowd(99, count=16)
    scaled = ccd.CollisionMesh.from_arrays(
        [(np.ldexp(start[mesh.vertex_body == b], exponent), *rest) for b, rest in enumerate(bodies_of(mesh))],
        codimensional_points=True,
        radius=np.ldexp(mesh.radius, exponent),
    )
    was = ccd.mesh_ccd(mesh, start, end, device="cpu").contacts
    now = ccd.mesh_ccd(scaled, np.ldexp(start, exponent), np.ldexp(end, exponent), device="cpu").contacts
    assert len(was) > 5 and found_contacts(was) == found_contacts(now)


# ---- On the device ---------------------------------------------------------------------------------------------------


def test_radii_written_between_launches_are_those_of_the_next_one():
    mesh, start, end = crowd(101, static=[1])
    others = on_lattice(np.random.default_rng(102).random(mesh.num_vertices) * 0.05)
    pipeline = ccd.CollisionPipeline(mesh, device="cpu")
    given = [on_device(x) for x in (start, end)]
    pipeline.launch(*given)
    for radius in (others, mesh.radius, 0.5 * others, 0 * others):
        pipeline.radius.assign(radius)
        result = pipeline.launch(*given)
        anew = ccd.CollisionMesh.from_arrays(
            [(start[mesh.vertex_body == b], *rest) for b, rest in enumerate(bodies_of(mesh))],
            codimensional_points=True,
            static=[1],
            radius=radius,
        )
        expected = ccd.CollisionPipeline(anew, device="cpu").launch(*given)
        assert {k: v.tobytes() for k, v in host(result).items()} == {k: v.tobytes() for k, v in host(expected).items()}
        exact = exact_contacts(mesh, start, end, radius=radius)
        found = found_contacts(result.to_host().contacts)
        assert exact.keys() <= found.keys() and not any(e.late(found[key]) for key, e in exact.items())


def test_static_boxes_grow_with_radii_in_launches_that_read_only_what_moves():
    sheet_below = (TRIANGLE[0], TRIANGLE[1])
    point = (np.array([[0.2, 0.2, 1.0]]), NO_FACES)
    mesh = ccd.CollisionMesh.from_arrays([sheet_below, point], codimensional_points=True, static=[0], radius=0.0)
    x, y = (on_device(np.array([[0.2, 0.2, z]])) for z in (1.0, 0.5))
    for broad_phase in ("tree", "hash"):
        pipeline = ccd.CollisionPipeline(mesh, broad_phase=broad_phase, device="cpu")
        assert np.isinf(pipeline.launch(x, y).toi.numpy()[0])
        pipeline.radius.assign([0.75, 0.75, 0.75, 0.0])
        assert pipeline.launch(x, y).toi.numpy()[0] == pytest.approx(0.5, rel=1e-12)
        pipeline.radius.zero_()
        assert np.isinf(pipeline.launch(x, y).toi.numpy()[0])


def test_captured_launch_reads_the_radii_of_its_replay():
    mesh, start, end = two_sheets(1.0, 0.0)
    pipeline = ccd.CollisionPipeline(mesh, device="cpu")
    given = [on_device(x) for x in (start, end)]
    result = pipeline.launch(*given)
    with wp.ScopedCapture("cpu") as capture:
        pipeline.launch(*given)
    for radius in (0.25, 0.125, 0.0):
        pipeline.radius.fill_(radius)
        wp.capture_launch(capture.graph)
        assert result.toi.numpy()[0] == pytest.approx(0.5 - radius, rel=1e-12)


@pytest.mark.parametrize("bad", [-1.0, -5e-324, np.nan, np.inf, -np.inf])
def test_invalid_radius_on_the_device_stops_its_world_and_no_other(bad):
    mesh, start, end = crowd(103, count=8)
    worlds = mesh.replicate(3)
    given = [on_device(np.tile(x, (3, 1))) for x in (start, end)]
    pipeline = ccd.CollisionPipeline(worlds, device="cpu")
    expected = host(pipeline.launch(*given))
    radius = worlds.radius.copy()
    radius[mesh.num_vertices + 5] = bad
    pipeline.radius.assign(radius)
    found = host(pipeline.launch(*given))
    assert found["world_flags"].tolist() == [0, ccd.LaunchFlag.INVALID_INPUT, 0]
    assert found["flags"][0] == ccd.LaunchFlag.INVALID_INPUT and found["world_toi"][1] == 0.0
    count = mesh.num_vertices
    assert (found["vertex_toi"][count : 2 * count] == 0.0).all()
    for k in (0, 2):
        part = slice(k * count, (k + 1) * count)
        assert np.array_equal(found["vertex_toi"][part], expected["vertex_toi"][part])
    # a line search moves nothing there
    tip = on_device(np.tile(end, (3, 1)))
    pipeline.launch_line_search(given[0], tip, per="vertex")
    assert np.array_equal(tip.numpy()[count : 2 * count], start)
    pipeline.radius.assign(worlds.radius)
    again = host(pipeline.launch(*given))
    assert {k: v.tobytes() for k, v in again.items()} == {k: v.tobytes() for k, v in expected.items()}


def close_vertices(mesh, start):
    """A vertex of either primitive of each pair that starts within its distance."""
    pairs = []
    for kind, *pair in exact_contacts(mesh, start, start, more=1e-9):
        corners = corners_of(mesh, ccd.PairKind(kind), [pair])[0]
        pairs.append((corners[0], corners[-1]))
    return pairs


def test_line_searches_keep_the_distance_of_every_pair():
    mesh, start, end = crowd(104, count=14, motion=0.1)
    mesh = mesh.excluding({"vertices": close_vertices(mesh, start)})
    assert exact_contacts(mesh, start, end)
    pipeline = ccd.CollisionPipeline(mesh, device="cpu")
    for per in ("scene", "vertex"):
        found = ccd.line_search(mesh, start, end, per=per, device="cpu").vertices
        launched = on_device(end)
        pipeline.launch_line_search(on_device(start), launched, per=per)
        for reached in (found, launched.numpy()):
            assert not np.array_equal(reached, start) and not exact_contacts(mesh, start, reached)


# ---- What it goes with -----------------------------------------------------------------------------------------------


def test_radius_and_a_separation_in_the_maximum_norm_are_an_error_that_names_both():
    mesh, start, end = two_sheets(1.0, 0.1)
    message = r"minimum_separation is 0.01 and the mesh has a radius of up to 0.1"
    for call in (ccd.mesh_ccd, ccd.collision_free_step, ccd.is_step_collision_free, ccd.line_search):
        with pytest.raises(ValueError, match=message):
            call(mesh, start, end, minimum_separation=0.01, device="cpu")
    with pytest.raises(ValueError, match=message):
        ccd.CollisionPipeline(mesh, minimum_separation=0.01, device="cpu")
    # a radius of 0 could be changed on the device, and only there
    flat, *_ = two_sheets(1.0, 0.0)
    pipeline = ccd.CollisionPipeline(flat, minimum_separation=0.01, device="cpu")
    assert pipeline.mesh_ccd(start, end).toi < 0.5
    with pytest.raises(ValueError, match=r"minimum_separation is 0.01 and the mesh has a radius of up to 0"):
        pipeline.launch(on_device(start), on_device(end))


def test_pipeline_has_the_radius_of_its_mesh_and_keeps_it_when_it_reserves():
    mesh, start, end = two_sheets(1.0, [0.1, 0.2])
    pipeline = ccd.CollisionPipeline(mesh, device="cpu")
    assert pipeline.radius.numpy().tolist() == mesh.radius.tolist() and pipeline.radius.dtype is wp.float64
    pipeline.radius.fill_(0.25)
    pipeline.reserve(max_pairs=1 << 13)
    assert pipeline.launch(on_device(start), on_device(end)).toi.numpy()[0] == pytest.approx(0.25)
    assert mesh.radius.max() == 0.2 and pipeline.mesh_ccd(start, end).toi == pytest.approx(0.35)
    assert ccd.CollisionPipeline(two_sheets(1.0, None)[0], device="cpu").radius is None


def test_intersections_are_exact_whatever_the_thickness():
    mesh, start, _ = two_sheets(0.25, 0.5)
    assert len(ccd.find_intersections(mesh, start, device="cpu")) == 0
    assert ccd.mesh_ccd(mesh, start, start, device="cpu").pairs_at_start


def test_scene_without_radii_compiles_nothing_of_them(monkeypatch):
    norms = []

    def seen(name, **parameters):
        norms.append(parameters.get("norm", "maximum"))
        return specialised(name, **parameters)

    monkeypatch.setattr(lanes, "specialised", seen)
    for radius in (None, 0.0):
        mesh, start, end = two_sheets(1.0, radius)
        ccd.mesh_ccd(mesh, start, end, device="cpu")
    assert set(norms) == {"maximum"}


def test_radius_counts_where_a_difference_of_coordinates_is_beyond_the_largest_number():
    reach, radius, start, end = 1.2e308, 1e301, 1e303, 1e300
    no_faces, edge = np.zeros((0, 3), int), np.array([[0, 1]])
    below = np.array([[-reach, 0.0, 0.0], [reach, 0.0, 0.0]])
    above = np.array([[-reach, -1e307, end], [reach, 1e307, end]])  # crosses it far below twice the radius
    mesh = ccd.CollisionMesh.from_arrays([(below, no_faces, edge), (above, no_faces, edge)], radius=radius)
    vertices_t0 = mesh.vertices.copy()
    vertices_t0[2:, 2] = start
    exact = (start - 2.0 * radius) / (start - end)
    toi = ccd.mesh_ccd(mesh, vertices_t0, mesh.vertices).toi
    assert 0.99 * exact < toi <= exact  # the tolerance is a share of the length of the edges
