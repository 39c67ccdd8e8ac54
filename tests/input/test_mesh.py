"""CollisionMesh: what it is made of, frames, copies, and what it calls its bodies."""

import copy
import gc
import pickle
import weakref
from dataclasses import fields, replace

import numpy as np
import pytest
import trimesh

import ccd_warp as ccd
from ccd_warp import CollisionMesh
from ccd_warp._engine.mesh.mesh_cache import MeshCache

TRIANGLE = (np.eye(3), [[0, 1, 2]])
TETRAHEDRON = (np.eye(4, 3), [[0, 1, 2], [0, 3, 1], [1, 3, 2], [2, 3, 0]])
COPIERS = [copy.copy, copy.deepcopy, lambda mesh: pickle.loads(pickle.dumps(mesh))]


def test_edges_are_unique_pairs_sorted_by_max_then_min():
    rng = np.random.default_rng(0)
    faces = rng.integers(0, 30, (200, 3))
    mesh = CollisionMesh.from_arrays([(rng.random((30, 3)), faces)])
    pairs = {(int(min(p)), int(max(p))) for f in faces for p in zip(f, np.roll(f, 1), strict=True) if p[0] != p[1]}
    assert [tuple(e) for e in mesh.edges.tolist()] == sorted(pairs, key=lambda p: (p[1], p[0]))
    twice = CollisionMesh.from_arrays([(np.zeros((3, 3)), [[0, 0, 1], [2, 2, 2], [0, 1, 2], [0, 1, 2]])])
    assert twice.edges.tolist() == [[0, 1], [0, 2], [1, 2]]


def test_objects_of_trimesh_are_bodies_in_order_and_a_scene_one_a_node():
    box, ball = trimesh.creation.box(), trimesh.creation.icosphere(1)
    path = trimesh.load_path([[0, 0, 0], [1, 0, 0], [1, 1, 0]])
    mesh = CollisionMesh.from_trimesh([box, ball, path, trimesh.PointCloud(np.eye(2, 3))], static=[1])
    assert np.array_equal(mesh.vertices[:50], np.concatenate([box.vertices, ball.vertices]))
    assert np.array_equal(mesh.faces, np.concatenate([box.faces, ball.faces + 8]))
    assert mesh.edges[mesh.codimensional_edges].tolist() == [[50, 51], [51, 52]]
    assert mesh.num_edges == len(box.edges_unique) + len(ball.edges_unique) + 2
    assert mesh.codimensional_points.tolist() == [53, 54] and CollisionMesh.from_trimesh(box).names == ("body 0",)
    unused = trimesh.Trimesh(np.zeros((4, 3)), [[0, 1, 2]], process=False)
    assert CollisionMesh.from_trimesh([unused], codimensional_points=True).codimensional_points.tolist() == [3]
    # a box used by two nodes, the second moved and turned, and points
    scene, turned = trimesh.Scene(), trimesh.transformations.rotation_matrix(np.pi / 2, [0, 0, 1])
    turned[:3, 3] = [0.1, 0.2, 5.0]
    scene.add_geometry(box, node_name="floor", geom_name="box")
    scene.graph.update(frame_to="crate", matrix=turned, geometry="box")
    scene.add_geometry(trimesh.PointCloud(np.eye(2, 3)), node_name="dust")
    mesh = CollisionMesh.from_trimesh(scene, static=["floor"])
    assert mesh.names == ("floor", "crate", "dust") and mesh.static.tolist() == [True, False, False]
    assert np.array_equal(mesh.vertices[:8], box.vertices)  # the identity changes no bit
    assert np.allclose(mesh.vertices[8:16], box.vertices @ turned[:3, :3].T + turned[:3, 3], atol=1e-15)
    names = ("body 0", "floor", "crate", "dust", "floor (2)", "crate (2)", "dust (2)")
    assert CollisionMesh.from_trimesh([ball, scene, scene]).names == names
    arc = trimesh.path.Path3D([trimesh.path.entities.Arc([0, 1, 2])], np.eye(3))
    for bodies, message in ((trimesh.Scene(), "a Scene without geom"), (arc, "a Arc; expected a path of straight")):
        with pytest.raises(ValueError, match=message):
            CollisionMesh.from_trimesh(bodies)


def test_a_mesh_shows_its_names_and_is_made_by_its_class_methods_alone():
    mesh = CollisionMesh.from_arrays([TRIANGLE, TETRAHEDRON], names=["cloth", "ball"], static=["cloth"])
    assert repr(mesh) == "CollisionMesh(2 bodies (cloth, ball), 7 vertices, 9 edges, 5 faces)"
    for wrong in (lambda: CollisionMesh(*TRIANGLE), lambda: CollisionMesh(vertices=TRIANGLE[0], faces=TRIANGLE[1])):
        with pytest.raises(TypeError, match=r"use CollisionMesh\.from_arrays\(\[\(vertices, faces\)\]\), with a tuple"):
            wrong()


def test_codimensional_edges_are_added_to_the_edges_of_faces_and_points_only_where_asked():
    cable = (np.zeros((5, 3)), [[0, 1, 2]], [[3, 2], [4, 3], [2, 3], [1, 0], [4, 4]])
    mesh = CollisionMesh.from_arrays([TRIANGLE, cable, (np.zeros((2, 3)), [], [[1, 0]])])
    # [1, 0] of the second body is an edge of its face, [2, 3] comes twice, and [4, 4] is no edge
    assert mesh.edges.tolist() == [[0, 1], [0, 2], [1, 2], [3, 4], [3, 5], [4, 5], [5, 6], [6, 7], [8, 9]]
    names = ("faces", "edges", "codimensional_edges", "codimensional_points", "vertex_body", "edge_body", "face_body")
    assert {getattr(mesh, name).dtype.name for name in names} == {"int32"} and mesh.vertices.dtype == np.float64
    assert mesh.body_vertex_range.tolist() == [0, 3, 8, 10] and mesh.vertex_body.tolist() == [0] * 3 + [1] * 5 + [2] * 2
    assert mesh.face_body.tolist() == [0, 1] and mesh.faces[1].tolist() == [3, 4, 5]
    assert mesh.edges[mesh.codimensional_edges].tolist() == [[5, 6], [6, 7], [8, 9]]
    assert mesh.edge_body.tolist() == [0] * 3 + [1] * 5 + [2] and "3 codimensional edges" in repr(mesh)
    body = (np.zeros((7, 3)), [[0, 1, 2], [6, 6, 6]], [[3, 4], [2, 2]])  # nothing uses vertex 5
    for asked, points in ((False, []), (True, [5, 12]), ([False, True], [12])):
        mesh = CollisionMesh.from_arrays([body, body], codimensional_points=asked)
        assert mesh.codimensional_points.tolist() == points
    assert "1 codimensional points" in repr(mesh)


@pytest.mark.parametrize("far", [0.0, np.nan, np.inf, 1e300])
def test_a_vertex_that_nothing_uses_takes_no_part_wherever_it_is(far):
    """In map coordinates: it makes no length scale, and is no number if it likes."""
    place = np.array([5.4e6, 4e5, 0])
    body = (np.vstack([[[far] * 3], np.eye(3) + place, [[far] * 3]]), [[1, 2, 3]])
    dust = (np.eye(2, 3) + place, np.zeros((0, 3), int))
    mesh = CollisionMesh.from_arrays([body, dust, body], codimensional_points=[False, False, False])
    assert mesh.unused_vertices.tolist() == [0, 4, 7, 11] and mesh.unused_vertices.dtype == np.int32
    assert mesh.length_scale == 1.0 and repr(mesh).endswith("2 faces, 4 vertices take no part)")
    assert mesh.replicate(2).unused_vertices.tolist() == [0, 4, 7, 11, 12, 16, 19, 23]
    end = mesh.vertices + 1.0
    assert np.array_equal(mesh.frames(mesh.vertices, end)[1], end, equal_nan=True)
    assert np.array_equal(
        np.isinf(ccd.displacement_bounds(mesh, mesh.vertices, 0.1)), np.isin(range(12), [0, 4, 7, 11])
    )
    still = CollisionMesh.from_arrays([body, dust], static=[0])
    still.frames(still.vertices, np.where(np.isin(range(7), [1, 2, 3])[:, None], still.vertices, still.vertices + 1))
    still.frames(still.vertices, still.vertices[5:])
    for make, row in (
        (lambda: CollisionMesh.from_arrays([body], codimensional_points=True), 0),
        (lambda: CollisionMesh.from_arrays([(body[0], [[1, 2, 4]])]), 4),
        (lambda: CollisionMesh.from_volume(body[0], [[0, 1, 2, 3]]), 0),
        (lambda: mesh.frame(np.where(np.arange(12)[:, None] == 5, far, mesh.vertices)), 5),
    ):
        if not np.isfinite(far):
            with pytest.raises(ValueError, match=rf"vertices.* holds (nan|inf) in row {row}"):
                make()


@pytest.mark.parametrize("rings", [3, 10**12])
def test_rings_beyond_the_mesh_leave_out_everything_and_say_which_number_to_lower(rings, monkeypatch):
    vertices, faces = trimesh.creation.box().vertices, trimesh.creation.box().faces
    mesh = CollisionMesh.from_arrays([(vertices, faces)], exclusion_rings=rings)
    assert len(ccd.find_candidates(mesh, vertices, -vertices, inflation=9.0).edge_edge) == 0
    monkeypatch.setattr("ccd_warp._engine.mesh.rings._MOST_VERTICES", 10)
    mesh = CollisionMesh.from_arrays([(vertices, faces)], exclusion_rings=rings)
    with pytest.raises(ValueError, match=rf"exclusion_rings is {rings}, which leaves out more than .*; expected a low"):
        ccd.mesh_ccd(mesh, vertices, vertices + 1.0)


def test_a_mesh_cannot_be_changed_and_does_not_freeze_the_arrays_of_the_caller():
    vertices = np.eye(3)
    mesh = CollisionMesh.from_arrays([(vertices, [[0, 1, 2]])])
    vertices[0, 0] = 2.0
    arrays = [value for field in fields(mesh) if isinstance(value := getattr(mesh, field.name), np.ndarray)]
    assert len(arrays) == 17 and not any(array.flags.writeable for array in arrays)
    for change in (lambda: setattr(mesh, "faces", None), lambda: delattr(mesh, "faces")):
        with pytest.raises(AttributeError):
            change()
    with pytest.raises(TypeError, match="from_arrays"):
        replace(mesh, faces=np.array([[0, 1, 2], [0, 1, 3]], dtype=np.int32))


@pytest.mark.parametrize("copied", COPIERS)
def test_a_copy_of_a_mesh_that_was_used_is_the_same_mesh_and_begins_with_nothing_on_a_device(copied):
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0.2, 0.2, 0.5], [0.4, 0.2, 0.7], [0.2, 0.4, 0.7]])
    mesh = CollisionMesh.from_arrays([(vertices[k : k + 3], [[0, 1, 2]]) for k in (0, 3)], names=["floor", "leg"])
    end = vertices - [0, 0, 1.0] * (vertices[:, 2:] > 0.25)
    expected, same = ccd.mesh_ccd(mesh, vertices, end), copied(mesh)
    assert MeshCache.of(mesh).topologies and MeshCache.of(mesh).idle_workspaces
    assert not MeshCache.of(same).topologies and not MeshCache.of(same).idle_workspaces
    for field in fields(mesh):
        np.testing.assert_array_equal(getattr(same, field.name), getattr(mesh, field.name))
    assert not same.faces.flags.writeable
    result = pickle.loads(pickle.dumps(ccd.mesh_ccd(same, vertices, end)))
    assert result.toi == expected.toi < np.inf and repr(result.first) == repr(expected.first) and "leg" in repr(result)


def test_a_mesh_that_was_used_goes_with_all_that_was_kept_for_it():
    mesh = CollisionMesh.from_arrays([TRIANGLE])
    ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices)
    gone = [weakref.ref(mesh), *map(weakref.ref, MeshCache.of(mesh).topologies.values())]
    del mesh
    gc.collect()
    assert len(gone) == 2 and not any(ref() for ref in gone)
