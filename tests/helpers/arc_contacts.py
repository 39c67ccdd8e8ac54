"""When two primitives touch, as features: each touches where some functions of time vanish and others are not negative.

For the distance zero, a pair has one feature: two primitives touch iff the equations hold. For a distance D > 0, what
is within D of a primitive is a union: of a slab over the interior, cylinders around edges, and balls around vertices.
A condition divides by nothing, so it holds for degenerate primitives as well, if for more than those that touch.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

from arc_paths import Basis, Vector, cross, dot, scaled, short, sub
from flint import arb

Function = Callable[["PairOnInterval"], object]


class PairOnInterval:
    """The points of a pair, as polynomials on an interval of time, and what is computed of them once."""

    def __init__(self, paths, middle: arb, half: arb):
        self._bases = [Basis(path.theta, middle, half) for path in paths]
        self._paths = paths
        self.time = self._bases[0].t
        self._known: dict = {}
        self.half = half

    def once(self, key, compute: Callable[[], object]):
        if key not in self._known:
            self._known[key] = compute()
        return self._known[key]

    def point(self, side: int, k: int) -> Vector:
        return self.once(("points", side), lambda: self._paths[side].points(self._bases[side]))[k]

    def difference(self, first: tuple, second: tuple) -> Vector:
        """The vector from the second point to the first."""
        return self.once((first, second), lambda: sub(self.point(*first), self.point(*second)))

    def product(self, a, b):
        """The dot product of two vectors, each named by its key or by two points."""
        return self.once(("dot", a, b), lambda: short(dot(self.named(a), self.named(b))))

    def named(self, key) -> Vector:
        if key[0] == "cross":
            return self.once(key, lambda: [short(x) for x in cross(self.named(key[1]), self.named(key[2]))])
        return self.difference(*key)


@dataclass(frozen=True)
class Feature:
    """Touches at the times where the first functions are zero and the second ones not negative.

    `may_vanish` names a vector without which the conditions say nothing: an edge of two equal points, or a normal,
    which vanishes for parallel edges. Then they hold, but prove no contact.
    """

    zero: tuple[Function, ...]
    not_negative: tuple[Function, ...]
    may_vanish: tuple | None = None


def _ball(p, q, squared: arb) -> Feature:
    return Feature((), (lambda at: squared - at.product((p, q), (p, q)),))


def _along(p, a, b) -> tuple[Function, ...]:
    """Whether the nearest point of a line is between two of its points."""
    w, e = (p, a), (b, a)
    return (lambda at: at.product(w, e)), (lambda at: at.product(e, e) - at.product(w, e))


def _cylinder(p, a, b, squared: arb) -> Feature:
    area = ("cross", (p, a), (b, a))
    near = lambda at: short(squared * at.product((b, a), (b, a))) - at.product(area, area)  # noqa: E731
    return Feature((), (near, *_along(p, a, b)), (b, a))


def _slab(height: Function, n, inside: tuple[Function, ...], squared: arb | None) -> Feature:
    if squared is None:
        return Feature((height,), inside, n)

    def near(at):
        f = height(at)
        return squared * at.product(n, n) - short(f * f)

    return Feature((), (near, *inside), n)


def _vertex_face(squared: arb | None) -> list[Feature]:
    p, (f0, f1, f2) = (0, 0), [(1, k) for k in range(3)]
    w, e1, e2 = (p, f0), (f1, f0), (f2, f0)
    n = ("cross", e1, e2)
    first = lambda at: at.product(("cross", w, e2), n)  # noqa: E731
    second = lambda at: at.product(("cross", e1, w), n)  # noqa: E731
    inside = first, second, lambda at: at.product(n, n) - first(at) - second(at)
    features = [_slab(lambda at: at.product(n, w), n, inside, squared)]
    if squared is not None:
        features += [_cylinder(p, a, b, squared) for a, b in ((f0, f1), (f1, f2), (f2, f0))]
        features += [_ball(p, f, squared) for f in (f0, f1, f2)]
    return features


def _edge_edge(squared: arb | None) -> list[Feature]:
    a, b = [(0, 0), (0, 1)], [(1, 0), (1, 1)]
    w, ea, eb = (b[0], a[0]), (a[1], a[0]), (b[1], b[0])
    n = ("cross", ea, eb)
    u = lambda at: at.product(("cross", w, eb), n)  # noqa: E731
    v = lambda at: at.product(("cross", w, ea), n)  # noqa: E731
    inside = u, v, lambda at: at.product(n, n) - u(at), lambda at: at.product(n, n) - v(at)
    features = [_slab(lambda at: at.product(n, w), n, inside, squared)]
    if squared is not None:
        features += [_cylinder(p, *b, squared) for p in a] + [_cylinder(q, *a, squared) for q in b]
        features += [_ball(p, q, squared) for p, q in product(a, b)]
    return features


def _point_segment(squared: arb | None) -> list[Feature]:
    p, a, b = (0, 0), (1, 0), (1, 1)
    if squared is not None:
        return [_cylinder(p, a, b, squared), _ball(p, a, squared), _ball(p, b, squared)]
    area = ("cross", (p, a), (b, a))
    return [Feature(tuple((lambda at, k=k: at.named(area)[k]) for k in range(3)), _along(p, a, b), (b, a))]


def _point_point(squared: arb | None) -> list[Feature]:
    p, q = (0, 0), (1, 0)
    if squared is not None:
        return [_ball(p, q, squared)]
    return [Feature(tuple((lambda at, k=k: at.difference(p, q)[k]) for k in range(3)), ())]


FEATURES = {
    "vertex-face": _vertex_face,
    "edge-edge": _edge_edge,
    "point-segment": _point_segment,
    "point-point": _point_point,
}
POINTS = {"vertex-face": (1, 3), "edge-edge": (2, 2), "point-segment": (1, 2), "point-point": (1, 1)}


def is_separated(at: PairOnInterval, paths, kind: str, distance: arb) -> bool:
    """Whether a direction, fixed in the world or in the frame of a body, keeps the primitives apart on the interval."""
    sides = [range(count) for count in POINTS[kind]]
    corners = [at.difference((0, i), (1, j)) for i, j in product(*sides)]
    middles = [[x[0].mid() if x.length() else arb(0) for x in corner] for corner in corners]
    direction, margin = None, distance
    for d in _directions(kind, at, middles):
        length = dot(d, d).sqrt()
        if length > 0:
            values = [dot(d, corner) / length for corner in middles]
            least = min(values, key=float)
            if least > margin:
                direction, margin = scaled(1 / length, d), least.mid()
    if direction is None:
        return False
    for omega in {str(path.omega): path.omega for path in (*paths, None) if path is not None}.values():
        if _keeps_apart(corners, _turning_with(direction, omega, at.half), distance):
            return True
    return _keeps_apart(corners, direction, distance)


def _directions(kind: str, at: PairOnInterval, corners):
    """Directions at the middle of the interval, of both signs."""
    edges = [sub(corners[i], corners[j]) for i, j in ((-1, 0), (-1, 1), (0, 1)) if len(corners) > 1]
    if kind == "edge-edge":
        edges = [sub(corners[2], corners[0]), sub(corners[1], corners[0])]
    candidates = list(corners)
    for edge in edges:
        squared = dot(edge, edge)
        if squared > 0:
            candidates += [sub(c, scaled(dot(c, edge) / squared, edge)) for c in corners]
    if len(edges) > 1:
        candidates.append(cross(edges[0], edges[1]))
    for d in candidates:
        yield d
        yield scaled(-1, d)


def _turning_with(direction: Vector, omega: Vector, half: arb) -> Vector:
    """A direction that turns with a body, as polynomials; it is as given in the middle of the interval."""
    basis = Basis(dot(omega, omega).sqrt(), arb(0), half)
    q = cross(omega, direction)
    return [d + x * basis.sigma1 + y * basis.sigma2 for d, x, y in zip(direction, q, cross(omega, q), strict=True)]


def _keeps_apart(corners, direction: Vector, distance: arb) -> bool:
    for corner in corners:
        value = dot(corner, direction)
        rest = value.right_shift(1)(arb(0, 1)) if value.length() > 1 else arb(0)
        if not value[0] - rest.abs_upper() > distance:
            return False
    return True
