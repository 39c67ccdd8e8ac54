"""What `exclude_pairs` takes, keeps and shows; that what it names alone is not tested, all drawn scenes say."""

import copy
import pickle

import numpy as np
import pytest
from laws.scenes import drawn

import ccd_warp as ccd

BODIES = [(np.eye(3) * [1, 1, 0] + [0, 0, z], [[0, 1, 2]]) for z in (0.0, 0.5, 1.0)]
TWO = ccd.CollisionMesh.from_arrays(BODIES[:2])


def rows_of(contacts):
    """What contacts are, in order."""
    return [*zip(contacts.kind.tolist(), contacts.primitives.tolist(), contacts.toi.tolist(), strict=True)]


def test_duplicates_and_either_order_are_one_pair_and_more_are_added_to_those_before():
    mesh = TWO.excluding({"edge_edge": [[4, 1], [1, 4], [4, 1], [2, 2]], "vertex_face": [[0, 1]] * 3})
    listed = {key: pairs.tolist() for key, pairs in mesh.exclude_pairs.items()}
    assert listed == {"vertex_face": [[0, 1]], "edge_edge": [[1, 4]]} and not TWO.exclude_pairs
    assert "2 excluded pairs" in repr(mesh) and repr(mesh.exclude_pairs) == "ExcludedPairs(1 vertex-face, 1 edge-edge)"
    both = mesh.excluding({"edge_edge": [[0, 3]], "vertices": [[5, 0]]})
    assert both.exclude_pairs["edge_edge"].tolist() == [[0, 3], [1, 4]]
    assert both.exclude_pairs["vertices"].tolist() == [[0, 5]] and mesh.exclude_pairs["edge_edge"].tolist() == [[1, 4]]
    assert mesh.excluding(both.exclude_pairs).exclude_pairs == both.exclude_pairs
    alone = TWO.excluding({"bodies": [(1, 1)]})  # with itself: no self-collision
    assert alone.self_collision.tolist() == [True, False] and not alone.exclude_pairs


@pytest.mark.parametrize("values", [{}, {"bodies": []}, {"edge_edge": np.zeros((0, 2), dtype=int)}, {"vertices": [[]]}])
def test_no_pairs_are_no_filter(values):
    mesh = ccd.CollisionMesh.from_arrays(BODIES, exclude_pairs=values)
    assert not mesh.exclude_pairs and mesh.self_collision.all()


def test_excluded_bodies_do_not_come_near_each_other():
    options = {"self_collision": False, "exclude_pairs": {"bodies": [(0, 1), (0, 2), (1, 2)]}}
    mesh = ccd.CollisionMesh.from_arrays(BODIES, **options)
    result = ccd.mesh_ccd(mesh, mesh.vertices, -mesh.vertices)
    assert result.counts.num_active_bodies == 0 and not result.hit


def test_an_excluded_pair_of_static_bodies_or_of_two_worlds_changes_nothing():
    options = {"static": [0, 1], "vertex_world": [0] * 3 + [1] * 3 + [0] * 3}
    plain = ccd.CollisionMesh.from_arrays(BODIES, **options)
    start = plain.vertices
    end = start - np.repeat([0, 0, 2.0], 3)[:, None] * [0, 0, 1]
    listed = plain.excluding({"bodies": [(0, 1), (2, 1)]})
    first, second = (rows_of(ccd.mesh_ccd(mesh, start, end).contacts) for mesh in (plain, listed))
    assert first and first == second
    assert ccd.mesh_ccd(plain.excluding({"bodies": [(2, 0)]}), start, end).toi == np.inf


def test_pairs_of_vertices_join_the_rings():
    """Rings of two are the pairs of vertices that an edge joins."""
    rng = np.random.default_rng(50)
    faces = rng.integers(0, 40, (60, 3))
    body, listed = (rng.normal(size=(40, 3)), faces), rng.integers(0, 40, (50, 2)).tolist()
    edges = ccd.CollisionMesh.from_arrays([body]).edges.tolist()
    found = []
    for rings, pairs in ((2, listed), (1, listed + edges)):
        mesh = ccd.CollisionMesh.from_arrays([body], exclusion_rings=rings, exclude_pairs={"vertices": pairs})
        found.append(ccd.find_candidates(mesh, body[0], -body[0]).sorted())
    assert len(found[0].vertex_face) > 100
    for name, pairs in vars(found[0]).items():
        np.testing.assert_array_equal(getattr(found[1], name), pairs)


@pytest.mark.parametrize("broad_phase", ["tree", "hash"])
def test_a_short_static_edge_and_a_long_one_that_moves_through_it_are_one_excluded_pair(broad_phase):
    """A spatial hash finds them from the shorter edge, which is the first primitive, but not the one that moves."""
    k, no_faces = np.arange(30), np.zeros((0, 3), dtype=int)
    cable = (np.column_stack([0.01 * k - 0.145, 0 * k, 0 * k]), no_faces, np.column_stack([k[:-1], k[1:]]))
    mesh = ccd.CollisionMesh.from_arrays([cable, ([[0, -1, 1], [0, 1, 1]], no_faces, [[0, 1]])], static=[0])
    step = mesh.vertices, mesh.vertices - [0, 0, 2] * ~mesh.static[mesh.vertex_body][:, None]
    assert ccd.mesh_ccd(mesh, *step, broad_phase=broad_phase).contacts.primitives.tolist() == [[14, 29]]
    without = mesh.excluding({"edge_edge": [[14, 29]]})
    assert ccd.mesh_ccd(without, *step, broad_phase=broad_phase).toi == np.inf


def hanging_nodes(turn, n=5):
    """A square, beside it a strip of n squares whose nodes hang on its side, and a step that bends both."""
    corners = [[0, 0], [1, 0], [1, 1], [0, 1], *([1, k / n] for k in range(1, n))]
    corners += [[1.2, k / n] for k in range(n + 1)]
    faces, side = [[0, 1, 2], [0, 2, 3]], [1, *range(4, n + 3), 2]
    for k in range(n):
        faces += [[side[k], n + 3 + k, n + 4 + k], [side[k], n + 4 + k, side[k + 1]]]
    start = np.pad(np.array(corners), ((0, 0), (0, 1))) @ turn.T
    end = start + 0.05 * np.column_stack([np.sin(3 * start[:, 0]), 0 * start[:, 0], start[:, 1] ** 2])
    for k in range(1, n):
        end[3 + k] = end[1] + (end[2] - end[1]) * (k / n)  # what holds a node on the side
    return ccd.CollisionMesh.from_arrays([(start, faces)]), start, end


def test_nodes_that_hang_on_an_edge_do_not_stop_a_step_once_what_is_near_is_excluded():
    rng = np.random.default_rng(6)
    for scale in (1e-3, 1.0, 1e3):
        mesh, start, end = hanging_nodes(np.linalg.qr(rng.standard_normal((3, 3)))[0])
        start, end = scale * start, scale * end
        near = ccd.find_proximity(mesh, start, 1e-9 * scale)
        fewer = mesh.excluding(near)
        assert ccd.mesh_ccd(mesh, start, end).toi == 0 and ccd.mesh_ccd(fewer, start, end).toi == np.inf
        assert ccd.collision_free_step(fewer, start, end) == 1
        kinds = {kind.name.lower(): near.primitives[near.kind == kind] for kind in ccd.PairKind}
        assert fewer.exclude_pairs == mesh.excluding(kinds).exclude_pairs


def test_contacts_of_all_kinds_are_excluded_as_they_are_and_copies_keep_them():
    kinds = set()
    for seed in range(16):
        mesh, start, end = drawn(seed, "any").make()
        contacts = ccd.mesh_ccd(mesh, start, end).contacts
        kinds |= {*contacts.kind.tolist()}
        fewer, others = mesh.excluding(contacts), mesh.excluding(contacts[3:])
        assert ccd.mesh_ccd(fewer, start, end).toi == np.inf and ccd.is_step_collision_free(fewer, start, end)
        for same in (others, copy.copy(others), copy.deepcopy(others), pickle.loads(pickle.dumps(others))):
            assert rows_of(ccd.mesh_ccd(same, start, end).contacts) == rows_of(contacts[:3])
            for pairs in same.exclude_pairs.values():
                with pytest.raises(ValueError, match="read-only"):
                    pairs[...] = 1
    assert kinds == {0, 1, 2, 3, 4}
    with pytest.raises(TypeError):
        others.exclude_pairs["edge_edge"] = np.zeros((0, 2))
    with pytest.raises(ValueError, match=r"exclude_pairs is Contacts.* of a mesh with .* other .*; expected"):
        TWO.excluding(contacts)
