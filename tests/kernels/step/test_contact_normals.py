"""Normals of contacts: the direction of the gap at toi where there is one, from the second primitive to the first."""

import math
from fractions import Fraction

import numpy as np
import pytest
from distance_oracle import exact_gap
from distance_queries import KINDS
from hard_cases import FAMILIES
from scenes import NO_FACES, pairs_in_worlds

import ccd_warp as ccd

UNIT = 2.0**-53
FACE = np.array([[0, 1, 2]])
SQUARE = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
TWO_FACES = np.array([[0, 1, 2], [0, 2, 3]])
CORNERS = {"vertex-face": ((0, 1), (0, 2), (0, 3)), "edge-edge": ((0, 2), (0, 3), (1, 2), (1, 3))}
CORNERS |= {"point-segment": ((0, 1), (0, 2)), "point-point": ((0, 1),)}
every_kind = pytest.mark.parametrize("kind, dimension", KINDS, ids=[f"{k}-{d}d" for k, d in KINDS])
each_precision = pytest.mark.parametrize("precision", ["float64", "float32"])


def sine(direction, gap):
    """Of the angle between a computed direction and an exact one, above 1 where they are opposed."""
    d = [Fraction(x) for x in direction]
    cross = [d[k - 2] * gap[k - 1] - d[k - 1] * gap[k - 2] for k in range(3)]
    squares = [sum(x * x for x in v) for v in (cross, d, gap)]
    value = math.sqrt(squares[0] / (squares[1] * squares[2]))
    return value if sum(x * y for x, y in zip(d, gap, strict=True)) > 0 else 2.0 - value


def at_parameters(kind, p0, p1, t, uv):
    """The vector from the second to the first point of a contact at its toi and its (u, v), rational."""
    t = Fraction(t)
    x = [
        [(1 - t) * Fraction(a) + t * Fraction(b) for a, b in zip(*row, strict=True)] for row in zip(p0, p1, strict=True)
    ]
    u, v = map(Fraction, uv)
    weights = {
        "vertex-face": (1, u + v - 1, -u, -v),
        "edge-edge": (1 - u, u, v - 1, -v),
        "point-segment": (1, u - 1, -u),
        "point-point": (1, -1),
    }[kind]
    return [sum(w * row[k] for w, row in zip(weights, x, strict=True)) for k in range(len(x[0]))]


def check_against_oracle(kind, points_t0, points_t1, **options):
    """Compare normals and parameters of all contacts with the exact gap; their number, and how many have a gap."""
    dimension = points_t0.shape[2]
    contacts = ccd.mesh_ccd(*pairs_in_worlds(kind, points_t0, points_t1), device="cpu", **options).contacts
    is_kind = contacts.kind == ccd.PairKind[kind.upper().replace("-", "_")]
    assert is_kind.all()
    num_gaps = 0
    for k in range(len(contacts)):
        i = contacts.world[k]
        p0, p1, toi = points_t0[i], points_t1[i], float(contacts.toi[k])
        gap = exact_gap(kind, p0, p1, toi)
        length = math.sqrt(sum(x * x for x in gap))
        size = np.abs([x[a] - x[b] for x in (p0, p1) for a, b in CORNERS[kind]]).max(axis=0)
        rounding = UNIT * float(np.linalg.norm(size))
        if length <= 64 * rounding:
            continue  # may be none, as the kernel sees it
        num_gaps += 1
        normal = np.pad(contacts.normal[k], (0, 3 - dimension))
        # 1.2 of 20,000 pairs measured; a direction of no rounding has three components of one each
        assert sine(normal, gap) <= 4 * rounding / length + 8 * UNIT
        assert np.linalg.norm(normal) == pytest.approx(1, abs=4 * UNIT)
        reported = at_parameters(kind, p0, p1, toi, contacts.parameters[k].tolist())
        # the weights reach the point that is nearest up to roundings of the size of the pair (test_closest_point.py)
        assert math.sqrt(sum(x * x for x in reported)) <= length + 16 * rounding
    return len(contacts), num_gaps


@each_precision
@every_kind
def test_normals_and_parameters_are_those_of_the_exact_gap(kind, dimension, precision):
    rng = np.random.default_rng(7)
    names = ("random_colliding", "slivers", "parallel_edges", "grazing_vertex", "one_plane", "mixed_axis_scales")
    points = [FAMILIES[name](kind, 8, rng, dimension=dimension) for name in names]
    points_t0, points_t1 = (np.concatenate([p[k] for p in points]) for k in (0, 1))
    total = 0
    for options in ({"minimum_distance": 0.05}, {"minimum_separation": 0.05, "length_scale": 1.0}, {"tolerance": 1e-4}):
        count, num_gaps = check_against_oracle(kind, points_t0, points_t1, precision=precision, **options)
        assert count
        total += num_gaps
    assert total > 20


def contact_of(bodies, motion, kind=None, **options):
    """The contacts of a step in which each vertex of body k moves by motion[k]."""
    mesh = ccd.CollisionMesh.from_arrays(bodies)
    end = mesh.vertices + np.asarray(motion, dtype=np.float64)[mesh.vertex_body]
    contacts = ccd.mesh_ccd(mesh, mesh.vertices, end, device="cpu", **options).contacts
    return contacts if kind is None else contacts[contacts.kind == kind]


@pytest.mark.parametrize("motion", [[0, 0, -1], [0, 0, 1], [-1, 0, 0], [1, 0, 0], [0, 1, 0]])
def test_squares_side_by_side_are_pushed_apart_within_their_plane(motion):
    # they start within the distance; the normal of a face, and the velocity, would push one over or into the other
    bodies = [(SQUARE, TWO_FACES), (SQUARE + [1.05, 0.25, 0.0], TWO_FACES)]
    contacts = contact_of(bodies, [[0, 0, 0], 0.01 * np.array(motion)], minimum_distance=0.08)
    assert len(contacts) >= 5 and (contacts.toi == 0).all()
    from_second_to_first = np.where(contacts.bodies[:, 0] == 0, -1.0, 1.0)
    assert np.array_equal(contacts.normal, from_second_to_first[:, None] * [1, 0, 0])


@pytest.mark.parametrize("motion", [-1.0, 1.0])
def test_layers_that_move_apart_keep_their_sides(motion):
    above = SQUARE[:3] * 0.2 + [0.5, 0.3, 0.05]
    (contact, *others) = contact_of(
        [(SQUARE, TWO_FACES), (above, FACE)],
        [[0, 0, 0], [0, 0, motion]],
        ccd.PairKind.VERTEX_FACE,
        minimum_distance=0.1,
    )
    assert contact.toi == 0 and contact.normal.tolist() == [0, 0, 1]
    assert all(other.normal.tolist() == [0, 0, 1] for other in others)


@pytest.mark.parametrize(
    ("point", "expected"),
    [([-0.03, -0.04, 0.0], [-0.6, -0.8, 0.0]), ([0.5, -0.03, 0.04], [0.0, -0.6, 0.8]), ([0.6, 0.2, 0.05], [0, 0, 1])],
    ids=["corner", "side", "inside"],
)
def test_point_beyond_a_corner_of_a_face_is_pushed_away_from_the_corner(point, expected):
    # at twice its distance; it comes along the line from its closest point
    point, expected = np.array(point), np.array(expected)
    bodies = [(SQUARE[:3], FACE), ([point + 0.05 * expected], NO_FACES)]
    mesh = ccd.CollisionMesh.from_arrays(bodies, codimensional_points=[False, True], static=[0])
    end = mesh.vertices.copy()
    end[3] += 0.01 * np.cross(expected, [0.3, 0.5, 0.1]) - 0.1 * expected  # not along the gap alone
    for precision in ("float64", "float32"):
        options = {"minimum_distance": 0.05, "precision": precision, "device": "cpu"}
        (contact,) = ccd.mesh_ccd(mesh, mesh.vertices, end, **options).contacts
        at_toi = mesh.vertices[3] + contact.toi * (end[3] - mesh.vertices[3])
        u, v = contact.parameters
        gap = at_toi - (SQUARE[0] + u * (SQUARE[1] - SQUARE[0]) + v * (SQUARE[2] - SQUARE[0]))
        assert np.allclose(contact.normal, gap / np.linalg.norm(gap), atol=1e-14)
        assert np.allclose(contact.normal, expected, atol=0.1)
        # the reported gap is Euclidean where the distance is
        assert np.linalg.norm(gap) <= 0.05 + contact.gap + 1e-16
        assert contact.gap < (1e-14 if precision == "float64" else 1e-5)


def test_edges_in_one_line_are_pushed_apart_along_it():
    bodies = [([[0.0, 0, 0], [1, 0, 0]], NO_FACES, [[0, 1]]), ([[1.05, 0, 0], [2, 0, 0]], NO_FACES, [[0, 1]])]
    for motion in ([-1, 0, 0], [0, 1, 0], [1, 0, 0]):
        (contact,) = contact_of(bodies, [[0, 0, 0], motion], minimum_distance=0.1)
        assert contact.normal.tolist() == [-1, 0, 0] and contact.parameters == (1.0, 0.0)


def test_parallel_edges_are_pushed_apart_across_both():
    lower, upper = [[0.0, 0, 0], [1, 0, 0]], [[0.25, 0.03, 0.04], [0.75, 0.03, 0.04]]
    bodies = [(lower, NO_FACES, [[0, 1]]), (upper, NO_FACES, [[0, 1]])]
    (contact,) = contact_of(bodies, [[0, 0, 0], [0, 1, 0]], minimum_distance=0.1)
    assert np.allclose(contact.normal, [0, -0.6, -0.8], atol=4 * UNIT)


def test_pair_that_touches_without_a_gap_has_a_normal_against_its_velocity():
    on_the_face = SQUARE[:3] * 0.2 + [0.5, 0.3, 0.0]
    for speed in (-1.0, 1.0):
        contacts = contact_of(
            [(SQUARE, TWO_FACES), (on_the_face, FACE)], [[0, 0, 0], [0, 0, speed]], ccd.PairKind.VERTEX_FACE
        )
        assert len(contacts) >= 3 and (contacts.toi == 0).all()
        assert np.array_equal(contacts.normal, np.tile([0, 0, -speed], (len(contacts), 1)))


@pytest.mark.parametrize("frame", ["axes", "turned"])
def test_edges_that_meet_end_to_end_in_one_line_oppose_their_velocity(frame):
    turn = np.eye(3) if frame == "axes" else np.linalg.qr(np.random.default_rng(4).standard_normal((3, 3)))[0]
    flat = np.array([[0.0, 0, 0], [0, 0, 1], [0, 0, 2]])  # a face without area, along z
    for faces, edges in ((NO_FACES, [[0, 1]]), (FACE, None)):
        body = flat[:2] if edges else flat
        upper, lower = ((body + [0, 0, z]) @ turn.T for z in (1.5, -len(body)))
        given = [(x, faces, edges) if edges else (x, faces) for x in (upper, lower)]
        contacts = contact_of(given, [-3 * turn[:, 2], [0, 0, 0]])
        normal = contacts.normal * np.where(contacts.bodies[:, :1] == 0, 1, -1)
        assert len(contacts) and np.allclose(normal, turn[:, 2], atol=1e-9)


def test_points_that_start_at_one_place_and_stay_have_no_normal():
    mesh = ccd.CollisionMesh.from_arrays([([[1.0, 2, 3], [1, 2, 3]], NO_FACES)], codimensional_points=True)
    (contact,) = ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices + [1.0, 0, 0], device="cpu").contacts
    assert contact.normal.tolist() == [0, 0, 0]


def test_segments_in_the_plane_are_pushed_apart_along_the_gap():
    ground = ([[-1.0, 0], [1, 0]], [[0, 1]])
    wheel = ([[0.0, 0.05], [0.5, 0.5]], [[0, 1]])
    mesh = ccd.CollisionMesh.from_arrays([ground, wheel])
    end = mesh.vertices + [[0, 0], [0, 0], [3, 0], [3, 0]]
    contacts = ccd.mesh_ccd(mesh, mesh.vertices, end, minimum_distance=0.1, device="cpu").contacts
    assert len(contacts) and contacts.normal.shape == (len(contacts), 2)
    of_point = contacts[contacts.primitives[:, 0] == 2]
    assert of_point.normal.tolist() == [[0, 1]] * len(of_point) and len(of_point)


@every_kind
def test_weights_of_the_vertices_give_the_difference_of_the_closest_points(kind, dimension):
    rng = np.random.default_rng(12)
    points_t0, points_t1 = FAMILIES["random_colliding"](kind, 12, rng, dimension=dimension)
    mesh, start, end = pairs_in_worlds(kind, points_t0, points_t1)
    contacts = ccd.mesh_ccd(mesh, start, end, minimum_distance=0.05, device="cpu").contacts
    toi = contacts.toi[:, None, None]
    x = (1 - toi) * start[contacts.vertices] + toi * end[contacts.vertices]
    gap = np.einsum("mk,mkd->md", contacts.weights, x)
    assert len(contacts) > 5 and np.allclose(contacts.weights.sum(axis=1), 0, atol=1e-14)
    length = np.linalg.norm(gap, axis=1, keepdims=True)
    assert np.allclose(gap / length, contacts.normal, atol=1e-9) and np.allclose(
        length[contacts.toi > 0], 0.05, atol=1e-6
    )
