"""Roots of cubics in [0, 1] in floating point, for whole batches: in closed form, as eigenvalues, by Newton's method.

References:
    Press et al., "Numerical Recipes", section 5.6 (the closed form).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

# A leading coefficient below this multiple of the largest one is dropped before the closed form and the eigenvalues,
# which lose as many digits as it is smaller; the polish afterwards is on the whole cubic.
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


def _normalised(coefficients: np.ndarray) -> np.ndarray:
    """Coefficients times a power of two, so that the largest is about one and no product of them overflows."""
    exponent = np.frexp(np.abs(coefficients).max(axis=1))[1]
    return np.ldexp(coefficients, -exponent[:, None])


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


def _in_step(coefficients: np.ndarray, roots: np.ndarray) -> np.ndarray:
    """Roots in [0, 1], polished and sorted, inf where there is none, [n, 3]."""
    roots = _polished(coefficients, roots)
    inside = (roots >= -_SLACK) & (roots <= 1.0 + _SLACK)
    roots = np.sort(np.where(inside, np.clip(roots, 0.0, 1.0), np.inf), axis=1)
    return np.pad(roots, ((0, 0), (0, 3 - roots.shape[1])), constant_values=np.inf)


def _by_degree(coefficients: np.ndarray, cubic_roots: Callable[..., np.ndarray]) -> np.ndarray:
    """Roots of monic cubics by `cubic_roots(c, b, a)`, of all lower degrees by the formula for quadratics."""
    coefficients = _normalised(coefficients)
    roots = np.full((len(coefficients), 3), np.nan)
    with np.errstate(all="ignore"):
        cubic = np.abs(coefficients[:, 3]) > _NEGLIGIBLE * np.abs(coefficients).max(axis=1)
        c, b, a, lead = coefficients[cubic].T
        roots[cubic] = cubic_roots(c / lead, b / lead, a / lead)
        roots[~cubic, :2] = _quadratic_roots(*coefficients[~cubic, :3].T)
        return _in_step(coefficients, roots)


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


def _eigenvalues(c: np.ndarray, b: np.ndarray, a: np.ndarray) -> np.ndarray:
    companion = np.zeros((len(c), 3, 3))
    companion[:, 0] = np.stack([-a, -b, -c], axis=1)
    companion[:, 1, 0] = companion[:, 2, 1] = 1.0
    values = np.linalg.eigvals(companion)
    real, imaginary = np.real(values), np.abs(np.imag(values))
    return np.where(imaginary <= np.sqrt(_DOUBLE) * np.maximum(1.0, np.abs(real)), real, np.nan)


def closed_form_roots(coefficients: np.ndarray) -> np.ndarray:
    """Roots in [0, 1] by Cardano's formula or its trigonometric form, and the quadratic that remains.

    Args:
        coefficients: Cubics, lowest degree first, of any degree up to three, float64, shape [n, 4].

    Returns:
        Roots in increasing order, inf where there are fewer, float64, shape [n, 3]; none for a cubic that is zero.
    """
    return _by_degree(coefficients, _cardano)


def companion_roots(coefficients: np.ndarray) -> np.ndarray:
    """Roots in [0, 1] as eigenvalues of the companion matrix; arguments and result as for `closed_form_roots`."""
    return _by_degree(coefficients, _eigenvalues)


def newton_roots(coefficients: np.ndarray) -> np.ndarray:
    """Roots in [0, 1] by Newton's method between the extrema, with bisection where it leaves its interval.

    Arguments and result as for `closed_form_roots`. An extremum without a change of sign counts as a root if the cubic
    is below 1e-8 of its coefficients there, as in El Topo.
    """
    coefficients = _normalised(coefficients)
    with np.errstate(all="ignore"):
        extrema = _quadratic_roots(*(coefficients[:, 1:] * [1.0, 2.0, 3.0]).T)
        # What is no extremum inside the step leaves an interval of no length at its end.
        extrema = np.sort(np.where((extrema > 0.0) & (extrema < 1.0), extrema, 1.0), axis=1)
        ends = np.concatenate([np.zeros((len(extrema), 1)), extrema, np.ones((len(extrema), 1))], axis=1)
        values = _value(coefficients, ends)
        low, high = ends[:, :-1].copy(), ends[:, 1:].copy()
        falls = values[:, :-1] > 0.0
        crosses = (values[:, :-1] * values[:, 1:] < 0.0) | (values[:, 1:] == 0.0)
        crosses[:, 0] |= values[:, 0] == 0.0
        proper = low < high
        crosses &= proper
        t = 0.5 * (low + high)
        active = crosses.any(axis=1)
        for _ in range(60):  # bisection alone comes to the last bit in 53
            f = _value(coefficients[active], t[active])
            left = (f > 0.0) == falls[active]
            low[active] = np.where(left, t[active], low[active])
            high[active] = np.where(left, high[active], t[active])
            better = t[active] - f / _slope(coefficients[active], t[active])
            outside = ~((better > low[active]) & (better < high[active]))
            better = np.where(outside, 0.5 * (low[active] + high[active]), better)
            moved = (np.abs(better - t[active]) > 2.0**-52) & crosses[active]
            t[active] = better
            active[active] = moved.any(axis=1)
            if not active.any():
                break
        # An end that is a root to the last bit is taken as it is.
        t = np.where(values[:, 1:] == 0.0, ends[:, 1:], t)
        t[:, 0] = np.where(values[:, 0] == 0.0, 0.0, t[:, 0])
        touches = np.abs(values[:, 1:]) <= 1e-8 * np.abs(coefficients).sum(axis=1, keepdims=True)
        touches[:, :-1] &= ~crosses[:, 1:]
        t = np.where(crosses, t, np.where(touches & proper, ends[:, 1:], np.inf))
    t[~coefficients.any(axis=1)] = np.inf
    return np.sort(t, axis=1)


ROOTS = {"closed_form": closed_form_roots, "companion": companion_roots, "newton": newton_roots}
