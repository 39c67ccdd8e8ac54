"""Volume cells: their boundary surface, and a mesh that takes and gives the positions of all nodes."""

import itertools
from collections import Counter
from types import SimpleNamespace

import numpy as np
import pytest

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


def test_nodes_inside_go_in_and_out_meet_nothing_and_are_no_particles(bar):
    """The bar falls on a plate, and on a half-space, while what is inside flies anywhere, as if that were not there."""
    nodes, cells = bar
    mesh = ccd.CollisionMesh.from_volume(nodes, cells["tetra"], [PLATE], static=[1], codimensional_points=True)
    inner, twice = mesh.inner_vertices, mesh.replicate(2)
    assert len(inner) and np.isin(inner, mesh.unused_vertices).all() and "vertices inside" in repr(mesh)
    assert len(twice.inner_vertices) == 2 * len(inner) and not len(twice.codimensional_points)
    surface = ccd.CollisionMesh.from_arrays([(nodes, mesh.faces[mesh.face_body == 0]), PLATE], static=[1])
    start = np.vstack([nodes, PLATE[0]])
    end = start - [0, 0, 2.0] * (mesh.vertex_body == 0)[:, None]
    end[inner] += np.random.default_rng(0).uniform(-20.0, 20.0, (len(inner), 3))
    full, alone = (ccd.mesh_ccd(each, start, end, length_scale=4.0) for each in (mesh, surface))
    assert 0.4 < full.toi == alone.toi < 0.51 and np.array_equal(full.vertex_toi, alone.vertex_toi)
    found = ccd.line_search(mesh, start, end, per="vertex", length_scale=4.0).vertices
    assert np.array_equal(found[inner], end[inner]) and np.isinf(full.vertex_toi[inner]).all()
    ground = ccd.HalfSpace([0.0, 0.0, -1.0], [0.0, 0.0, 1.0])
    over = ccd.CollisionMesh.from_volume(nodes, cells["tetra"], [ground])
    end = nodes - np.where(np.isin(np.arange(len(nodes)), inner), 9.5, 0.5)[:, None] * [0, 0, 1]
    assert ccd.mesh_ccd(over, nodes, end).toi == np.inf and len(ccd.find_intersections(over, end)) == 0


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_quadratic_cells_have_the_surface_of_their_corners_and_say_how_far_their_nodes_are_off(bar, scale):
    """Of any size; that the middles of all types are those of their edges is looked at in files."""
    nodes, cells = bar
    linear = cells["tetra"]
    ends = linear[:, np.array([(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)])].reshape(-1, 2)
    every = scale * np.concatenate([nodes, nodes[ends].mean(axis=1)])
    of_type = {"tetra10": np.column_stack([linear, np.arange(len(nodes), len(every)).reshape(-1, 6)])}
    mesh = ccd.CollisionMesh.from_volume(every, of_type)  # straight edges, of which nothing is said
    expected = ccd.CollisionMesh.from_volume(scale * nodes, linear).faces
    assert np.array_equal(mesh.faces, expected) and {*range(len(nodes), len(every))} <= {*mesh.inner_vertices}
    # the nodes at one end of the bar are moved along their edges, and by a tenth across these
    is_at_end = (every[len(nodes) :, 0] == 0) & (np.ptp(nodes[ends], axis=1) == [0, 1, 0]).all(axis=1)
    every[len(nodes) :][is_at_end] += scale * np.array([-0.1, 0.2, 0.0])
    with pytest.warns(RuntimeWarning, match=f"cells of body 0: quadratic .* up to {0.1 * scale:.3g} off these, the"):
        assert np.array_equal(ccd.CollisionMesh.from_volume(every, of_type).faces, expected)
    of_type["tetra10"][0, -1] = len(every)
    with pytest.raises(ValueError, match=rf"cells of body 0\['tetra10'\] holds index {len(every)}"):
        ccd.CollisionMesh.from_volume(every, of_type)
