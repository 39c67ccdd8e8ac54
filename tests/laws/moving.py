"""When the pairs of a scene whose bodies turn or deform first touch: all that may meet, in interval arithmetic."""

import sys
from functools import cached_property

import numpy as np
from flint import arb, arb_poly
from kept import kept

import ccd_warp as ccd
from laws import trajectories, turning
from laws.trajectories import UNIT, first_contact, precise, straight
from laws.truth import NAMES, PLANE, Pairs

_SLICES = 16


class Moves:
    """A step, as trajectories of primitives.

    Args:
        mesh, start, end: As calls take them; in the plane, z is 0.
        motion: What `RigidMotion` takes, by name.
        shares: How much of its motion each body makes; all by default.
    """

    def __init__(self, mesh: ccd.CollisionMesh, start, end, motion: dict | None = None, shares=None) -> None:
        self.mesh, self.motion, self.pairs = mesh, motion, Pairs(mesh)
        rows = (mesh.vertices, start, end, mesh.planes.points, mesh.planes.normals)
        self.local, self.start, self.end, *self.planes = (np.pad(x, ((0, 0), (0, 3 - mesh.dimension))) for x in rows)
        self.shares = np.ones(mesh.num_bodies) if shares is None else shares
        self.row = np.cumsum(mesh.rigid) - 1 if motion is not None else None

    def primitive(self, vertices) -> trajectories.Trajectory:
        """Vertices of one body."""
        body = self.mesh.vertex_body[vertices[0]]
        if self.motion is None or not self.mesh.rigid[body]:
            return straight(self.start[vertices], self.end[vertices])
        row, names = self.row[body], {"path": self.motion["path"]}
        rows = {
            name: self.motion.get(key) for name, key in (("end", "poses_t1"), ("twist", "twist"), ("pivot", "pivot"))
        }
        names |= {name: x[row] for name, x in rows.items() if x is not None}
        whole = turning.turning(self.local[vertices], self.motion["poses_t0"][row], **names)
        return lambda t: whole(t * arb(float(self.shares[body])))

    def plane(self, k: int) -> trajectories.Trajectory:
        """A point and the normal of a half-space."""
        own, (points, normals) = self.mesh.planes.vertices[k], self.planes
        ends = [points[k] if own < 0 else x[own] for x in (self.start, self.end)]
        return straight(*([point, normals[k]] for point in ends))

    @cached_property
    @precise
    def boxes(self) -> np.ndarray:
        """Corners of boxes around all vertices in slices of the step, shape [2, slices, V, 3]."""
        found = np.zeros((2, _SLICES, self.mesh.num_vertices, 3))
        for begin, stop in zip(self.mesh.body_vertex_range, self.mesh.body_vertex_range[1:], strict=False):
            if begin < stop:
                points = self.primitive(np.arange(begin, stop))
                for k in range(_SLICES):
                    places = points(arb_poly([arb(2 * k + 1) / (2 * _SLICES), arb(1) / (2 * _SLICES)]))
                    places = [[arb_poly(x)(UNIT) for x in place] for place in places]
                    found[0, k, begin:stop] = [[float(x.lower()) for x in place] for place in places]
                    found[1, k, begin:stop] = [[float(x.upper()) for x in place] for place in places]
        return found

    @property
    def size(self) -> float:
        """Of what is rounded."""
        return max(np.abs(x).max() for x in (self.boxes, self.local))

    def near(self, kind: int, distance: float) -> np.ndarray:
        """The pairs of a kind that may come within a distance beside their radii."""
        pairs = self.pairs.with_planes if kind == PLANE else self.pairs.of_kinds[kind]
        if kind == PLANE or not len(pairs):
            return pairs
        reach = distance + self.pairs.radii(kind, pairs) + 1e-9 * self.size
        sides = np.split(self.pairs.corners(kind, pairs), [2 if kind == 1 else 1], axis=1)
        (a, b), (c, d) = ((self.boxes[0][:, x].min(axis=2), self.boxes[1][:, x].max(axis=2)) for x in sides)
        return pairs[np.maximum(a - d, c - b).max(axis=2).min(axis=0) <= reach]

    def first_times(self, distance: float, factor: float = 1.0, pairs: list | None = None) -> dict:
        """lo and hi of pairs, or all, within a factor of a distance and their radii: (kind, first, second) to both."""
        found = {}
        for kind in range(5):
            chosen = self.near(kind, distance) if pairs is None else [pair for k, *pair in pairs if k == kind]
            chosen = np.reshape(np.array(chosen, dtype=int), (-1, 2))
            corners, distances = self.pairs.corners(kind, chosen), distance + self.pairs.radii(kind, chosen)
            given = [self.local, self.start, self.end, self.mesh.vertex_body, self.mesh.rigid, self.shares]
            given += [*self.planes, self.mesh.planes.vertices]
            rows = _times(self, kind, chosen, factor * distances, question=[given, self.motion or {}, chosen, corners])
            found |= dict(zip([(kind, *pair) for pair in chosen.tolist()], rows, strict=True))
        return found

    def exact_time(self, kind: int, pair, distance: float) -> trajectories.Answer:
        """When a pair first comes within a distance."""
        if kind == PLANE:
            return first_contact("vertex-plane", self.primitive([pair[0]]), self.plane(pair[1]), distance)
        corners, split = self.pairs.corners(kind, np.array(pair))[0], 2 if kind == 1 else 1
        first, second = self.primitive(corners[:split]), self.primitive(corners[split:])
        if self.mesh.dimension == 2 and kind == 2 and distance == 0:  # as an edge across the plane, which says the same
            return first_contact("edge-edge", lambda t: [[*first(t)[0][:2], arb(z)] for z in (-1, 1)], second)
        return first_contact(NAMES[kind], first, second, distance)


def _solve(moves: Moves, kind: int, pairs, distances, question) -> list[tuple[float, float]]:
    found = [moves.exact_time(kind, pair, distance) for pair, distance in zip(pairs, distances.tolist(), strict=True)]
    return [(turning.rounded_down(x.lo), turning.rounded_down(x.hi)) for x in found]


_times = kept(
    _solve,
    trajectories,
    turning,
    sys.modules[__name__],
    question_of=lambda _, *arguments, question: [arguments, question],
)
