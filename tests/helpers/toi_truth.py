"""Derivatives of exact times of impact: differences of rational brackets, which share no code with the kernels."""

from fractions import Fraction

import numpy as np
from distance_oracle import exact_distance_tois
from oracle import exact_tois

BITS = 240  # to which a toi is bracketed: moves of 1e-12 of the size leave 60 digits of a difference


def exact_times(kind, start, end, distance, is_euclidean, t_max=1.0):
    """Exact tois of pairs as fractions, None where there is none."""
    if is_euclidean and distance > 0:
        found = exact_distance_tois(kind, start, end, distance, t_max)
    else:
        found = exact_tois(kind, start, end, separation=distance, t_max=t_max)
    return [
        Fraction(int(lo.p), int(lo.q)) if (lo := each.refine(BITS)[0] if each.hit else None) else lo for each in found
    ]


def difference(kind, points, moves, distance, is_euclidean, distance_move=0.0, one_sided=False):
    """Change of each exact toi with moves of the points at both ends and of the distance, and the moves that were made.

    Args:
        kind: Name of the kind of pair, as of the oracles.
        points: Positions at both ends, shape [n, points, 3] or [n, points, 2] each.
        moves: Moves of them, of the same shapes.
        distance: The distance that counts as contact.
        is_euclidean: Its norm.
        distance_move: Move of the distance.
        one_sided: Whether all moves are to one side alone.

    Returns:
        The change as a float64, nan where one of the two has no contact, [n]; and the moves at both ends and of the
        distance as they are after rounding.
    """
    to = (*(x + dx for x, dx in zip(points, moves, strict=True)), distance + distance_move)
    since = (*points, distance)
    if not one_sided:
        since = (*(x - dx for x, dx in zip(points, moves, strict=True)), distance - distance_move)
    late, early = (exact_times(kind, *ends, is_euclidean) for ends in (to, since))
    change = [float(b - a) if a is not None and b is not None else np.nan for a, b in zip(early, late, strict=True)]
    return np.array(change), [b - a for a, b in zip(since, to, strict=True)]
