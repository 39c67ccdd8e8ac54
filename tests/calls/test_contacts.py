"""Contacts of a result: where they are, of which bodies and worlds, one at a time, by toi, and after a launch."""

import copy
import pickle

import numpy as np
import pytest
import warp as wp
from scenes import (
    FACE,
    NO_FACES,
    TRIANGLE,
    cloth_and_ball_in_worlds,
    named_cloth_and_ball,
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
