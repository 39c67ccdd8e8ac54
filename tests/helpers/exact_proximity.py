"""What is near in a mesh, by exact arithmetic over all pairs; nothing is shared with the kernels."""

from decimal import Decimal
from fractions import Fraction

import numpy as np
import scenes
from distance_oracle import exact_distance
from oracles import brute_force, corners_of, listing, plane_value

import ccd_warp as ccd


def few(count=3, seed=0, spread=0.6, half_spaces=(), **arguments):
    """Two bodies of few faces, cables and particles, close together, which form pairs of every kind."""
    rng = np.random.default_rng(seed)
    bodies = []
    for _ in range(2):
        vertices, faces, edges = scenes.cables_and_particles(rng, count, 0.15)
        bodies.append((spread * vertices, faces, edges))
    return ccd.CollisionMesh.from_arrays([*bodies, *half_spaces], codimensional_points=True, **arguments)


def few_in_plane(**arguments):
    """Cables and particles in the plane."""
    rng = np.random.default_rng(1)
    k = np.arange(12)
    bodies = [
        (rng.random((12, 2)), np.stack([k[:-1], k[1:]], axis=1)),
        (rng.random((8, 2)), np.zeros((0, 2), dtype=int)),
        (rng.random((8, 2)), rng.permutation(8).reshape(-1, 2)),
    ]
    return ccd.CollisionMesh.from_arrays(bodies, codimensional_points=True, **arguments)


def few_and_a_giant(**arguments):
    """A static face a thousand times as large as the others, among them."""
    rng = np.random.default_rng(2)
    giant = 1000 * scenes.TRIANGLE + [0.1, 0.2, 0.5]
    bodies = [scenes.soup(rng, 30, 0.1, spread=0.6), (giant, scenes.FACE)]
    return ccd.CollisionMesh.from_arrays(bodies, static=[1], **arguments)


EXCLUDED = {"vertex_face": [[0, 4], [40, 2]], "edge_edge": [[0, 9], [3, 20]], "vertices": [[1, 30], [2, 40]]}
HALF_SPACES = ccd.HalfSpace([0.1, 0.2, 0.1], [0.1, -0.2, 3.0]), ccd.HalfSpace([-0.1, 0.0, 0.0], [1e-3, 0.0, 0.0])
SCENES = {
    "every kind": few,
    "a static body": lambda: few(static=[1]),
    "one body without self-collision": lambda: few(self_collision=[True, False]),
    "in the plane, a static body": lambda: few_in_plane(static=[2]),
    "worlds": lambda: few(vertex_world=[1] * 27 + [0] * 27),
    "excluded pairs": lambda: few(exclude_pairs=EXCLUDED),
    "a giant face": few_and_a_giant,
    "half-spaces": lambda: few(half_spaces=HALF_SPACES, exclude_pairs={"vertex_plane": [[3, 0]], "bodies": [(0, 3)]}),
}


def size_of(points):
    """The largest distance of two points of a pair."""
    return np.linalg.norm(points[:, None] - points[None], axis=2).max()


def radius_of(mesh, kind, corners):
    """The sum of the radii of the two primitives of a pair."""
    if mesh.radius is None:
        return 0.0
    cut = 2 if kind == ccd.PairKind.EDGE_EDGE else 1
    return max(mesh.radius[corners[:cut]]) + max(mesh.radius[corners[cut:]])


def exact_proximities(mesh, x, distance):
    """For each (kind, first, second) that the mesh lets collide, and whose boxes are near: distance, radii and size."""
    near = {}
    most = distance if mesh.radius is None else distance + 2 * mesh.radius.max()
    for kind, pairs in zip(ccd.PairKind, brute_force(mesh, x, x, most), strict=True):
        if kind == ccd.PairKind.VERTEX_PLANE or not pairs:
            continue
        for pair, corners in zip(pairs, corners_of(mesh, kind, pairs), strict=True):
            points = x[corners]
            exact = exact_distance(kind.name.lower().replace("_", "-"), points, points, 0.0)
            near[(int(kind), *pair)] = exact, radius_of(mesh, kind, corners), size_of(points)
    return near | exact_planes(mesh, x)


def exact_planes(mesh, x):
    """The same for vertices and half-spaces, whatever their distance."""
    found = {}
    is_allowed = listing(mesh)
    for k, (point, normal, body, vertex) in enumerate(zip(*vars(mesh.planes).values(), strict=True)):
        point = point if vertex < 0 else x[vertex]
        squared = sum(Fraction(n) ** 2 for n in normal.tolist())
        length = (Decimal(squared.numerator) / Decimal(squared.denominator)).sqrt()
        for v in np.flatnonzero(~(mesh.static | mesh.kinematic)[mesh.vertex_body]).tolist():
            if mesh.body_pairs is not None and not mesh.body_pairs[mesh.vertex_body[v], body]:
                continue
            if is_allowed(ccd.PairKind.VERTEX_PLANE, (v, k)):
                f = plane_value(mesh, k, x[v], x)
                exact = float(Decimal(f.numerator) / Decimal(f.denominator) / length)
                around = [v, *mesh.edges[(mesh.edges == v).any(axis=1)].ravel()]  # a plane meets the thickest primitive
                radius = 0.0 if mesh.radius is None else mesh.radius[around].max()
                found[(int(ccd.PairKind.VERTEX_PLANE), v, k)] = exact, radius, np.linalg.norm(x[v] - point)
    return found


def check_proximities(mesh, x, distance, found):
    """Assert that what was found is what is near, with exact distances and points; returns the number of pairs."""
    expected = exact_proximities(mesh, x, distance)
    rows = [(k, *pair) for k, pair in zip(found.kind.tolist(), found.primitives.tolist(), strict=True)]
    assert rows == sorted(rows) and len({*rows}) == len(rows)
    must = {row for row, (exact, radii, _) in expected.items() if exact <= distance + radii}
    may = {row for row, (exact, radii, size) in expected.items() if exact <= distance + radii + 2e-15 * size}
    assert must <= {*rows} <= may
    sizes = np.array([expected[row][2] for row in rows])
    # 1e-15 of the size is what is promised; points add the roundings of positions and weights
    assert (np.abs(found.distance - [expected[row][0] for row in rows]) <= 1e-15 * sizes).all()
    gap = found.points[:, 0] - found.points[:, 1]
    between = found.distance - np.array([expected[row][1] for row in rows])  # the surfaces
    error = np.linalg.norm(gap - between[:, None] * found.direction, axis=1)
    assert (error <= 4e-15 * (sizes + np.abs(x).max())).all()
    return len(rows)


def exact_bounds(mesh, x, search_radius, kept=0.0):
    """The bound of each vertex without rounding, and the size of the largest pair."""
    moving = ~mesh.static[mesh.vertex_body]
    bodies = np.flatnonzero(~mesh.static)  # each in a single world
    worlds = mesh.vertex_world[mesh.body_vertex_range[bodies]]
    collides = (mesh.self_collision | mesh.kinematic)[bodies].any()
    is_alone = not collides and 0 < len({*worlds.tolist()}) == len(bodies)
    bounds = np.where(moving, search_radius if is_alone else 0.5 * search_radius, 0.0)
    largest = 0.0
    for (kind, *pair), (exact, radii, size) in exact_proximities(mesh, x, search_radius + kept).items():
        is_plane = kind == ccd.PairKind.VERTEX_PLANE
        corners = np.array(pair[:1]) if is_plane else corners_of(mesh, kind, [pair])[0]
        is_static_plane = is_plane and mesh.planes.vertices[pair[1]] < 0
        if is_plane and not is_static_plane:
            corners = np.append(corners, mesh.planes.vertices[pair[1]])
        gap = max(exact - kept - radii, 0.0)
        share = gap if is_static_plane or not moving[corners].all() else 0.5 * gap
        chosen = corners[moving[corners]]
        bounds[chosen] = np.minimum(bounds[chosen], share)
        largest = max(largest, size)
    return bounds, largest
