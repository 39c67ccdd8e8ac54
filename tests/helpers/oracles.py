"""What the answers on meshes are compared with: all pairs, without a tree, and exact arithmetic."""

import itertools
from fractions import Fraction

import numpy as np
from exact import exact_tois

import ccd_warp as ccd
from ccd_warp._pairs import pair_vertices


def corners_of(mesh, kind, pairs):
    """The vertices of each pair of one kind, shape [n, 4], [n, 3] or [n, 2]."""
    first, second = np.asarray(pairs).T
    if kind == ccd.PairKind.EDGE_EDGE:
        return np.column_stack([mesh.edges[first], mesh.edges[second]])
    others = {ccd.PairKind.VERTEX_FACE: mesh.faces, ccd.PairKind.POINT_SEGMENT: mesh.edges}
    return np.column_stack([first, others[kind][second] if kind in others else second])


def boxes_of(primitives, frames, inflation):
    """Lower and upper corners, shape [n, 3] each, of primitives given by vertex indices, shape [n, k]."""
    points = np.concatenate([np.asarray(frame, dtype=np.float64)[primitives] for frame in frames], axis=1)
    lower, upper = points.min(axis=1), points.max(axis=1)
    if inflation > 0:
        with np.errstate(over="ignore"):
            lower, upper = np.nextafter(lower - inflation, -np.inf), np.nextafter(upper + inflation, np.inf)
    return lower, upper


def taking_part(mesh):
    """Vertices of faces and edges, codimensional points, and those of bodies that have neither faces nor edges."""
    used = {*mesh.faces.ravel().tolist(), *mesh.edges.ravel().tolist(), *mesh.codimensional_points.tolist()}
    surfaces = {*mesh.face_body.tolist(), *mesh.edge_body.tolist()}
    return [v for v, body in enumerate(mesh.vertex_body.tolist()) if v in used or body not in surfaces]


def brute_force(mesh, start, end, inflation=0.0):
    """All candidates of each kind, as sorted lists of tuples."""
    prescribed = mesh.static | mesh.kinematic
    vertices, takes_part = np.arange(mesh.num_vertices), {*taking_part(mesh)}
    ids = {"v": vertices, "e": np.arange(mesh.num_edges), "f": np.arange(mesh.num_faces)}
    ids |= {"p": mesh.codimensional_points, "s": mesh.codimensional_edges}
    kinds = {"v": vertices[:, None], "e": mesh.edges, "f": mesh.faces}
    kinds |= {"p": kinds["v"][mesh.codimensional_points], "s": mesh.edges[mesh.codimensional_edges]}
    body = {"v": mesh.vertex_body, "e": mesh.edge_body, "f": mesh.face_body}
    body |= {"p": mesh.vertex_body[mesh.codimensional_points], "s": mesh.edge_body[mesh.codimensional_edges]}
    found = []
    for first, second in ("vf", "ee", "ps", "pp") if mesh.dimension == 3 else (("", ""), ("", ""), "ve", "pp"):
        if not first:
            found.append([])
            continue
        (lower_i, upper_i), (lower_j, upper_j) = (boxes_of(kinds[k], (start, end), inflation) for k in (first, second))
        pairs = []
        for i in range(len(lower_i)):
            overlap = ((lower_i[i] <= upper_j) & (lower_j <= upper_i[i])).all(axis=1)
            overlap &= ~(kinds[second][:, :, None] == kinds[first][i]).any(axis=(1, 2))
            overlap &= ~(prescribed[body[first][i]] & prescribed[body[second]])
            overlap &= not (first == "v" and (i in mesh.planes.vertices or i not in takes_part))
            overlap &= mesh.self_collision[body[second]] | (body[first][i] != body[second])
            pairs += [
                (int(ids[first][i]), int(ids[second][j])) for j in np.flatnonzero(overlap) if first != second or j > i
            ]
        found.append(pairs)
    found.append(near_planes(mesh, (start, end), inflation))
    is_allowed = listing(mesh)
    return [[pair for pair in pairs if is_allowed(kind, pair)] for kind, pairs in enumerate(found)]


def plane_value(mesh, plane, x, positions=None):
    """(x - point)·normal of a plane of a mesh, exactly; the point of one that moves is among the positions."""
    vertex = mesh.planes.vertices[plane]
    point = mesh.planes.points[plane] if vertex < 0 else positions[vertex]
    sides = (np.asarray(a).tolist() for a in (x, point, mesh.planes.normals[plane]))
    return sum((Fraction(a) - Fraction(p)) * Fraction(n) for a, p, n in zip(*sides, strict=True))


def near_planes(mesh, frames, inflation):
    """Free vertices whose boxes overlap half-spaces in a step, both enlarged, with the planes."""
    found = []
    is_free = ~(mesh.static | mesh.kinematic)[mesh.vertex_body]
    for vertex in filter(is_free.__getitem__, taking_part(mesh)):
        for plane, normal in enumerate(mesh.planes.normals.tolist()):
            point = mesh.planes.vertices[plane]
            if point >= 0 and mesh.vertex_world[point] != mesh.vertex_world[vertex]:
                continue
            reach = 2 * Fraction(inflation) * sum(abs(Fraction(n)) for n in normal)
            if any(plane_value(mesh, plane, x[vertex], x) <= reach for x in frames):
                found.append((vertex, plane))
    return found


def listing(mesh):
    """Whether neither tables and lists nor the worlds of a mesh leave out a pair of primitives of a kind."""
    tables = {"v": [[v] for v in range(mesh.num_vertices)], "e": mesh.edges.tolist(), "f": mesh.faces.tolist()}
    listed = {key: set(map(tuple, pairs.tolist())) for key, pairs in mesh.exclude_pairs.items()}
    of_kind = [listed.get(kind.name.lower(), set()) for kind in ccd.PairKind]
    bodies, vertices = (listed.get(key, set()) for key in ("bodies", "vertices"))
    body, world = mesh.vertex_body.tolist(), mesh.vertex_world.tolist()

    def is_allowed(kind, pair):
        if kind == ccd.PairKind.VERTEX_PLANE:
            bodies_of = body[pair[0]], int(mesh.planes.bodies[pair[1]])
            may_meet = mesh.body_pairs is None or mesh.body_pairs[bodies_of]
            return may_meet and tuple(sorted(bodies_of)) not in bodies and pair not in of_kind[kind]
        a, b = (tables[name][i] for name, i in zip(("vf", "ee", "ve", "vv")[kind], pair, strict=True))
        bodies_of = body[a[0]], body[b[0]]
        return (
            (mesh.body_pairs is None or bodies_of[0] == bodies_of[1] or mesh.body_pairs[bodies_of])
            and world[a[0]] == world[b[0]]
            and pair not in of_kind[kind]
            and tuple(sorted(bodies_of)) not in bodies
            and not any(tuple(sorted(both)) in vertices for both in itertools.product(a, b))
        )

    return is_allowed


def exact_pairs(mesh, start, end):
    """All pairs of each kind that the mesh lets collide and that touch, by exact arithmetic: (kind, *pair) to toi."""
    found = {}
    for kind, pairs in zip(ccd.PairKind, brute_force(mesh, 0 * start, 0 * start), strict=True):
        if pairs:
            corners = corners_of(mesh, kind, pairs)
            exact = exact_tois(kind.name.lower().replace("_", "-"), start[corners], end[corners])
            found |= {(int(kind), *pair): e for pair, e in zip(pairs, exact, strict=True) if e.hit}
    return found


def rows(contacts):
    """Contacts as a mapping from kind and primitives to toi."""
    keys = np.column_stack([contacts.kind, contacts.primitives]).tolist()
    return dict(zip(map(tuple, keys), contacts.toi.tolist(), strict=True))


def check_candidates(mesh, start, end, inflation=0.0, device=None, num_threads=1):
    """Assert equality with brute force, order included; returns the number of pairs."""
    found = ccd.find_candidates(mesh, start, end, inflation, device=device, num_threads=num_threads).sorted()
    all_expected = brute_force(mesh, start, end, inflation)
    for pairs, expected in zip(vars(found).values(), all_expected, strict=True):
        assert pairs.dtype == np.int32 and pairs.ndim == 2 and pairs.shape[1] == 2
        assert [tuple(pair) for pair in pairs.tolist()] == expected
    return sum(map(len, all_expected))


def exact_contacts(mesh, start, end):
    """Pairs that share no vertex, have a vertex that moves, and touch: (kind, vertices…), by exact arithmetic."""
    moved = (start != end).any(axis=1)
    found = []
    for kind, pairs in (
        ("vertex-face", [(v, *f) for v in range(len(start)) for f in mesh.faces.tolist()]),
        ("edge-edge", [(*a, *b) for a, b in itertools.combinations(mesh.edges.tolist(), 2)]),
    ):
        corners = np.array([c for c in pairs if len(set(c)) == 4 and moved[list(c)].any()], dtype=int).reshape(-1, 4)
        if len(corners):
            exact = exact_tois(kind, start[corners], end[corners])
            found += [(kind, *c) for c, e in zip(corners.tolist(), exact, strict=True) if e.hit]
    return found


def num_touching(mesh, start, end, **options):
    """Contacts of vertices that move, by `mesh_ccd` on the host."""
    corners = pair_vertices(mesh, ccd.mesh_ccd(mesh, start, end, **options).contacts)
    return int((start[corners] != end[corners]).any(axis=(1, 2)).sum())
