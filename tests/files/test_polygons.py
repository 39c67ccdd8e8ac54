"""Polygons of files become triangles that cover their area once, the same ones in every frame."""

from collections import Counter
from itertools import combinations, pairwise

import numpy as np
import pytest
from mesh_files import of_extra, polygon_file

import ccd_warp as ccd
from ccd_warp._files.polygons import fan, triangulated

HOLE = [(0, 0), (6, 0), (6, 6), (0, 6), (0, 0), (2, 2), (2, 4), (4, 4), (4, 2), (2, 2)]  # and its bridge
KNOWN = [
    [(0, 0), (6, 0), (6, 4), (4, 4), (4, 1), (2, 1), (2, 4), (0, 4)],  # a wall with a doorway
    [(0, 0), (2, 1), (4, 0), (2, 4)],  # a dart, whose fan about its first corner covers too much
    [(0, 0), (1, 0), (2, 0), (3, 0), (0, 3)],  # three corners on a side
    HOLE,
    [(0, 0), (8, 0), (8, 8), (0, 8), (0, 0), (1, 2), (1, 6), (3, 4), (1, 2), (5, 4), (7, 6), (7, 2), (5, 4), (1, 2)],
]


def _area(a, b, c) -> int:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _crosses(p, q, r, s) -> bool:
    """Whether two segments of integers have one point within both in common."""
    return _area(p, q, r) * _area(p, q, s) < 0 and _area(r, s, p) * _area(r, s, q) < 0


def _touches(a, b, c) -> bool:
    """Whether a point of integers is on a segment."""
    return not _area(a, b, c) and min(a, b) <= c <= max(a, b)


def _meeting(polygon) -> tuple[int, int] | None:
    """Two sides that meet elsewhere than in a corner that they share."""
    n = len(polygon)
    for i, j in combinations(range(n), 2):
        (p, q), (r, s) = ((polygon[k], polygon[(k + 1) % n]) for k in (i, j))
        ends = [(p, q, r)] * (q != r) + [(p, q, s)] * (s != p) + [(r, s, p)] * (s != p) + [(r, s, q)] * (q != r)
        if _crosses(p, q, r, s) or any(_touches(*three) for three in ends):
            return i, j
    return None


def _drawn(rng, size) -> list[tuple[int, int]]:
    """A simple polygon of integers: random points, of which what lies between two sides that meet is turned round."""
    while True:
        places = {*map(tuple, rng.integers(0, size, (int(rng.integers(4, 13)), 2)).tolist())}
        polygon = rng.permutation([*places]).tolist()
        polygon = [*map(tuple, polygon)]
        for _ in range(100):
            if (meeting := _meeting(polygon)) is None:
                return polygon
            i, j = meeting
            polygon[i + 1 : j + 1] = polygon[i + 1 : j + 1][::-1]


def _triangles(polygon, turned) -> np.ndarray:
    """The triangles of a polygon that lies in space as its axes are turned, of corners that have one number if one."""
    places = np.array(polygon, dtype=float)
    points = np.column_stack([places, places @ [0.25, -0.5] + 0.125])[:, turned]
    corners = np.array([polygon.index(corner) for corner in polygon])
    return triangulated(points, fan(corners, np.array([len(polygon)])), np.array([len(polygon)]))


@pytest.mark.parametrize("size, shear", [(4, 0), (7, 0), (1000, 0), (7, 2**18)])
def test_every_simple_polygon_is_covered_once(size, shear):
    """Triangles of one orientation whose sides cancel but for those of the polygon cover it as often as it goes round.

    A convex polygon keeps its fan, and one of which two sides cross is refused. Sheared to a line but for roundings, of
    which signs of rounded areas are none, it is covered, too.
    """
    rng, refused = np.random.default_rng(size), 0
    for polygon in KNOWN + [_drawn(rng, size) for _ in range(60)]:
        n, turned = len(polygon), rng.permutation(3)
        polygon = [(x + shear * y, y + shear * (x + shear * y)) for x, y in polygon]
        start, way = int(rng.integers(n)), int(rng.choice([1, -1]))
        polygon = (polygon[start:] + polygon[:start])[::way]
        faces = _triangles(polygon, turned)
        signs = {np.sign(_area(*(polygon[k] for k in face))) for face in faces.tolist()}
        assert len(faces) == n - 2 and len(signs) == 1 and 0 not in signs
        corners = [polygon.index(corner) for corner in polygon]
        sides = Counter(side for a, b, c in faces.tolist() for side in ((a, b), (b, c), (c, a)))
        sides.subtract(pairwise([*corners, corners[0]]))
        assert all(count == sides[b, a] for (a, b), count in [*sides.items()])
        turns = {np.sign(_area(polygon[k - 2], polygon[k - 1], polygon[k])) for k in range(n)}
        if len(turns) == 1 and not shear:
            assert faces.tolist() == [[0, k, k + 1] for k in range(1, n - 1)]
        i, j = rng.choice(n, 2, replace=False)
        polygon[i], polygon[j] = polygon[j], polygon[i]
        sides = pairwise([*polygon, polygon[0]])
        if not shear and any(_crosses(*one, *two) for one, two in combinations(sides, 2)):
            with pytest.raises(ValueError, match=f"face 0, counted from 0, of {n} corners, is no simple polygon"):
                _triangles(polygon, turned)
            refused += 1
    assert refused > 10 or shear


def test_frames_have_the_triangles_of_the_first_and_a_doorway_lets_a_ball_through(tmp_path):
    """In every format of polygons; in the last frame the wall has folded so that no side of it is where it was."""
    wall = np.insert(np.array(KNOWN[0], float), 1, 0.0, axis=1)
    of_extra("collada")
    for name in ("a.obj", "a.off", "a.ply", "a.dae", "a.vtp"):
        paths = [tmp_path / f"{k} {name}" for k in range(3)]
        for path, x in zip(paths, (wall, wall, np.roll(wall, 3, axis=0)), strict=True):
            path.write_text(polygon_file(name, x, [range(8)]))
        sequence = ccd.read_sequence(paths)
        faces = sequence.mesh.faces
        last = np.roll(wall, 3, axis=0)[[*sequence.step(0).source_index]]
        assert len(faces) == 6 and np.array_equal(sequence[2], last)
        mesh = ccd.CollisionMesh.from_arrays([(sequence[0], faces), ([[3.0, -2, 2]], [])], static=[0], radius=[0, 0.3])
        assert ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices + np.outer(mesh.vertex_body, [0, 4, 0])).toi == np.inf
        paths[0].write_text(polygon_file(name, wall[[0, 2, 1, 3, 4, 5, 6, 7]], [range(8)]))
        with pytest.raises(ValueError, match=rf"0 {name}: face 0, counted from 0, of 8 corners, is no simple polygon"):
            ccd.read_sequence(paths)
        paths[1].write_text(polygon_file(name, wall, [range(7, -1, -1)]))
        paths[0].write_text(polygon_file(name, wall, [range(8)]))
        if name != "a.dae":  # whose corners have no numbers of their own
            with pytest.raises(ValueError, match=r"\(1 of 1 faces differ, and in their orientation alone\)"):
                ccd.read_sequence(paths)


def test_a_bent_quadrilateral_is_no_simple_polygon_of_a_plane_and_two_triangles():
    """Four corners far from any plane, whose sides cross as seen along each axis."""
    points = np.array([[0, 0, 0], [1, 1, 0.4], [1, 0, 0], [0, 1, 0.6]])
    faces = triangulated(points, fan(np.arange(4), np.array([4])), np.array([4]))
    assert {*map(frozenset, faces.tolist())} in (
        {*map(frozenset, halves)} for halves in ([(0, 1, 2), (0, 2, 3)], [(0, 1, 3), (1, 2, 3)])
    )
