"""Normals of contacts: the direction of the gap at toi where there is one, from the second primitive to the first."""

import math
from fractions import Fraction

import numpy as np
import pytest
from distance_oracle import exact_gap
from distance_queries import KINDS
from hard_cases import FAMILIES
from oracle_corners import CORNERS
from scenes import FACE, NO_FACES, pairs_in_worlds

import ccd_warp as ccd

UNIT = 2.0**-53
SQUARE = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
TWO_FACES = np.array([[0, 1, 2], [0, 2, 3]])
LINE = [[0, 1]]


exactly = np.vectorize(Fraction, otypes=[object])


def sine(direction, gap):
    """Of the angle between a computed direction and an exact one, above 1 where they are opposed."""
    d, gap = exactly(direction), np.array(gap)
    cross = np.cross(d, gap)
    value = math.sqrt(cross @ cross / ((d @ d) * (gap @ gap)))
    return value if d @ gap > 0 else 2.0 - value


@pytest.mark.parametrize(("kind", "dimension"), KINDS, ids=[f"{k}-{d}d" for k, d in KINDS])
def test_normals_and_weights_are_those_of_the_exact_gap(kind, dimension, precision):
    rng, num_gaps = np.random.default_rng(7), 0
    names = ("random_colliding", "slivers", "parallel_edges", "grazing_vertex", "one_plane", "mixed_axis_scales")
    drawn = [FAMILIES[name](kind, 8, rng, dimension=dimension) for name in names]
    start, end = (np.concatenate([p[k] for p in drawn]) for k in (0, 1))
    mesh, x0, x1 = pairs_in_worlds(kind, start, end)
    for options in ({"minimum_distance": 0.05}, {"minimum_separation": 0.05, "length_scale": 1.0}, {"tolerance": 1e-4}):
        contacts = ccd.mesh_ccd(mesh, x0, x1, precision=precision, **options).contacts
        assert len(contacts) and np.allclose(contacts.weights.sum(axis=1), 0, atol=1e-14)
        for k, i in enumerate(contacts.world):
            p, q, t = start[i], end[i], Fraction(float(contacts.toi[k]))
            gap = exact_gap(kind, p, q, float(t))
            length = math.sqrt(np.dot(gap, gap))
            size = np.abs([x[a] - x[b] for x in (p, q) for a, b in CORNERS[kind]]).max(axis=0)
            rounding = UNIT * float(np.linalg.norm(size))
            if length <= 64 * rounding:
                continue  # may be none, as the kernel sees it
            num_gaps += 1
            normal = np.pad(contacts.normal[k], (0, 3 - dimension))
            # 1.2 of 20,000 pairs measured; a direction of no rounding has three components of one each
            assert sine(normal, gap) <= 4 * rounding / length + 8 * UNIT
            assert np.linalg.norm(normal) == pytest.approx(1, abs=4 * UNIT)
            # weights reach the point that is nearest up to roundings of the size of the pair
            v = contacts.vertices[k]
            at = exactly(contacts.weights[k]) @ ((1 - t) * exactly(x0[v]) + t * exactly(x1[v]))
            assert math.sqrt(at @ at) <= length + 16 * rounding
    assert num_gaps > 20


def contacts_of(bodies, motion, **options):
    """The contacts of a step in which each vertex of body k moves by motion[k]."""
    mesh = ccd.CollisionMesh.from_arrays(bodies)
    return ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices + np.array(motion)[mesh.vertex_body], **options).contacts


def test_pair_that_touches_without_a_gap_has_a_normal_against_its_velocity():
    for speed in (-1.0, 1.0):  # what lies on a face, and layers with a gap, that part or press on
        for height, distance, sign in ((0.0, 0.0, -speed), (0.05, 0.1, 1.0)):
            bodies = [(SQUARE, TWO_FACES), (SQUARE[:3] * 0.2 + [0.5, 0.3, height], FACE)]
            found = contacts_of(bodies, [[0, 0, 0], [0, 0, speed]], minimum_distance=distance)
            found = found[found.kind == ccd.PairKind.VERTEX_FACE]
            assert len(found) >= 3 and (found.toi == 0).all() and (found.normal == [0, 0, sign]).all()
    turn = np.linalg.qr(np.random.default_rng(4).normal(size=(3, 3)))[0]
    flat = np.array([[0.0, 0, 0], [0, 0, 1], [0, 0, 2]])  # end to end in a line
    for axes, (x, *parts) in ((a, b) for a in (np.eye(3), turn) for b in ((flat[:2], NO_FACES, LINE), (flat, FACE))):
        bodies = [((x + [0, 0, z]) @ axes.T, *parts) for z in (1.5, -len(x))]
        contacts = contacts_of(bodies, [-3 * axes[:, 2], [0, 0, 0]])
        normal = contacts.normal * np.where(contacts.bodies[:, :1] == 0, 1, -1)
        assert len(contacts) and np.allclose(normal, axes[:, 2], atol=1e-9)
    mesh = ccd.CollisionMesh.from_arrays([([[1.0, 2, 3], [1, 2, 3]], NO_FACES)], codimensional_points=True)
    (contact,) = ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices + [1.0, 0, 0]).contacts
    assert contact.normal.tolist() == [0, 0, 0]  # points in one place that stay so
