"""`unique()` keeps one contact for each two features that touch, by exact arithmetic, however tois are rounded."""

from collections import defaultdict
from fractions import Fraction

import numpy as np
import pytest

import ccd_warp as ccd
from laws.outputs import rows_of
from laws.scenes import drawn
from laws.touches import check_unique

pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")


@pytest.mark.parametrize("seed", [386, 537, 638])
def test_touches_whose_tois_differ_by_their_gaps_alone_are_one(seed):
    """In these scenes half of what rounding may shift is not enough, nor that of the later contact alone."""
    scene = drawn(seed)
    mesh, start, end = scene.make()
    assert check_unique(mesh, ccd.mesh_ccd(mesh, start, end, **scene.options).contacts, start, end, scene.delta)


def dot(a, b):
    return sum(x * y for x, y in zip(a, b, strict=True))


def cross(a, b):
    return [a[k - 2] * b[k - 1] - a[k - 1] * b[k - 2] for k in range(3)]


def touch_of(kind, vertices, x, motion):
    """When whole points of a pair touch, and the vertices of both features that do; None if they do not.

    The first primitive moves by ``motion`` relative to the second. It is "unclear" where they slide along each other.
    """
    p, q, r, s = x
    is_face = kind == int(ccd.PairKind.VERTEX_FACE)
    u, w = (r - q, s - q) if is_face else (q - p, s - r)
    n, gap = cross(u, w), (q if is_face else r) - p
    if dot(n, motion) == 0:
        return None if any(n) and dot(n, gap) else "unclear"
    t = Fraction(dot(n, gap), dot(n, motion))
    left = [t * m - g for m, g in zip(motion, gap, strict=True)]  # from the second origin to the first at t
    along_u, along_w = (Fraction(dot(cross(*of), n), dot(n, n)) for of in ((left, w), (u, left)))
    if is_face:
        weights = [1, 1 - along_u - along_w, along_u, along_w]
    else:
        weights = [1 + along_u, -along_u, 1 - along_w, along_w]
    if not 0 <= t <= 1 or min(weights) < 0:
        return None
    sides = zip(
        np.split(vertices, [1 if is_face else 2]), np.split(np.array(weights), [1 if is_face else 2]), strict=True
    )
    return frozenset(frozenset(of_side[weight > 0].tolist()) for of_side, weight in sides)


def falling(seed):
    """Tetrahedra that fall onto a sheet, with a vertex or the middle of an edge onto one, or onto a side or a face."""
    rng = np.random.default_rng(seed)
    grid = 8 * np.stack([*np.mgrid[:4, :4], rng.integers(-1, 2) * rng.integers(0, 2, (4, 4))], axis=-1).reshape(-1, 3)
    a = np.arange(12)[np.arange(12) % 4 < 3]
    faces = np.concatenate([np.stack([a, a + 4, a + 1], 1), np.stack([a + 1, a + 4, a + 5], 1)])
    bodies, motions = [(grid, faces)], [np.zeros(3, int)]
    for _ in range(2):
        x = 4 * rng.integers(-3, 4, (4, 3))
        motions.append(2 * np.append(rng.integers(-6, 7, 2), -rng.integers(8, 20)))
        target = faces[rng.integers(len(faces))][[[0, 0, 0, 0], [0, 0, 1, 1], [0, 1, 2, 2]][rng.integers(3)]]
        own = x[rng.permutation(4)[: 1 + rng.integers(2)]].mean(axis=0).astype(int)
        x = x - own + grid[target].mean(axis=0).astype(int) - motions[-1] // 2
        bodies.append((x, [[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]]))
    mesh = ccd.CollisionMesh.from_arrays([(x.astype(float), f) for x, f in bodies], static=[0], self_collision=False)
    return mesh, np.array(motions)


def test_one_contact_for_each_two_features_that_touch_exactly():
    num_groups = num_shared = 0
    for seed in range(200):
        mesh, motions = falling(seed)
        start, body = mesh.vertices, mesh.vertex_body
        contacts, groups = ccd.mesh_ccd(mesh, start, start + motions[body]).contacts, defaultdict(list)
        for k, (a, b) in enumerate(contacts.bodies):
            vertices, motion = contacts.vertices[k], motions[a] - motions[b]
            groups[touch_of(contacts.kind[k], vertices, start[vertices].astype(int), motion)].append(k)
        if not {None, "unclear"} & groups.keys():
            rows, unique = rows_of(contacts), contacts.unique()
            kept = dict(zip(rows_of(unique), unique.toi.tolist(), strict=True))
            for of_group in groups.values():
                (toi,) = [kept[rows[k]] for k in of_group if rows[k] in kept]
                assert toi == contacts.toi[of_group].min()
            assert len(kept) == len(groups)
            num_groups, num_shared = num_groups + len(groups), num_shared + sum(len(g) > 1 for g in groups.values())
    assert num_groups > 5_000 and num_shared > 200
