"""Robots from URDF files: joints, bodies around what the file describes, neighbours, and what is refused."""

import importlib.util
import sys

import numpy as np
import pytest

import ccd_warp as ccd

needs_parser = pytest.mark.skipif(importlib.util.find_spec("yourdfpy") is None, reason="needs the extra urdf")
HALF = np.sqrt(0.5)

GRIPPER = """<?xml version="1.0"?>
<robot name="gripper">
  <link name="base"><collision><geometry><box size="0.2 0.4 0.1"/></geometry></collision></link>
  <link name="arm">
    <collision><origin xyz="0 0 0.3"/><geometry><cylinder radius="0.05" length="0.4"/></geometry></collision>
    <!-- a lamp -->
    <collision><origin xyz="0.1 0 0.3"/><geometry><sphere radius="0.03"/></geometry></collision>
  </link>
  <link name="flange"/>
  <sensor:camera name="eye"/>
  <link name="hand"><collision><geometry>
    <mesh filename="package://gripper/meshes/hand.stl" scale="0.1 0.1 0.2"/></geometry></collision></link>
  <link name="camera"><collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>
  <link name="left"><collision><geometry><box size="0.01 0.01 0.1"/></geometry></collision></link>
  <link name="right"><collision><geometry><box size="0.01 0.01 0.1"/></geometry></collision></link>
  <joint name="turn" type="revolute"><parent link="base"/><child link="arm"/>
    <origin xyz="0 0 0.1" rpy="0 0 1.5707963267948966"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
  <joint name="roll" type="continuous"><parent link="arm"/><child link="flange"/><origin xyz="0 0 0.5"/></joint>
  <joint name="mount" type="fixed"><parent link="flange"/><child link="hand"/></joint>
  <joint name="eye" type="fixed"><parent link="hand"/><child link="camera"/><origin xyz="0 0.1 0"/></joint>
  <joint name="grip" type="prismatic"><parent link="hand"/><child link="left"/><axis xyz="0 1 0"/></joint>
  <joint name="follow" type="prismatic"><parent link="hand"/><child link="right"/><axis xyz="0 -1 0"/>
    <mimic joint="grip" multiplier="2" offset="0.5"/></joint>
</robot>
"""
CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)


@pytest.fixture
def file(tmp_path):
    """The file, and its mesh beside it."""
    import trimesh

    (tmp_path / "meshes").mkdir()
    hull = trimesh.Trimesh(CUBE).convex_hull
    hull.export(tmp_path / "meshes" / "hand.stl")
    (tmp_path / "gripper.urdf").write_text(GRIPPER)
    return tmp_path / "gripper.urdf"


@needs_parser
def test_joints_and_bodies_of_a_file(file):
    robot = ccd.read_urdf(file)
    assert repr(robot) == "Robot(3 moving joints, 6 links with geometry)"
    assert robot.names == ("base", "arm", "hand", "camera", "left", "right")
    assert robot.coordinates == ("turn", "roll", "grip") and robot.num_coordinates == 3
    assert robot.static == ("base",)
    roll = robot.joints[1]
    assert (roll.kind, roll.axis, roll.origin) == ("continuous", (1.0, 0.0, 0.0), (0, 0, 0.5, 0, 0, 0, 1))
    turned = (0, 0, 0.1, 0, 0, HALF, HALF)
    assert np.abs(np.subtract(robot.joints[0].origin, turned)).max() < 1e-15
    base, _, hand, *_ = robot.bodies
    assert np.array_equal(np.abs(base[0]).max(axis=0), [0.1, 0.2, 0.05]) and len(base[1]) == 12
    assert np.abs(np.unique(hand[0], axis=0) - CUBE * [0.1, 0.1, 0.2]).max() < 1e-8  # STL is of float32
    assert len(hand[0]) == 8


@needs_parser
def test_bodies_are_around_cylinders_and_spheres_and_hardly_larger(file):
    vertices, faces = ccd.read_urdf(file).bodies[1]
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    of_sphere = faces[:, 0] >= 66
    nearest = (normals * (corners[:, 0] - [0.1, 0, 0.3])).sum(axis=1)[of_sphere]
    assert of_sphere.sum() == 1280 and nearest.min() >= 0.03
    assert np.linalg.norm(vertices[66:] - [0.1, 0, 0.3], axis=1).max() < 0.03 * 1.01
    heights = (normals * (corners[:, 0] - [0, 0, 0.3])).sum(axis=1)[~of_sphere]
    is_end = np.abs(normals[~of_sphere, 2]) > 0.5
    assert heights[is_end].min() >= 0.2 and heights[~is_end].min() >= 0.05
    assert np.linalg.norm(vertices[:66, :2], axis=1).max() < 0.05 * 1.005


@needs_parser
def test_neighbours_are_not_tested_against_each_other(file):
    robot = ccd.read_urdf(file)
    pairs = [("arm", "base"), ("arm", "hand"), ("camera", "hand"), ("hand", "left"), ("hand", "right")]
    assert robot.neighbours == frozenset(pairs)  # across the flange, which has no geometry
    floor = ([[-1.0, -1, 0], [1, -1, 0], [0, 1, 0]], [[0, 1, 2]])
    mesh = robot.mesh({"floor": floor}, exclude=[("left", "right")])
    assert mesh.names == (*robot.names, "floor")
    assert mesh.rigid.tolist() == [True] * 6 + [False] and mesh.static.tolist() == [True] + [False] * 5 + [True]
    may = mesh.body_pairs
    assert not may[0, 1] and not may[4, 5] and may[3, 4] and may[1, 6]
    with pytest.raises(ValueError, match=r"exclude has \('left', 'foot'\); expected two names out of base, arm"):
        robot.mesh(exclude=[("left", "foot")])
    with pytest.raises(ValueError, match="obstacles is 3; expected vertices and faces by name"):
        robot.mesh(3)


@needs_parser
def test_a_motion_has_a_row_for_each_body_and_joints_that_mimic_go_along(file):
    robot = ccd.read_urdf(file, base=(1, 0, 0, 0, 0, 0, 1))
    motion = robot.motion([0, 0, 0], np.array([[0, 0, 0.25], [1, 1, 0]]))
    assert motion.names == robot.names and motion.num_worlds == 2
    assert np.abs(motion.poses_t1[0, 4:, :3] - [[0.75, 0, 0.6], [2, 0, 0.6]]).max() < 1e-15
    assert np.array_equal(robot.configuration([1, 2, 3]), [1, 2, 3, 6.5])
    with pytest.raises(ValueError, match=r"q1 has shape \(4,\); expected shape \(..., 3\), the numbers of the joints"):
        robot.motion([0, 0, 0], [0, 0, 0, 0])


@needs_parser
def test_links_are_where_the_parser_has_them(file, caplog):
    """Its own kinematics, by matrices."""
    import yourdfpy

    robot = ccd.read_urdf(file)
    assert not caplog.text
    other = yourdfpy.URDF.load(str(file), load_meshes=False)
    for q in np.random.default_rng(0).normal(size=(3, 3)):
        other.update_cfg(q)
        poses = robot.motion(q, q).poses_t0
        matrices = np.array([other.get_transform(name) for name in robot.names])
        seen = ccd.RigidMotion(matrices, matrices).poses_t0
        signs = np.sign((poses[:, 3:] * seen[:, 3:]).sum(axis=1, keepdims=True))
        assert np.abs(np.hstack([seen[:, :3], signs * seen[:, 3:]]) - poses).max() < 1e-14


DAMAGED = [
    ("</robot>", "", "is no URDF file"),
    ('<parent link="base"/>', "", "is no URDF file"),
    ('<parent link="base"/>', '<parent link="bse"/>', "joint 'turn' joins 'bse', which is no link"),
    ('<child link="arm"/>', '<child link="base"/>', "a loop of 1 joint: turn"),
    ('type="continuous"', 'type="planar"', "kind of joint 'roll' is 'planar'"),
    ('<axis xyz="0 -1 0"/>', '<axis xyz="0 0 0"/>', "axis of joint 'follow' is"),
    ("meshes/hand.stl", "meshes/hnd.stl", "which is not found; expected packages="),
    ('<mimic joint="grip"', '<mimic joint="eye"', "joint 'follow' mimics 'eye'"),
    ('<link name="flange"/>', '<link name="flange"/><link name="lid"/>', "has the links lid, which no joint joins"),
]


@needs_parser
@pytest.mark.parametrize(("old", "new", "message"), DAMAGED)
def test_damaged_files_are_refused(file, old, new, message):
    file.write_text(GRIPPER.replace(old, new, 1))
    with pytest.raises(ValueError) as error:
        ccd.read_urdf(file)
    assert message in str(error.value) and "gripper.urdf" in str(error.value)


@needs_parser
def test_packages_are_folders(file, tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "meshes").rename(tmp_path / "elsewhere" / "meshes")
    robot = ccd.read_urdf(file, packages={"gripper": tmp_path / "elsewhere"})
    assert len(robot.bodies[2][0]) == 8


@needs_parser
def test_vertices_of_a_mesh_that_are_in_no_face_are_left_out(file):
    """Whatever they are; the others are merged as they would be without."""
    hull = "v 1 0 0\nv nan 0 0\nv 0 1 0\nv 0 0 1\nv 1 0 0\nv 9 9 9\nv 0 1 1\nf 1 3 4\nf 5 3 7\n"
    (file.parent / "meshes" / "hand.obj").write_text(hull)
    file.write_text(GRIPPER.replace("hand.stl", "hand.obj"))
    vertices, faces = ccd.read_urdf(file).bodies[2]
    corners = np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1], [0, 1, 1]]) * [0.1, 0.1, 0.2]
    assert np.array_equal(vertices[faces], corners[[[0, 1, 2], [0, 1, 3]]]) and len(vertices) == 4


def test_without_the_extra_the_error_says_which(monkeypatch):
    monkeypatch.setitem(sys.modules, "yourdfpy", None)
    with pytest.raises(ImportError, match=r"read_urdf needs yourdfpy; install with: pip install 'ccd-warp\[urdf\]'"):
        ccd.read_urdf("a.urdf")
