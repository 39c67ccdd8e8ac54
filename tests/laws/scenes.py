"""Scenes that are drawn by a seed: small ones, with any features that a step can have."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps
from itertools import pairwise
from typing import Any

import numpy as np
from scenes import TETRAHEDRON, sheet, with_static_at_rest

import ccd_warp as ccd
from laws.calls import StepCase
from laws.turning import turned, unit

# Of those without a motion. Half of the scenes are of no family, and have coordinates at random or on a grid.
FAMILIES = ("touching", "slivers", "parallel", "far", "in plane", "close", "dust", "worlds")
_GRID = 16
# Of so many scenes one has several blocks of primitives, and of so many one more vertices than are copied as a whole.
_SCENES_A_LARGE, _SCENES_A_CROWDED, _UNUSED = 10, 40, 5_600


@dataclass(frozen=True)
class Scene(StepCase):
    """A drawn step: what the calls take, and what laws ask besides.

    Attributes:
        family: What its numbers are like: "any", one of `FAMILIES`, "arcs", or "pressed".
        size: A power of two that all lengths are in proportion to.
        make_motion: The motion of the rigid bodies, anew; None but for "arcs".
    """

    family: str = "any"
    size: float = 1.0
    make_motion: Callable[[], ccd.RigidMotion] | None = None

    @property
    def is_euclidean(self) -> bool:
        """Whether the distance is Euclidean, as it is wherever there are radii."""
        return "minimum_separation" not in self.options

    @property
    def distance(self) -> float:
        """The distance at which pairs touch, without their radii, exactly as the options say it."""
        if self.is_euclidean:
            return self.options.get("minimum_distance", 0.0)
        return self.options["minimum_separation"] * self.options["length_scale"]

    @property
    def delta(self) -> float:
        """The tolerance as a length."""
        return self.options["tolerance"] * self.options["length_scale"]

    def without_end(self) -> dict[str, Any]:
        """Options of line searches."""
        return {name: value for name, value in self.options.items() if name != "t_max"}


def drawn(seed: int, family: str | None = None) -> Scene:
    """The scene of a seed, of the family that its number has, or a given one."""
    if family is None:
        family = FAMILIES[seed // 2 % len(FAMILIES)] if seed % 2 else "any"
    return _Drawing(seed, family).scene()


def pressed(seed: int) -> Scene:
    """Flat sheets, or chains, each up to a thousand times as thick as another, apart or stacked, over a ground."""
    drawing = _Drawing(seed, "pressed")
    drawing.rng = np.random.default_rng([seed, *b"pressed"])
    rng, size, dimension = drawing.rng, drawing.size, drawing.dimension
    turn, count = np.linalg.qr(rng.standard_normal((dimension, dimension)))[0], int(rng.integers(3, 5))
    options = {**drawing.options(), "start_gap_fraction": "hold"}
    names: dict[str, Any] = {"static": [0], "self_collision": False}
    thickness = 0.1 * size * 10.0 ** -rng.integers(0, 4, count)
    heights = size * np.arange(count)
    if "minimum_separation" in options:
        thickness *= 0.0
    elif drawing.flip(0.5):  # a rounding within their distances
        apart = options["minimum_distance"] + thickness[:-1] + thickness[1:]
        heights = (1 - 1e-12) * np.append(0.0, np.cumsum(apart))
    else:  # deep within a thick one, which is below the others
        thickness = np.append(0.1 * size, 0.03 * thickness[1:])
        apart = options["minimum_distance"] + thickness[:-1] + thickness[1:]
        heights = np.append(0.0, np.cumsum(apart * np.append(0.05, np.full(count - 2, 3.0))))
    bodies: list[Any] = []
    for height in heights:
        x, *parts = _sheet(rng) if dimension == 3 else (np.linspace([-1, 0], [1, 0], 4), [[0, 1], [1, 2], [2, 3]])
        x = size * (x[:, :-1] + 0.2 * rng.standard_normal(dimension - 1))
        bodies.append((np.column_stack([x, np.full(len(x), height)]) @ turn, *parts))
    names["radius"] = np.repeat(thickness, [len(body[0]) for body in bodies]) if thickness.any() else None
    if drawing.flip(0.3):
        names["static"] = []
        bodies.append(ccd.HalfSpace(-0.5 * size * turn[-1], turn[-1]))
    mesh = ccd.CollisionMesh.from_arrays(bodies, **names).replicate(int(rng.integers(1, 3)))
    return Scene(lambda: (mesh, mesh.vertices, -1.5 * count * size * turn[-1]), options, 1_000, "pressed", size)


def motion_of(mesh, rng, num_worlds=None):
    """Bodies that turn, by next to nothing or by several turns, on screws or about pivots, towards each other."""
    bodies = np.flatnonzero(mesh.rigid)
    size, middle = np.ptp(mesh.vertices, axis=0).max(), mesh.vertices.mean(axis=0)
    centre = np.array([mesh.vertices[mesh.vertex_body == b].mean(axis=0) for b in bodies])
    shape = centre.shape if num_worlds is None else (num_worlds, *centre.shape)
    centre = np.broadcast_to(centre, shape)
    turns = [np.append(0.3 * rng.standard_normal(shape), np.ones((*shape[:-1], 1)), axis=-1) for _ in range(2)]
    place = centre - turned(unit(turns[0]), centre) + 0.05 * size * rng.standard_normal(shape)
    shift = rng.choice([0.5, 1.0, 2.0]) * (middle - centre) + 0.1 * size * rng.standard_normal(shape)
    motion = {"poses_t0": np.concatenate([place, turns[0]], axis=-1), "path": str(rng.choice(["linear", "screw"]))}
    if rng.random() < 0.3:
        end = centre - turned(unit(turns[1]), centre) + shift
        motion["poses_t1"] = np.concatenate([end, turns[1]], axis=-1)
    else:
        omega = rng.choice([1e-9, 0.05, 0.5, 4.0]) * rng.standard_normal(shape)
        motion["twist"] = np.concatenate([shift, omega], axis=-1)
    if motion["path"] == "linear" and rng.random() < 0.7:
        motion["pivot"] = centre
    return motion


# --- bodies of about unit size, in space and in the plane: vertices, faces, edges ---


def _mixed(rng):
    """Two faces, two cables and particles, apart from each other."""
    x = np.repeat(rng.uniform(-0.6, 0.6, (5, 1, 3)), 3, axis=1) + rng.normal(0, 0.3, (5, 3, 3))
    return x.reshape(-1, 3), np.arange(6).reshape(2, 3), np.array([[6, 7], [7, 8], [9, 10], [10, 11]])


def _fan(rng):
    """Faces around a vertex, which has three neighbours or more."""
    count = rng.integers(3, 7)
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    rim = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1) * rng.uniform(0.5, 1, (count, 1))
    k = np.arange(count)
    faces = np.stack([0 * k, 1 + k, 1 + (k + 1) % count], axis=1)[rng.integers(0, 2) :]
    return np.concatenate([[[0, 0, rng.choice([0.0, 0.7])]], rim]), faces, np.zeros((0, 2), int)


def _sheet(rng):
    """A square of eight faces, flat or not."""
    x, faces = sheet(2, 1.6)
    x[:, 2] += rng.choice([0.0, 0.2]) * rng.standard_normal(9)
    return x, faces[rng.permutation(8)[rng.integers(0, 4) :]], np.zeros((0, 2), int)


def _tetrahedron(rng):
    """A closed surface, sometimes with a face twice, a face with a vertex twice, and a cable at a corner."""
    faces, cable = np.concatenate([TETRAHEDRON[1], [[2, 1, 0]], [[3, 3, 1]]]), np.array([[0, 4]])
    return 0.6 * rng.standard_normal((6, 3)), faces[: rng.choice([4, 4, 5, 6])], cable[: rng.integers(0, 2)]


def _cable(rng):
    """A cable, its vertices in a row."""
    k = np.arange(rng.integers(2, 6))
    x = np.cumsum(0.5 * rng.standard_normal((len(k), 3)), axis=0)
    return x - x.mean(axis=0), np.zeros((0, 3), int), np.stack([k[:-1], k[1:]], axis=1)


def _particles(rng):
    """Points alone."""
    return rng.uniform(-0.8, 0.8, (rng.integers(1, 7), 3)), np.zeros((0, 3), int), np.zeros((0, 2), int)


def _in_plane(rng):
    """A chain, a polygon, segments or points."""
    count = int(rng.integers(3, 9))
    k = np.arange(count)
    chain = np.stack([k, (k + 1) % count], axis=1)
    edges = [chain, chain[:-1], rng.permutation(count)[: count // 2 * 2].reshape(-1, 2)[1:], chain[:0]]
    angle = 2 * np.pi * k / count
    x = np.stack([np.cos(angle), np.sin(angle)], axis=1) * rng.uniform(0.3, 1, (count, 1))
    return x, None, edges[rng.integers(0, 4)]


_IN_SPACE = (_mixed, _mixed, _fan, _sheet, _tetrahedron, _tetrahedron, _cable, _particles)


def feature(draw):
    """A part of a scene, drawn by a stream that is spawned by its name, which no other part changes."""

    @wraps(draw)
    def of_own_stream(self, *arguments):
        before, self.rng = self.rng, np.random.default_rng([self.seed, *self.family.encode(), *draw.__name__.encode()])
        drawn = draw(self, *arguments)
        self.rng = before
        return drawn

    return of_own_stream


class _Drawing:
    """What is drawn for one scene, part after part."""

    def __init__(self, seed: int, family: str) -> None:
        self.rng, self.seed, self.family = None, seed, family
        # the oracle of what turns looks at every vertex in every slice
        self.is_large = seed % _SCENES_A_LARGE == 7 and family != "arcs"
        self.is_crowded = self.is_large and seed % _SCENES_A_CROWDED == 7
        self.space()

    def flip(self, share: float) -> bool:
        return bool(self.rng.random() < share)

    @feature
    def space(self) -> None:
        """The dimension, whether coordinates are on a grid, and the size."""
        is_flat = self.family not in ("slivers", "parallel", "arcs") and self.flip(0.25)
        self.dimension = 2 if is_flat else 3
        is_on_grid = self.family in ("any", "in plane", "worlds") and self.flip(0.4)
        self.is_on_grid = self.family == "touching" or is_on_grid
        self.size = float(2.0 ** self.rng.choice([-10, -3, 0, 0, 0, 4, 10]))

    def scene(self) -> Scene:
        bodies = self.bodies()
        if self.is_large:
            bodies.append(self.large())
        shapes = len(bodies)
        self.add_half_spaces(bodies)
        names = {}
        self.add_roles(names, len(bodies), shapes)
        self.add_filters(names, len(bodies), shapes)
        bodies = self.in_any_order(bodies, names, shapes)
        options = self.options()
        bare = ccd.CollisionMesh.from_arrays(bodies, **names)
        if "minimum_separation" not in options and bare.num_vertices != len(bodies):
            self.add_radii(names, bare)
        self.add_worlds(names, bare)
        copies = self.num_copies() if self.family == "worlds" and bare.num_vertices < 30 else 1
        lists = self.listed(bare)

        def make_mesh() -> ccd.CollisionMesh:
            mesh = ccd.CollisionMesh.from_arrays(bodies, **names, exclude_pairs=lists)
            return mesh.replicate(copies) if copies > 1 else mesh

        mesh = make_mesh()
        start, end = self.positions(mesh)
        motion = None
        if self.family == "arcs":
            rows = mesh.rigid[mesh.vertex_body][:, None]
            start, end = (np.where(rows, mesh.vertices, x) for x in (start, end))
            motion = self.motion(mesh)
        capacity = 20_000 if self.is_large else 1_000
        return Scene(lambda: (make_mesh(), start, end), options, capacity, self.family, self.size, motion)

    # --- the mesh ---

    @feature
    def bodies(self) -> list:
        """Two to four bodies around the corners of a cube, so that many start apart."""
        rng, found = self.rng, []
        count = int(rng.integers(2, 5))
        corners = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)][:: 4 // self.dimension + 1])
        corners = rng.permutation(corners if self.dimension == 3 else np.unique(corners[:, :2], axis=0))
        for n in range(count):
            pool = _IN_SPACE if self.family != "dust" else (_cable, _particles, _mixed)
            x, faces, edges = (_in_plane if self.dimension == 2 else pool[rng.integers(len(pool))])(rng)
            turn = np.linalg.qr(rng.standard_normal((self.dimension, self.dimension)))[0]
            x = x if self.flip(0.3) else x @ turn
            if self.family == "slivers":
                axis = rng.standard_normal(3)
                axis /= np.linalg.norm(axis)
                x = x - (1 - 10.0 ** -rng.uniform(2, 12)) * np.outer(x @ axis, axis)
            if self.family == "parallel":
                axis = np.array([1.0, 0.7, 0.2]) / np.linalg.norm([1.0, 0.7, 0.2])
                x = np.outer(x @ axis, axis) + 10.0 ** -rng.uniform(1, 9) * x
            spread = rng.choice([0.3, 0.7])
            x = rng.choice([0.3, 0.3, 0.3, 0.01, 3.0], p=[0.3, 0.3, 0.25, 0.1, 0.05]) * x
            x = x + spread * (corners[n % len(corners)] + 0.2 * rng.standard_normal(self.dimension))
            found.append((self.size * x, edges) if faces is None else (self.size * x, faces, edges))
        return found

    @feature
    def large(self) -> tuple:
        """A sheet of 288 faces, or a chain of edges, above the others; perhaps with thousands of unused vertices."""
        height = self.rng.uniform(0.3, 0.8)
        if self.dimension == 2:
            n = np.arange(300)
            x, parts = np.column_stack([n / 150.0 - 1.0, 0 * n]), (np.stack([n[:-1], n[1:]], axis=1),)
        else:
            x, faces = sheet(12, 2.0)
            parts = faces, np.zeros((0, 2), int)
        x[:, -1] = height + 0.01 * self.rng.standard_normal(len(x))
        if self.is_crowded:
            x = np.concatenate([x, self.rng.uniform(-1, 1, (_UNUSED, self.dimension))])
        return self.size * x, *parts

    @feature
    def add_half_spaces(self, bodies) -> None:
        """Half-spaces below most of the scene, of normals of any length."""
        for _ in range(int(self.rng.integers(1, 3)) if self.flip(0.5) or self.is_crowded else 0):
            normal = self.rng.standard_normal(self.dimension) + 2 * np.eye(self.dimension)[-1]
            point = self.size * (self.rng.uniform(-0.1, 0.4, self.dimension) - 0.5 * normal / np.linalg.norm(normal))
            if self.is_on_grid:
                normal, point = np.round(2 * normal), self.on_grid(point)
                normal[-1] += not normal.any()
            bodies.append(ccd.HalfSpace(point, normal * 10.0 ** self.rng.integers(-3, 4)))

    @feature
    def add_roles(self, names, count, shapes) -> None:
        """Which bodies have codimensional points, are static or kinematic, or turn."""
        names["codimensional_points"] = [self.flip(0.8) for _ in range(count)]
        if self.is_large:
            names["codimensional_points"][shapes - 1] = False
        static = [int(self.rng.integers(shapes))] if self.flip(0.4) else []
        if self.family == "arcs":
            names["rigid"] = [b for b in range(shapes) if b not in static][:2] or [0]
            static = [b for b in static if b not in names["rigid"]]
        names["static"] = static
        if self.flip(0.3) or self.is_crowded:
            taken = {*static, *names.get("rigid", [])}
            moves = [self.flip(0.4) or (self.is_crowded and b >= shapes) for b in range(count)]
            names["kinematic"] = [b for b in range(count) if b not in taken and moves[b]]

    @feature
    def add_filters(self, names, count, shapes) -> None:
        """What may not meet, by bodies and by rings of edges."""
        if self.flip(0.4) or self.is_large:
            names["self_collision"] = [self.flip(0.5) and b < shapes - self.is_large for b in range(count)]
        if self.flip(0.3):
            allowed = self.rng.random((count, count)) < 0.7
            names["body_pairs"] = allowed & allowed.T | np.eye(count, dtype=bool)
        if self.flip(0.2):
            names["exclusion_rings"] = int(self.rng.integers(2, 4))

    @feature
    def in_any_order(self, bodies, names, shapes) -> list:
        """All bodies in another order where half-spaces are among them; indices and flags of ``names`` follow it."""
        if len(bodies) == shapes or self.flip(0.3):
            return bodies
        order = self.rng.permutation(len(bodies))
        number = np.argsort(order)
        for name in names.keys() & {"static", "kinematic", "rigid"}:
            names[name] = sorted(number[names[name]].tolist())
        for name in names.keys() & {"codimensional_points", "self_collision"}:
            names[name] = [names[name][b] for b in order]
        if "body_pairs" in names:
            names["body_pairs"] = names["body_pairs"][np.ix_(order, order)]
        return [bodies[b] for b in order]

    @feature
    def add_radii(self, names, mesh) -> None:
        """Radii of vertices, whose sums are exact."""
        if self.flip(0.5):
            radius = self.rng.random(mesh.num_vertices) * self.rng.integers(0, 2, mesh.num_vertices)
            radius *= self.rng.choice([0.01, 0.1]) * ~np.isin(mesh.vertex_body, mesh.planes.bodies)
            names["radius"] = np.round(radius * 2.0**24) * (2.0**-24 * self.size)

    @feature
    def add_worlds(self, names, mesh) -> None:
        """Which world each body is in."""
        if self.flip(0.2) or self.family == "worlds":
            names["vertex_world"] = self.rng.integers(0, min(4, mesh.num_vertices), mesh.num_bodies)[mesh.vertex_body]

    @feature
    def num_copies(self) -> int:
        return int(self.rng.integers(2, 6))

    @feature
    def listed(self, mesh) -> dict[str, np.ndarray]:
        """Excluded pairs of every kind, mostly none."""
        if not self.flip(0.3):
            return {}
        in_plane, points = self.dimension == 2, mesh.codimensional_points
        vertices, edges, faces = map(np.arange, (mesh.num_vertices, mesh.num_edges, mesh.num_faces))
        indices = {
            "vertices": (vertices, vertices),
            "bodies": (np.arange(mesh.num_bodies),) * 2,
            "vertex_face": (vertices, faces),
            "edge_edge": (edges, edges),
            "vertex_plane": (vertices, np.arange(len(mesh.planes))),
            "point_segment": (vertices, edges) if in_plane else (points, mesh.codimensional_edges),
            "point_point": (points, points),
        }
        found = {}
        for key, (first, second) in indices.items():
            possible = len(first) * len(second)
            if possible and self.flip(0.5):
                most = min({"bodies": 1, "vertices": 0.02 * possible}.get(key, 0.5 * possible), 5_000)
                pairs = self.rng.integers(0, (len(first), len(second)), (1 + int(most * self.rng.random()), 2))
                pairs = np.stack([first[pairs[:, 0]], second[pairs[:, 1]]], axis=1)
                found[key] = pairs if first is not second else pairs[pairs[:, 0] != pairs[:, 1]]
        at_rest = np.flatnonzero(mesh.static[mesh.vertex_body])
        if len(at_rest) and mesh.num_faces and self.flip(0.5):  # one corner alone of faces that are queries
            rows = self.rng.integers(0, mesh.num_faces, 20), self.rng.integers(0, 3, 20)
            pairs = np.stack([self.rng.choice(at_rest, 20), mesh.faces[rows]], axis=1)
            found["vertices"] = np.concatenate([found.get("vertices", pairs[:0]), pairs[pairs[:, 0] != pairs[:, 1]]])
        return found

    # --- positions and options ---

    def on_grid(self, x):
        return np.round(x / self.size * _GRID) * (self.size / _GRID)

    @feature
    def positions(self, mesh) -> tuple[np.ndarray, np.ndarray]:
        """Where all vertices are at both ends: bodies move as a whole and deform, and what is hostile is put in."""
        rng, size = self.rng, self.size
        start = mesh.vertices.copy()
        body, middle = mesh.vertex_body, start.mean(axis=0)
        num = np.maximum(np.bincount(body, minlength=mesh.num_bodies), 1)[:, None]
        towards = -np.stack([np.bincount(body, x, mesh.num_bodies) for x in (start - middle).T], axis=1) / num
        speed = rng.choice([0.05, 0.3, 1.0]) if self.family != "close" else 0.05
        throw = speed * size * rng.standard_normal(towards.shape)
        throw += rng.choice([0.0, 0.7, 0.7, 1.5]) * towards * (self.family != "close")
        end = start + throw[body] + rng.choice([0.0, 0.1, 0.5]) * speed * size * rng.standard_normal(start.shape)
        points = mesh.codimensional_points
        if len(points) > 3 and self.flip(0.4):  # head-on, and onto a place where another rests
            a, b, c, d = points[rng.permutation(len(points))[:4]]
            end[a], end[b], end[c], end[d] = start[b], start[a], start[d], start[d]
        if self.family == "in plane" and self.dimension == 3:
            start[:, 2], end[:, 2] = (
                0.5 * size - 0.5 * x[:, 0] + 0.25 * x[:, 1] for x in map(self.on_grid, (start, end))
            )
            start[:, :2], end[:, :2] = self.on_grid(start)[:, :2], self.on_grid(end)[:, :2]
        if self.is_on_grid and self.family != "in plane":
            start, end = self.on_grid(start), self.on_grid(end)
        if self.family == "touching":
            start, end = self.stacked(mesh, start, end)
        self.corner(mesh, start, end)
        if self.family == "far":
            start, end = (x + size * 1e6 * rng.choice([-1, 0, 1], self.dimension) for x in (start, end))
        if not self.is_on_grid and self.family not in ("in plane", "arcs") and self.flip(0.6):
            self.meet(mesh, start, end)
        return start, with_static_at_rest(mesh, start, end)

    @feature
    def meet(self, mesh, start, end) -> None:
        """Vertices that come onto a face, an edge or a plane at some time, but for rounding, and perhaps beyond."""
        rng, solids = self.rng, mesh.faces if len(mesh.faces) else mesh.edges
        free = rng.permutation(np.flatnonzero(~(mesh.static | mesh.kinematic)[mesh.vertex_body]))
        for n, v in enumerate(free[:6]):
            t = (1.0, 0.5, rng.uniform(0.1, 1.0))[n % 3]
            if n < 4 and len(solids):
                corners = solids[rng.integers(len(solids))]
                target = rng.dirichlet(np.ones(len(corners))) @ ((1 - t) * start[corners] + t * end[corners])
            elif len(mesh.planes):
                k = rng.integers(len(mesh.planes))
                normal, own = mesh.planes.normals[k], mesh.planes.vertices[k]
                point = mesh.planes.points[k] if own < 0 else (1 - t) * start[own] + t * end[own]
                x = (1 - t) * start[v] + t * end[v]
                target = x - (x - point) @ normal / (normal @ normal) * normal
            else:
                continue
            end[v] = start[v] + (target - start[v]) / t

    @feature
    def corner(self, mesh, start, end) -> None:
        """The first two particles begin in one place, on the last of the half-spaces, and move on."""
        planes, pair = mesh.planes, mesh.codimensional_points[:2]
        if len(planes) > 1 and len(pair) == 2 and planes.vertices[-1] < 0 and self.flip(0.8):
            end[pair] += planes.points[-1] - start[pair]
            start[pair] = planes.points[-1]

    @feature
    def stacked(self, mesh, start, end):
        """Each body begins or ends where it just touches the one before, along the last axis, and slides or parts."""
        body = mesh.vertex_body
        for before, after in pairwise(np.unique(body)):
            own, below = body == after, body == before
            rise = start[below, -1].max() - start[own, -1].min()
            start[own, -1] += rise
            end[own] = start[own] + self.on_grid(self.size * self.rng.uniform(-0.3, 0.3, self.dimension))
            way = self.rng.integers(0, 3)  # slides, parts, or comes from above
            drop = self.size / _GRID * self.rng.integers(1, 5)
            if way == 0:
                end[own, -1] = start[own, -1]
                end[below, -1] = start[below, -1]
            elif way == 2:
                end[own, -1] = start[own, -1] + (end[below, -1].max() - start[below, -1].max())
                start[own, -1] += drop
        return start, end

    @feature
    def options(self) -> dict[str, Any]:
        rng = self.rng
        options = {
            "tolerance": float(rng.choice([1e-6, 1e-6, 1e-3])),
            "length_scale": self.size,
            "broad_phase": str(rng.choice(["tree", "hash"])),
            "num_threads": int(rng.integers(1, 4)),
            "t_max": float(rng.choice([1.0, 1.0, 0.625, 0.3])),
            "start_gap_fraction": (None, "hold", "hold", 0.5)[rng.integers(0, 3 if self.family == "arcs" else 4)],
        }
        share = float(rng.choice([0.0, 0.0, 2.0**-7, 2.0**-5])) if self.family != "close" else 2.0**-4
        name = "minimum_distance" if self.flip(0.5) else "minimum_separation"
        options[name] = share if name == "minimum_separation" else share * self.size
        if self.flip(0.1):
            options["pair_kinds"] = ["vertex_face", "edge_edge", "point_segment", "point_point", "vertex_plane"]
            options["pair_kinds"] = [kind for kind in options["pair_kinds"] if self.flip(0.6)] or ["edge_edge"]
        return options

    @feature
    def motion(self, mesh) -> Callable[[], ccd.RigidMotion]:
        """Bodies that turn, by less than a slice or by several, on screws or about pivots."""
        rng, size, bodies = self.rng, self.size, np.flatnonzero(mesh.rigid)
        middle = mesh.vertices.mean(axis=0)
        way = np.array([middle - mesh.vertices[mesh.vertex_body == b].mean(axis=0) for b in bodies])
        turned = np.append(0.3 * rng.standard_normal((len(bodies), 3)), np.ones((len(bodies), 1)), axis=1)
        poses = np.hstack([0.05 * size * rng.standard_normal(way.shape), turned])
        shift = rng.choice([0.3, 1.0]) * way + 0.1 * size * rng.standard_normal(way.shape)
        twist = np.hstack([shift, rng.choice([0.05, 0.5, 4.0]) * rng.standard_normal(way.shape)])
        path = str(rng.choice(["linear", "screw"]))
        pivot = way if path == "linear" and self.flip(0.5) else None
        within = ~mesh.static[bodies] * rng.choice([0.0, 0.0, 1e-3 * size, 0.02 * size], len(bodies))
        return lambda: ccd.RigidMotion(poses, twist=twist, path=path, pivot=pivot, within=within)
