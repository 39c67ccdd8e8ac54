"""The closest point of a patch of any shape, against exact rational arithmetic."""

from functools import cache

import numpy as np
import pytest
import warp as wp
from ccd_warp.kernels.template import specialised
from distance_queries import UNIT_ROUNDOFF
from flint import fmpq
from oracle_corners import integer_rows
from rounding_samples import exactly

DTYPES = {"float64": np.float64, "float32": np.float32}

# Distance lost to rounding, in units of roundoff and of the largest distance of a corner from the origin. An end of an
# edge, a foot on it, and the coordinates of a foot on the patch are each a chain of about ten roundings of numbers of
# that size; of two candidates whose distances are computed so, the farther may be taken.
ROUNDINGS = 10

# Sides below the root of the least normal number have squares without all digits: they count as points.
POINT = {"float64": 2.0**-510, "float32": 2.0**-62}


@cache
def _kernel(precision):
    real = {"float64": wp.float64, "float32": wp.float32}[precision]
    vec3 = wp.types.vector(length=3, dtype=real)
    functions = specialised("pair.closest_point", real=real)
    closest_weights, closest_on_patch = functions.closest_weights, functions.closest_on_patch

    @wp.kernel(module="unique", enable_backward=False)
    def closest_points(
        # in
        corners: wp.array2d[vec3],
        is_triangle: bool,
        # out
        weights: wp.array[vec3],
        vectors: wp.array[vec3],
    ):
        i = wp.tid()
        wb, wc, from_w11 = closest_weights(corners[i, 0], corners[i, 1], corners[i, 2], corners[i, 3], is_triangle)
        weights[i] = vec3(wb, wc, wp.where(from_w11, real(1.0), real(0.0)))
        q, _b, _c, _from_w11 = closest_on_patch(corners[i, 0], corners[i, 1], corners[i, 2], corners[i, 3], is_triangle)
        vectors[i] = q

    return closest_points, vec3


def _launch(corners, is_triangle, precision):
    """Weights of the closest points, whether they are of the fourth corner, and the vectors to them."""
    kernel, vec3 = _kernel(precision)
    out = [wp.zeros(len(corners), dtype=vec3) for _ in range(2)]
    wp.launch(kernel, dim=len(corners), inputs=[wp.array(corners, dtype=vec3), is_triangle], outputs=out)
    return tuple(x.numpy().astype(np.float64) for x in out)


def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _root(square):
    """Root of a fraction whose float may underflow."""
    return float(square * 4**400) ** 0.5 * 2.0**-400


def exact_squares(patches, is_triangle):
    """Squares of the least distances of flat patches from the origin: their edges', or of a foot inside."""
    flat = np.concatenate([patches.reshape(len(patches), 12).astype(np.float64), np.ones((len(patches), 1))], axis=1)
    for row in integer_rows(flat):  # the last entry is the scale of the integers
        a, b, c, d = (row[k : k + 3] for k in (0, 3, 6, 9))
        squares = [(_dot(p, p), 1) for p in (a, b, c, d)]
        for start, end in [(a, b), (b, c), (c, a)] if is_triangle else [(a, b), (b, d), (d, c), (c, a)]:
            side = [y - x for x, y in zip(start, end, strict=True)]
            along, length = -_dot(start, side), _dot(side, side)
            if 0 < along < length:
                squares.append((_dot(start, start) * length - along * along, length))
        q, r = ([y - x for x, y in zip(a, end, strict=True)] for end in (b, c))
        qq, qr, rr, qa, ra = _dot(q, q), _dot(q, r), _dot(r, r), -_dot(q, a), -_dot(r, a)
        area, v, u = qq * rr - qr * qr, qa * rr - ra * qr, ra * qq - qa * qr
        if area and min(u, v) >= 0 and (u + v <= area if is_triangle else max(u, v) <= area):
            squares.append((_dot(a, [q[k - 2] * r[k - 1] - q[k - 1] * r[k - 2] for k in range(3)]) ** 2, area))
        yield min(fmpq(*square) for square in squares) / row[-1] ** 2


def assert_closest(corners, is_triangle, precision):
    """The weights lie in the simplex, and no point of the patch is closer by more than the roundings."""
    unit, found = UNIT_ROUNDOFF[precision], _launch(corners, is_triangle, precision)[0]
    assert (found >= 0).all() and (found[:, :2].sum(axis=1) <= 1 + 2 * unit).all()
    size = np.linalg.norm(corners.astype(np.float64), axis=-1).max(axis=1) + POINT[precision]
    for weights, patch, length, least in zip(found, corners, size, exact_squares(corners, is_triangle), strict=True):
        wb, wc, from_w11 = exactly(weights)
        point = [1 - wb - wc, wb, wc] @ exactly(patch[[3 if from_w11 else 0, 1, 2]])
        square = _dot(point, point)
        if square > least:
            assert _root(square) - _root(least) - POINT[precision] <= ROUNDINGS * length * unit, patch


def _directions(rng, n):
    a = rng.normal(size=(n, 3))
    return a / np.linalg.norm(a, axis=1)[:, None]


def _patches(sides_q, sides_r, is_triangle, rng, dtype):
    """Patches with the given sides, the origin near a point of each or beside it: at distances from 1 down to 1e-9."""
    n = len(sides_q)
    v, u = rng.uniform(-0.3, 1.3, (2, n, 1))
    heights = 10.0 ** rng.uniform(-9, 0, (n, 1)) * rng.choice([0.0, 1.0], (n, 1), p=[0.2, 0.8])
    first = heights * _directions(rng, n) - v * sides_q - u * sides_r
    second, third = first + sides_q, first + sides_r
    fourth = third if is_triangle else second + sides_r
    return np.stack([first, second, third, fourth], axis=1).astype(dtype)


of_both_shapes = pytest.mark.parametrize("is_triangle", [True, False], ids=["triangle", "parallelogram"])
SLIVERS = {
    "float64": [1e-3, 1e-6, 1e-8, 1e-10, 1e-12, 1e-14, 1e-15],
    "float32": [1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7],
}


@of_both_shapes
@pytest.mark.parametrize("lean", [0.0, 0.4, 1.0, 2.5, -1.0])
def test_slivers(lean, is_triangle, precision):
    """The second side is a multiple of the first, but for a small share across: needles, caps and folded shapes."""
    rng = np.random.default_rng(1)
    for aspect in SLIVERS[precision]:
        q = _directions(rng, 40)
        r = lean * q + aspect * _directions(rng, 40)
        for sides in ((q, r), (r, q)):
            assert_closest(_patches(*sides, is_triangle, rng, DTYPES[precision]), is_triangle, precision)


@of_both_shapes
def test_patches_with_area(is_triangle, precision):
    rng = np.random.default_rng(2)
    lengths = 10.0 ** rng.uniform(-6, 0, (2, 300, 1))
    sides = lengths * rng.normal(size=(2, 300, 3))
    assert_closest(_patches(*sides, is_triangle, rng, DTYPES[precision]), is_triangle, precision)


@of_both_shapes
@pytest.mark.parametrize("sides", [(0, 1), (1, 0), (1, 1), (1, 2), (2, 1), (1, -1), (-3, 1), (0, 0)])
def test_sides_without_length_and_sides_in_one_line(sides, is_triangle, precision):
    """Triples in every order, the duplicate at every corner; of parallelograms, no length of either edge or of both."""
    rng = np.random.default_rng(3)
    # coordinates on a grid, so that the points are in one line exactly
    along = rng.integers(-8, 9, (200, 3)) / 8
    first = rng.integers(-32, 33, (200, 1)) / 16 * along + rng.integers(-2, 3, (200, 3)) / 8
    second, third = first + sides[0] * along, first + sides[1] * along
    fourth = third if is_triangle else second + third - first
    corners = np.stack([first, second, third, fourth], axis=1).astype(DTYPES[precision])
    assert_closest(corners, is_triangle, precision)
    # the vector that clips time is the closest point's, too
    _, vectors = _launch(corners, is_triangle, precision)
    least = np.array([_root(square) for square in exact_squares(corners, is_triangle)])
    size = np.linalg.norm(corners.astype(np.float64), axis=-1).max(axis=1)
    slack = ROUNDINGS * UNIT_ROUNDOFF[precision] * size
    assert (np.abs(np.linalg.norm(vectors, axis=1) - least) <= slack).all()


def test_sides_whose_squares_underflow(precision):
    rng = np.random.default_rng(4)
    for exponent in (-60, -70, -76, -80) if precision == "float32" else (-500, -530, -540, -600):
        short = np.ldexp(rng.normal(size=(40, 3)), exponent)
        long = rng.normal(size=(40, 3))
        for sides in ((short, long), (long, short), (short, short[::-1]), (long, long + short)):
            for is_triangle in (True, False):
                assert_closest(_patches(*sides, is_triangle, rng, DTYPES[precision]), is_triangle, precision)
