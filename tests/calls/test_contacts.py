"""Contacts of a result and of a launch: what touches what and where, one at a time, by toi, and once in each place."""

import copy
import pickle

import numpy as np
import pytest
import trimesh
import warp as wp
from expected_warnings import OF_STRAIGHT_MOTION
from laws.calls import on_device
from scenes import TRIANGLE, named_cloth_and_ball

import ccd_warp as ccd
from ccd_warp._results.contact_place import MovingVertices, points_at_toi

NAMES = ("points", "vertices", "weights", "bodies", "world")


@pytest.fixture(scope="module")
def step():
    mesh, start, end = named_cloth_and_ball()
    return mesh, start, end, ccd.mesh_ccd(mesh, start, end)


def test_the_first_contact_says_what_touches_what_and_where(step):
    mesh, start, _, result = step
    first, contacts = result.first, result.contacts
    assert first.toi == result.toi and first.index == int(np.argmin(contacts.toi))
    # The top of the ball is at 0.3, and the cloth falls on it by 0.2 of the way from 0.5 to -0.5.
    assert np.allclose(first.point, [0.0, 0.0, 0.3], atol=1e-5)
    assert {*first.body_names} == {"cloth", "ball"} == {mesh.names[b] for b in first.bodies}
    assert first.kind == ccd.PairKind.VERTEX_FACE and first.status == ccd.CCDStatus.COLLISION and first.world == 0
    vertex, face = first.primitives
    assert first.vertices.tolist() == [vertex, *mesh.faces[face].tolist()]
    assert mesh.static[first.bodies].tolist() == [True, False]  # an array, which indexes
    assert repr(first).startswith("Contact(vertex-face of ball and cloth at (")
    assert repr(first).endswith(f"toi={result.toi!r})") and repr(first)[8:40] in repr(result)
    alone = ccd.Contacts(**vars(contacts))  # made of arrays, which know no mesh
    assert repr(alone[0]) == "Contact(vertex-face, toi=0.41396618080018616)"
    none = ccd.mesh_ccd(mesh, start, start)
    assert none.first is None and list(none.contacts) == [] and repr(none) == "MeshResult(toi=inf, no contact)"
    assert none.contacts.points.shape == (0, 3) and none.contacts.vertices.shape == (0, 4)


def test_contacts_are_read_one_at_a_time_in_part_by_toi_and_as_copies(step):
    contacts = step[3].contacts
    assert [c.toi for c in contacts] == contacts.toi.tolist() and contacts[-1].index == len(contacts) - 1
    for chosen in (contacts.toi < 0.3, [3, 1], slice(5, 2, -1)):
        part = contacts[chosen]
        assert isinstance(part, ccd.Contacts) and np.array_equal(part.points, contacts.points[chosen])
        assert np.array_equal(part.vertices, contacts.vertices[chosen])
    by_toi = contacts.sorted_by_toi()
    assert np.array_equal(by_toi.points, contacts.points[np.argsort(contacts.toi, kind="stable")])
    found = ccd.line_search(*step[:3])
    for copied in (copy.copy, copy.deepcopy, lambda value: pickle.loads(pickle.dumps(value))):
        result = copied(step[3])
        assert np.array_equal(result.contacts.points, contacts.points) and repr(result) == repr(step[3])
        assert np.array_equal(copied(result.first).vertices, result.first.vertices)
        shortened_by = copied(copied(found)).shortened_by
        assert len(shortened_by) and np.array_equal(shortened_by.points, found.shortened_by.points)


@pytest.mark.parametrize("num_more", [0, 19_000])  # few and many vertices for each contact
def test_points_are_those_of_the_step_whatever_becomes_of_the_callers_arrays(num_more):
    mesh, start, end = named_cloth_and_ball()
    far = np.tile(TRIANGLE, (num_more // 3, 1)) + 9.0
    bodies = [(start, mesh.faces), (far, np.arange(len(far)).reshape(-1, 3))]
    mesh = ccd.CollisionMesh.from_arrays(bodies, static=[1])
    start, end = np.vstack([start, far]), np.vstack([end, far])
    contacts = ccd.mesh_ccd(mesh, start, end).contacts
    expected = points_at_toi(MovingVertices(mesh, start.copy(), end.copy()), contacts)
    start[:] = end[:] = 0.0
    assert len(expected) and np.array_equal(contacts.points, expected)
    assert np.allclose(contacts.relative_velocity[:, :2], 0.0) and (abs(contacts.relative_velocity[:, 2]) > 0.5).all()


# --- what a response uses: each place once, and its normal ---


def box(lower, upper):
    """A box between two corners: vertices and faces."""
    mesh = trimesh.creation.box(bounds=[lower, upper])
    return np.array(mesh.vertices), np.array(mesh.faces)


BASE = box([0, 0, -1], [1, 1, 0])


@OF_STRAIGHT_MOTION
def test_unique_of_worlds_of_a_launch_of_a_motion_and_in_the_plane_is_that_of_one():
    upper, lower, count = box([0, 0, 0], [1, 1, 1]), BASE, 5  # the corners, and where two diagonals cross
    mesh = ccd.CollisionMesh.from_arrays([upper, lower], static=[1], rigid=[0], self_collision=False).replicate(3)
    start = mesh.vertices + [0, 0, 0.5] * (mesh.vertex_body % 2 == 0)[:, None]
    end = start - [0, 0, 1.0] * (mesh.vertex_body % 2 == 0)[:, None]
    poses = np.tile([0.0, 0, 0.5, 0, 0, 0, 1], (3, 1))
    motion = ccd.RigidMotion(poses, poses - [0, 0, 1, 0, 0, 0, 0])
    of_motion = ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices, motion=motion)  # which keeps no positions
    launched = ccd.CollisionPipeline(mesh).launch(start, end).to_host()
    for result in (launched, of_motion, ccd.mesh_ccd(mesh, start, end)):
        found = result.contacts.unique()
        assert np.bincount(found.world).tolist() == 3 * [count] and np.allclose(np.abs(found.normal), [0, 0, 1])
        assert result.first.normal.tolist() == [0, 0, 1]
    square, sides = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]]), [[0, 1], [1, 2], [2, 3], [3, 0]]
    for shift, count in ((0.0, 2), (0.3, 2), (1.0, 1)):
        mesh = ccd.CollisionMesh.from_arrays([(square + [shift, 1.5], sides), (square, sides)], self_collision=False)
        result = ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices - [0, 1] * (mesh.vertex_body == 0)[:, None])
        touches = result.contacts.unique()
        assert np.abs(touches.normal[touches.toi < result.toi + 1e-12]).tolist() == count * [[0, 1]]


# --- of a launch, asked where they are ---


def test_nothing_is_made_for_those_who_do_not_ask_and_once_for_those_who_do(step, monkeypatch):
    made, empty = [], wp.empty
    pipeline = ccd.CollisionPipeline(step[0], max_contacts=567)
    before = ccd.CollisionPipeline(step[0]).reserve()
    with pytest.raises(ValueError, match=r"contacts\.points are not known, as no launch has read positions"):
        _ = before.contacts.points
    assert before.to_host().contacts.points.shape == (0, 3) and before.to_host().first is None
    monkeypatch.setattr(wp, "empty", lambda shape, *a, **k: (made.append(shape), empty(shape, *a, **k))[1])
    result = pipeline.launch(*step[1:3])
    assert made.count(567) == len(vars(result.contacts)) - 1
    made.clear()
    assert result.contacts.points is result.contacts.points and made == [567]
    # those beyond the capacity are left out
    assert result.contacts.count.numpy()[0] > 567 == len(result.to_host().contacts) == len(result.contacts.points)
    x, y = on_device(step[1]), on_device(step[2])
    contacts = ccd.CollisionPipeline(step[0]).launch(x, y).contacts
    questions = {name: lambda name=name: getattr(contacts, name) for name in NAMES}
    questions |= {"points_at": lambda: contacts.points_at(x, y)}
    for name, ask in questions.items():
        message = rf"a graph is being captured; ask for contacts\.{name}\b.* once before the capture"
        with pytest.raises(RuntimeError, match=message), wp.ScopedCapture():
            ask()
