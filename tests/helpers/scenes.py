"""Scenes that test modules share: meshes, pairs, and where their vertices are at both ends of a step."""

import numpy as np
import trimesh

import ccd_warp as ccd

TRIANGLE = np.array([[-1.0, -1, 0], [1, -1, 0], [0, 1, 0]])
FACE = np.array([[0, 1, 2]])
NO_FACES = np.zeros((0, 3), dtype=int)
TETRAHEDRON = np.eye(4, 3, -1), np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
# Points of a pair.
CORNERS = {"vertex_face": 4, "edge_edge": 4, "point_segment": 3, "point_point": 2}


def single(vertices, faces):
    """A mesh of one body."""
    return ccd.CollisionMesh.from_arrays([(vertices, faces)])


# --- at random places ---


def soup(rng, num_faces, size, num_vertices=None, spread=1.0):
    """Faces at random places: vertices [3 num_faces, 3] and faces; shared vertices where num_vertices is given."""
    vertices = (spread * rng.random((num_faces, 1, 3)) + size * rng.standard_normal((num_faces, 3, 3))).reshape(-1, 3)
    faces = np.arange(3 * num_faces).reshape(-1, 3)
    return vertices, faces if num_vertices is None else faces % num_vertices


def triangles(rng, count, **options):
    """Triangles at random places, a body each: mesh and positions."""
    mesh = ccd.CollisionMesh.from_arrays([(rng.uniform(-1, 1, (3, 3)), FACE) for _ in range(count)], **options)
    return mesh, mesh.vertices.copy()


def crowd(rng, num_faces=400, size=0.08, speed=0.1, *, num_bodies=1, num_others=0, dust=0, **options):
    """Faces at random places that move at random, but for static ones: mesh, start and end positions.

    Each body has half as many faces as the one before, so many cables and particles among them, and as many vertices
    in one place as ``dust`` says.
    """
    bodies = []
    for count in (num_faces >> k for k in range(num_bodies)):
        x = np.concatenate([soup(rng, count + num_others, size)[0], 0.01 * rng.standard_normal((dust, 3))])
        k = np.arange(3 * count, 3 * count + 2 * num_others, 2)
        bodies.append((x, np.arange(3 * count).reshape(-1, 3), np.stack([k, k + 1], axis=1)))
    mesh = ccd.CollisionMesh.from_arrays(bodies, codimensional_points=num_others > 0, **options)
    end = mesh.vertices + speed * rng.standard_normal(mesh.vertices.shape)
    return mesh, mesh.vertices.copy(), with_static_at_rest(mesh, mesh.vertices, end)


def crowd_of_three(num_faces, num_others=0, size=0.1, **options):
    """Three bodies of faces, and cables and particles among them."""
    return crowd(np.random.default_rng(21), num_faces, size, 1.5 * size, num_bodies=3, num_others=num_others, **options)


def random_pairs(kind, count=200, seed=0, dimension=3):
    """Points of pairs at both ends of a step, [count, 4, 3] or as the kind has it, in which some touch."""
    start = np.random.default_rng(seed).uniform(-1, 1, (count, CORNERS[kind], dimension))
    return start, start[:, ::-1] + 0.1


def pairs_in_worlds(kind, start, end, radius=None):
    """A mesh of pairs, each in a world of its own, start and end positions: row i of the points are its vertices.

    A radius may be given for each vertex.
    """
    count, corners, dimension = start.shape
    kind = kind.replace("_", "-")
    first = corners * np.arange(count)[:, None]
    sides = {"edge-edge": [[0, 1], [2, 3]], "point-segment": [[1, 2]]}.get(kind, [])
    edges = np.concatenate([first + side for side in sides]) if sides else np.zeros((0, 2), dtype=int)
    faces = first + [1, 2, 3] if kind == "vertex-face" else NO_FACES
    points = start.reshape(-1, dimension)
    mesh = ccd.CollisionMesh.from_arrays(
        [(points, edges) if dimension == 2 else (points, faces, edges)],
        codimensional_points=kind != "edge-edge",
        vertex_world=np.repeat(np.arange(count), corners),
        radius=radius,
    )
    return mesh, points, end.reshape(-1, dimension)


def crowd_in_plane(rng, count=25, size=0.1, speed=0.3, **options):
    """Chains of two segments, single segments, and points, a body each, that move at random, some points head-on."""
    chains = np.repeat(rng.random((count, 1, 2)), 3, axis=1) + size * rng.standard_normal((count, 3, 2))
    of_chain = np.arange(3 * count).reshape(-1, 3)
    segments = np.repeat(rng.random((count, 1, 2)), 2, axis=1) + size * rng.standard_normal((count, 2, 2))
    bodies = [
        (chains.reshape(-1, 2), np.concatenate([of_chain[:, :2], of_chain[:, 1:]])),
        (segments.reshape(-1, 2), np.arange(2 * count).reshape(-1, 2)),
        (rng.random((count, 2)), np.zeros((0, 2), dtype=int)),
    ]
    mesh = ccd.CollisionMesh.from_arrays(bodies, names=["chains", "segments", "dust"], **options)
    end = mesh.vertices + speed * rng.standard_normal(mesh.vertices.shape)
    points = mesh.codimensional_points[: count // 4 * 4].reshape(-1, 4)
    end[points[:, 0]], end[points[:, 1]] = mesh.vertices[points[:, 1]], mesh.vertices[points[:, 0]]
    return mesh, mesh.vertices, with_static_at_rest(mesh, mesh.vertices, end)


# --- laid out ---

# A rotation or reflection whose columns lie along no axis.
TURN = np.linalg.qr(np.array([[1.0, 0.3, -0.2], [0.9, -1.0, 0.4], [1.1, 0.2, 1.3]]))[0]


def tube(num=800):
    """Needles around an axis along no axis of the coordinates: vertices, and two faces for each needle."""
    angle = np.linspace(0, 2 * np.pi, num, endpoint=False)
    circle = 0.1 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    vertices = np.concatenate([np.column_stack([circle, np.full(num, z)]) for z in (0.0, 10.0)]) @ TURN.T
    i, j = np.arange(num), (np.arange(num) + 1) % num
    faces = np.concatenate([np.stack([i, j, i + num], axis=1), np.stack([j, j + num, i + num], axis=1)])
    return vertices, faces


def squeezed(vertices, share):
    """A tube whose far side moves towards the near one, and beyond for a share above 1."""
    across = (vertices - vertices.mean(axis=0)) @ TURN[:, 0]
    return vertices - share * np.outer(across, TURN[:, 0])


def stacked(*heights):
    """Triangles above each other, each a little aside of the one before, a body each: mesh and positions."""
    bodies = [(TRIANGLE + [0.1 * k, 0.07 * k, z], FACE) for k, z in enumerate(heights)]
    return ccd.CollisionMesh.from_arrays(bodies), np.concatenate([vertices for vertices, _ in bodies])


def falling(height=1.0, **options):
    """A triangle that falls through another: mesh, start and end positions."""
    mesh = ccd.CollisionMesh.from_arrays([(TRIANGLE, FACE), (TRIANGLE + [0, 0, height], FACE)], **options)
    return mesh, mesh.vertices.copy(), mesh.vertices - [0, 0, 2.0 * height] * (mesh.vertex_body == 1)[:, None]


def leaning_stack(count, gap=1e-4):
    """Copies of a leaning triangle, ``gap`` apart, that rise together: all boxes overlap, and nothing ever touches."""
    triangle = np.array([[0.0, 0, 0], [1, 0, 1], [0, 1, 0.5]])
    start = (triangle + np.arange(count)[:, None, None] * [0, 0, gap]).reshape(-1, 3)
    return single(start, np.arange(3 * count).reshape(-1, 3)), start, start + [0, 0, 0.5]


def sheet(n, size=1.0):
    """A square grid of (n + 1)² vertices in the plane z = 0: vertices and faces."""
    k = np.arange(n + 1) / n - 0.5
    vertices = size * np.stack([*np.meshgrid(k, k, indexing="ij"), np.zeros((n + 1, n + 1))], axis=-1).reshape(-1, 3)
    a = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    faces = np.concatenate([np.stack([a, a + n + 1, a + 1], 1), np.stack([a + 1, a + n + 1, a + n + 2], 1)])
    return vertices, faces


def with_static_at_rest(mesh, start, end):
    """The end positions, with static bodies where they start."""
    return np.where(mesh.static[mesh.vertex_body][:, None], start, end)


def crowd_of_all_kinds(rng, count=8, **options):
    """Three bodies of faces, cables and particles, mixed, that move at random: mesh, start and end positions.

    Cables and particles stay in one plane, where they meet, and some pairs of particles meet head-on.
    """
    bodies = []
    for _ in range(3):
        start = np.repeat(rng.random((3 * count, 1, 3)), 3, axis=1) + 0.2 * rng.standard_normal((3 * count, 3, 3))
        faces, cables = rng.permutation(9 * count)[: 6 * count].reshape(2, count, 3)
        bodies.append((start.reshape(-1, 3), faces, np.concatenate([cables[:, :2], cables[:, 1:]])))
    names = ["net", "rope", "dust"]
    mesh = ccd.CollisionMesh.from_arrays(bodies, codimensional_points=True, names=names, **options)
    start, particles = mesh.vertices.copy(), mesh.codimensional_points
    end = start + 0.2 * rng.standard_normal(start.shape)
    in_plane = np.append(mesh.edges[mesh.codimensional_edges], particles)
    start[in_plane, 2] = end[in_plane, 2] = 0.5
    a, b, *_ = particles[: len(particles) // 4 * 4].reshape(-1, 4).T
    end[a], end[b] = start[b], start[a]
    return mesh, start, with_static_at_rest(mesh, start, end)


def two_of_every_kind(*half_spaces, **options):
    """A face, a cable and particles, the same a little higher as another body, and half-spaces: a mesh."""
    cables = [[-2.0, 0, 0], [-1.5, 0.4, 0.02], [2.0, 0.1, 0.01], [-1.75, 0.2, 0.01], [5.0, 5.0, 0.02]]
    lower = np.array([*TRIANGLE, *cables])
    upper = lower * [0.98, 1.04, 1.0] + [0.02, 0.01, 0.5] + 0.02 * np.random.default_rng(0).random(lower.shape)
    bodies = [*((x, FACE, [[3, 4]]) for x in (lower, upper)), *half_spaces]
    options = {"codimensional_points": True, "self_collision": False} | options
    return ccd.CollisionMesh.from_arrays(bodies, **options)


def sheet_over_floor(n=8):
    """A sheet that falls through a static floor: mesh, start and end positions."""
    vertices, faces = sheet(n)
    floor = vertices * 1.3 + [0.013, 0.007, -0.2]
    mesh = ccd.CollisionMesh.from_arrays([(vertices, faces), (floor, faces)], static=[1])
    return mesh, mesh.vertices, mesh.vertices - [0, 0, 0.4] * (mesh.vertex_body == 0)[:, None]


def named_cloth_and_ball():
    """A cloth that falls through a static ball: mesh, start and end positions."""
    vertices, faces = sheet(12)
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.3)
    bodies = [(vertices + [0.013, 0.007, 0.5], faces), (ball.vertices, ball.faces)]
    mesh = ccd.CollisionMesh.from_arrays(bodies, static=["ball"], names=["cloth", "ball"])
    return mesh, mesh.vertices, mesh.vertices - [0, 0, 1.0] * (mesh.vertex_body == 0)[:, None]


def cloth_and_ball_in_worlds(count=4):
    """Copies of a cloth over a ball, of which the first half fall on it: mesh, start and end positions [W, n, 3]."""
    vertices, faces = sheet(4)
    ball = trimesh.creation.icosphere(subdivisions=1, radius=0.3)
    bodies = [(vertices + [0.01, 0.02, 0.5], faces), (ball.vertices, ball.faces)]
    one = ccd.CollisionMesh.from_arrays(bodies, static=["ball"], names=["cloth", "ball"])
    start = np.tile(one.vertices, (count, 1, 1))
    end = start.copy()
    end[: count // 2, : len(vertices), 2] -= 1.0
    end[count // 2 :, : len(vertices), 2] += 1.0
    return one, one.replicate(count), start, end
