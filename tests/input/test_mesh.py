"""CollisionMesh: joining, unique edges, frames and messages."""

import copy
import gc
import multiprocessing
import pickle
import weakref
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields, replace

import numpy as np
import pytest
import trimesh

from ccd_warp import CollisionPipeline, mesh_ccd
from ccd_warp._engine.mesh.mesh_cache import MeshCache
from ccd_warp._mesh import CollisionMesh

TRIANGLE = (np.eye(3), [[0, 1, 2]])
TETRAHEDRON = (np.eye(4, 3), [[0, 1, 2], [0, 3, 1], [1, 3, 2], [2, 3, 0]])


def test_bodies_are_joined_in_order():
    mesh = CollisionMesh.from_arrays([TRIANGLE, TETRAHEDRON], static=[1], self_collision=[True, False])
    assert mesh.num_bodies == 2
    assert mesh.vertices.shape == (7, 3) and mesh.vertices.dtype == np.float64
    assert mesh.faces.dtype == np.int32 and mesh.faces[1].tolist() == [3, 4, 5]
    assert mesh.vertex_body.tolist() == [0] * 3 + [1] * 4
    assert mesh.edge_body.tolist() == [0] * 3 + [1] * 6
    assert mesh.face_body.tolist() == [0] + [1] * 4
    assert mesh.body_vertex_range.tolist() == [0, 3, 7]
    assert mesh.static.tolist() == [False, True] and mesh.self_collision.tolist() == [True, False]
    assert mesh.moving_vertices.tolist() == [0, 1, 2]


def test_points_joined_to_a_mesh_are_rows_that_launches_take():
    mesh = CollisionMesh.from_arrays([(np.zeros((1, 3)), np.zeros((0, 3), int))] * 5, codimensional_points=True)
    assert mesh.vertices.flags.c_contiguous
    CollisionPipeline(mesh, device="cpu").launch(mesh.vertices, mesh.vertices)


def test_edges_are_unique_pairs_sorted_by_max_then_min():
    rng = np.random.default_rng(0)
    faces = rng.integers(0, 30, (200, 3))
    mesh = CollisionMesh.from_arrays([(rng.random((30, 3)), faces)])
    pairs = {(int(min(p)), int(max(p))) for f in faces for p in zip(f, np.roll(f, 1), strict=True) if p[0] != p[1]}
    assert mesh.edges.dtype == np.int32
    assert [tuple(e) for e in mesh.edges.tolist()] == sorted(pairs, key=lambda p: (p[1], p[0]))


def test_degenerate_and_duplicate_faces_are_valid():
    mesh = CollisionMesh.from_arrays([(np.zeros((3, 3)), [[0, 0, 1], [2, 2, 2], [0, 1, 2], [0, 1, 2]])])
    assert mesh.edges.tolist() == [[0, 1], [0, 2], [1, 2]]


@pytest.mark.parametrize("faces", [[], np.zeros((0, 3), dtype=int)])
def test_body_without_faces_is_valid(faces):
    mesh = CollisionMesh.from_arrays([(np.zeros((2, 3)), faces), (np.zeros((0, 3)), faces), TRIANGLE])
    assert mesh.num_faces == 1 and mesh.num_edges == 3 and mesh.faces.tolist() == [[2, 3, 4]]
    assert CollisionMesh.from_arrays([([], [])]).num_vertices == 0


def test_from_trimesh():
    box, ball = trimesh.creation.box(), trimesh.creation.icosphere(1)
    mesh = CollisionMesh.from_trimesh([box, ball], static=[1])
    assert np.array_equal(mesh.vertices, np.concatenate([box.vertices, ball.vertices]))
    assert np.array_equal(mesh.faces, np.concatenate([box.faces, ball.faces + 8]))
    assert mesh.num_edges == len(box.edges_unique) + len(ball.edges_unique)


def test_from_trimesh_takes_a_single_mesh():
    box = trimesh.creation.box()
    mesh = CollisionMesh.from_trimesh(box)
    assert mesh.num_bodies == 1 and mesh.names == ("body 0",) and np.array_equal(mesh.vertices, box.vertices)


def _scene():
    """A box used by two nodes, the second moved and turned, and points."""
    scene = trimesh.Scene()
    scene.add_geometry(trimesh.creation.box(), node_name="floor", geom_name="box")
    turned = trimesh.transformations.rotation_matrix(np.pi / 2, [0, 0, 1])
    turned[:3, 3] = [0.1, 0.2, 5.0]
    scene.graph.update(frame_to="crate", matrix=turned, geometry="box")
    scene.add_geometry(trimesh.PointCloud(np.eye(2, 3)), node_name="dust")
    return scene, turned


def test_a_scene_is_a_body_a_node_with_its_name_and_transformation():
    scene, turned = _scene()
    mesh = CollisionMesh.from_trimesh(scene, static=["floor"])
    assert mesh.names == ("floor", "crate", "dust") and mesh.static.tolist() == [True, False, False]
    corners = scene.geometry["box"].vertices
    assert np.array_equal(mesh.vertices[:8], corners)  # the identity changes no bit
    assert np.allclose(mesh.vertices[8:16], corners @ turned[:3, :3].T + turned[:3, 3], atol=1e-15)
    assert mesh.codimensional_points.tolist() == [16, 17]


def test_scenes_and_meshes_mix_in_a_list_and_keep_names_apart():
    scene, _ = _scene()
    mesh = CollisionMesh.from_trimesh([trimesh.creation.icosphere(1), scene, scene])
    names = ("body 0", "floor", "crate", "dust", "floor (2)", "crate (2)", "dust (2)")
    assert mesh.names == names
    with pytest.raises(ValueError, match="body 0 is a Scene without geometry"):
        CollisionMesh.from_trimesh(trimesh.Scene())


def test_messages_call_bodies_by_their_names():
    named = {"names": ["cloth", "ball"]}
    with pytest.raises(ValueError, match=r"faces of body 1 \(ball\) holds index 7"):
        CollisionMesh.from_arrays([TRIANGLE, (np.eye(3), [[0, 1, 7]])], **named)
    with pytest.raises(ValueError, match=r"at \(0, 1\) and \(1, 0\), body 0 \(cloth\) and body 1 \(ball"):
        CollisionMesh.from_arrays([TRIANGLE, TRIANGLE], **named, body_pairs=[[False, True], [False, False]])
    with pytest.raises(ValueError, match=r"static holds 'bal'; expected body indices in \[0, 2\) or names of bodies"):
        CollisionMesh.from_arrays([TRIANGLE, TRIANGLE], **named, static=["bal"])
    with pytest.raises(ValueError, match=r"vertex_world gives face 1 of ball worlds \[0, 0, 1\]; expected one"):
        CollisionMesh.from_arrays([TRIANGLE, TRIANGLE], **named, vertex_world=[0, 0, 0, 0, 0, 1])
    mesh = CollisionMesh.from_arrays([TRIANGLE, TETRAHEDRON], **named, static=["cloth"])
    assert mesh.static.tolist() == [True, False]
    bad = np.zeros((7, 3))
    bad[5] = np.nan
    with pytest.raises(
        ValueError, match=r"vertices_t0 holds nan in row 5 \(vertex 2 of ball\); expected finite values"
    ):
        mesh.frame(bad)
    with pytest.raises(
        ValueError, match=r"vertices_t1 holds nan in row 2 \(vertex 2 of ball\); expected finite values"
    ):
        mesh.frames(np.zeros((7, 3)), bad[3:])
    assert repr(mesh) == "CollisionMesh(2 bodies (cloth, ball), 7 vertices, 9 edges, 5 faces)"


def test_codimensional_edges_are_added_to_the_edges_of_faces():
    cable = (np.zeros((5, 3)), [[0, 1, 2]], [[3, 2], [4, 3], [2, 3], [1, 0], [4, 4]])
    mesh = CollisionMesh.from_arrays([TRIANGLE, cable, (np.zeros((2, 3)), [], [[1, 0]])])
    # [1, 0] of the second body is an edge of its face, [2, 3] comes twice, and [4, 4] is no edge
    edges = [[0, 1], [0, 2], [1, 2], [3, 4], [3, 5], [4, 5], [5, 6], [6, 7], [8, 9]]
    assert mesh.edges.dtype == mesh.codimensional_edges.dtype == np.int32
    assert mesh.edges.tolist() == edges
    assert mesh.edges[mesh.codimensional_edges].tolist() == [[5, 6], [6, 7], [8, 9]]
    assert mesh.edge_body.tolist() == [0] * 3 + [1] * 5 + [2]
    assert "3 codimensional edges" in repr(mesh)


def test_triangle_mesh_has_no_codimensional_primitives():
    for bodies in ([TRIANGLE, TETRAHEDRON], [(*TRIANGLE, [])], [(*TETRAHEDRON, [[1, 2]])]):
        mesh = CollisionMesh.from_arrays(bodies)
        assert mesh.codimensional_edges.tolist() == mesh.codimensional_points.tolist() == []
        assert "codimensional" not in repr(mesh)


def test_unused_vertices_are_codimensional_points_only_where_asked():
    body = (np.zeros((7, 3)), [[0, 1, 2], [6, 6, 6]], [[3, 4], [2, 2]])  # nothing uses vertex 5
    assert CollisionMesh.from_arrays([body, body]).codimensional_points.tolist() == []
    assert CollisionMesh.from_arrays([body, body], codimensional_points=True).codimensional_points.tolist() == [5, 12]
    mesh = CollisionMesh.from_arrays([body, body], codimensional_points=[False, True])
    assert mesh.codimensional_points.tolist() == [12] and mesh.codimensional_points.dtype == np.int32
    assert "1 codimensional points" in repr(mesh)
    unused = trimesh.Trimesh(np.zeros((4, 3)), [[0, 1, 2]], process=False)
    assert CollisionMesh.from_trimesh([unused]).codimensional_points.tolist() == []
    assert CollisionMesh.from_trimesh([unused], codimensional_points=True).codimensional_points.tolist() == [3]


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
    assert not len(CollisionMesh.from_arrays([dust]).unused_vertices)
    end = mesh.vertices + 1.0
    assert np.array_equal(mesh.frames(mesh.vertices, end)[1], end, equal_nan=True)
    still = CollisionMesh.from_arrays([body, dust], static=[0])
    still.frames(still.vertices, np.where(np.arange(7)[:, None] % 4, still.vertices, still.vertices + 1.0))
    still.frames(still.vertices, still.vertices[5:])
    if not np.isfinite(far):
        with pytest.raises(ValueError, match=r"vertices of body 0 holds (nan|inf) in row 0; expected finite values"):
            CollisionMesh.from_arrays([body], codimensional_points=True)
        with pytest.raises(ValueError, match=r"vertices of body 0 holds (nan|inf) in row 4; expected finite values"):
            CollisionMesh.from_arrays([(body[0], [[1, 2, 4]])])
        with pytest.raises(ValueError, match=r"vertices of body 0 holds (nan|inf) in row 0; expected finite values"):
            CollisionMesh.from_volume(body[0], [[0, 1, 2, 3]])
        with pytest.raises(ValueError, match=r"vertices_t0 holds .* in row 5"):
            mesh.frame(np.where(np.arange(12)[:, None] == 5, far, mesh.vertices))


def test_cells_are_turned_outward_whatever_lies_in_no_cell():
    """A tetrahedron either way round, and a node so far away that its volume would be lost beside it."""
    nodes = np.vstack([np.eye(4, 3), [[1e300] * 3], [[np.nan] * 3]])
    for corners in ([1, 0, 2, 3], [0, 1, 2, 3]):
        mesh = CollisionMesh.from_volume(nodes, [corners])
        a, b, c = mesh.vertices[mesh.faces].transpose(1, 0, 2)
        assert np.einsum("ij,ij->", a, np.cross(b, c)) > 0 and mesh.unused_vertices.tolist() == [4, 5]


def test_from_trimesh_takes_paths_and_point_clouds():
    path = trimesh.load_path([[0, 0, 0], [1, 0, 0], [1, 1, 0]])
    cloud = trimesh.PointCloud(np.eye(2, 3))
    mesh = CollisionMesh.from_trimesh([cloud, trimesh.creation.box(), path], static=[1])
    assert mesh.body_vertex_range.tolist() == [0, 2, 10, 13]
    assert mesh.codimensional_points.tolist() == [0, 1]
    assert mesh.edges[mesh.codimensional_edges].tolist() == [[10, 11], [11, 12]]
    assert mesh.num_faces == 12


def test_from_trimesh_refuses_curves():
    arc = trimesh.path.Path3D([trimesh.path.entities.Arc([0, 1, 2])], np.eye(3))
    with pytest.raises(ValueError, match="body 0 holds a Arc; expected a path of straight lines"):
        CollisionMesh.from_trimesh([arc])


def test_mesh_is_frozen():
    mesh = CollisionMesh.from_arrays([TRIANGLE])
    with pytest.raises(AttributeError):
        mesh.faces = None
    with pytest.raises(AttributeError):
        del mesh.faces
    arrays = [value for field in fields(mesh) if isinstance(value := getattr(mesh, field.name), np.ndarray)]
    assert len(arrays) == 17
    for array in arrays:
        with pytest.raises(ValueError):
            array[...] = 0


def test_a_mesh_cannot_be_changed_in_part_past_the_checks():
    mesh = CollisionMesh.from_arrays([TRIANGLE])
    with pytest.raises((TypeError, ValueError), match="given_edges"):
        replace(mesh, faces=np.array([[0, 1, 2], [0, 1, 3]], dtype=np.int32))


def test_threads_that_come_at_once_share_one_cache():
    meshes = [CollisionMesh.from_arrays([TRIANGLE]) for _ in range(50)]
    with ThreadPoolExecutor(8) as threads:
        for mesh in meshes:
            caches = list(threads.map(lambda _, m=mesh: MeshCache.of(m), range(32)))
            assert all(cache is caches[0] for cache in caches)


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, lambda mesh: pickle.loads(pickle.dumps(mesh))])
def test_a_copy_of_a_mesh_that_was_used_begins_with_nothing_on_a_device(copied):
    vertices, _ = TRIANGLE
    mesh = CollisionMesh.from_arrays([TRIANGLE])
    mesh_ccd(mesh, vertices, vertices, device="cpu")
    assert MeshCache.of(mesh).topologies and MeshCache.of(mesh).idle_workspaces
    cache = MeshCache.of(copied(mesh))
    assert not cache.topologies and not cache.idle_workspaces


def _toi_of(mesh):
    """The result of a step in which the upper body falls by 1; also called in other processes."""
    return mesh_ccd(mesh, mesh.vertices, mesh.vertices - (mesh.vertices[:, 2:] > 0.25) * [0.0, 0.0, 1.0])


def _used_mesh():
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0.2, 0.2, 0.5], [0.4, 0.2, 0.7], [0.2, 0.4, 0.7]])
    mesh = CollisionMesh.from_arrays([(vertices[:3], [[0, 1, 2]]), (vertices[3:], [[0, 1, 2]])], names=["floor", "leg"])
    return mesh, _toi_of(mesh)


def test_a_mesh_that_was_used_goes_to_other_processes_and_its_results_come_back():
    mesh, expected = _used_mesh()
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        (result,) = pool.map(_toi_of, [mesh])
    assert result.toi == expected.toi < np.inf
    assert repr(result.first) == repr(expected.first) and "leg" in repr(result)


def test_joblib_takes_a_mesh_that_was_used():
    joblib = pytest.importorskip("joblib")
    mesh, expected = _used_mesh()
    results = joblib.Parallel(n_jobs=2)(joblib.delayed(_toi_of)(each) for each in (mesh, mesh))
    assert [result.toi for result in results] == [expected.toi] * 2


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, lambda mesh: pickle.loads(pickle.dumps(mesh))])
def test_a_copy_of_a_mesh_that_was_used_is_the_same_mesh(copied):
    mesh, expected = _used_mesh()
    same = copied(mesh)
    for field in fields(mesh):
        np.testing.assert_array_equal(getattr(same, field.name), getattr(mesh, field.name))
    assert _toi_of(same).toi == expected.toi and same.names == ("floor", "leg")


def test_a_pipeline_says_that_it_is_built_again_from_its_mesh_and_options():
    pipeline = CollisionPipeline(_used_mesh()[0])
    for refused in (copy.copy, copy.deepcopy, pickle.dumps):
        with pytest.raises(TypeError, match=r"a CollisionPipeline cannot be copied or pickled; .* CollisionPipeline\("):
            refused(pipeline)


def test_a_mesh_that_was_used_goes_with_all_that_was_kept_for_it():
    vertices, _ = TRIANGLE
    mesh = CollisionMesh.from_arrays([TRIANGLE])
    mesh_ccd(mesh, vertices, vertices, device="cpu")
    gone = weakref.ref(mesh), weakref.ref(MeshCache.of(mesh).topologies["cpu"])
    del mesh
    gc.collect()
    assert [ref() for ref in gone] == [None, None]


def test_mesh_does_not_freeze_the_arrays_of_the_caller():
    vertices = np.eye(3)
    CollisionMesh.from_arrays([(vertices, [[0, 1, 2]])])
    vertices[0, 0] = 2.0


def test_from_trimesh_names_what_is_not_a_mesh():
    with pytest.raises(
        TypeError, match=r"body 0 is a ndarray; expected a trimesh\.Trimesh, Path3D, PointCloud or Scene"
    ):
        CollisionMesh.from_trimesh([np.eye(3)])
    for value in (7, "ball.ply", {"a": trimesh.creation.box()}, trimesh.Trimesh):
        with pytest.raises(TypeError, match=r"bodies is .*; expected a trimesh\.Trimesh, .* or a list of these"):
            CollisionMesh.from_trimesh(value)


def test_frames_of_static_bodies_rest():
    mesh = CollisionMesh.from_arrays([TRIANGLE, TETRAHEDRON, TRIANGLE], static=[1])
    start = np.arange(30.0).reshape(10, 3)
    start[4] = 0.0
    end = start + 100
    end[3:7] = start[3:7]
    for given in (end, np.where(end == 0.0, -0.0, end), end[mesh.moving_vertices]):
        t0, t1 = mesh.frames(start, given)
        assert np.array_equal(t0, start) and np.array_equal(t1, end)


def test_static_bodies_that_move_are_named():
    mesh = CollisionMesh.from_arrays([TRIANGLE, TETRAHEDRON, TRIANGLE], static=[1], names=["cloth", "wall", "sheet"])
    end = np.ones((10, 3))
    end[4] += 1e-9
    end[5] -= [0, 3, 4]
    where = r"vertex 2 of body 1 \(wall\), which is static, by 5 \(row 5\); .* kinematic=\['wall'\] in place of static"
    with pytest.raises(ValueError, match=where):
        mesh.frames(np.ones((10, 3)), end)
    end[5] = np.nan
    with pytest.raises(ValueError, match=r"vertices_t1 holds nan in row 5 \(vertex 2 of wall\)"):
        mesh.frames(np.ones((10, 3)), end)


def test_frame_takes_lists_and_float32():
    mesh = CollisionMesh.from_arrays([TRIANGLE])
    assert mesh.frame([[0, 1, 2]] * 3).dtype == np.float64
    assert mesh.frame(np.eye(3, dtype=np.float32)).dtype == np.float64


@pytest.mark.parametrize(
    ("static", "start", "end", "message"),
    [
        ([], np.eye(7, 2), np.eye(7, 3), r"vertices_t0 has shape \(7, 2\); expected \(7, 3\)"),
        ([], np.eye(7, 3), np.eye(7, 2), r"vertices_t1 has shape \(7, 2\); expected \(7, 3\) like vertices_t0"),
        ([], np.eye(7, 3), np.eye(3, 3), r"vertices_t1 has shape \(3, 3\); expected \(7, 3\) like vertices_t0"),
        ([1], np.eye(7, 3), np.eye(4, 3), r"vertices_t1 has shape \(4, 3\); expected \(7, 3\) .* or \(3, 3\)"),
        ([1], np.full((7, 3), np.inf), np.eye(7, 3), "vertices_t0 holds inf in row 0; expected finite values"),
        ([1], np.eye(7, 3), np.full((7, 3), np.nan), "vertices_t1 holds nan in row 0; expected finite values"),
    ],
)
def test_bad_frames_are_named(static, start, end, message):
    mesh = CollisionMesh.from_arrays([TRIANGLE, TETRAHEDRON], static=static)
    with pytest.raises(ValueError, match=message):
        mesh.frames(start, end)


def test_constructor_says_which_factory_takes_arrays():
    vertices, faces = TRIANGLE
    mesh = CollisionMesh.from_arrays([TRIANGLE])
    for call in (
        lambda: CollisionMesh(vertices, mesh.edges, faces),
        lambda: CollisionMesh(vertices, faces),
        lambda: CollisionMesh(vertices=vertices, faces=faces),
    ):
        with pytest.raises(TypeError, match=r"use CollisionMesh\.from_arrays\(\[\(vertices, faces\)\]\), with a tuple"):
            call()
    assert pickle.loads(pickle.dumps(mesh)).num_faces == copy.copy(mesh).num_faces == 1
