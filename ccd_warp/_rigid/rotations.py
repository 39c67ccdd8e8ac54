"""Rotations as quaternions x y z w and as rotation vectors, in NumPy, one a row, to a few units in the last place."""

import numpy as np
from numpy.typing import NDArray

EPS = 2.0**-52
_SPLITTER = 2.0**27 + 1.0
_NEXT, _LAST = [1, 2, 0], [2, 0, 1]


def scaled(quaternions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Quaternions times powers of two, exactly: the largest component is in [1/2, 1), so that no square overflows."""
    largest = np.abs(quaternions).max(axis=1, keepdims=True, initial=0.0)
    return np.ldexp(quaternions, -np.frexp(largest)[1])


def normalized(quaternions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit quaternions of the same rotations, to 2 eps; for :func:`scaled` ones of any length but 0."""
    return quaternions / np.sqrt((quaternions * quaternions).sum(axis=1, keepdims=True))


def norms(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Lengths of vectors, shape [n], to 2 eps: no square vanishes, however short a vector is."""
    return np.hypot(np.hypot(vectors[:, 0], vectors[:, 1]), vectors[:, 2])


def cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Vector products, shape [n, 3]; for few rows in a quarter of NumPy's time."""
    return a[:, _NEXT] * b[:, _LAST] - a[:, _LAST] * b[:, _NEXT]


def products(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Quaternions of the rotations b followed by a."""
    vectors = a[:, 3:] * b[:, :3] + b[:, 3:] * a[:, :3] + cross(a[:, :3], b[:, :3])
    return np.hstack([vectors, a[:, 3:] * b[:, 3:] - (a[:, :3] * b[:, :3]).sum(axis=1, keepdims=True)])


def rotated(quaternions: NDArray[np.float64], vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Vectors turned by unit quaternions, to 8 eps of their lengths."""
    twice = 2.0 * cross(quaternions[:, :3], vectors)
    return vectors + quaternions[:, 3:] * twice + cross(quaternions[:, :3], twice)


def quaternions_of(vectors: NDArray[np.float64], t: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit quaternions of the rotation vectors times t, shape [n]."""
    half = 0.5 * norms(vectors) * t
    return np.hstack([arc_factors(vectors, 0.5 * t)[0] * vectors, np.cos(half)[:, None]])


def arc_factors(
    vectors: NDArray[np.float64], t: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """σ1 = sin(θt)/θ and σ2 = (1 − cos(θt))/θ² of rotation vectors of length θ, shape [n, 1] each.

    A vector x turned by t ω is x + σ1 ω × x + σ2 ω × (ω × x). Where θ = 0 they are their limits t and t²/2.
    """
    angles = norms(vectors)
    turning = angles > 0.0
    divisors = np.where(turning, angles, 1.0)
    first = np.where(turning, np.sin(angles * t) / divisors, t)
    # 1 − cos = 2 sin² of the half angle, without cancellation and without a square that vanishes
    half = np.where(turning, np.sin(0.5 * angles * t) / divisors, 0.5 * t)
    return first[:, None], (2.0 * half * half)[:, None]


def arcs(
    omega: NDArray[np.float64],
    arms: NDArray[np.float64],
    t: NDArray[np.float64],
    factors: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None,
) -> NDArray[np.float64]:
    """(Rot(t omega) − 1) times vectors: 0 where nothing turns, and relative to the turn where it is small.

    Where the factors of omega and t are known, they need not be computed.
    """
    first, second = factors or arc_factors(omega, t)
    across = cross(omega, arms)
    return first * across + second * cross(omega, across)


def rotation_vectors(start: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.float64]:
    """The shortest rotation vectors from the rotations of some quaternions to those of others, shape [n, 3].

    Accurate to 4 eps of their own lengths, however small the turn: the product of the quaternions is summed from exact
    products, since its vector part cancels where they are near each other. Where they are equal, or opposite, the
    vector is exactly 0. Half a turn has two shortest vectors; it is the one of the product's sign.

    Args:
        start: Quaternions of any length but 0, :func:`scaled`, shape [n, 4].
        end: Those of the end.

    References:
        Ogita, Rump, Oishi, "Accurate sum and dot product", SIAM J. Sci. Comput. 26 (2005), algorithms 3.2 and 4.8.
    """
    x0, y0, z0, w0 = start.T
    x1, y1, z1, w1 = end.T
    left = np.stack([[w0, -w1, z1, -y1], [w0, -w1, x1, -z1], [w0, -w1, y1, -x1], [w0, x0, y0, z0]], axis=1)
    right = np.stack([[x1, x0, y0, z0], [y1, y0, z0, x0], [z1, z0, x0, y0], [w1, x1, y1, z1]], axis=1)
    x, y, z, w = _sums(np.concatenate(_exact_products(left, right)))
    vectors = np.column_stack([x, y, z])
    sines = norms(vectors)
    angles = 2.0 * np.arctan2(sines, np.abs(w))
    factors = np.where(w < 0.0, -angles, angles) / np.where(sines > 0.0, sines, 1.0)
    return factors[:, None] * vectors + 0.0


def quaternions_of_matrices(matrices: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit quaternions of the rotations nearest to matrices that depart from one by up to 1e-6, shape [n, 3, 3].

    References:
        Björck, Bowie, "An iterative algorithm for computing the best estimate of an orthogonal matrix" (1971).
        Shepperd, "Quaternion from rotation matrix" (1978).
    """
    for _ in range(2):  # an error of e becomes one of e²
        matrices = 1.5 * matrices - 0.5 * matrices @ (matrices.transpose(0, 2, 1) @ matrices)
    xx, yy, zz = matrices[:, 0, 0], matrices[:, 1, 1], matrices[:, 2, 2]
    ((xy, yx), (xz, zx), (yz, zy)) = ((matrices[:, i, j], matrices[:, j, i]) for i, j in ((0, 1), (0, 2), (1, 2)))
    # 4 q qᵀ, of which the row with the largest diagonal is a multiple of q without cancellation
    outer = np.array(
        [
            [1.0 + xx - yy - zz, xy + yx, xz + zx, zy - yz],
            [xy + yx, 1.0 - xx + yy - zz, yz + zy, xz - zx],
            [xz + zx, yz + zy, 1.0 - xx - yy + zz, yx - xy],
            [zy - yz, xz - zx, yx - xy, 1.0 + xx + yy + zz],
        ]
    )
    rows = np.array([xx, yy, zz, xx + yy + zz]).argmax(axis=0)
    return normalized(outer[rows, :, np.arange(len(matrices))] * 0.5)


def _exact_products(a: NDArray[np.float64], b: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Products and their rounding errors, by Dekker's and Veltkamp's splitting; for factors below 2."""
    product = a * b
    a_high, b_high = (_SPLITTER * x - (_SPLITTER * x - x) for x in (a, b))
    a_low, b_low = a - a_high, b - b_high
    error = a_low * b_low - (((product - a_high * b_high) - a_low * b_high) - a_high * b_low)
    return product, error


def _sums(terms: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sums over the first axis, as if computed in four times the precision and rounded.

    Parts of products of numbers near each other cancel to 2**-106 of themselves, which leaves digits enough.
    """
    for _ in range(3):
        for i in range(1, len(terms)):
            total = terms[i - 1] + terms[i]
            rounded = total - terms[i - 1]
            terms[i - 1] = (terms[i - 1] - (total - rounded)) + (terms[i] - rounded)
            terms[i] = total
    return terms[:-1].sum(axis=0) + terms[-1]


def in_space(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Vectors in the plane, shape [..., 2], with z = 0; others as they are."""
    if vectors.shape[-1] == 3:
        return vectors
    return np.concatenate([vectors, np.zeros((*vectors.shape[:-1], 1))], axis=-1)
