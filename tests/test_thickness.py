"""Thickness: a radius for each body or vertex, and distances that grow by it."""

import copy
import pickle

import numpy as np
import pytest
from scenes import NO_FACES

import ccd_warp as ccd
from ccd_warp._engine.topology import Topology

TRIANGLE = (np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), [[0, 1, 2]])
POINT = (np.array([[0.2, 0.2, 1.0]]), NO_FACES)


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


@pytest.mark.parametrize(
    "given, message",
    [
        (-1.0, "radius is -1.0; expected a finite length of at least 0"),
        (float("nan"), "radius is nan; expected a finite length"),
        (float("inf"), "radius is inf; expected a finite length"),
        (True, "radius is True; expected a finite length"),
        (1 << 1100, "radius is 1.*that float64 can hold"),
        (2**53 + 1, "without rounding"),
        ("0.1", "radius"),
        ([0.1], r"radius has shape \(1,\); expected a number, shape \(2,\), one a body, or \(4,\), one a vertex"),
        ([[0.1, 0.2]], r"radius has shape \(1, 2\)"),
        ([0.1, -0.2], "radius holds -0.2 in entry 1; expected finite lengths of at least 0"),
        ([0.1, np.nan], "radius holds nan in entry 1"),
        ([0, 0, np.inf, 0], "radius holds inf in entry 2 of sheet"),
        (np.array(-1.0), "radius holds -1.0 in entry 0"),
        ([True, False], "radius has dtype bool"),
        ([1j, 2], "radius has dtype complex128"),
        ([0.1, None], "radius has dtype object"),
        ([[0.1], [0.1, 0.2]], "radius is not an array"),
        (np.ma.array([0.1, 0.2], mask=[0, 1]), "radius is a masked array"),
        ([2**53 + 1, 0.5], "radius holds 9007199254740993 in entry 0"),
    ],
)
def test_bad_radius_is_a_value_error_that_names_it(given, message):
    with pytest.raises(ValueError, match=message):
        triangle_and_point(given)


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
    import trimesh

    ball, box = trimesh.creation.icosphere(0), trimesh.creation.box()
    mesh = ccd.CollisionMesh.from_trimesh([ball, box], radius=[0.5, 0.0])
    assert mesh.radius.tolist() == [0.5] * len(ball.vertices) + [0.0] * len(box.vertices)


def test_boxes_of_vertices_hold_the_thickest_primitive_around_them():
    import warp as wp

    strip = (np.zeros((5, 3)), [[0, 1, 2], [1, 2, 3]], [[3, 4]])
    mesh = ccd.CollisionMesh.from_arrays([strip], radius=[1.0, 0, 0, 0, 5.0])
    topology = Topology.of(mesh, wp.get_device("cpu"))
    assert topology.radius.numpy().tolist() == mesh.radius.tolist()
    assert topology.box_radius.numpy().tolist() == [1.0, 1.0, 1.0, 5.0, 5.0]
    none = Topology.of(ccd.CollisionMesh.from_arrays([strip]), wp.get_device("cpu"))
    assert len(none.radius) == len(none.box_radius) == 0
