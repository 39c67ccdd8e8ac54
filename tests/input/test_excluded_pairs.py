"""What `exclude_pairs` takes, keeps and shows; that what it names alone is not tested, all drawn scenes say."""

import copy
import pickle

import numpy as np
import pytest
from laws.outputs import tois_of
from laws.scenes import drawn

import ccd_warp as ccd

BODIES = [(np.eye(3) * [1, 1, 0] + [0, 0, z], [[0, 1, 2]]) for z in (0.0, 0.5, 1.0)]
TWO = ccd.CollisionMesh.from_arrays(BODIES[:2])


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


STAR = [[0, 1, 1], [1, 0, 0], [1, 0, 0]]
LISTS = [[("c", "a"), ("b", "a")], [(2, "a"), ("a", "b")], {(0, 1), (0, 2)}, zip("aa", "bc", strict=True)]


@pytest.mark.parametrize("pairs", [*LISTS, STAR, np.array(STAR, dtype=np.uint8), np.array(STAR, dtype=bool)])
def test_pairs_of_bodies_that_may_touch_are_listed_by_name_or_index_or_flagged_by_0_and_1(pairs):
    mesh = ccd.CollisionMesh.from_arrays(BODIES, names=list("abc"), body_pairs=pairs)
    assert mesh.body_pairs.dtype == bool and mesh.body_pairs.astype(int).tolist() == STAR


@pytest.mark.parametrize("values", [{}, {"bodies": []}, {"edge_edge": np.zeros((0, 2), dtype=int)}, {"vertices": [[]]}])
def test_no_pairs_are_no_filter(values):
    mesh = ccd.CollisionMesh.from_arrays(BODIES, exclude_pairs=values)
    assert not mesh.exclude_pairs and mesh.self_collision.all()


def test_contacts_and_proximities_of_all_kinds_are_excluded_as_they_are_and_copies_keep_them():
    kinds = set()
    for seed in range(16):
        mesh, start, end = drawn(seed, "any").make()
        near, contacts = ccd.find_proximity(mesh, start, 0.1), ccd.mesh_ccd(mesh, start, end).contacts
        without = mesh.excluding(near)
        of_kinds = {kind.name.lower(): near.primitives[near.kind == kind] for kind in ccd.PairKind}
        assert len(ccd.find_proximity(without, start, 0.1)) == 0
        assert without.exclude_pairs == mesh.excluding(of_kinds).exclude_pairs
        kinds |= {*contacts.kind.tolist()}
        fewer, others = mesh.excluding(contacts), mesh.excluding(contacts[3:])
        assert ccd.mesh_ccd(fewer, start, end).toi == np.inf and ccd.is_step_collision_free(fewer, start, end)
        assert tois_of(ccd.mesh_ccd(others, start, end).contacts) == tois_of(contacts[:3])
        for same in (others, copy.copy(others), copy.deepcopy(others), pickle.loads(pickle.dumps(others))):
            assert same.exclude_pairs == others.exclude_pairs
            for pairs in same.exclude_pairs.values():
                with pytest.raises(ValueError, match="read-only"):
                    pairs[...] = 1
    assert kinds == {0, 1, 2, 3, 4}
    with pytest.raises(TypeError):
        others.exclude_pairs["edge_edge"] = np.zeros((0, 2))
    with pytest.raises(ValueError, match=r"exclude_pairs is Contacts.* of a mesh with .* other .*; expected"):
        TWO.excluding(contacts)
