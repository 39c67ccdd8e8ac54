"""Half-spaces as bodies, static and as they are told to move: numbers that overflow, and what is said of them."""

import pickle

import numpy as np
import pytest
from expected_warnings import OF_ROUNDING
from laws.calls import EVERY_PER
from laws.outputs import tois_of
from laws.truth import Pairs, PlaneTruth, plane_value
from scenes import FACE, NO_FACES, TRIANGLE, sheet

import ccd_warp as ccd

pytestmark = OF_ROUNDING

UP = np.array([0.0, 0.0, 1.0])
GROUND = ccd.HalfSpace([0, 0, 0], UP)
VERTEX_PLANE = ccd.PairKind.VERTEX_PLANE


def particles(points, *half_spaces, **arguments):
    """A body of points, and half-spaces."""
    return ccd.CollisionMesh.from_arrays([(points, NO_FACES), *half_spaces], **arguments)


def sheet_over_ground(height):
    """A tilted sheet that falls on a tilted ground: mesh, start and end positions."""
    vertices, faces = sheet(6)
    vertices = vertices + np.array([0.03, 0.01, height]) + 0.1 * vertices[:, :1] * UP
    ground = ccd.HalfSpace([0.3, 0, 0], [0.1, -0.2, 3.0])
    mesh = ccd.CollisionMesh.from_arrays([(vertices, faces), ground], names=["sheet", "ground"])
    return mesh, mesh.vertices, mesh.vertices - UP


def lift():
    """Particles, a static wall, and a floor that is to rise: the mesh and its start positions."""
    points = np.array([[0.2, 0.1, 0.5], [0.1, 0.3, 5.0], [0.3, 0.0, 0.5], [0.0, 0.0, -1.0]])
    wall, floor = ccd.HalfSpace([9.0, 0, 0], [-1, 0, 0]), ccd.HalfSpace([0, 0, 0], UP)
    mesh = particles(points, wall, floor, names=["dust", "wall", "floor"], kinematic=["floor"])
    return mesh, mesh.vertices


# --- in rational arithmetic ---

NORMALS = [[0, 0, 1], [0, -1e-320, 0], [1e308, 1e308, -1e308], [5e-324, 0, 5e-324], [1, 1e-300, 1e-310], [1e300, 1, 0]]
NORMALS += [[1, 1, 1], [-3, 4, 0], [0.3, -1.1, 0.7], [-2.3, 0.1, 0.01], [1.9, -0.4, -1.2]]


def check(mesh, start, end, distance=0.0, is_euclidean=False):
    """Each vertex meets each plane in time, and where its gap says; returns how many do."""
    options = {"minimum_distance": distance} if is_euclidean else {"minimum_separation": distance, "length_scale": 1.0}
    contacts = ccd.mesh_ccd(mesh, start, end, **options).contacts
    found = dict(zip(tois_of(contacts), zip(contacts.toi.tolist(), contacts.gap.tolist(), strict=True), strict=True))
    for v, k in Pairs(mesh).with_planes.tolist():
        truth, (toi, gap) = PlaneTruth(mesh, start, end, v, k), found.get((VERTEX_PLANE, v, k), (np.inf, 0.0))
        assert not truth.is_late(toi, distance, is_euclidean, 1.0)
        assert toi == np.inf or distance > 0 or truth.excess(truth.at(toi), gap, is_euclidean) <= 0
    return len(contacts)


@pytest.mark.parametrize("seed", range(3))
def test_hostile_vertices_and_planes_are_never_late(seed):
    """Points on, beside and along planes, of sizes that overflow and underflow, and normals that lose bits."""
    rng = np.random.default_rng(seed)
    planes, points = [], [[0, 0, 0], [1e308, -1e308, 1e308], [5e-324, 5e-324, -5e-324], [1, 2, 3]]
    for k, normal in enumerate(NORMALS):
        scale = [1.0, 1e-310, 1e308, 1e-200, 1e150, 1e-5][k % 6]
        x = scale * np.round(rng.uniform(-1, 1, 3), k % 3)
        planes.append(ccd.HalfSpace(x, normal))
        along = np.cross(normal / np.max(np.abs(normal)), rng.standard_normal(3))
        along *= max(np.abs(x).max(), 5e-324) / np.abs(along).max()
        points += [x, np.nextafter(x, np.inf), np.nextafter(x, -np.inf), 0.5 * x + 0.5 * along, 0.3 * x]
    start = np.array(points)
    end = start[rng.permutation(len(start))]
    mesh = particles(start, *planes)
    assert check(mesh, start, end) > 300
    for distance in (1e-323, 1e-5, 1e200, 1.7e308):
        check(mesh, start, end, distance, bool(seed % 2))
    inside = ccd.find_intersections(mesh, start)
    expected = [[v, k] for v, k in np.ndindex(len(start), len(planes)) if plane_value(mesh, k, start[v], start) <= 0]
    assert np.array_equal(inside.primitives, expected) and len(expected) > 100
    # to the point of another plane, often of another size, or by the least that float64 knows
    at, to = mesh.planes.points, mesh.planes.points[rng.permutation(len(planes))]
    to[::3] = np.nextafter(at[::3], -np.inf)
    mesh = particles(start, *planes, kinematic=range(1, 1 + len(planes)))
    assert check(mesh, np.concatenate([start, at]), np.concatenate([end, to])) > 300


# --- what is said of them ---


def test_a_contact_and_a_start_in_the_solid_say_of_what():
    mesh, start, end = sheet_over_ground(height=0.5)
    contacts = ccd.mesh_ccd(mesh, start, end, minimum_distance=0.02).contacts
    unit = mesh.planes.normals[0] / np.linalg.norm(mesh.planes.normals[0])
    np.testing.assert_allclose(contacts.normal, np.tile(unit, (len(contacts), 1)), rtol=1e-15)
    at_toi = start[contacts.primitives[:, 0]] - contacts.toi[:, None] * UP
    np.testing.assert_allclose(contacts.points, at_toi - 0.01 * unit, atol=1e-15)
    assert contacts.bodies.tolist() == [[0, 1]] * len(contacts) and (contacts.gap < 3e-15).all()
    assert contacts[0].vertices.tolist() == [contacts[0].primitives[0]] and "1 half-space" in repr(mesh)
    assert repr(contacts[0]).startswith("Contact(vertex-plane of sheet and ground at (")
    mesh, start, end = sheet_over_ground(height=0.0)
    result = ccd.mesh_ccd(mesh, start, end, check_start=True)
    below = sum(plane_value(mesh, 0, x, start) <= 0 for x in start)
    assert result.toi == 0 and 0 < below < len(start) and result.start.by_bodies() == {("sheet", "ground"): below}
    assert f"{below} pairs are in contact at the start already, with toi 0: {below} of sheet and ground" in repr(result)
    pipeline = ccd.CollisionPipeline(mesh)
    num_found, counts = len(pipeline.find_candidates(start, end).vertex_plane), pipeline.counts
    assert (counts.num_searches[VERTEX_PLANE], counts.num_candidates[VERTEX_PLANE]) == (1, num_found)


def test_a_mesh_keeps_its_half_spaces_as_they_were_given_and_without_radius():
    point, normal = np.array([1, 2, 3]), np.array([0, 0, 1e-310])
    plane = ccd.HalfSpace(point, normal)
    assert plane in {plane} and plane != ccd.HalfSpace(point, normal)  # as an object, for it may hold arrays
    mesh = ccd.CollisionMesh.from_arrays([plane, (TRIANGLE, FACE)], radius=[0, 0.1])
    point[0] = 7
    assert mesh.planes.points.tolist() == [[1, 2, 3]] and mesh.planes.normals.tolist() == [[0, 0, 1e-310]]
    assert mesh.planes.bodies.tolist() == [0] and mesh.static.tolist() == [True, False]
    assert mesh.body_vertex_range.tolist() == [0, 0, 3] and mesh.radius.tolist() == [0.1] * 3
    for each in (mesh, pickle.loads(pickle.dumps(mesh))):
        assert each.planes == mesh.planes != GROUND and not each.planes.normals.flags.writeable


def test_worlds_share_the_ground_and_what_is_excluded_of_it():
    bodies = [(TRIANGLE, FACE), GROUND, (TRIANGLE + UP, FACE), ccd.HalfSpace([0, 0, 9], -UP)]
    mesh = ccd.CollisionMesh.from_arrays(bodies, names=["a", "floor", "b", "roof"])
    mesh = mesh.excluding({"bodies": [("floor", "b"), ("a", "b")], "vertex_plane": [(1, 0), (4, 1)]})
    worlds = mesh.replicate(2)
    assert worlds.names == ("a[0]", "b[0]", "a[1]", "b[1]", "floor", "roof")
    assert worlds.planes.bodies.tolist() == [4, 5] and worlds.static.tolist() == [0, 0, 0, 0, 1, 1]
    named = {tuple(worlds.names[body] for body in pair) for pair in worlds.exclude_pairs["bodies"].tolist()}
    assert named == {("a[0]", "b[0]"), ("a[1]", "b[1]"), ("b[0]", "floor"), ("b[1]", "floor")}
    assert worlds.exclude_pairs["vertex_plane"].tolist() == [[1, 0], [4, 1], [7, 0], [10, 1]]
    contacts = ccd.mesh_ccd(worlds, worlds.vertices, worlds.vertices - 10.0 * UP).contacts
    assert contacts[contacts.kind == VERTEX_PLANE].primitives.tolist() == [[0, 0], [2, 0], [6, 0], [8, 0]]


# --- that move as they are told ---


def test_a_floor_that_rises_meets_what_is_at_rest_in_each_world_its_own():
    mesh, start = lift()
    assert mesh.num_vertices == 5 and mesh.static.tolist() == [False, True, False]
    assert mesh.kinematic.tolist() == [False, False, True] and mesh.planes.vertices.tolist() == [-1, 4]
    assert mesh.length_scale == 6.0 and "kinematic" in mesh._repr_html_()  # a length of the particles alone
    rise = np.outer([0, 0, 0, 0, 2], UP)
    result = ccd.mesh_ccd(mesh, start, start + rise)
    assert result.vertex_toi[:4].tolist() == pytest.approx([0.25, np.inf, 0.25, 0.0], abs=1e-15)
    assert result.body_toi.tolist() == [0.0, np.inf, 0.0] and result.first.body_names == ("dust", "floor")
    (risen,) = result.contacts[result.contacts.primitives[:, 0] == 0]
    assert np.allclose(risen.point, [0.2, 0.1, 0.5], atol=1e-15) and risen.primitives.tolist() == [0, 1]
    with pytest.raises(ValueError, match=r"vertices_t1 has shape \(4, 3\)"):
        ccd.mesh_ccd(mesh, start, start[:4])
    with pytest.raises(ValueError, match=r"expected at most \d+ copies of a mesh with kinematic half-spaces"):
        mesh.replicate(100_000)
    worlds = mesh.excluding({"vertex_plane": [(3, 1)]}).replicate(3)
    assert worlds.names == ("dust[0]", "floor[0]", "dust[1]", "floor[1]", "dust[2]", "floor[2]", "wall")
    assert worlds.planes.vertices.tolist() == [4, 9, 14, -1] and worlds.planes.bodies.tolist() == [1, 3, 5, 6]
    assert worlds.exclude_pairs["vertex_plane"].tolist() == [[3, 0], [8, 1], [13, 2]]
    frames = np.tile(start, (3, 1, 1)), start + np.array([0.0, 0.5, 1.0])[:, None, None] * rise
    assert ccd.mesh_ccd(worlds, *frames).world_toi.tolist() == pytest.approx([np.inf, 0.5, 0.25], abs=1e-15)


@pytest.mark.parametrize("per", EVERY_PER)
def test_a_piston_strikes_what_cannot_get_out_of_its_way(per):
    mesh, start = lift()
    mesh = mesh.excluding({"vertex_plane": [(3, 1)]})
    wished = start + np.array([[0.0, 0, 1.7], [0.3, 0, -0.5], [0, 0, 0.5], [0, 0, 0], [0, 0, 2.0]])
    found, together = ccd.line_search(mesh, start, wished, per=per), per != "vertex"
    assert not found.is_limited and found.vertex_fraction.tolist() == ([0, 0, 0, 0, 1] if together else [1, 1, 0, 1, 1])
    assert np.array_equal(found.vertices[2:], [start[2], start[3], wished[4]]) and len(found.touching) == 0
    struck = found.struck
    assert struck.primitives.tolist() == ([[0, 1], [2, 1]] if together else [[2, 1]])
    assert struck.toi.tolist() == pytest.approx([0.25] * len(struck), abs=1e-15)
    pipeline, end = ccd.CollisionPipeline(mesh), wished.copy()
    result = pipeline.launch_line_search(start, end, per=per).to_host()
    np.testing.assert_array_equal(end, found.vertices)
    assert result.flags == result.world_flags[0] == ccd.LaunchFlag.STRUCK
    assert result.contacts.primitives.tolist() == struck.primitives.tolist()
    np.testing.assert_array_equal(result.contacts.toi, struck.toi)
    cut = start + 0.9 * struck.toi.min() * (wished - start)  # as the documents say; nothing is struck then
    assert pipeline.launch_line_search(start, cut, per=per).to_host().flags == 0
