"""Contacts of a result: where they are, of which bodies and worlds, one at a time, by toi, and after a launch."""

import copy
import pickle

import numpy as np
import pytest
import trimesh
import warp as wp
from scenes import (
    FACE,
    NO_FACES,
    TRIANGLE,
    cloth_and_ball_in_worlds,
    crowd_in_plane,
    crowd_of_all_kinds,
    named_cloth_and_ball,
    sheet,
    with_static_at_rest,
)

import ccd_warp as ccd
from ccd_warp import viz
from ccd_warp._contact_place import located


@pytest.fixture(scope="module")
def step():
    mesh, start, end = named_cloth_and_ball()
    return mesh, start, end, ccd.mesh_ccd(mesh, start, end)


def test_the_first_contact_says_what_touches_what_and_where(step):
    mesh, _, _, result = step
    first = result.first
    assert first.toi == result.toi == result.contacts.toi.min()
    assert first.index == int(np.argmin(result.contacts.toi)) and {*first.body_names} == {"cloth", "ball"}
    # The top of the ball is at 0.3, and the cloth falls on it by 0.2 of the way from 0.5 to -0.5.
    assert np.allclose(first.point, [0.0, 0.0, 0.3], atol=1e-5)
    assert [mesh.names[b] for b in first.bodies] == list(first.body_names)
    assert first.kind == ccd.PairKind.VERTEX_FACE and first.status == ccd.CCDStatus.COLLISION and first.world == 0
    vertex, face = first.primitives
    assert first.vertices.tolist() == [vertex, *mesh.faces[face].tolist()]
    # arrays, which index positions and bodies
    assert step[1][first.vertices].shape == (4, 3) and mesh.static[first.bodies].tolist() == [True, False]
    assert repr(first).startswith("Contact(vertex-face of ball and cloth at (")
    assert repr(first).endswith(f"toi={result.toi!r})")


def turning_bar():
    """A bar that turns, a post in its way that falls, and a ground that comes up: mesh, start, end."""
    bar = np.array([[-1.0, 0, 0], [1.0, 0.0, 0.1], [0.0, 0.3, 0.1], [0.0, -0.3, 0.05]])
    post = np.array([[0.3, 0.8, -2.0], [0.3, 0.8, 3.0], [0.5, 0.9, 3.0]])
    ground = ccd.HalfSpace([0.0, 0.0, -2.5], [0.1, 0.0, 1.0])
    bodies = [(bar, [[0, 1, 2], [0, 3, 1]]), (post, FACE), ground]
    mesh = ccd.CollisionMesh.from_arrays(bodies, rigid=[0], kinematic=[2])
    end = mesh.vertices + np.array([[0, 0, 0], [0, 0, -1.2], [0, 0.2, 3.5]])[mesh.vertex_body]
    return mesh, mesh.vertices, end


@pytest.mark.parametrize("path", ["linear", "screw"])
def test_the_relative_velocity_of_what_turns_is_that_of_points_of_the_body(path):
    mesh, start, end = turning_bar()
    twist = np.array([0.2, -0.1, 0.3, 0.4, 0.3, 2.0])
    motion = ccd.RigidMotion([[0.1, 0.0, 0.0, 0, 0, 0, 1]], path=path, twist=[twist])
    contacts = ccd.mesh_ccd(mesh, start, end, motion=motion).contacts
    assert {0, 1} <= {*contacts.bodies[contacts.kind == ccd.PairKind.EDGE_EDGE].ravel().tolist()}
    assert {0, 2} <= {*contacts.bodies[contacts.kind == ccd.PairKind.VERTEX_PLANE].ravel().tolist()}
    for contact in contacts[(contacts.bodies == 0).any(axis=1)]:
        origin = motion.at(contact.toi)[0, :3]
        # on a screw the velocity of the origin turns with the body
        h = 1e-6
        linear = (motion.at(contact.toi + h)[0, :3] - motion.at(contact.toi - h)[0, :3]) / (2 * h)
        of_bar = linear + np.cross(twist[3:], contact.point - origin)
        of_other = [0, 0, -1.2] if 1 in contact.bodies else [0, 0.2, 3.5]
        expected = of_bar - of_other if contact.bodies[0] == 0 else of_other - of_bar
        assert np.allclose(contact.relative_velocity, expected, atol=1e-8)  # of the difference quotient
        assert contact.relative_velocity @ contact.normal < 0


def test_points_lie_on_both_primitives_at_toi(step):
    mesh, start, end, result = step
    contacts = result.contacts
    assert np.array_equal(contacts.points, viz.contact_points(mesh, start, end, contacts))
    corners = contacts.vertices
    at_toi = (1 - contacts.toi[:, None, None]) * start[corners] + contacts.toi[:, None, None] * end[corners]
    is_edges = contacts.kind == ccd.PairKind.EDGE_EDGE
    u, v = contacts.parameters[is_edges].T[..., None]
    ends = at_toi[is_edges]
    midpoints = 0.5 * ((1 - u) * ends[:, 0] + u * ends[:, 1] + (1 - v) * ends[:, 2] + v * ends[:, 3])
    assert np.allclose(contacts.points[is_edges], midpoints, atol=1e-12)
    assert np.array_equal(contacts.bodies, mesh.vertex_body[corners[:, [0, 3]]])
    assert contacts.world.tolist() == [0] * len(contacts)


def test_points_are_those_of_the_step_whatever_becomes_of_the_callers_arrays():
    for length in (1, 20):  # few and many vertices for each contact
        mesh, start, end = named_cloth_and_ball()
        extra = np.tile(TRIANGLE, (1000 * (length - 1), 1)) + [9.0, 9.0, 9.0]
        faces = np.arange(len(extra)).reshape(-1, 3)
        bodies = [(mesh.vertices[:169], mesh.faces[mesh.face_body == 0])]
        bodies += [(mesh.vertices[169:], mesh.faces[mesh.face_body == 1] - 169), (extra, faces)]
        mesh = ccd.CollisionMesh.from_arrays(bodies, static=[1, 2])
        start, end = np.vstack([start, extra]), np.vstack([end, extra])
        result = ccd.mesh_ccd(mesh, start, end)
        contacts = result.contacts
        expected = viz.contact_points(mesh, start, end, contacts)
        velocity = (contacts.weights[..., None] * (end - start)[contacts.vertices]).sum(axis=1)
        start[:] = end[:] = 0.0
        assert len(expected) and np.array_equal(result.contacts.points, expected)
        assert np.array_equal(contacts.relative_velocity, velocity)


def test_contacts_are_read_one_at_a_time_in_part_and_by_toi(step):
    contacts = step[3].contacts
    assert len(list(contacts)) == len(contacts)
    assert [c.toi for c in contacts] == contacts.toi.tolist() and [c.index for c in contacts][-1] == len(contacts) - 1
    last = contacts[-1]
    assert last.index == len(contacts) - 1 and np.array_equal(last.point, contacts.points[-1])
    chosen = contacts[contacts.toi < 0.3]
    assert isinstance(chosen, ccd.Contacts) and np.array_equal(chosen.points, contacts.points[contacts.toi < 0.3])
    assert np.array_equal(contacts[[3, 1]].vertices, contacts.vertices[[3, 1]])
    by_toi = contacts.sorted_by_toi()
    assert (np.diff(by_toi.toi) >= 0).all()
    assert np.array_equal(by_toi[0].primitives, step[3].first.primitives)
    assert np.array_equal(by_toi.points, contacts.points[np.argsort(contacts.toi, kind="stable")])
    with pytest.raises(IndexError, match=f"index is {len(contacts)}; expected one of {len(contacts)} contacts"):
        contacts[len(contacts)]


def test_without_a_contact_there_is_no_first(step):
    mesh, start, _, _ = step
    result = ccd.mesh_ccd(mesh, start, start)
    assert result.first is None and list(result.contacts) == [] and result.contacts.points.shape == (0, 3)
    assert result.contacts.vertices.shape == (0, 4) and repr(result) == "MeshResult(toi=inf, no contact)"


def test_particles_have_as_many_vertices_as_they_have():
    bodies = [([[0.0, 0, 0], [4, 0, 0]], NO_FACES, [[0, 1]]), ([[1.0, 0, 1], [0, 5, 0], [2, 5, 0]], NO_FACES)]
    mesh = ccd.CollisionMesh.from_arrays(bodies, codimensional_points=True, names=["cable", "dust"])
    end = mesh.vertices.copy()
    end[2] -= [0, 0, 2]
    end[3] += [2, 0, 0]
    on_cable, together = ccd.mesh_ccd(mesh, mesh.vertices, end).contacts
    assert on_cable.vertices.tolist() == [2, 0, 1] and together.vertices.tolist() == [3, 4]
    assert on_cable.body_names == ("dust", "cable") and together.body_names == ("dust", "dust")
    assert "point-point of dust and itself at (2, 5, 0)" in repr(together)


def test_contacts_made_of_arrays_alone_say_that_they_know_no_mesh(step):
    contacts = ccd.Contacts(**vars(step[3].contacts))
    for name in ("points", "vertices", "bodies", "world"):
        with pytest.raises(ValueError, match="contacts were made of arrays alone; expected those of a result"):
            getattr(contacts, name)
    assert repr(contacts[0]) == "Contact(vertex-face, toi=0.41396618080018466)"
    mesh, start, end, result = step
    assert np.array_equal(located(contacts, mesh, start, end).points, result.contacts.points)


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, lambda value: pickle.loads(pickle.dumps(value))])
def test_results_are_copied_and_pickled_with_all_that_they_know(step, copied):
    result = copied(step[3])
    assert np.array_equal(result.contacts.points, step[3].contacts.points)
    assert repr(result) == repr(step[3]) and np.array_equal(copied(result.first).vertices, result.first.vertices)


def test_what_a_line_search_could_not_move_is_located():
    standing = np.array([[0.1, 0.2, 0.0], [0.2, 0.2, 1.0], [0.1, 0.3, 1.0]])  # on one vertex
    mesh = ccd.CollisionMesh.from_arrays([(TRIANGLE, FACE), (standing, FACE)], static=["floor"], names=["floor", "leg"])
    end = with_static_at_rest(mesh, mesh.vertices, mesh.vertices - [0, 0, 0.5])
    touching = ccd.line_search(mesh, mesh.vertices, end, per="vertex").touching
    (foot,) = touching[touching.kind == ccd.PairKind.VERTEX_FACE]
    assert (
        np.allclose(foot.point, [0.1, 0.2, 0.0], atol=1e-15)
        and foot.body_names == ("leg", "floor")
        and foot.vertices[0] == 3
    )


@pytest.mark.parametrize("dtype", [wp.vec3d, wp.vec3f])
@pytest.mark.parametrize("has_static", [False, True])
def test_a_launch_locates_its_contacts(step, dtype, has_static):
    mesh, start, end, _ = step
    if not has_static:
        bodies = [(start[:169], mesh.faces[mesh.face_body == 0]), (start[169:], mesh.faces[mesh.face_body == 1] - 169)]
        mesh = ccd.CollisionMesh.from_arrays(bodies, names=mesh.names)
    real = np.float64 if dtype is wp.vec3d else np.float32
    start, end = start.astype(real).astype(np.float64), end.astype(real).astype(np.float64)
    expected = ccd.mesh_ccd(mesh, start, end, length_scale=1.0, device="cpu")
    pipeline = ccd.CollisionPipeline(mesh, length_scale=1.0, device="cpu")
    before = pipeline.reserve()
    with pytest.raises(ValueError, match="vertices_t1 is None; expected both"):
        before.to_host(start)
    assert before.to_host().contacts.points.shape == (0, 3) and before.to_host().first is None
    x, y = (wp.array(v.astype(real), dtype=dtype, device="cpu") for v in (start, end))
    result = pipeline.launch(x, y)
    found = result.to_host()
    assert found.toi == expected.toi and found.hit and found.flags == 0 and found.num_contacts == len(found.contacts)
    for name in ("points", "vertices", "bodies", "world"):
        np.testing.assert_array_equal(getattr(found.contacts, name), getattr(expected.contacts, name))
    assert np.array_equal(found.first.primitives, expected.first.primitives)
    assert np.array_equal(result.contacts.to_host().points, expected.contacts.points)
    assert np.array_equal(found.vertex_toi, expected.vertex_toi)
    x.zero_()
    y.zero_()
    pipeline.launch(x, y)
    assert found.toi == expected.toi  # a copy, which later launches do not change
    assert np.array_equal(found.vertex_toi, expected.vertex_toi)


def test_points_of_a_launch_can_be_those_of_positions_given_later(step):
    mesh, start, end, _ = step
    pipeline = ccd.CollisionPipeline(mesh, device="cpu")
    result = pipeline.launch(start, end)
    shifted = [0.0, 0.0, 1.0]
    contacts = result.to_host(start + shifted, end + shifted).contacts
    assert np.allclose(contacts.points, result.to_host().contacts.points + shifted, atol=1e-12)
    with pytest.raises(TypeError, match=r"LaunchResult cannot be copied or pickled; .* to_host\(\) returns"):
        pickle.dumps(result)
    with pytest.raises(TypeError, match=r"DeviceContacts cannot be copied or pickled"):
        copy.copy(result.contacts)


def test_copies_of_a_mesh_are_worlds_of_their_own():
    one, mesh, start, _ = cloth_and_ball_in_worlds(3)
    n = one.num_vertices
    assert mesh.num_worlds == 3 and mesh.num_bodies == 6 and np.array_equal(mesh.vertices, start.reshape(-1, 3))
    assert mesh.names == ("cloth[0]", "ball[0]", "cloth[1]", "ball[1]", "cloth[2]", "ball[2]")
    assert mesh.static.tolist() == [False, True] * 3 and mesh.vertex_world.tolist() == np.repeat(range(3), n).tolist()
    assert np.array_equal(mesh.faces.reshape(3, -1, 3)[2], one.faces + 2 * n)
    assert np.array_equal(mesh.edges.reshape(3, -1, 2)[1], one.edges + n)
    assert "3 worlds" in repr(mesh)


def test_copies_keep_codimensional_primitives_and_filters():
    bodies = [(TRIANGLE, FACE), (np.eye(4, 3), NO_FACES, [[0, 1]])]
    pairs = np.array([[False, True], [True, False]])
    one = ccd.CollisionMesh.from_arrays(
        bodies, codimensional_points=[False, True], self_collision=[True, False], body_pairs=pairs, exclusion_rings=2
    )
    mesh = one.replicate(2).replicate(2)
    assert mesh.num_worlds == 4 and mesh.exclusion_rings == 2 and mesh.self_collision.tolist() == [True, False] * 4
    assert mesh.codimensional_points.tolist() == [k + 7 * w for w in range(4) for k in one.codimensional_points]
    assert mesh.edges[mesh.codimensional_edges].tolist() == [[3 + 7 * w, 4 + 7 * w] for w in range(4)]
    assert np.array_equal(mesh.body_pairs[2:4, 2:4], pairs) and mesh.body_pairs.shape == (8, 8)
    with pytest.raises(ValueError, match="count is 0; expected a positive integer"):
        one.replicate(0)
    with pytest.raises(ValueError, match="count is 1000000000; expected at most"):
        one.replicate(10**9)


def test_every_call_takes_positions_with_an_axis_of_worlds():
    one, mesh, start, end = cloth_and_ball_in_worlds()
    flat_start, flat_end = start.reshape(-1, 3), end.reshape(-1, 3)
    moving = end[:, :25]  # the vertices of the cloths alone
    options = {"length_scale": 1.0, "device": "cpu"}
    expected = ccd.mesh_ccd(mesh, flat_start, flat_end, **options)
    alone = ccd.mesh_ccd(one, start[0], end[0], **options)
    assert expected.world_toi.tolist() == [alone.toi, alone.toi, np.inf, np.inf] and alone.hit
    assert expected.first.world == 0 and expected.first.body_names == tuple(f"{n}[0]" for n in alone.first.body_names)
    assert np.bincount(expected.contacts.world).tolist() == [len(alone.contacts)] * 2
    for form in (end, moving, end.tolist(), wp.array(end, dtype=wp.vec3d, device="cpu")):
        for t0 in (start, start.tolist()):
            assert np.array_equal(ccd.mesh_ccd(mesh, t0, form, **options).vertex_toi, expected.vertex_toi)
    assert ccd.collision_free_step(mesh, start, end, **options) <= alone.toi
    assert len(ccd.find_candidates(mesh, start, end).edge_edge) == len(
        ccd.find_candidates(mesh, flat_start, flat_end).edge_edge
    )
    searched = ccd.line_search(mesh, start, end, per="world", device="cpu")
    assert np.array_equal(
        searched.vertices, ccd.line_search(mesh, flat_start, flat_end, per="world", device="cpu").vertices
    )
    assert mesh.frame(start).shape == (mesh.num_vertices, 3)


@pytest.mark.parametrize("make", ["numpy", "warp float64", "warp vec3d", "warp vec3f"])
def test_launches_take_an_axis_of_worlds_and_write_through_it(make):
    _, mesh, start, end = cloth_and_ball_in_worlds()
    options = {"length_scale": 1.0, "device": "cpu"}
    real = np.float32 if make.endswith("f") else np.float64

    def array(x):
        if make == "numpy":
            return x.astype(real)
        dtype = {"warp float64": wp.float64, "warp vec3d": wp.vec3d, "warp vec3f": wp.vec3f}[make]
        return wp.array(x.astype(real), dtype=dtype, device="cpu")

    rounded = [x.astype(real).astype(np.float64) for x in (start, end)]
    expected = ccd.mesh_ccd(mesh, *rounded, **options)
    pipeline = ccd.CollisionPipeline(mesh, **options)
    pipeline.reserve(vertices=start)
    result = pipeline.launch(array(start), array(end)).to_host()
    assert np.array_equal(result.world_toi, expected.world_toi)
    assert np.array_equal(result.contacts.points, expected.contacts.points)
    assert np.array_equal(pipeline.launch(array(start), array(end[:, :25])).world_toi.numpy(), expected.world_toi)
    moved = pipeline.launch(array(start), displacements=array(end - start)).world_toi.numpy()
    assert np.isfinite(moved).tolist() == [True, True, False, False]
    wished = array(end)
    pipeline.launch_line_search(array(start), wished, per="world")
    shortened = (wished if make == "numpy" else wished.numpy()).reshape(end.shape)
    assert (shortened[:2, :25, 2] > end[:2, :25, 2]).all() and np.array_equal(shortened[2:], end[2:].astype(real))


def test_copies_of_several_worlds_have_an_axis_of_copies():
    bodies = [(TRIANGLE, FACE), (np.eye(4, 3), FACE)]
    one = ccd.CollisionMesh.from_arrays(bodies, vertex_world=[0] * 3 + [1] * 4, static=[1])
    mesh = one.replicate(3)
    start, flat = np.tile(one.vertices, (3, 1, 1)), np.tile(one.vertices, (3, 1))
    end = start + [0.0, 0.0, 0.5] * (np.arange(7) < 3)[:, None]
    assert np.array_equal(mesh.frame(start), flat)
    assert np.array_equal(mesh.frames(start, end[:, :3])[1], mesh.frames(flat, end.reshape(-1, 3))[1])
    assert ccd.mesh_ccd(mesh, start, end).toi == ccd.mesh_ccd(mesh, flat, end.reshape(-1, 3)).toi == np.inf
    launched = ccd.CollisionPipeline(mesh, device="cpu").launch(start, end[:, :3].copy())
    assert launched.to_host().toi == np.inf
    twice = named_cloth_and_ball()[0].replicate(2).replicate(3)
    for blocks in (6, 3, 2, 1):
        assert np.array_equal(twice.frame(twice.vertices.reshape(blocks, -1, 3)), twice.vertices)
    with pytest.raises(
        ValueError, match=r"vertices_t0 has shape \(7, 3, 3\); expected .*, or \(3, 7, 3\), with an axis"
    ):
        mesh.frame(flat.reshape(7, 3, 3))


def test_worlds_of_different_sizes_have_no_axis():
    bodies = [(TRIANGLE, FACE), (np.eye(4, 3), FACE)]
    mesh = ccd.CollisionMesh.from_arrays(bodies, vertex_world=[0] * 3 + [1] * 4)
    with pytest.raises(ValueError, match=r"vertices_t0 has shape \(7, 1, 3\); expected \(7, 3\) one row a vertex"):
        mesh.frame(mesh.vertices[:, None])
    even = ccd.CollisionMesh.from_arrays([bodies[0]]).replicate(2)
    with pytest.raises(ValueError, match=r"vertices_t0 has shape \(3, 2, 3\); expected .*, or \(2, 3, 3\), with"):
        even.frame(np.zeros((3, 2, 3)))


# --- what a response uses: touches, normals, the first, and points between surfaces ---


def turned(rng):
    """A rotation at random."""
    q, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    return q * np.sign(np.linalg.det(q))


def box(lower, upper):
    """A box between two corners: vertices and faces."""
    mesh = trimesh.creation.box(bounds=[lower, upper])
    return np.array(mesh.vertices), np.array(mesh.faces)


def tip(x, y):
    """A cone whose tip stands in (x, y, 0)."""
    corners = np.array([[0, 0, 0], [0.3, 0.1, 0.5], [-0.2, 0.4, 0.6], [-0.1, -0.3, 0.4]])
    return corners + [x, y, 0], [[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]]


def ball(x, y):
    """A ball, turned so that a single vertex is lowest, in (x, y, 0)."""
    mesh = trimesh.creation.icosphere(2, 0.3)
    vertices = np.array(mesh.vertices) @ turned(np.random.default_rng(3))
    return vertices + [x, y, 0] - vertices[np.argmin(vertices[:, 2])], np.array(mesh.faces)


def particle(x, y):
    """A ball of radius 0.1 that touches the plane z = 0 from above."""
    return np.array([[x, y, 0.1]]), NO_FACES


BASE = box([0, 0, -1], [1, 1, 0])
GRID = sheet(8, 2.0)  # its squares have sides of 0.25, and diagonals from (0.25, 0) to (0, 0.25)
ROOF = (np.array([[-1, 0, 0], [1, 0, 0], [1, 1, -1], [-1, 1, -1], [-1, -1, -1], [1, -1, -1.0]]),)
ROOF += ([[0, 1, 2], [0, 2, 3], [0, 4, 5], [0, 5, 1]],)
# what stands on what, and in how many places
LANDINGS = {
    "a box on one of its size": (box([0, 0, 0], [1, 1, 1]), BASE, 5),  # the corners, and where two diagonals cross
    "a small box inside a face": (box([0.1, 0.55, 0], [0.3, 0.8, 1]), BASE, 4),
    "a box of the size of a square of a grid": (box([0, 0, 0], [0.25, 0.25, 1]), GRID, 4),  # diagonals in one line
    "a box within squares of a grid": (box([0.05, 0.05, 0], [0.1, 0.1, 1]), GRID, 4),
    "a box half over the rim": (box([0.5, 0.4, 0], [1.5, 0.8, 1]), BASE, 8),  # 2 corners, 6 crossings of edges
    "a tip in a face": (tip(0.1, 0.05), GRID, 1),
    "a tip on a diagonal": (tip(0.125, 0.125), GRID, 1),
    "a tip on the side of a square": (tip(0.25, 0.125), GRID, 1),
    "a tip on a corner of a square": (tip(0.25, 0.25), GRID, 1),
    "a ball in a face": (ball(0.1, 0.05), GRID, 1),
    "a ball on a diagonal": (ball(0.125, 0.125), GRID, 1),
    "a ball on a corner of a square": (ball(0.25, 0.25), GRID, 1),
    "a ridge across a ridge": ((np.array([[0.3, -2, 0], [0.3, 2, 0], [0.3, 0, 1]]), FACE), ROOF, 1),
    "a particle beside a diagonal": (particle(0.12, 0.12), GRID, 1),
    "a particle a rounding beside a diagonal": (particle(0.125 + 1e-12, 0.125), GRID, 1),
    "a particle on a diagonal": (particle(0.125, 0.125), GRID, 1),
    "a particle on a corner of a square": (particle(0.25, 0.25), GRID, 1),
    "a particle beside a corner of a square": (particle(0.26, 0.27), GRID, 1),
}


@pytest.mark.parametrize("name", LANDINGS)
def test_what_lands_touches_once_in_each_place_with_the_normal_of_the_ground(name, device):
    (upper, upper_faces), (lower, lower_faces), count = LANDINGS[name]
    rng = np.random.default_rng(len(name))
    is_ball = len(upper_faces) == 0
    for motion in ([0.0, 0.0, -1.0], [0.6, 0.3, -1.0]):
        for scale, options in (
            (1.0, {}),
            (1e3, {}),
            (1e-3, {"precision": "float32"}),
            (1.0, {"minimum_distance": 0.02}),
        ):
            distance, frame, step = options.get("minimum_distance", 0.0), turned(rng), np.array(motion)
            above = upper + [0, 0, distance] - 0.5 * step
            bodies = [(scale * above @ frame.T, upper_faces), (scale * np.array(lower) @ frame.T, lower_faces)]
            thick = {"codimensional_points": True, "radius": [0.1 * scale, 0.0]} if is_ball else {}
            mesh = ccd.CollisionMesh.from_arrays(bodies, static=[1], self_collision=False, **thick)
            end = mesh.vertices + scale * (frame @ step) * (mesh.vertex_body == 0)[:, None]
            options = options | ({"minimum_distance": scale * distance} if distance else {})
            result = ccd.mesh_ccd(mesh, mesh.vertices, end, device=device, **options)
            unique, normals = result.contacts.unique(), result.contacts.normal
            touches = unique[unique.toi <= 0.5 + 1e-5]
            assert len(touches) == count and np.abs(result.toi - 0.5) < 1e-5
            assert np.allclose(np.abs(touches.normal @ frame), [0, 0, 1], atol=2e-5)  # float32 stops 4e-7 early
            up = touches.normal * np.where(mesh.vertex_body[touches.vertices[:, 0]] == 0, 1, -1)[:, None]
            assert ((up @ frame)[:, 2] > 0).all()
            if is_ball:  # nothing beside what it has met, later, either
                between = [*upper[0][:2], 0.5 * distance]
                assert len(unique) == 1 and np.allclose(result.first.point @ frame / scale, between, atol=1e-5)
            assert np.allclose(np.linalg.norm(normals, axis=1), 1.0)
            first = result.first
            assert first.toi - result.toi < 1e-5 and first.normal @ first.relative_velocity < -0.99 * scale
            assert first.index in np.flatnonzero(result.contacts.toi <= 0.5 + 1e-5)


def test_unique_of_worlds_and_of_a_launch_is_that_of_one():
    upper, lower, count = LANDINGS["a box on one of its size"]
    mesh = ccd.CollisionMesh.from_arrays([upper, lower], static=[1], rigid=[0], self_collision=False)
    start = mesh.vertices + [0, 0, 0.5] * (mesh.vertex_body == 0)[:, None]
    end = start - [0, 0, 1.0] * (mesh.vertex_body == 0)[:, None]
    expected = ccd.mesh_ccd(mesh, start, end).contacts.unique()
    launched = ccd.CollisionPipeline(mesh, length_scale=1.0, device="cpu").launch(start, end).to_host()
    assert np.array_equal(launched.contacts.unique().primitives, expected.primitives)
    assert launched.first.normal.tolist() == [0, 0, 1]
    many = mesh.replicate(3)
    contacts = ccd.mesh_ccd(many, np.tile(start, (3, 1)), np.tile(end, (3, 1))).contacts.unique()
    poses = np.tile([0.0, 0, 0.5, 0, 0, 0, 1], (3, 1, 1))
    motion = ccd.RigidMotion(poses, poses - [0, 0, 1, 0, 0, 0, 0])
    of_motion = ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices, motion=motion)  # which keeps no positions
    for found in (contacts, of_motion.contacts.unique()):
        assert np.bincount(found.world).tolist() == 3 * [count] and np.allclose(np.abs(found.normal), [0, 0, 1])
    assert of_motion.first.normal.tolist() == [0, 0, 1]


def test_corners_in_the_plane_touch_once():
    square = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    sides = [[0, 1], [1, 2], [2, 3], [3, 0]]
    for shift, count in (([0.0, 1.5], 2), ([0.3, 1.5], 2), ([1.0, 1.5], 1)):
        mesh = ccd.CollisionMesh.from_arrays(
            [(square + shift, sides), (square, sides)], static=[1], self_collision=False
        )
        end = mesh.vertices - [0, 1] * (mesh.vertex_body == 0)[:, None]
        result = ccd.mesh_ccd(mesh, mesh.vertices, end)
        touches = result.contacts.unique()
        touches = touches[touches.toi < result.toi + 1e-12]
        assert len(touches) == count and np.abs(touches.normal).tolist() == count * [[0, 1]]


def test_contacts_without_positions_have_no_unique_ones(step):
    with pytest.raises(ValueError, match="contacts were made of arrays alone"):
        ccd.Contacts(**vars(step[3].contacts)).unique()


def cable_over_ground(rng, radius):
    """A cable with a thick and a thin end, and particles, that fall on a half-space."""
    ground = ccd.HalfSpace([0.0, 0, -0.5], [0.1, 0.2, 1.0])
    cable, dust = [[0.0, 0, 0], [1, 0.1, 0], [2, 0, 0.2]], rng.random((5, 3))
    bodies = [(cable, NO_FACES, [[0, 1], [1, 2]]), (dust, NO_FACES), ground]
    mesh = ccd.CollisionMesh.from_arrays(bodies, codimensional_points=True, radius=radius[:8])
    return mesh, mesh.vertices, mesh.vertices - [0, 0, 3]


def surfaces_of(mesh, pairs):
    """Radii of both primitives of each pair, from the lists of the mesh, shape [m, 2]."""
    around = mesh.radius.copy()
    for a, b in mesh.edges:
        around[[a, b]] = np.maximum(around[[a, b]], mesh.radius[[a, b]].max())
    corners = {"vertex": np.arange(mesh.num_vertices)[:, None], "edge": mesh.edges, "face": mesh.faces}
    radii = []
    for kind, (first, second) in zip(pairs.kind, pairs.primitives, strict=True):
        names = ccd.PairKind(kind).name.lower().replace("point", "vertex").replace("segment", "edge").split("_")
        if names[1] == "plane":
            radii.append([around[first], 0.0])
        else:
            radii.append([mesh.radius[corners[name][k]].max() for name, k in zip(names, (first, second), strict=True)])
    return np.array(radii)


def closest_points(pairs, positions):
    """The closest points of both primitives, from the positions of their four vertices, by the weights."""
    first = np.arange(4) < np.where(pairs.kind == int(ccd.PairKind.VERTEX_FACE), 1, 2)[:, None]
    sides = (pairs.weights * side for side in (first, ~first))
    return [np.abs(w)[:, None] @ positions for w in sides]


@pytest.mark.parametrize("make", [crowd_of_all_kinds, crowd_in_plane, cable_over_ground])
@pytest.mark.parametrize("minimum_distance", [0.0, 0.01])
def test_points_lie_halfway_between_both_surfaces(make, minimum_distance, device):
    rng = np.random.default_rng(8)
    radius = rng.uniform(0.0, 0.05, 400)
    if make is cable_over_ground:
        mesh, start, end = make(rng, radius)
    else:
        mesh, start, end = make(rng, radius=radius[: make(np.random.default_rng(8))[0].num_vertices])
    options = {"minimum_distance": minimum_distance, "length_scale": 1.0, "device": device}
    contacts = ccd.mesh_ccd(mesh, start, end, **options).contacts
    frames = (wp.array(x, dtype=(wp.vec2d, wp.vec3d)[mesh.dimension - 2], device=device) for x in (start, end))
    launched = ccd.CollisionPipeline(mesh, **options).launch(*frames)
    assert np.array_equal(launched.to_host().contacts.points, contacts.points)
    order = launched.contacts.order_by_toi().numpy()[: len(contacts)]
    of_device = launched.contacts.points.numpy()[order, : mesh.dimension]
    assert np.array_equal(of_device, contacts.sorted_by_toi().points)
    assert np.array_equal(viz.contact_points(mesh, start, end, contacts), contacts.points)
    later = contacts[contacts.toi > 0]  # between whose closest points is the distance
    t = later.toi[:, None, None]
    first, second = closest_points(later, (1 - t) * start[later.vertices] + t * end[later.vertices])
    radii = surfaces_of(mesh, later)
    assert len(later) > 5 and {*later.kind} >= ({4} if make is cable_over_ground else {2, 3})
    reach = radii + 0.5 * minimum_distance
    has_second = later.kind != int(ccd.PairKind.VERTEX_PLANE)  # a plane has no closest point that vertices give
    assert np.allclose(first[:, 0] - reach[:, :1] * later.normal, later.points, atol=1e-12)
    assert np.allclose((second[:, 0] + reach[:, 1:] * later.normal)[has_second], later.points[has_second], atol=1e-12)
