"""Roots of cubics in [0, 1] in floating point, for whole batches, in closed form.

References:
    Press et al., "Numerical Recipes", section 5.6 (the closed form).
"""

from __future__ import annotations

import numpy as np

# A leading coefficient below this multiple of the largest one is dropped before the closed form, which loses as many
# digits as it is smaller; the polish afterwards is on the whole cubic.
_NEGLIGIBLE = 1e-8
# Rounding makes a complex pair of a double root: its discriminant is negative, its imaginary part the square root.
_DOUBLE = 1e-12
# A root this far outside the step is taken for its end, as in El Topo.
_SLACK = 1e-8


def _value(coefficients: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Cubics [n, 4] at the times [n, k]."""
    c, b, a, lead = coefficients.T[..., None]
    return ((lead * t + a) * t + b) * t + c


def _slope(coefficients: np.ndarray, t: np.ndarray) -> np.ndarray:
    _, b, a, lead = coefficients.T[..., None]
    return (3.0 * lead * t + 2.0 * a) * t + b


def _quadratic_roots(c: np.ndarray, b: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Roots of a t² + b t + c without cancellation, [n, 2]; what is not a root is inf or nan. Serves a = 0 as well."""
    discriminant = b * b - 4.0 * a * c
    # One that is negative by rounding alone belongs to a double root.
    rounding = _DOUBLE * (b * b + np.abs(4.0 * a * c))
    discriminant = np.where(discriminant >= -rounding, np.maximum(discriminant, 0.0), np.nan)
    w = -0.5 * (b + np.copysign(np.sqrt(discriminant), b))
    return np.stack([w / a, c / w], axis=1)


def _polished(coefficients: np.ndarray, roots: np.ndarray) -> np.ndarray:
    """Roots [n, k] after two Newton steps, each of them taken only if it helps."""
    for _ in range(2):
        better = roots - _value(coefficients, roots) / _slope(coefficients, roots)
        improves = np.abs(_value(coefficients, better)) < np.abs(_value(coefficients, roots))
        roots = np.where(improves, better, roots)
    return roots


def _cardano(c: np.ndarray, b: np.ndarray, a: np.ndarray) -> np.ndarray:
    """One real root in closed form, the largest where there are three, and the others from what is left.

    The formulas for the smaller ones lose half of the digits, and more where one root is far larger.
    """
    q = (a * a - 3.0 * b) / 9.0
    r = (2.0 * a * a * a - 9.0 * a * b + 27.0 * c) / 54.0
    # Three real roots: by angles. One: the sum of two cube roots of like sign, the second from the first.
    angle = np.arccos(np.clip(r / np.sqrt(q * q * q), -1.0, 1.0))
    turn = 2.0 * np.pi * np.array([-1.0, 0.0, 1.0])
    three = -2.0 * np.sqrt(q)[:, None] * np.cos((angle[:, None] + turn) / 3.0) - a[:, None] / 3.0
    largest = np.take_along_axis(three, np.argmax(np.abs(three), axis=1)[:, None], axis=1)[:, 0]
    first = -np.copysign(np.cbrt(np.abs(r) + np.sqrt(r * r - q * q * q)), r)
    one = first + np.where(first == 0.0, 0.0, q / first) - a / 3.0
    x = np.where(r * r < q * q * q, largest, one)
    monic = np.stack([c, b, a, np.ones_like(a)], axis=1)
    x = _polished(monic, x[:, None])[:, 0]
    # t² + s t + p is left; from below for a small root, from above for a large one, neither of which cancels.
    large = np.abs(x * x * x) > np.abs(c)
    p = np.where(large, -c / x, b + (a + x) * x)
    s = np.where(large, (p - b) / x, a + x)
    return np.concatenate([x[:, None], _quadratic_roots(p, s, np.ones_like(s))], axis=1)


def cubic_roots(coefficients: np.ndarray) -> np.ndarray:
    """Roots in [0, 1] by Cardano's formula or its trigonometric form, and the quadratic that remains.

    Args:
        coefficients: Cubics, lowest degree first, of any degree up to three, float64, shape [n, 4].

    Returns:
        Roots in increasing order, inf where there are fewer, float64, shape [n, 3]; none for a cubic that is zero.
    """
    exponent = np.frexp(np.abs(coefficients).max(axis=1))[1]
    coefficients = np.ldexp(coefficients, -exponent[:, None])  # so that no product of them overflows
    roots = np.full((len(coefficients), 3), np.nan)
    with np.errstate(all="ignore"):
        cubic = np.abs(coefficients[:, 3]) > _NEGLIGIBLE * np.abs(coefficients).max(axis=1)
        c, b, a, lead = coefficients[cubic].T
        roots[cubic] = _cardano(c / lead, b / lead, a / lead)
        roots[~cubic, :2] = _quadratic_roots(*coefficients[~cubic, :3].T)
        roots = _polished(coefficients, roots)
    inside = (roots >= -_SLACK) & (roots <= 1.0 + _SLACK)
    return np.sort(np.where(inside, np.clip(roots, 0.0, 1.0), np.inf), axis=1)
