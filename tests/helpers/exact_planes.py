"""The pairs of vertices and planes in rational arithmetic, and what is never to differ from it."""

from fractions import Fraction

import numpy as np
from oracles import plane_value
from scenes import NO_FACES

import ccd_warp as ccd

U = Fraction(1, 2**53)
VERTEX_PLANE = ccd.PairKind.VERTEX_PLANE


def particles(points, *half_spaces, **arguments):
    """A body of points, and half-spaces."""
    return ccd.CollisionMesh.from_arrays([(points, NO_FACES), *half_spaces], **arguments)


class Truth:
    """The pair of a vertex and a plane in rational arithmetic.

    Attributes:
        f: (x - point)·normal at both ends.
        terms: Sum of the magnitudes of its terms at both ends, to which roundings are in proportion.
    """

    def __init__(self, mesh, start, end, vertex, plane):
        ends, own = (start, end), mesh.planes.vertices[plane]
        points = [mesh.planes.points[plane] if own < 0 else x[own] for x in ends]
        self.f = [plane_value(mesh, plane, x[vertex], x) for x in ends]
        self.normal = [Fraction(n) for n in mesh.planes.normals[plane].tolist()]
        self.terms = sum(
            abs((Fraction(a) - Fraction(p)) * n)
            for x, point in zip(ends, points, strict=True)
            for a, p, n in zip(x[vertex].tolist(), point.tolist(), self.normal, strict=True)
        )

    def at(self, t):
        """The value at a time."""
        t = Fraction(t)
        return (1 - t) * self.f[0] + t * self.f[1]

    def excess(self, f, distance, is_euclidean):
        """A number with the sign of the gap beyond a distance, where the value is f."""
        distance = Fraction(distance)
        if not is_euclidean:
            return f - distance * sum(map(abs, self.normal))
        return f if f <= 0 else f**2 - distance**2 * sum(n**2 for n in self.normal)

    def is_late(self, toi, distance=0.0, is_euclidean=False):
        """Whether the vertex comes within the distance before toi, or at all where that is inf."""
        before = [self.f[0]] if toi > 0 else []
        before += [self.f[1]] if toi == np.inf else []
        if any(self.excess(f, distance, is_euclidean) <= 0 for f in before):
            return True
        return 0 < toi < np.inf and self.excess(self.at(toi), distance, is_euclidean) < 0

    def is_early(self, toi, distance=0.0):
        """Whether the gap at toi is larger than roundings explain; the distance in either norm."""
        reach = Fraction(distance) * sum(map(abs, self.normal))
        slack = 64 * U * (self.terms + reach) + Fraction(2) ** -990 * max(map(abs, self.normal))
        return self.at(toi) > reach + slack


def tois_of(result, num_vertices, num_planes):
    """Toi of every pair, and its gap, shapes [V, H]; the contacts of a result."""
    toi, gap = np.full((2, num_vertices, num_planes), np.inf)
    contacts = result.contacts
    assert (contacts.kind == VERTEX_PLANE).all() and not contacts.parameters.any() and not contacts.width.any()
    toi[tuple(contacts.primitives.T)], gap[tuple(contacts.primitives.T)] = contacts.toi, contacts.gap
    at_start = (ccd.CCDStatus.INITIAL_CONTACT, ccd.CCDStatus.ROUNDING_LIMIT)
    assert ((contacts.toi == 0) == np.isin(contacts.status, at_start)).all()
    return toi, gap


def check_never_late(mesh, start, end, result, distance=0.0, is_euclidean=False):
    """Compare every pair with the exact one; returns the number of pairs that touch."""
    toi, gap = tois_of(result, mesh.num_vertices, len(mesh.planes))
    for vertex, plane in np.ndindex(toi.shape):
        if vertex in mesh.planes.vertices:
            assert toi[vertex, plane] == np.inf
            continue
        truth, t = Truth(mesh, start, end, vertex, plane), float(toi[vertex, plane])
        place = f"vertex {start[vertex].tolist()} to {end[vertex].tolist()}, {mesh.planes.points[plane].tolist()}, "
        place += f"{mesh.planes.normals[plane].tolist()}, toi {t}"
        assert not truth.is_late(t, distance, is_euclidean), place
        if t < np.inf:
            assert not truth.is_early(t, distance), place
            largest = Fraction(distance) + Fraction(float(gap[vertex, plane]))
            assert truth.excess(truth.at(t), largest, is_euclidean) <= 0, place
    return int(np.isfinite(toi).sum())


def moved_planes(mesh, start, end, of_planes):
    """The same mesh with half-spaces that move from their points to these, and the positions at both ends."""
    planes = [ccd.HalfSpace(p, n) for p, n in zip(mesh.planes.points, mesh.planes.normals, strict=True)]
    moving = particles(start, *planes, kinematic=range(1, 1 + len(planes)))
    return moving, np.concatenate([start, mesh.planes.points]), np.concatenate([end, of_planes])


def random_queries(rng, scale=1.0):
    """Points that move at random, and planes through the same box."""
    start, end = scale * rng.uniform(-1, 1, (2, 40, 3))
    planes = [
        ccd.HalfSpace(scale * rng.uniform(-1, 1, 3), n * 10 ** rng.uniform(-9, 9)) for n in rng.standard_normal((25, 3))
    ]
    mesh = particles(start, *planes)
    return mesh, start, end


def hostile_queries(rng):
    """Points on, beside and along planes, of sizes that overflow and underflow, and normals that lose bits."""
    normals = [
        [0, 0, 1],
        [0, -1e-320, 0],
        [1e308, 1e308, -1e308],
        [5e-324, 0, 5e-324],
        [1, 1e-300, 1e-310],
        [1e300, 1, 0],
    ]
    normals += [[1, 1, 1], [-3, 4, 0], *rng.standard_normal((3, 3)).tolist()]
    planes, points = [], []
    for k, normal in enumerate(normals):
        scale = [1.0, 1e-310, 1e308, 1e-200, 1e150, 1e-5][k % 6]
        planes.append(ccd.HalfSpace(scale * np.round(rng.uniform(-1, 1, 3), k % 3), normal))
    for half_space in planes:
        on_plane = np.array(half_space.point)
        along = np.cross(half_space.normal / np.max(np.abs(half_space.normal)), rng.standard_normal(3))
        size = max(np.abs(on_plane).max(), 5e-324)
        points += [on_plane, np.nextafter(on_plane, np.inf), np.nextafter(on_plane, -np.inf)]
        points += [0.5 * on_plane + 0.5 * size * along / np.abs(along).max(), 0.3 * on_plane]
    points = np.array([*points, [0, 0, 0], [1e308, -1e308, 1e308], [5e-324, 5e-324, -5e-324], [1, 2, 3]])
    order = rng.permutation(len(points))
    return particles(points, *planes), points, points[order]
