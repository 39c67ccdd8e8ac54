"""Volume cells: their boundary surface, and a mesh that takes and gives the positions of all nodes."""

import itertools
from collections import Counter
from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp

import ccd_warp as ccd

CUBE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]])
SIX = [[0, 1, 2, 6], [0, 2, 3, 6], [0, 3, 7, 6], [0, 7, 4, 6], [0, 4, 5, 6], [0, 5, 1, 6]]  # tetrahedra of a cube
TWO = [[0, 1, 2, 4, 5, 6], [0, 2, 3, 4, 6, 7]]  # its wedges
BELOW = [[0, 1, 2, 3], [4, 7, 6, 5], [0, 4, 5, 1], [1, 5, 6, 2], [2, 6, 7, 3], [3, 7, 4, 0]]  # its sides, from within
PLATE = (np.array([[-9.0, -9.0, -1.0], [9.0, -9.0, -1.0], [0.0, 9.0, -1.0]]), [[0, 1, 2]])
SIZE = (4, 3, 3)


@pytest.fixture(scope="module")
def bar():
    """Nodes of a bar of 4 x 3 x 3 unit cubes, and its cells of each type, by name; pyramids have the middles, too."""
    cubes = np.array(list(itertools.product(*map(range, SIZE))))
    nodes, index = np.unique((cubes[:, None] + CUBE).reshape(-1, 3), axis=0, return_inverse=True)
    hexahedra = index.reshape(-1, 8)
    middles = len(nodes) + np.arange(len(cubes))
    pyramids = [np.column_stack([hexahedra[:, side], middles]) for side in BELOW]
    nodes = np.concatenate([nodes, cubes + 0.5]).astype(float)
    return nodes, {
        "tetra": np.concatenate([hexahedra[:, four] for four in SIX]),
        "hexahedron": hexahedra,
        "wedge": np.concatenate([hexahedra[:, six] for six in TWO]),
        "pyramid": np.concatenate(pyramids),
    }


def _volume(mesh) -> float:
    a, b, c = mesh.vertices[mesh.faces].transpose(1, 0, 2)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def _assert_is_outward_surface_of_bar(mesh):
    half_edges = Counter((f[k], f[k - 2]) for f in mesh.faces.tolist() for k in range(3))
    assert all(half_edges[b, a] == 1 for a, b in half_edges), "not closed, or not turned alike"
    assert _volume(mesh) == pytest.approx(np.prod(SIZE))
    x, y, z = SIZE
    assert mesh.num_faces == 4 * (x * y + y * z + z * x)
    is_inside = ((mesh.vertices > 0) & (mesh.vertices < SIZE)).all(axis=1)
    assert mesh.inner_vertices.tolist() == np.flatnonzero(is_inside).tolist()


@pytest.mark.parametrize("kind", ["tetra", "hexahedron", "wedge", "pyramid"])
def test_the_surface_of_cells_of_one_type_is_closed_and_outward(bar, kind):
    nodes, cells = bar
    _assert_is_outward_surface_of_bar(ccd.CollisionMesh.from_volume(nodes, cells[kind]))


def test_mirrored_cells_and_mixed_types_have_the_same_surface(bar):
    """Columns of hexahedra and of wedges in turn, whose sides with four corners are one; every way to give them."""
    nodes, cells = bar
    is_wedge = nodes[cells["hexahedron"][:, 0]].astype(int)[:, :2].sum(axis=1) % 2 == 1
    wedges = cells["wedge"].reshape(2, -1, 6)[:, is_wedge].reshape(-1, 6)
    half = {"hexahedron": cells["hexahedron"][~is_wedge], "wedge": wedges}
    blocks = [SimpleNamespace(type=kind, data=values) for kind, values in half.items()]
    for given in (half, list(half.values()), list(half.items()), blocks, blocks[::-1]):
        _assert_is_outward_surface_of_bar(ccd.CollisionMesh.from_volume(nodes, given))
        mirrored = ccd.CollisionMesh.from_volume(nodes * [-1.0, 1.0, 1.0], given)
        assert _volume(mirrored) == pytest.approx(np.prod(SIZE))
    _assert_is_outward_surface_of_bar(ccd.CollisionMesh.from_volume(nodes, cells["tetra"].tolist()))
    # a node so far away that the volume of a cell would be lost beside it
    far = np.vstack([np.eye(4, 3), [[1e300] * 3], [[np.nan] * 3]])
    for corners in ([1, 0, 2, 3], [0, 1, 2, 3]):
        mesh = ccd.CollisionMesh.from_volume(far, [corners])
        assert _volume(mesh) > 0 and mesh.unused_vertices.tolist() == [4, 5]
    mesh = ccd.CollisionMesh.from_arrays([PLATE, (nodes, {"hexahedron": cells["hexahedron"]})], static=[0])
    assert mesh.num_faces == 1 + 132 and (mesh.inner_vertices > 3).all()


def test_hexahedra_with_repeated_corners_are_what_they_have_shrunk_to(bar):
    nodes, cells = bar
    wedges = cells["wedge"][:, [0, 1, 2, 2, 3, 4, 5, 5]]
    shrunk = ccd.CollisionMesh.from_volume(nodes, wedges)
    assert np.array_equal(np.sort(shrunk.faces), np.sort(ccd.CollisionMesh.from_volume(nodes, cells["wedge"]).faces))
    tetrahedra = cells["tetra"][:, [0, 1, 2, 2, 3, 3, 3, 3]]
    _assert_is_outward_surface_of_bar(ccd.CollisionMesh.from_volume(nodes, tetrahedra))


def test_shells_that_are_sides_of_volumes_add_nothing_and_others_are_faces(bar):
    nodes, cells = bar
    plain = ccd.CollisionMesh.from_volume(nodes, cells["hexahedron"])
    both = {"quad": cells["hexahedron"][:, [0, 1, 5, 4]], "hexahedron": cells["hexahedron"]}
    assert np.array_equal(ccd.CollisionMesh.from_volume(nodes, both).faces, plain.faces)
    fin = {"hexahedron": cells["hexahedron"], "triangle": [[0, 1, len(nodes) - 1]]}
    mesh = ccd.CollisionMesh.from_volume(nodes, fin)
    assert mesh.faces[-1].tolist() == [0, 1, len(nodes) - 1] and mesh.num_faces == plain.num_faces + 1
    assert len(mesh.inner_vertices) == len(plain.inner_vertices) - 1


def test_every_edge_of_a_quad_with_repeated_corners_stays_an_obstacle():
    """Whatever corners are one, the triangles have the edges of the polygon, and no more of them than it takes."""
    for quad in itertools.product(range(4), repeat=4):
        mesh = ccd.CollisionMesh.from_volume(np.eye(4)[:, :3], [("quad", [quad])])
        faces = [set(face) for face in mesh.faces.tolist()]
        assert len(faces) == 1 or not (faces[0] <= faces[1] or faces[1] <= faces[0]), quad
        for edge in zip(quad, np.roll(quad, 1), strict=True):
            assert any({*edge} <= face for face in faces), quad


def test_all_nodes_go_in_and_out_and_those_inside_meet_nothing(bar):
    """Answers are those of the surface alone, whose vertices have numbers of their own."""
    nodes, cells = bar
    mesh = ccd.CollisionMesh.from_volume(nodes, cells["tetra"], [PLATE], static=[1], names=["bar", "plate"])
    # the bar falls on the plate by two, and what is inside flies anywhere
    x0 = np.vstack([nodes, PLATE[0]])
    x1 = x0.copy()
    x1[: len(nodes)] += np.stack([0.1 * nodes[:, 1], 0 * nodes[:, 0], -2.0 + 0.05 * nodes[:, 0]], axis=1)
    x1[mesh.inner_vertices] += np.random.default_rng(0).uniform(-20.0, 20.0, (len(mesh.inner_vertices), 3))
    kept = np.setdiff1d(np.arange(mesh.num_vertices), mesh.inner_vertices)
    number = np.full(mesh.num_vertices, -1)
    number[kept] = np.arange(len(kept))
    faces = number[mesh.faces[mesh.face_body == 0]]
    surface = ccd.CollisionMesh.from_arrays([(nodes[kept[kept < len(nodes)]], faces), PLATE], static=[1])
    both, options = ((mesh, x0, x1), (surface, x0[kept], x1[kept])), {"length_scale": 4.0}
    full, alone = (ccd.mesh_ccd(*step, **options) for step in both)
    assert 0.4 < full.toi == alone.toi < 0.51 and np.isinf(full.vertex_toi[mesh.inner_vertices]).all()
    assert np.array_equal(full.vertex_toi[kept], alone.vertex_toi)
    assert np.array_equal(np.sort(number[full.contacts.vertices]), np.sort(alone.contacts.vertices))
    found, expected = (ccd.line_search(*step, per="vertex", **options).vertices for step in both)
    assert np.array_equal(found[kept], expected)
    assert np.array_equal(found[mesh.inner_vertices], x1[mesh.inner_vertices])
    for count in (
        lambda m, start, end: len(ccd.find_intersections(m, end)),
        lambda m, start, end: len(ccd.find_proximity(m, start, 1.1)),
        lambda m, start, end: len(ccd.find_candidates(m, start, end).vertex_face),
    ):
        assert count(*both[0]) == count(*both[1]) > 0
    launched = ccd.CollisionPipeline(mesh, **options).launch(*(wp.array(x, dtype=wp.vec3d) for x in (x0, x1)))
    assert np.array_equal(launched.to_host().vertex_toi, full.vertex_toi)


def test_nodes_inside_pass_through_their_own_surface_and_a_half_space_and_copies_have_their_own(bar):
    nodes, cells = bar
    ground = ccd.HalfSpace([0.0, 0.0, -1.0], [0.0, 0.0, 1.0])
    mesh = ccd.CollisionMesh.from_volume(nodes, cells["tetra"], [ground], codimensional_points=True)
    end = nodes - [0.0, 0.0, 0.5]
    end[mesh.inner_vertices] -= [0.0, 0.0, 9.0]
    assert ccd.mesh_ccd(mesh, nodes, end).toi == np.inf and len(ccd.find_intersections(mesh, end)) == 0
    points = ccd.CollisionMesh.from_arrays([(nodes, mesh.faces)], codimensional_points=True)
    assert ccd.mesh_ccd(points, nodes, end).toi < 0.4  # without the cells they would hit it
    end[mesh.inner_vertices[0]] = [0.5, 0.25, -0.5]  # on a face
    assert len(ccd.find_intersections(mesh, end)) == 0
    both = mesh.replicate(2)
    assert len(both.inner_vertices) == 2 * len(mesh.inner_vertices) and not len(both.codimensional_points)
    assert "vertices inside" in repr(mesh)


@pytest.mark.parametrize(
    "cells, message",
    [
        ([[0, 1, 2, 3], [1, 0, 2, 3]], "holds two cells of the vertices"),
        ([[0, 1, 2, 4], [0, 1, 2, 5], [0, 1, 2, 6]], r"has 3 cells at the side \[0, 2, 1, 1\]; expected at most two"),
        ([[0, 1, 2, 300]], r"holds index 300; expected indices in \[0, 116\)"),
        (np.zeros((2, 7), dtype=int), r"cells has shape \(2, 7\); expected \(n, corners\) with 4 of a tetra"),
        ({"tetra14": np.zeros((1, 14), dtype=int)}, "holds the type 'tetra14'; expected cells by type"),
        ({"tetra": np.zeros((0, 4), dtype=int)}, "cells in place of faces of body 0 are none"),
        ({"tetra": [[0.0, 1.0, 2.0, 3.0]]}, "expected integers"),
    ],
)
def test_cells_without_a_clear_outside_are_refused(bar, cells, message):
    with pytest.raises(ValueError, match=message):
        ccd.CollisionMesh.from_volume(bar[0], cells)


# the edges of each cell in the order of the nodes in the middle of these
_RING = [(0, 1), (1, 2), (2, 3), (3, 0)]
_EDGES = {
    "tetra": [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)],
    "hexahedron": [*_RING, (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)],
    "triangle": _RING[:2] + [(2, 0)],
    "quad": _RING,
}


@pytest.mark.parametrize("kind", _EDGES)
@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_quadratic_cells_collide_by_their_corners_and_say_how_far_their_nodes_are_off(bar, kind, scale):
    nodes, cells = bar
    linear = cells[kind] if kind in cells else cells["hexahedron"][:, [3, 0, 1] if kind == "triangle" else [0, 1, 2, 3]]
    middles = len(nodes) + np.arange(len(linear) * len(_EDGES[kind]))
    quadratic = np.column_stack([linear, middles.reshape(len(linear), -1)])
    ends = linear[:, np.array(_EDGES[kind])].reshape(-1, 2)
    every = scale * np.concatenate([nodes, nodes[ends].mean(axis=1)])
    of_type = {f"{kind}{quadratic.shape[1]}": quadratic}
    mesh = ccd.CollisionMesh.from_volume(every, of_type)  # straight edges, of which nothing is said
    expected = ccd.CollisionMesh.from_volume(scale * nodes, {kind: linear})
    assert np.array_equal(mesh.faces, expected.faces) and {*range(len(nodes), len(every))} <= {*mesh.inner_vertices}
    # the nodes at one end of the bar are moved along their edges, and by a tenth across these
    bent = every.copy()
    is_at_end = (every[len(nodes) :, 0] == 0) & (np.ptp(nodes[ends], axis=1) == [0, 1, 0]).all(axis=1)
    assert is_at_end.any()
    bent[len(nodes) :][is_at_end] += scale * np.array([-0.1, 0.2, 0.0])
    with pytest.warns(RuntimeWarning, match=f"cells of body 0: quadratic .* up to {0.1 * scale:.3g} off these, the"):
        mesh = ccd.CollisionMesh.from_volume(bent, of_type)
    assert np.array_equal(mesh.faces, expected.faces)
    end = bent + scale * np.array([0, 0, -1.0])
    plate = (scale * PLATE[0] * [1, 1, 0.5], PLATE[1])
    with pytest.warns(RuntimeWarning):
        both = ccd.CollisionMesh.from_volume(bent, of_type, [plate])
    assert ccd.mesh_ccd(both, both.vertices, np.concatenate([end, plate[0]])).toi == pytest.approx(0.5, abs=1e-5)
    quadratic[0, -1] = len(every)
    with pytest.raises(ValueError, match=rf"cells of body 0\['{kind}\d+'\] holds index {len(every)}"):
        ccd.CollisionMesh.from_volume(every, of_type)
