"""Building blocks of the hard cases: queries that touch, exactly on a lattice or up to rounding in floating point.

On the lattice, positions at the contact are integers with integer parameters, motions are multiples of eight, and the
contact is at an eighth of the step, so that nothing is rounded.
"""

from __future__ import annotations

import numpy as np

Points = tuple[np.ndarray, np.ndarray]

POINTS = {"vertex-face": 4, "edge-edge": 4, "point-segment": 3, "point-point": 2}


def as_points(points_t0: np.ndarray, points_t1: np.ndarray) -> Points:
    return np.ascontiguousarray(points_t0, dtype=np.float64), np.ascontiguousarray(points_t1, dtype=np.float64)


def first_of_pair(kind: str) -> slice:
    """Rows of the first primitive of the pair."""
    return slice(0, 2 if kind == "edge-edge" else 1)


def assemble(kind: str, origin: np.ndarray, q: np.ndarray, r: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Points with the second primitive at `origin`, spanned by q and r, and the first at parameters (u, v) of it."""
    if kind == "vertex-face":
        return np.stack([origin + u * q + v * r, origin, origin + q, origin + r], axis=1)
    if kind == "edge-edge":
        start = origin + v * r - u * q
        return np.stack([start, start + q, origin, origin + r], axis=1)
    if kind == "point-segment":
        return np.stack([origin + u * q, origin, origin + q], axis=1)
    return np.stack([origin, origin], axis=1)


def lattice_contact(
    kind: str,
    n: int,
    rng: np.random.Generator,
    dimension: int,
    eighths: tuple[int, int] = (1, 7),
    u: tuple[int, int] = (1, 3),
    v: tuple[int, int] = (1, 3),
    reach: int = 3,
    q: np.ndarray | None = None,
    r: np.ndarray | None = None,
    glide: np.ndarray | int = 0,
) -> Points:
    """Integer queries with contact at t = k / 8 and parameters (i / 8, j / 8), for k, i, j in the given ranges.

    Edges q and r at the contact are an eighth of the real ones, and `glide` is added to the motion of the first
    primitive in an eighth of the step; all three must be integers.
    """
    origin, drawn_q, drawn_r = (rng.integers(-reach, reach + 1, (n, dimension)) for _ in range(3))
    q = drawn_q if q is None else q
    r = drawn_r if r is None else r
    i, j = (rng.integers(low, high, (n, 1), endpoint=True) for low, high in (u, v))
    # Edges are eight times a lattice vector, so that eighths of them are lattice points.
    contact = assemble(kind, 8 * origin, 8 * q, 8 * r, i / 8, j / 8)
    k = rng.integers(*eighths, (n, 1, 1), endpoint=True)
    motion = rng.integers(-reach, reach + 1, contact.shape)
    motion[:, first_of_pair(kind)] += glide
    return as_points(contact - k * motion, contact + (8 - k) * motion)


def touching(
    kind: str,
    n: int,
    rng: np.random.Generator,
    dimension: int,
    q: np.ndarray | None = None,
    r: np.ndarray | None = None,
) -> np.ndarray:
    """Random float positions that touch, up to rounding, inside both primitives; q and r are their edges."""
    origin = rng.uniform(-1, 1, (n, dimension))
    q = rng.uniform(-1, 1, (n, dimension)) if q is None else q
    r = rng.uniform(-1, 1, (n, dimension)) if r is None else r
    return assemble(kind, origin, q, r, rng.uniform(0, 0.5, (n, 1)), rng.uniform(0, 0.5, (n, 1)))


def passing_through(contact: np.ndarray, motion: np.ndarray, rng: np.random.Generator) -> Points:
    """Queries that pass through the positions `contact` at a random time, moving by `motion` over the step."""
    t = rng.uniform(0, 1, (len(contact), 1, 1))
    return as_points(contact - t * motion, contact + (1 - t) * motion)


def colliding(kind: str, n: int, rng: np.random.Generator, dimension: int) -> Points:
    contact = touching(kind, n, rng, dimension)
    return passing_through(contact, rng.uniform(-1, 1, contact.shape), rng)


def half_and_half(first: Points, second: Points) -> Points:
    """Queries of the two in turn; both have n of them, and n come back."""
    take = (np.arange(len(first[0])) % 2 == 0)[:, None, None]
    return as_points(*(np.where(take, a, b) for a, b in zip(first, second, strict=True)))


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
