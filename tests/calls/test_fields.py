"""What the fields of a result mean: its sides, signs, orders and units, in one step that has every kind of pair."""

import numpy as np
import pytest
from scenes import FACE, TRIANGLE, two_of_every_kind

import ccd_warp as ccd

DISTANCE = 0.1


@pytest.fixture(scope="module")
def step():
    """Two bodies, the upper one (1) comes within the distance of the lower one (0), and that of the ground (2)."""
    mesh = two_of_every_kind(ccd.HalfSpace([0, 0, -0.35], [0, 0, 2.0]))
    end = mesh.vertices - np.where(mesh.vertex_body == 1, 0.75, 0.3)[:, None] * [0, 0, 1]
    contacts = ccd.mesh_ccd(mesh, mesh.vertices, end, minimum_distance=DISTANCE).contacts
    at_toi = [(1 - contact.toi) * mesh.vertices + contact.toi * end for contact in contacts]
    return mesh, contacts, at_toi, ccd.find_proximity(mesh, end, DISTANCE)


def one_of_each_kind(pairs):
    """A row of every kind of pair."""
    return [int(np.flatnonzero(pairs.kind == kind)[0]) for kind in ccd.PairKind]


def test_the_first_primitive_and_its_body_come_first_and_normals_point_to_it(step):
    mesh, contacts, _, near = step
    tables = {"vertex": np.arange(mesh.num_vertices)[:, None], "edge": mesh.edges, "face": mesh.faces}
    tables |= {"point": tables["vertex"], "segment": mesh.edges, "plane": np.empty((1, 0), dtype=int)}
    for pairs, normal in ((contacts, contacts.normal), (near, near.direction)):
        for k in one_of_each_kind(pairs):
            names, (a, b) = ccd.PairKind(int(pairs.kind[k])).name.lower().split("_"), pairs.primitives[k].tolist()
            first, second = tables[names[0]][a].tolist(), tables[names[1]][b].tolist()
            assert list(dict.fromkeys(pairs.vertices[k].tolist())) == first + second
            body = mesh.vertex_body[second[0]] if second else mesh.planes.bodies[b]
            assert pairs.bodies[k].tolist() == [mesh.vertex_body[first[0]], body]
            # which a push by the weights along the normal moves away from the other
            assert pairs.weights[k, : 1 if pairs.kind[k] == 0 else 2].sum() == pytest.approx(1.0, abs=1e-15)
        is_first_above = (pairs.bodies[:, 0] == 1) | (pairs.bodies[:, 1] == 2)
        assert 5 < is_first_above.sum() < len(pairs) and np.array_equal(normal[:, 2] > 0, is_first_above)


def test_points_and_parameters_are_those_of_the_closest_points(step):
    _, contacts, at_toi, near = step
    for k in one_of_each_kind(contacts):
        contact = contacts[k]
        x, (u, v) = at_toi[k][contacts.vertices[k]], contact.parameters
        p, q = {
            "VERTEX_FACE": (x[0], x[1] + u * (x[2] - x[1]) + v * (x[3] - x[1])),
            "EDGE_EDGE": (x[0] + u * (x[1] - x[0]), x[2] + v * (x[3] - x[2])),
            "POINT_SEGMENT": (x[0], x[2] + u * (x[3] - x[2])),
            "POINT_POINT": (x[0], x[2]),
            "VERTEX_PLANE": (x[0], [*x[0, :2], -0.35]),
        }[contact.kind.name]
        assert np.allclose(p - q, DISTANCE * contact.normal, atol=1e-5)
        assert np.allclose(contact.point, (p + q) / 2, atol=1e-12)
        assert np.array_equal(contact.point, contacts.points[k])
    near = near[near.kind <= int(ccd.PairKind.EDGE_EDGE)]  # features: a bit for each vertex of the closest points
    bits = near.features[:, None] >> np.arange(4) & 1
    assert np.array_equal(bits == 1, near.weights != 0) and len({*near.features.tolist()}) > 1


def test_velocities_are_those_of_the_first_less_the_second_and_gaps_no_less_than_true_ones(step):
    _, contacts, at_toi, _ = step
    velocity = np.array([[0, 0, -0.3], [0, 0, -0.75], [0, 0, 0]])[contacts.bodies]
    assert np.allclose(contacts.relative_velocity, velocity[:, 0] - velocity[:, 1], rtol=0, atol=1e-14)
    for k, contact in enumerate(contacts):
        assert np.array_equal(contact.relative_velocity, contacts.relative_velocity[k])
        assert contact.relative_velocity @ contact.normal < -0.1 and 0 <= contact.gap < 1e-4
        gap = np.linalg.norm(contacts.weights[k] @ at_toi[k][contacts.vertices[k]])
        assert contact.kind == ccd.PairKind.VERTEX_PLANE or gap - DISTANCE <= contact.gap + 1e-15


def test_a_line_search_says_how_far_each_vertex_goes_and_what_keeps_it():
    standing = np.array([[0.1, 0.2, 0.0], [0.2, 0.2, 1.0], [0.1, 0.3, 1.0]])  # on one vertex
    bodies = [(x, FACE) for x in (TRIANGLE, standing, TRIANGLE + [5.0, 0.0, 1.0])]
    mesh = ccd.CollisionMesh.from_arrays(bodies, static=[0], names=["floor", "leg", "other"])
    end = mesh.vertices - [0, 0, 0.5] * (mesh.vertex_body > 0)[:, None]
    found = ccd.line_search(mesh, mesh.vertices, end, per="vertex")
    assert found.vertex_fraction.tolist() == [1, 1, 1, 0, 1, 1, 1, 1, 1] and found.fraction == 0.0
    (foot,) = found.touching[found.touching.kind == ccd.PairKind.VERTEX_FACE]
    assert np.allclose(foot.point, [0.1, 0.2, 0.0], atol=1e-15) and foot.body_names == ("leg", "floor")
