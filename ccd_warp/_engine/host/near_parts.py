"""Which parts of bodies may touch in slices of a motion of joints, by spheres and boxes, before a vertex is placed.

The faces of a body are halved until a part has a dozen of them; a part has a sphere in the frame of its link, which
goes with it, or stands in a box. Two parts cannot touch in a slice if in the middle of it they are farther apart than
their points can come nearer in half of it (`_joint_sweeps`). Bodies are tested as wholes, then in groups of parts, then
part by part, each only where the test before says that they may touch.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ccd_warp._joint_courses import EPS, rotated

if TYPE_CHECKING:
    from ccd_warp._mesh import CollisionMesh

# Primitives of a part at most, and parts of a group on the levels between bodies and parts.
PART, GROUPS = 12, (32, 4)
_UP = 1.0 + 64.0 * EPS
_ERROR = 64.0 * EPS  # of places and distances, relative to the coordinates of both
_UNDERFLOW = 1e-150  # of lengths, whose squares vanish below 1e-162 and are rounded coarsely up to 1e-154
# Slices whose links are placed at once, and tests of pairs of bodies: so few that arrays stay in the cache.
_MOST_SLICES, _MOST_AT_ONCE = 1 << 12, 1 << 15


class Parts(NamedTuple):
    """Parts of all bodies on one level, those of a body one after another.

    Attributes:
        body: The body of each, shape [P].
        centre: Centre of a sphere around it, in the frame of its body, shape [P, 3].
        arm: Length of that, shape [P].
        radius: Radius of the sphere, with that of the vertices, shape [P].
        half: Half the sides of the box around the same centre, of bodies that are no links; 0 of links, shape [P, 3].
        rest: What is around the box, the radius of the vertices, or around the centre, shape [P].
        first: The first of its parts on the next level, shape [P + 1]; of the last level the first of its primitives.
    """

    body: NDArray[np.intp]
    centre: NDArray[np.float64]
    arm: NDArray[np.float64]
    radius: NDArray[np.float64]
    half: NDArray[np.float64]
    rest: NDArray[np.float64]
    first: NDArray[np.intp]


def spans(each: NDArray[np.intp], t_max: float) -> tuple[NDArray[np.intp], NDArray[np.float64], NDArray[np.float64]]:
    """So many slices of [0, t_max] for each world: the world, the begin and the end of each slice."""
    world = np.repeat(np.arange(len(each)), each)
    number = np.arange(len(world)) - np.repeat(np.cumsum(each) - each, each)
    begin, end = (t_max * (number + k) / each[world] for k in (0, 1))
    return world, begin, np.where(number + 1 == each[world], t_max, end)


def ranges(first: NDArray[np.intp], counts: NDArray[np.intp]) -> NDArray[np.intp]:
    """The numbers from each first one on, so many of each."""
    return np.repeat(first - np.cumsum(counts) + counts, counts) + np.arange(counts.sum())


class NearParts:
    """The parts of the bodies of a mesh of one world, and which of them may touch.

    Attributes:
        levels: Bodies, groups of parts, and parts.
        mesh: The mesh.
        primitives: Vertices of all primitives in the order of the parts, one of fewer than three repeated, [n, 3].
        kind: 0 of a face, 1 of a codimensional edge, 2 of a codimensional point, shape [n].
        number: The number of each among those of its kind, shape [n].
        link_of: The row of a motion that a rigid body is, shape [B].
        pairs: Pairs of bodies that may collide, of which one moves, shape [m, 2]; the first is a link.
    """

    def __init__(self, mesh: CollisionMesh, vertices: NDArray[np.float64]) -> None:
        """Divide the bodies of a mesh whose vertices, of links in their own frames, are at these places."""
        self.mesh = mesh
        self.primitives, order, begins, counts = _halved(mesh, vertices)
        bounds = np.cumsum([0, mesh.num_faces, len(mesh.codimensional_edges)])
        self.kind = np.searchsorted(bounds, order, side="right") - 1
        self.number = order - bounds[self.kind]
        self.levels = _levels(mesh, vertices, self.primitives, begins, counts)
        self.link_of = np.cumsum(mesh.rigid) - 1
        self.pairs = _pairs(mesh)

    def num_bodies(self, group: NDArray[np.intp], part: NDArray[np.intp], count: int) -> NDArray[np.intp]:
        """Of how many bodies the parts of each of so many groups are."""
        keys = np.unique(group * self.mesh.num_bodies + self.levels[-1].body[part])
        return np.bincount(keys // self.mesh.num_bodies, minlength=count)

    def near(
        self,
        motion: Any,
        world: NDArray[np.intp],
        begin: NDArray[np.float64],
        end: NDArray[np.float64],
        reach: float,
    ) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
        """Pairs of parts that may come within a distance in slices of the step.

        Args:
            motion: The ``JointMotion``, whose rows are the rigid bodies.
            world: World of each slice, shape [n].
            begin: Its begin.
            end: Its end.
            reach: The distance, Euclidean, besides the radii of the vertices.

        Returns:
            The slice and both parts of each pair.

        Guarantee: two primitives of different parts of bodies that may collide, which come within the distance at some
        time of a slice, on the trajectories of the motion in the mathematics of real numbers, are in such a pair.
        """
        if len(world) == 0 or len(self.pairs) == 0:
            return (np.zeros(0, np.intp),) * 3
        found = []
        each = max(1, _MOST_AT_ONCE // len(self.pairs))
        for first in range(0, len(world), _MOST_SLICES):
            some = slice(first, first + _MOST_SLICES)
            slices = _Slices(self, motion._of_worlds(world[some]), begin[some], end[some], reach)
            count = len(world[some])
            with np.errstate(all="ignore"):  # what is no number is near
                parts = [slices.near(np.arange(k, min(k + each, count))) for k in range(0, count, each)]
            found += [(row + first, a, b) for row, a, b in parts]
        row, a, b = (np.concatenate(x) for x in zip(*found, strict=True))
        return row, a, b


class _Slices:
    """Slices of the step: where links are in the middle of each, and how far they go."""

    def __init__(self, parts: NearParts, motion: Any, begin: Any, end: Any, reach: float) -> None:
        self._parts, self._reach = parts, reach
        self._sweeps = motion._sweeps(begin, end)
        moves = parts.mesh.rigid[parts.pairs[:, 1]]
        self._relative = np.full(len(parts.pairs), -1)
        self._relative[moves] = np.arange(int(moves.sum()))
        links = [(int(parts.link_of[a]), int(parts.link_of[b])) for a, b in parts.pairs[moves].tolist()]
        self._against = motion._relative_sweeps(links, begin, end)

    def near(self, rows: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
        """The pairs of parts in some slices."""
        parts = self._parts
        row, pair = np.repeat(rows, len(parts.pairs)), np.tile(np.arange(len(parts.pairs)), len(rows))
        a, b = parts.pairs[pair].T
        for k, level in enumerate(parts.levels):
            if k:
                row, pair, a, b = _children(parts.levels[k - 1], row, pair, a, b)
            may = self._may_touch(level, row, pair, a, b)
            row, pair, a, b = (x[may] for x in (row, pair, a, b))
        return row, a, b

    def _may_touch(self, level: Parts, row: Any, pair: Any, a: Any, b: Any) -> NDArray[np.bool_]:
        """Whether pairs of parts may come within the distance."""
        of_a = self._placed(level, row, a)
        relative = self._relative[pair]
        moves = np.flatnonzero(relative >= 0)
        of_b = level.centre[b].T.copy()
        of_b[:, moves] = self._placed(level, row[moves], b[moves])
        apart = np.abs(of_a - of_b)
        size = np.abs(of_a).max(axis=0) + np.abs(of_b).max(axis=0)
        gap = np.maximum(apart - level.half[b].T, 0.0)
        distance = np.sqrt((gap * gap).sum(axis=0))
        link = self._parts.link_of[level.body[a]]
        goes = self._sweeps.moved[link, row] + self._sweeps.turned[link, row] * level.arm[a]
        number, moved = relative[moves], row[moves]
        length, first, second = self._against
        goes[moves] = length[number, moved] + first[number, moved] * level.arm[a[moves]]
        goes[moves] += second[number, moved] * level.arm[b[moves]]
        most = (goes + level.radius[a] + level.rest[b] + self._reach) * _UP + _ERROR * size + _UNDERFLOW
        may: NDArray[np.bool_] = ~(distance > most)  # also where a number is none
        return may

    def _placed(self, level: Parts, row: Any, part: Any) -> NDArray[np.float64]:
        """Centres of parts in the world, in the middle of slices, shape [3, n]."""
        if len(row) == 0:
            return np.zeros((3, 0))
        first, items = int(row.min()), int(part.max()) + 1
        num_rows = int(row.max()) + 1 - first
        if num_rows * items < len(row):  # each is in several pairs: all of them once
            everything = np.arange(num_rows * items)
            placed = self._placed(level, everything // items + first, everything % items)
            return placed[:, (row - first) * items + part]
        link = self._parts.link_of[level.body[part]]
        rotation, position = self._sweeps.rotation[link, :, row].T, self._sweeps.position[link, :, row].T
        return position + rotated(rotation, level.centre[part].T)


def _children(level: Parts, row: Any, pair: Any, a: Any, b: Any) -> tuple[NDArray[np.intp], ...]:
    """All pairs of the parts of pairs on the next level."""
    of_a, of_b = (level.first[x + 1] - level.first[x] for x in (a, b))
    counts = of_a * of_b
    which = np.repeat(np.arange(len(a)), counts)
    number = np.arange(len(which)) - np.repeat(np.cumsum(counts) - counts, counts)
    first_a, first_b = level.first[a][which], level.first[b][which]
    return row[which], pair[which], first_a + number // of_b[which], first_b + number % of_b[which]


def _pairs(mesh: CollisionMesh) -> NDArray[np.intp]:
    """Pairs of bodies with vertices that may collide, of which the first is a link; some links stand where they are."""
    filled = np.zeros(mesh.num_bodies, dtype=bool)
    filled[mesh.vertex_body] = True
    may = np.triu(np.ones((mesh.num_bodies, mesh.num_bodies), dtype=bool), 1)
    if mesh.body_pairs is not None:
        may &= mesh.body_pairs
    may &= filled & filled[:, None] & ~(mesh.static & mesh.static[:, None])
    pairs = np.argwhere(may)
    swapped = ~mesh.rigid[pairs[:, 0]]
    pairs[swapped] = pairs[swapped][:, ::-1]
    return pairs


def _halved(mesh: CollisionMesh, vertices: NDArray[np.float64]) -> tuple[Any, Any, Any, Any]:
    """Primitives in the order of parts, this order, where each part begins, and the number of parts of each body."""
    lone, points = mesh.edges[mesh.codimensional_edges], mesh.codimensional_points
    corners = np.concatenate([mesh.faces, lone[:, [0, 1, 1]], np.repeat(points[:, None], 3, axis=1)]).astype(np.int32)
    body = mesh.vertex_body[corners[:, 0]]
    middle = vertices[corners].mean(axis=1)
    parts: list[NDArray[np.intp]] = []
    counts = np.zeros(mesh.num_bodies, dtype=np.intp)
    for each in np.unique(body).tolist():
        own = [np.flatnonzero(body == each)]
        while max(map(len, own)) > PART:
            own = [half for rows in own for half in _halves(rows, middle)]
        parts += own
        counts[each] = len(own)
    begins = np.cumsum([0, *map(len, parts)]).astype(np.intp)
    order = np.concatenate([*parts, np.zeros(0, np.intp)])
    return corners[order], order, begins, counts


def _halves(rows: NDArray[np.intp], middle: NDArray[np.float64]) -> list[NDArray[np.intp]]:
    """Both halves of primitives along the axis on which they extend most."""
    places = middle[rows]
    half = len(rows) // 2
    sides = np.argpartition(places[:, int(np.ptp(places, axis=0).argmax())], half)
    return [rows[sides[:half]], rows[sides[half:]]]


def _levels(
    mesh: CollisionMesh,
    vertices: NDArray[np.float64],
    primitives: NDArray[np.int32],
    begins: NDArray[np.intp],
    counts: NDArray[np.intp],
) -> list[Parts]:
    """Bodies, groups of parts, and parts, each with its sphere."""
    bodies = np.arange(mesh.num_bodies)
    parts = np.append(0, np.cumsum(counts))  # the first of each body
    # of each level: the body of each item, and at which part it begins
    items = [(bodies, parts)]
    for size in GROUPS:
        of_bodies = [np.arange(first, last, size) for first, last in pairwise(parts.tolist())]
        items.append((np.repeat(bodies, [len(x) for x in of_bodies]), np.concatenate([*of_bodies, parts[-1:]])))
    items.append((np.repeat(bodies, counts), np.arange(parts[-1] + 1)))
    levels = []
    for (body, here), (_, below) in pairwise([*items, items[-1]]):
        first = np.searchsorted(below, here)
        levels.append(_with_spheres(mesh, vertices, primitives, body, begins[here], first))
    return [*levels[:-1], levels[-1]._replace(first=begins)]


def _with_spheres(
    mesh: CollisionMesh,
    vertices: NDArray[np.float64],
    primitives: NDArray[np.int32],
    body: NDArray[np.intp],
    begins: NDArray[np.intp],
    first: NDArray[np.intp],
) -> Parts:
    """Parts of the primitives between the rows where they begin; of those without any the spheres mean nothing."""
    corners = np.append(primitives.ravel(), 0)  # the last one stands for a part beyond the last
    places = vertices[corners]
    lower, upper = (_reduced(f, places, begins) for f in (np.minimum, np.maximum))
    centre = 0.5 * lower + 0.5 * upper
    part = np.append(np.repeat(np.arange(len(body)), 3 * np.diff(begins)), 0)
    radius = _reduced(np.maximum, np.linalg.norm(places - centre[part], axis=1), begins) * _UP
    thick = np.zeros(len(body)) if mesh.radius is None else _reduced(np.maximum, mesh.radius[corners], begins)
    stands = ~mesh.rigid[body]
    half = np.where(stands[:, None], np.maximum(upper - centre, centre - lower) * _UP, 0.0)
    rest = np.where(stands, thick, radius + thick)
    return Parts(body, centre, np.linalg.norm(centre, axis=1) * _UP, radius + thick, half, rest, first)


def _reduced(function: np.ufunc, values: NDArray[np.float64], begins: NDArray[np.intp]) -> NDArray[np.float64]:
    """A function of the values of all corners of each part."""
    return function.reduceat(values, 3 * begins)[:-1]
