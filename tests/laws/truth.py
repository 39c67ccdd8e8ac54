"""What is true of a scene, whatever its features: brute force over all pairs, in exact arithmetic.

Pairs whose swept boxes are farther apart than their distance are left out by a comparison that rounding cannot change,
so the oracles, which share nothing with the kernels, are asked for few. Their answers are kept from run to run.
"""

import itertools
import sys
from decimal import Decimal
from fractions import Fraction
from functools import cache, cached_property

import algebraic
import distance_oracle
import exact_toi
import numpy as np
import oracle
import oracle_contact
import oracle_corners
from kept import kept

import ccd_warp as ccd

PLANE = ccd.PairKind.VERTEX_PLANE
NAMES = ("vertex-face", "edge-edge", "point-segment", "point-point")
UNITS = {"float64": 2.0**-53, "float32": 2.0**-24}
_SIDES = ("vf", "ee", "ve", "vv")
_ORACLES = (algebraic, exact_toi, oracle, oracle_contact, oracle_corners, distance_oracle, sys.modules[__name__])


class Pairs:
    """The pairs of primitives that may meet, of each kind."""

    def __init__(self, mesh: ccd.CollisionMesh) -> None:
        self.mesh, self.body = mesh, mesh.vertex_body
        count, prescribed = mesh.num_vertices, mesh.static | mesh.kinematic
        may = np.ones((mesh.num_bodies,) * 2, dtype=bool) if mesh.body_pairs is None else mesh.body_pairs.copy()
        np.fill_diagonal(may, mesh.self_collision)
        for a, b in mesh.exclude_pairs.get("bodies", ()):
            may[a, b] = may[b, a] = False
        self.bodies = may & ~(prescribed[:, None] & prescribed)
        of_parts = np.isin(self.body, [*mesh.face_body, *mesh.edge_body])  # bodies that have faces or edges
        used = np.isin(np.arange(count), [*mesh.faces.ravel(), *mesh.edges.ravel(), *mesh.codimensional_points])
        self.takes_part = (used | ~of_parts) & ~np.isin(np.arange(count), mesh.planes.vertices)
        # whether primitives with these vertices may not meet: those that take part, which large scenes have few of
        part = np.flatnonzero(self.takes_part)
        edge, (i, j) = np.eye(len(part), dtype=np.float32), np.searchsorted(part, mesh.edges).T
        edge[i, j] = edge[j, i] = 1
        near = np.linalg.matrix_power(edge, mesh.exclusion_rings - 1) > 0
        listed = mesh.exclude_pairs.get("vertices", np.zeros((0, 2), int))
        i, j = np.searchsorted(part, listed[self.takes_part[listed].all(axis=1)]).T
        near[i, j] = near[j, i] = True
        body, world = self.body[part], mesh.vertex_world[part]
        self.barred = np.ones((count, count), dtype=bool)
        self.barred[np.ix_(part, part)] = near | ~self.bodies[body][:, body] | (world[:, None] != world)
        self.tables = {"v": np.arange(count)[:, None], "e": mesh.edges, "f": mesh.faces}

    def allowed(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Whether primitives with vertices [n, i] and [m, j] may meet, [n, m]."""
        return ~np.any([self.barred[np.ix_(p, q)] for p, q in itertools.product(a.T, b.T)], axis=0)

    def indices(self, kind: int) -> tuple[np.ndarray, np.ndarray]:
        """Of the primitives that may be first and second in pairs of a kind."""
        mesh, parts = self.mesh, np.flatnonzero(self.takes_part)
        if mesh.dimension == 2:
            none = parts[:0]
            chosen = ((none, none), (none, none), (parts, np.arange(mesh.num_edges)))
        else:
            edges = np.arange(mesh.num_edges)
            cables = (mesh.codimensional_points, mesh.codimensional_edges)
            chosen = ((parts, np.arange(mesh.num_faces)), (edges, edges), cables)
        return (*chosen, (mesh.codimensional_points,) * 2)[kind]

    @cached_property
    def of_kinds(self) -> list[np.ndarray]:
        """All pairs that may meet of the kinds of two primitives, [n, 2] each, in order."""
        found = []
        for kind, sides in enumerate(_SIDES):
            first, second = self.indices(kind)
            is_allowed = self.allowed(self.tables[sides[0]][first], self.tables[sides[1]][second])
            if sides[0] == sides[1]:
                is_allowed &= first[:, None] < second
            i, j = np.nonzero(is_allowed)
            found.append(self._without_listed(np.stack([first[i], second[j]], axis=1), ccd.PairKind(kind).name.lower()))
        return found

    @cached_property
    def with_planes(self) -> np.ndarray:
        """Vertices and the planes that they may meet, [n, 2]."""
        planes, world = self.mesh.planes, self.mesh.vertex_world
        is_allowed = self.bodies[self.body][:, planes.bodies] & self.takes_part[:, None]
        is_allowed &= (planes.vertices < 0) | (world[:, None] == world[planes.vertices])
        return self._without_listed(np.argwhere(is_allowed), "vertex_plane")

    def _without_listed(self, pairs: np.ndarray, key: str) -> np.ndarray:
        listed = {*map(tuple, self.mesh.exclude_pairs.get(key, np.zeros((0, 2), int)).tolist())}
        if not listed:
            return pairs
        return pairs[[tuple(pair) not in listed for pair in pairs.tolist()]].reshape(-1, 2)

    def corners(self, kind: int, pairs: np.ndarray) -> np.ndarray:
        """Vertices of pairs of a kind, first those of the first primitive."""
        pairs = np.reshape(pairs, (-1, 2))
        if kind == PLANE:
            return pairs[:, :1]
        return np.hstack([self.tables[side][column] for side, column in zip(_SIDES[kind], pairs.T, strict=True)])

    def radii(self, kind: int, pairs: np.ndarray, radius: np.ndarray | None = None) -> np.ndarray:
        """The largest radius of either primitive, added up; of a vertex and a plane that of the primitives around."""
        radius = self.mesh.radius if radius is None else radius
        if radius is None:
            return np.zeros(len(pairs))
        if kind == PLANE:
            return self.around(radius)[pairs[:, 0]]
        parts = (self.tables[side][column] for side, column in zip(_SIDES[kind], pairs.T, strict=True))
        return sum(radius[part].max(axis=1, initial=0.0) for part in parts)

    def around(self, radius: np.ndarray) -> np.ndarray:
        """For each vertex the largest radius of the primitives with it."""
        largest = radius.copy()
        for a, b in (self.mesh.edges.T, self.mesh.edges.T[::-1]):
            np.maximum.at(largest, a, radius[b])
        return largest


# --- first times and distances of pairs ---


def boxes_come_near(start: np.ndarray, end: np.ndarray, split: int, reach: np.ndarray) -> np.ndarray:
    """Whether the swept boxes of both sides of pairs, [n, k, d], come within their reach: never wrongly false."""
    x = np.concatenate([start[:, :split], end[:, :split]], axis=1)
    y = np.concatenate([start[:, split:], end[:, split:]], axis=1)
    gap = np.maximum(x.min(axis=1) - y.max(axis=1), y.min(axis=1) - x.max(axis=1)).max(axis=1)
    return gap <= reach * (1 + 2.0**-50)  # a difference of numbers has the sign of the exact one, and rounds once


def _first_times(
    kind: str, start: np.ndarray, end: np.ndarray, distances: np.ndarray, is_euclidean: bool, t_max: float
):
    found = np.full(len(start), None, dtype=object)
    for distance in np.unique(distances):
        if distance == 0 or not is_euclidean:
            at = distances == distance
            found[at] = oracle.exact_tois(kind, start[at], end[at], float(distance), t_max)
    at = found == None  # noqa: E711
    if at.any():
        found[at] = distance_oracle.exact_distance_tois(kind, start[at], end[at], distances[at], t_max)
    return list(found)


def _distances(kind: str, start: np.ndarray, end: np.ndarray, times: np.ndarray, is_euclidean: bool) -> np.ndarray:
    measure = distance_oracle.exact_distance if is_euclidean else oracle.exact_gap
    return np.array([measure(kind, x, y, float(t)) for x, y, t in zip(start, end, times, strict=True)])


first_times, distances_at = kept(_first_times, *_ORACLES), kept(_distances, *_ORACLES)


def sizes(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The largest difference of two coordinates of a pair at either end, to which its roundings are in proportion."""
    return np.max([np.ptp(x, axis=1).max(axis=1), np.ptp(y, axis=1).max(axis=1)], axis=0)


# --- what every table of pairs says ---

_COLUMNS = ([0, 1, 2, 3], [0, 1, 2, 3], [0, 2, 3], [0, 2], [0])  # of different vertices, by kind


def first_sides(found) -> np.ndarray:
    """Which of the vertices of each pair are those of its first primitive, [n, 4]."""
    return np.arange(4) < np.where(found.kind == 0, 1, np.where(found.kind == PLANE, 4, 2))[:, None]


def check_sides(found, pairs: Pairs) -> None:
    """The first primitive and its body come first, and its weights are 1 together, those of the other one -1."""
    mesh, is_plane = pairs.mesh, found.kind == PLANE
    for kind, columns in enumerate(_COLUMNS):
        rows = found.kind == kind
        assert np.array_equal(found.vertices[rows][:, columns], pairs.corners(kind, found.primitives[rows]))
    bodies = mesh.vertex_body[found.vertices[:, [0, 3]]]
    bodies[is_plane, 1] = mesh.planes.bodies[found.primitives[is_plane, 1]]
    assert np.array_equal(found.bodies, bodies)
    of_sides = [(found.weights * side).sum(axis=1) for side in (first_sides(found), ~first_sides(found))]
    assert np.allclose(of_sides, [np.ones(len(found)), is_plane - 1.0], rtol=0, atol=1e-14)


def halfway(contacts, mesh: ccd.CollisionMesh, places: np.ndarray) -> np.ndarray:
    """The middle between the surfaces of two primitives, whose vertices are in these places, [n, 4, dimension]."""
    is_first = first_sides(contacts)
    # of a point a rounding outside of its face a weight has the other sign
    between = 0.5 * np.einsum("mk,mkd->md", np.where(is_first, 1, -1) * contacts.weights, places)
    if mesh.radius is not None:
        first, second = ((mesh.radius[contacts.vertices] * side).max(axis=1) for side in (is_first, ~is_first))
        between += 0.5 * (second - first)[:, None] * contacts.normal
    return between


def plane_moves(contacts, mesh: ccd.CollisionMesh, start, end) -> np.ndarray:
    """How the planes of contacts move in the step, [n, dimension]; 0 for contacts of other kinds."""
    moves, rows = np.zeros((len(contacts), mesh.dimension)), np.flatnonzero(contacts.kind == PLANE)
    own = mesh.planes.vertices[contacts.primitives[rows, 1]]
    moves[rows[own >= 0]] = (end - start)[own[own >= 0]]
    return moves


# --- vertices and planes ---


def plane_value(mesh: ccd.CollisionMesh, plane: int, x: np.ndarray, positions: np.ndarray) -> Fraction:
    """(x - point)·normal of a plane, exactly."""
    own = mesh.planes.vertices[plane]
    point = mesh.planes.points[plane] if own < 0 else positions[own]
    sides = (map(Fraction, np.asarray(a).tolist()) for a in (x, point, mesh.planes.normals[plane]))
    return sum((a - p) * n for a, p, n in zip(*sides, strict=True))


class PlaneTruth:
    """A vertex and a plane in a step: the value (x - point)·normal is linear in time."""

    def __init__(self, mesh, start, end, vertex: int, plane: int) -> None:
        self.f = [plane_value(mesh, plane, x[vertex], x) for x in (start, end)]
        self.normal = [Fraction(n) for n in mesh.planes.normals[plane].tolist()]
        own = mesh.planes.vertices[plane]
        points = [mesh.planes.points[plane] if own < 0 else x[own] for x in (start, end)]
        self._ends = [(x[vertex], p) for x, p in zip((start, end), points, strict=True)]

    @property
    def terms(self) -> Fraction:
        """The largest sum of the magnitudes of what the value is made of, at either end, about."""
        return Fraction(max(np.abs((x - p) * [*map(float, self.normal)]).sum() for x, p in self._ends))

    def length(self, is_euclidean: bool) -> float:
        """Of the normal, about: a gap times it is the value."""
        return float(np.linalg.norm([float(n) for n in self.normal], 2 if is_euclidean else 1))

    def at(self, t: float) -> Fraction:
        """The value at a time."""
        return self.f[0] + Fraction(t) * (self.f[1] - self.f[0])

    def excess(self, f: Fraction, distance: float, is_euclidean: bool) -> Fraction:
        """A number with the sign of the gap beyond a distance, where the value is f."""
        if not is_euclidean:
            return f - Fraction(distance) * sum(map(abs, self.normal))
        return f if f <= 0 else f * f - Fraction(distance) ** 2 * sum(n * n for n in self.normal)

    def is_late(self, toi: float, distance: float, is_euclidean: bool, t_max: float) -> bool:
        """Whether the vertex comes within the distance before toi, or in the step where that is inf."""
        if toi == 0:
            return False
        before = self.excess(self.f[0], distance, is_euclidean) <= 0
        last = self.excess(self.at(min(toi, t_max)), distance, is_euclidean)
        return before or last < 0 or (toi == np.inf and last <= 0)

    def is_early(self, toi: float, distance: float) -> bool:
        """Whether the gap at toi is larger than roundings explain; the distance in either norm."""
        reach = Fraction(distance) * sum(map(abs, self.normal))
        return self.at(toi) > reach + (self.terms + reach) / 2**46


# --- at one time ---


def swept_boxes(pairs: Pairs, start, end, inflation: float) -> tuple[np.ndarray, np.ndarray]:
    """Corners of the boxes of vertices, enlarged and rounded outward as `find_candidates` says it."""
    grown = [inflation] if pairs.mesh.radius is None else [inflation, pairs.around(pairs.mesh.radius)[:, None]]
    lower, upper = np.minimum(start, end), np.maximum(start, end)
    for length in grown:
        lower = np.where(length > 0, np.nextafter(lower - length, -np.inf), lower)
        upper = np.where(length > 0, np.nextafter(upper + length, np.inf), upper)
    return lower, upper


def candidates(pairs: Pairs, start, end, inflation: float) -> list[list[tuple[int, int]]]:
    """The pairs of each kind whose boxes overlap, in order."""
    lower, upper = swept_boxes(pairs, start, end, inflation)
    found = []
    for kind, all_pairs in enumerate(pairs.of_kinds):
        sides = [pairs.tables[side][column] for side, column in zip(_SIDES[kind], all_pairs.T, strict=True)]
        (a, b), (c, d) = ((lower[side].min(axis=1), upper[side].max(axis=1)) for side in sides)
        found.append([*map(tuple, all_pairs[((a <= d) & (c <= b)).all(axis=1)].tolist())])
    return [
        *found,
        [(v, k) for v, k in pairs.with_planes.tolist() if _is_at_plane(pairs, (start, end), v, k, inflation)],
    ]


def _is_at_plane(pairs: Pairs, ends, vertex: int, plane: int, inflation: float) -> bool:
    mesh = pairs.mesh
    radius = 0.0 if mesh.radius is None else pairs.around(mesh.radius)[vertex]
    reach = (2 * Fraction(inflation) + Fraction(radius)) * sum(
        map(abs, map(Fraction, mesh.planes.normals[plane].tolist()))
    )
    return any(plane_value(mesh, plane, x[vertex], x) <= reach for x in ends)


def proximities(pairs: Pairs, x: np.ndarray, distance: float) -> dict[tuple[int, int, int], tuple[float, float, float]]:
    """Distance, radii and size of all pairs whose boxes are near, and of all vertices and planes."""
    near = {}
    for kind, all_pairs in enumerate(pairs.of_kinds):
        corners, radii = pairs.corners(kind, all_pairs), pairs.radii(kind, all_pairs)
        at = boxes_come_near(
            x[corners], x[corners], len(corners.T) - len(_sides_of(kind)), (distance + radii) * (1 + 1e-9)
        )
        points = x[corners[at]]
        exact = distances_at(NAMES[kind], points, points, np.zeros(len(points)), True)
        size = np.linalg.norm(points[:, :, None] - points[:, None], axis=3).max(axis=(1, 2), initial=0.0)
        near |= {
            (kind, *p): row
            for p, row in zip(all_pairs[at].tolist(), zip(exact, radii[at], size, strict=True), strict=True)
        }
    radii = pairs.radii(PLANE, pairs.with_planes)
    for (v, k), radius in zip(pairs.with_planes.tolist(), radii, strict=True):
        f, own = plane_value(pairs.mesh, k, x[v], x), pairs.mesh.planes.vertices[k]
        squared = sum(Fraction(n) ** 2 for n in pairs.mesh.planes.normals[k].tolist())
        length = (Decimal(squared.numerator) / Decimal(squared.denominator)).sqrt()
        point = pairs.mesh.planes.points[k] if own < 0 else x[own]
        exact = float(Decimal(f.numerator) / Decimal(f.denominator) / length)
        near[(int(PLANE), v, k)] = exact, radius, float(np.linalg.norm(x[v] - point))
    return near


def _sides_of(kind: int) -> range:
    """Corners of the second primitive."""
    return range({"f": 3, "e": 2, "v": 1}[_SIDES[kind][1]])


def displacement_bounds(pairs: Pairs, x: np.ndarray, search_radius: float, kept_apart: float):
    """The bound of each vertex without rounding, and the size of the largest pair."""
    mesh, near = pairs.mesh, proximities(pairs, x, search_radius + kept_apart)
    moving = ~mesh.static[mesh.vertex_body]
    bodies = np.flatnonzero(~mesh.static)
    bodies = bodies[np.diff(mesh.body_vertex_range)[bodies] > 0]
    worlds = mesh.vertex_world[mesh.body_vertex_range[bodies]]
    collides = mesh.self_collision[bodies].any()
    is_alone = not collides and 0 < len({*worlds.tolist()}) == len(bodies)
    bounds = np.where(moving, search_radius if is_alone else 0.5 * search_radius, 0.0)
    largest = 0.0
    for (kind, *pair), (exact, radii, size) in near.items():
        corners = pairs.corners(kind, np.array(pair))[0]
        plane_vertex = mesh.planes.vertices[pair[1]] if kind == PLANE else -1
        corners = np.append(corners, plane_vertex) if plane_vertex >= 0 else corners
        is_shared = moving[corners].all() and not (kind == PLANE and plane_vertex < 0)
        gap = max(exact - kept_apart - radii, 0.0)
        chosen = corners[moving[corners]]
        bounds[chosen] = np.minimum(bounds[chosen], 0.5 * gap if is_shared else gap)
        largest = max(largest, size)
    return bounds, largest


def hulls_meet(a, b) -> bool:
    """Whether the convex hulls of two lists of rational points have a common point.

    They do if 0 is a convex combination of the differences: the first phase of the simplex method, by Bland's rule.
    """
    for axis in zip(*a, *b, strict=True):
        if max(axis[: len(a)]) < min(axis[len(a) :]) or max(axis[len(a) :]) < min(axis[: len(a)]):
            return False
    columns = [[*(x - y for x, y in zip(p, q, strict=True)), Fraction(1)] for p in a for q in b]
    rows = len(columns[0])
    # right-hand side (0, …, 0, 1), one artificial variable a row, whose sum is to become 0
    table = [[column[r] for column in columns] + [Fraction(int(r == rows - 1))] for r in range(rows)]
    basis = [None] * rows
    while True:
        cost = [sum(table[r][k] for r in range(rows) if basis[r] is None) for k in range(len(columns) + 1)]
        if cost[-1] == 0:
            return True
        enter = next((k for k in range(len(columns)) if cost[k] > 0), None)
        if enter is None:
            return False
        leave = min(
            (table[r][-1] / table[r][enter], -1 if basis[r] is None else basis[r], r)
            for r in range(rows)
            if table[r][enter] > 0
        )[2]
        pivot = table[leave][enter]
        table[leave] = [x / pivot for x in table[leave]]
        for r in range(rows):
            if r != leave and table[r][enter] != 0:
                factor = table[r][enter]
                table[r] = [x - factor * y for x, y in zip(table[r], table[leave], strict=True)]
        basis[leave] = enter


def _intersections(x: np.ndarray, kinds: list) -> list[tuple[int, int, int]]:
    """Those of the given pairs of primitives, (kind, first, second, vertices, vertices), that intersect."""
    points = [tuple(map(Fraction, row)) for row in x.tolist()]

    @cache
    def meet(a, b):
        return not {*a} & {*b} and hulls_meet([points[v] for v in a], [points[v] for v in b])

    def is_one(kind, a, b):
        sides = [*itertools.combinations(b, 2)] if len(b) == 3 else []
        if kind == ccd.IntersectionKind.EDGE_FACE:  # through the inside: no end in the face, and no side met
            return meet(a, b) and not any(meet((v,), b) for v in a) and not any(meet(a, side) for side in sides)
        if kind == ccd.IntersectionKind.EDGE_EDGE and x.shape[1] == 2:  # so do edges in the plane
            return meet(a, b) and not any(meet((v,), q) for p, q in ((a, b), (b, a)) for v in p)
        return meet(a, b)

    return [(kind, i, j) for kind, i, j, a, b in kinds if is_one(kind, tuple(a), tuple(b))]


_kept_intersections = kept(_intersections, sys.modules[__name__])


def intersections(pairs: Pairs, x: np.ndarray) -> list[tuple[int, int, int]]:
    """Every (kind, first, second) that `find_intersections` is to find."""
    mesh, found = pairs.mesh, []
    chosen = [(kind, sides, of_kind) for kind, (sides, of_kind) in enumerate(zip(_SIDES, pairs.of_kinds, strict=True))]
    edge_face = np.argwhere(pairs.allowed(mesh.edges, mesh.faces))
    chosen.append((int(ccd.IntersectionKind.EDGE_FACE), "ef", edge_face))
    if mesh.dimension == 2:
        i, j = np.nonzero(np.triu(pairs.allowed(mesh.edges, mesh.edges), 1))
        chosen[1] = (1, "ee", pairs._without_listed(np.stack([i, j], axis=1), "edge_edge"))
    for kind, sides, of_kind in chosen:
        a, b = (pairs.tables[side][column] for side, column in zip(sides, of_kind.T, strict=True))
        at = boxes_come_near(*(np.hstack([x[a], x[b]]),) * 2, len(a.T), np.zeros(len(a)))
        found += [
            (kind, *p, *q)
            for p, q in zip(of_kind[at].tolist(), zip(a[at].tolist(), b[at].tolist(), strict=True), strict=True)
        ]
    planes = [(5, v, k) for v, k in pairs.with_planes.tolist() if plane_value(mesh, k, x[v], x) <= 0]
    return sorted([*_kept_intersections(x, found), *planes])
