"""Polygons as triangles that cover their area: fans where a fan does, otherwise the ears of an exact ear clipping."""

import numpy as np

from ccd_warp._scene.input.messages import InputError

_BLOCK = 1 << 16  # polygons at a time
_MOST_STARTS = 16  # corners about which a fan is tried
# Heights and areas by this share of a length are those of roundings: more than single precision makes.
_THIN = 1e-6
_ROUNDING = 1e-14  # of a cross product of vectors of at most 1 on each axis, several times
_TINY = 1e-300  # far above what an underflow loses
_BITS = 1074  # times 2 to this power, every float64 is an integer


def fan(corners: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Triangles (0, k, k + 1) of every polygon, in the order of the polygons.

    Args:
        corners: Vertices of all polygons, one polygon after another.
        counts: Number of corners of each, at least 3.
    """
    if (counts == 3).all():
        return corners.reshape(-1, 3)
    triangles = counts - 2
    first = np.repeat(np.cumsum(counts) - counts, triangles)
    k = np.arange(len(first)) - np.repeat(np.cumsum(triangles) - triangles, triangles)
    return corners[np.stack([first, first + k + 1, first + k + 2], axis=1)]


def triangulated(vertices: np.ndarray, fans: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """The triangles of polygons that are given by their fans, as many of each.

    A convex polygon keeps its fan; so does whatever its fan covers once, unless a triangle of it has no height, so that
    a corner would lie on the side of another. Corners may lie on a straight line, stand twice, and bridge holes.

    Args:
        vertices: Positions, shape [n, 3].
        fans: The fans of all polygons, as :func:`fan` makes them, shape [m, 3].
        counts: Number of corners of each polygon.

    Raises:
        InputError: If one is no simple polygon.
    """
    faces, first = fans.copy(), np.cumsum(counts - 2) - (counts - 2)
    for count in np.unique(counts[counts > 3]).tolist():
        alike = np.flatnonzero(counts == count)
        for numbers in (alike[begin : begin + _BLOCK] for begin in range(0, len(alike), _BLOCK)):
            rows = first[numbers, None] + np.arange(count - 2)
            corners = np.concatenate([fans[rows[:, 0], :2], fans[rows, 2]], axis=1)
            points, left = vertices[corners], np.arange(len(corners))
            for start in range(min(count, _MOST_STARTS)):
                order = np.roll(np.arange(count), -start)
                is_covered = _is_covered(points[left][:, order])
                about = np.stack([np.broadcast_to(order[0], count - 2), order[1:-1], order[2:]], axis=1)
                done, left = left[is_covered], left[~is_covered]
                faces[rows[done]] = corners[done][:, about]
                if not len(left):
                    break
            for k in left.tolist():
                faces[rows[k]] = corners[k][_divided(points[k], int(numbers[k]))]
    return faces


def _is_covered(points: np.ndarray) -> np.ndarray:
    """Which polygons, shape [m, corners, 3], the fan about their first corner covers once, by triangles with a height.

    Areas are those seen along the normal of the polygon, the sum of those of its triangles.
    """
    with np.errstate(all="ignore"):  # what overflows is not covered
        arms = points[:, 1:] - points[:, :1]
        arms /= np.abs(arms).max(axis=(1, 2), keepdims=True)
        normals = np.cross(arms[:, :-1], arms[:, 1:])
        normal = normals.sum(axis=1, keepdims=True)
        area = np.linalg.norm(normal, axis=2)
        normal /= area[:, None]
        squares = (arms**2).sum(axis=2)
        longest = np.maximum(squares[:, :-1], squares[:, 1:])
        longest = np.maximum(longest, ((arms[:, 1:] - arms[:, :-1]) ** 2).sum(axis=2))
        least = np.maximum(_THIN * np.minimum(longest, area), _ROUNDING)
        is_covered: np.ndarray = ((normals * normal).sum(axis=2) > least).all(axis=1)
        if points.shape[1] > 4:  # whose arms may go around more than once
            side = (np.cross(arms[:, :1], arms[:, 1:]) * normal).sum(axis=2)
            is_covered &= ~((side > 0.0) & np.logical_or.accumulate(side < 0.0, axis=1)).any(axis=1)
    return is_covered


def _divided(points: np.ndarray, number: int) -> np.ndarray:
    """The triangles of one polygon, shape [corners - 2, 3]; ``number`` is that of messages."""
    with np.errstate(all="ignore"):
        arms = points[1:] - points[0]
        arms /= np.abs(arms).max()
        normals = np.cross(arms[:-1], arms[1:])
    axis = int(np.argmax(np.abs(normals.sum(axis=0))))
    try:
        return _ears(np.delete(points, axis, axis=1))
    except InputError as error:
        # Two triangles of four corners that lie in no plane share an edge alone; and those of a line cover it.
        is_skew = len(points) == 4 and abs(arms[0] @ normals[1]) > _THIN
        if is_skew or not np.abs(normals).max() > _THIN:
            ends = np.arange(1, len(points) - 1)
            return np.stack([0 * ends, ends, ends + 1], axis=1)
        raise InputError(
            f"face {number}, counted from 0, of {len(points)} corners, is no simple polygon: seen along "
            f"{'xyz'[axis]}, {error}; divide it into triangles in the program that wrote it"
        ) from None


def _ears(points: np.ndarray) -> np.ndarray:
    """Ears of a polygon in the plane, the roundest first, and what is left; by exact signs.

    Corners on the line between their neighbours are no ears, so that all triangles have an area but those of corners
    that stand twice: Meisters, Polygons have ears, 1975.
    """
    x, y = zip(*(map(_exact, point) for point in points.tolist()), strict=True)
    doubled = sum(x[k - 1] * y[k] - x[k] * y[k - 1] for k in range(len(x)))
    if not doubled:
        raise InputError("it has no area")
    if doubled < 0:
        points = points[:, ::-1]
    _check_edges(points)
    left, ears = np.arange(len(points)), []
    while len(left) > 3:
        before, tip, behind = (points[np.roll(left, shift)] for shift in (1, 0, -1))
        same = (before == tip).all(axis=1) | (tip == behind).all(axis=1) | (before == behind).all(axis=1)
        if same.any():
            k = int(np.argmax(same))
        else:
            with np.errstate(all="ignore"):
                u, v, w = tip - before, behind - before, behind - tip
                longest = np.maximum((u**2).sum(axis=1), np.maximum((v**2).sum(axis=1), (w**2).sum(axis=1)))
                height = (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]) / longest
            order = np.argsort(-np.nan_to_num(height), kind="stable").tolist()
            k = next((k for k in order if _is_ear(points[left], k)), -1)
            if k < 0:
                raise InputError("it has no triangle that can be cut off")
        ears.append(left[[k - 1, k, (k + 1) % len(left)]])
        left = np.delete(left, k)
    a, b, c = points[left]
    if not (_side(a, b, c) > 0 or (a == b).all() or (b == c).all() or (c == a).all()):
        raise InputError("what is left of it has no area")
    return np.array([*ears, left])


def _is_ear(points: np.ndarray, k: int) -> bool:
    """Whether the triangle at a corner of a counter-clockwise polygon is an ear: nothing of the polygon is in it."""
    a, b, c = (points[(k + shift) % len(points)] for shift in (-1, 0, 1))
    if not _side(a, b, c) > 0:
        return False
    near = ((points >= np.minimum(np.minimum(a, b), c)) & (points <= np.maximum(np.maximum(a, b), c))).all(axis=1)
    others = points[near]
    is_corner = [(others == corner).all(axis=1) for corner in (a, b, c)]
    others = others[~np.any(is_corner, axis=0)]
    if ((_side(a, b, others) >= 0) & (_side(b, c, others) >= 0) & (_side(c, a, others) >= 0)).any():
        return False
    # An edge from where the tip is, which goes through the triangle.
    same = np.flatnonzero((points == b).all(axis=1))
    ends = points[np.concatenate([same - 1, same + 1]) % len(points)]
    return not ((_side(a, b, ends) > 0) & (_side(b, c, ends) > 0)).any()


def _check_edges(points: np.ndarray) -> None:
    """Refuse two edges that cross, not only touch."""
    begin, end = points, np.roll(points, -1, axis=0)
    low, high = np.minimum(begin, end), np.maximum(begin, end)
    for k in range(len(points)):
        others = k + 1 + np.flatnonzero(((low[k] <= high[k + 1 :]) & (low[k + 1 :] <= high[k])).all(axis=1))
        p, q, r, s = begin[k], end[k], begin[others], end[others]
        crosses = (_side(p, q, r) * _side(p, q, s) < 0) & (_side(r, s, p) * _side(r, s, q) < 0)
        if crosses.any():
            raise InputError(f"its edges {k} and {others[np.argmax(crosses)]} cross")


def _side(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Exactly 1, 0 or -1: whether c is to the left of the line from a to b, on it or to the right.

    References: Shewchuk, Adaptive precision floating-point arithmetic, 1997: the error is below (3 + 16 ε) ε |…|.
    """
    a, b, c = np.broadcast_arrays(a, b, c)
    with np.errstate(all="ignore"):
        u, v = b - a, c - a
        left, right = u[..., 0] * v[..., 1], u[..., 1] * v[..., 0]
        area = left - right
        is_certain = np.abs(area) > 1e-15 * (np.abs(left) + np.abs(right)) + _TINY
    sides = np.where(is_certain, np.sign(area), 0.0)
    is_same = (a == b).all(axis=-1) | (b == c).all(axis=-1) | (a == c).all(axis=-1)
    for at in map(tuple, np.argwhere(~is_certain & ~is_same).tolist()):
        (ax, ay), (bx, by), (cx, cy) = (map(_exact, point[at].tolist()) for point in (a, b, c))
        exact = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        sides[at] = (exact > 0) - (exact < 0)
    return sides


def _exact(number: float) -> int:
    numerator, denominator = number.as_integer_ratio()
    return numerator * ((1 << _BITS) // denominator)
