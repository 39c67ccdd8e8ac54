"""What `exclude_pairs` names is never tested, and everything else still is: judged by brute force and exactly."""

import copy
import pickle

import numpy as np
import pytest
from launches import CAPACITIES, check_same, on_device
from oracles import brute_force, check_candidates, exact_pairs, rows
from scenes import cables_and_particles, crowd_of_all_kinds, stacked

import ccd_warp as ccd
from ccd_warp._pairs import pair_vertices

KEYS = ("bodies", "vertices", "vertex_face", "edge_edge", "point_segment", "point_point")
PAIR_KEYS = KEYS[2:]


def some_pairs(rng, mesh, key, share=0.4):
    """Some of the pairs of a mesh that could be tested, each in either order where its two sides are of one kind."""
    if key == "bodies":
        return [("dust", 0), (1, 1)]
    if key == "vertices":
        return rng.integers(0, mesh.num_vertices, (4 * mesh.num_vertices, 2))
    pairs = np.array(brute_force(mesh, 0 * mesh.vertices, 0 * mesh.vertices)[PAIR_KEYS.index(key)], dtype=int)
    pairs = pairs[rng.random(len(pairs)) < share]
    if key in ("edge_edge", "point_point"):
        pairs[::2] = pairs[::2, ::-1]
    return rng.permutation(pairs)


@pytest.mark.parametrize("key", KEYS)
def test_candidates_are_all_pairs_but_the_excluded_ones(device, key):
    rng = np.random.default_rng(KEYS.index(key))
    mesh, start, end = crowd_of_all_kinds(rng, static=["rope"])
    fewer = mesh.excluding({key: some_pairs(rng, mesh, key)})
    assert 0 < check_candidates(fewer, start, end, device=device) < check_candidates(mesh, start, end, device=device)


@pytest.mark.parametrize("key", KEYS)
def test_contacts_are_those_of_the_whole_mesh_but_the_excluded_ones(device, key):
    rng = np.random.default_rng(10 + KEYS.index(key))
    mesh, start, end = crowd_of_all_kinds(rng)
    fewer = mesh.excluding({key: some_pairs(rng, mesh, key)})
    every, found = (ccd.mesh_ccd(m, start, end, device=device) for m in (mesh, fewer))
    allowed = {
        (int(kind), *pair)
        for kind, pairs in zip(ccd.PairKind, brute_force(fewer, 0 * start, 0 * start), strict=True)
        for pair in pairs
    }
    expected = {pair: toi for pair, toi in rows(every.contacts).items() if pair in allowed}
    assert rows(found.contacts) == expected
    assert len(expected) < len(every.contacts)
    for pair, exact in exact_pairs(fewer, start, end).items():
        assert not exact.late(expected[pair])
    assert ccd.collision_free_step(fewer, start, end, device=device) == min(expected.values())
    result = ccd.CollisionPipeline(fewer, device=device, **CAPACITIES).launch(
        *(on_device(x, device) for x in (start, end))
    )
    check_same(result, found)


@pytest.mark.parametrize("key", KEYS)
def test_a_line_search_passes_through_excluded_pairs_only(device, key):
    rng = np.random.default_rng(20 + KEYS.index(key))
    mesh, start, end = crowd_of_all_kinds(rng)
    fewer = mesh.excluding({key: some_pairs(rng, mesh, key, share=0.7)})
    shortened = ccd.line_search(fewer, start, end, per="vertex", device=device).vertices
    on_the_device = on_device(end, device)
    pipeline = ccd.CollisionPipeline(fewer, device=device, **CAPACITIES)
    pipeline.launch_line_search(on_device(start, device), on_the_device, per="vertex")
    for there in (shortened, on_the_device.numpy()):
        moved = (there != start).any(axis=1)
        contacts = ccd.mesh_ccd(fewer, start, there, device=device).contacts
        assert not moved[pair_vertices(fewer, contacts)].any()
    assert len(ccd.mesh_ccd(mesh, start, shortened, device=device).contacts)


@pytest.mark.parametrize("key", KEYS)
def test_a_step_is_free_where_every_pair_that_touches_is_excluded(device, key):
    rng = np.random.default_rng(30)
    mesh, start, end = crowd_of_all_kinds(rng)
    kinds = {"bodies": PAIR_KEYS, "vertices": PAIR_KEYS}.get(key, (key,))
    options = {"pair_kinds": kinds, "device": device}
    assert not ccd.is_step_collision_free(mesh, start, end, **options)
    contacts = ccd.mesh_ccd(mesh, start, end, **options).contacts
    found = {"bodies": contacts.bodies, "vertices": contacts.vertices[:, [0, 3]]}.get(key, contacts.primitives)
    fewer = mesh.excluding({key: found})
    assert ccd.is_step_collision_free(fewer, start, end, **options)
    assert ccd.collision_free_step(fewer, start, end, **options) == 1.0


def test_all_pairs_of_all_kinds_excluded_at_once(device):
    rng = np.random.default_rng(40)
    mesh, start, end = crowd_of_all_kinds(rng, count=5)
    everything = brute_force(mesh, 0 * start, 0 * start)
    mesh = mesh.excluding(dict(zip(PAIR_KEYS, everything[: len(PAIR_KEYS)], strict=True)))
    assert check_candidates(mesh, start, end, inflation=10.0, device=device) == 0
    assert len(ccd.mesh_ccd(mesh, start, start * 0, device=device).contacts) == 0


def test_pairs_of_vertices_join_the_rings(device):
    rng = np.random.default_rng(50)
    vertices, faces, edges = cables_and_particles(rng, 12, 0.3)

    def build(rings, listed):
        pairs = {"vertices": listed} if len(listed) else None
        return ccd.CollisionMesh.from_arrays([(vertices, faces, edges)], exclusion_rings=rings, exclude_pairs=pairs)

    near = [(a, b) for a, b in build(1, []).edges.tolist()]
    listed = rng.integers(0, len(vertices), (200, 2)).tolist()
    with_rings, with_pairs = build(2, listed), build(1, listed + near)
    found = [ccd.find_candidates(m, vertices, -vertices, device=device).sorted() for m in (with_rings, with_pairs)]
    assert len(found[0].vertex_face) > 100
    for name, pairs in vars(found[0]).items():
        np.testing.assert_array_equal(getattr(found[1], name), pairs)


def test_every_copy_leaves_out_its_own_pairs(device):
    rng = np.random.default_rng(60)
    mesh, start, end = crowd_of_all_kinds(rng, count=6)
    mesh = mesh.excluding({key: some_pairs(rng, mesh, key) for key in KEYS[1:]} | {"bodies": [(2, 0)]})
    copies = mesh.replicate(3)
    expected = ccd.mesh_ccd(mesh, start, end, length_scale=1.0, device=device)
    found = ccd.mesh_ccd(copies, np.stack([start] * 3), np.stack([end] * 3), length_scale=1.0, device=device)
    assert len(expected.contacts) > 10
    shift = np.array([mesh.num_vertices, mesh.num_edges, mesh.num_vertices, mesh.num_vertices])
    second = np.array([mesh.num_faces, mesh.num_edges, mesh.num_edges, mesh.num_vertices])
    for world in range(3):
        ours = found.contacts[found.contacts.world == world]
        by_world = np.column_stack([shift[ours.kind], second[ours.kind]]) * world
        np.testing.assert_array_equal(ours.primitives - by_world, expected.contacts.primitives)
        np.testing.assert_array_equal(ours.toi, expected.contacts.toi)
    assert check_candidates(copies, np.tile(start, (3, 1)), np.tile(end, (3, 1)), device=device)


def test_an_excluded_pair_of_static_bodies_or_of_two_worlds_changes_nothing():
    _, start = stacked(0.0, 0.5, 1.0)
    end = start + np.repeat([[0, 0, 0], [0, 0, 0], [0, 0, -2.0]], 3, axis=0)
    bodies = [(start[k : k + 3], [[0, 1, 2]]) for k in (0, 3, 6)]
    options = {"static": [0, 1], "vertex_world": [0] * 3 + [1] * 3 + [0] * 3}
    plain = ccd.CollisionMesh.from_arrays(bodies, **options)
    listed = ccd.CollisionMesh.from_arrays(bodies, **options, exclude_pairs={"bodies": [(0, 1), (2, 1)]})
    first, second = (rows(ccd.mesh_ccd(m, start, end).contacts) for m in (plain, listed))
    assert first and first == second
    none = plain.excluding({"bodies": [(2, 0)]})
    assert ccd.mesh_ccd(none, start, end).toi == np.inf
    assert ccd.mesh_ccd(none, start, end).counts.num_active_bodies <= 3


def test_excluded_bodies_do_not_come_near_each_other():
    mesh, start = stacked(0.0, 0.5, 1.0)
    bodies = [(start[k : k + 3], [[0, 1, 2]]) for k in (0, 3, 6)]
    pairs = {"bodies": [(0, 1), (0, 2), (1, 2)]}
    mesh = ccd.CollisionMesh.from_arrays(bodies, self_collision=False, exclude_pairs=pairs)
    result = ccd.mesh_ccd(mesh, start, -start)
    assert result.counts.num_active_bodies == 0 and not result.hit


def test_a_body_paired_with_itself_has_no_self_collision():
    mesh = stacked(0.0, 0.5)[0].excluding({"bodies": [(1, 1)]})
    assert mesh.self_collision.tolist() == [True, False] and not mesh.exclude_pairs


@pytest.mark.parametrize("broad_phase", ["tree", "hash"])
def test_a_short_static_edge_and_a_long_one_that_moves_through_it_are_one_excluded_pair(broad_phase, device):
    """A spatial hash finds them from the shorter edge, which is the first primitive, but not the one that moves."""
    k = np.arange(30)
    cable = np.column_stack([0.01 * k - 0.145, 0 * k, 0 * k])
    no_faces = np.zeros((0, 3), dtype=int)
    bodies = [(cable, no_faces, np.column_stack([k[:-1], k[1:]])), ([[0, -1, 1], [0, 1, 1]], no_faces, [[0, 1]])]
    mesh = ccd.CollisionMesh.from_arrays(bodies, static=[0])
    end = mesh.vertices - [0, 0, 2] * ~mesh.static[mesh.vertex_body][:, None]
    contacts = ccd.mesh_ccd(mesh, mesh.vertices, end, broad_phase=broad_phase, device=device).contacts
    assert contacts.primitives.tolist() == [[14, 29]]
    without = mesh.excluding({"edge_edge": [[14, 29]]})
    assert ccd.mesh_ccd(without, mesh.vertices, end, broad_phase=broad_phase, device=device).toi == np.inf


def test_duplicates_and_either_order_are_one_pair():
    mesh = stacked(0.0, 0.5)[0].excluding({"edge_edge": [[4, 1], [1, 4], [4, 1], [2, 2]], "vertex_face": [[0, 1]] * 3})
    assert {key: pairs.tolist() for key, pairs in mesh.exclude_pairs.items()} == {
        "vertex_face": [[0, 1]],
        "edge_edge": [[1, 4]],
    }
    assert "2 excluded pairs" in repr(mesh) and repr(mesh.exclude_pairs) == "ExcludedPairs(1 vertex-face, 1 edge-edge)"


def test_more_pairs_are_added_to_those_before():
    first = stacked(0.0, 0.5)[0].excluding({"edge_edge": [[1, 4]]})
    both = first.excluding({"edge_edge": [[0, 3]], "vertices": [[5, 0]]})
    assert both.exclude_pairs["edge_edge"].tolist() == [[0, 3], [1, 4]]
    assert both.exclude_pairs["vertices"].tolist() == [[0, 5]]
    assert first.exclude_pairs["edge_edge"].tolist() == [[1, 4]]
    assert dict(first.excluding(both.exclude_pairs).exclude_pairs).keys() == dict(both.exclude_pairs).keys()


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
        turn, _ = np.linalg.qr(rng.standard_normal((3, 3)))
        mesh, start, end = hanging_nodes(turn)
        start, end = scale * start, scale * end
        near = ccd.find_proximity(mesh, start, 1e-9 * scale)
        fewer = mesh.excluding(near)
        assert ccd.mesh_ccd(mesh, start, end).toi == 0 and ccd.mesh_ccd(fewer, start, end).toi == np.inf
        assert ccd.collision_free_step(fewer, start, end) == 1
        kinds = {kind.name.lower(): near.primitives[near.kind == kind] for kind in ccd.PairKind}
        assert fewer.exclude_pairs == mesh.excluding(kinds).exclude_pairs


def test_contacts_of_all_kinds_are_excluded_as_they_are():
    mesh, start, end = crowd_of_all_kinds(np.random.default_rng(71), count=5)
    for contacts in (
        ccd.mesh_ccd(mesh, start, end).contacts,
        ccd.CollisionPipeline(mesh, device="cpu").launch(start, end).to_host().contacts,
    ):
        fewer = mesh.excluding(contacts)
        assert len({*contacts.kind}) == 4 and ccd.mesh_ccd(fewer, start, end).toi == np.inf
        assert rows(ccd.mesh_ccd(mesh.excluding(contacts[3:]), start, end).contacts) == rows(contacts[:3])
    other = stacked(0.0, 0.5)[0]
    with pytest.raises(ValueError, match=r"exclude_pairs is Contacts.* of a mesh with .* other edges; expected"):
        other.excluding(contacts)
    launched = ccd.CollisionPipeline(mesh, device="cpu").launch(start, end)
    for value in (launched.contacts, ccd.find_intersections(mesh, start)):
        with pytest.raises(ValueError, match=r"expected a mapping .* or contacts or proximities .*to_host\(\)"):
            mesh.excluding(value)


def test_a_copy_and_a_pickle_keep_the_pairs_and_cannot_be_written():
    rng = np.random.default_rng(70)
    mesh, start, end = crowd_of_all_kinds(rng, count=5)
    mesh = mesh.excluding({key: some_pairs(rng, mesh, key) for key in KEYS})
    expected = rows(ccd.mesh_ccd(mesh, start, end).contacts)
    for other in (copy.copy(mesh), copy.deepcopy(mesh), pickle.loads(pickle.dumps(mesh))):
        assert rows(ccd.mesh_ccd(other, start, end).contacts) == expected
        with pytest.raises(ValueError, match="read-only"):
            other.exclude_pairs["edge_edge"][0, 0] = 1
    with pytest.raises(TypeError):
        mesh.exclude_pairs["edge_edge"] = np.zeros((0, 2))


@pytest.mark.parametrize("values", [{}, {"bodies": []}, {"edge_edge": np.zeros((0, 2), dtype=int)}, {"vertices": [[]]}])
def test_no_pairs_are_no_filter(values):
    mesh = ccd.CollisionMesh.from_arrays([(np.eye(3), [[0, 1, 2]])], exclude_pairs=values)
    assert not mesh.exclude_pairs and mesh.self_collision.all()
