"""Inputs with which the tests attack the rounding analysis, and arithmetic that takes floats and fractions alike."""

import numpy as np
import warp as wp
from flint import fmpq

REALS = {"float64": wp.float64, "float32": wp.float32}
POINTS = wp.array2d[wp.vec3d]
FLOATS = {"float64": np.float64, "float32": np.float32}
KINDS = {"vertex-face": 0, "edge-edge": 1}
# the corners of a pair, from the definition of its kind
CORNERS = {"vertex-face": ((0, 1), (0, 2), (0, 3)), "edge-edge": ((0, 2), (0, 3), (1, 2), (1, 3))}
# its two sides, whose product is the normal
SIDES = {"vertex-face": ((1, 2), (1, 3)), "edge-edge": ((2, 3), (1, 0))}


def struct(name: str, fields: list):
    """A struct of fields, whose names are given by type."""
    annotations = {field: kind for names, kind in fields for field in names.split()}
    return wp.struct(type(name, (), {"__annotations__": annotations}))


def rational(x: float) -> fmpq:
    """The same number as a fraction."""
    return fmpq(*float(x).as_integer_ratio())


def exactly(values: np.ndarray) -> np.ndarray:
    """The same numbers as fractions."""
    flat = [rational(x) for x in np.asarray(values, dtype=np.float64).ravel().tolist()]
    return np.array(flat, dtype=object).reshape(np.shape(values))


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    turn = [(1, 2), (2, 0), (0, 1)]
    return np.stack([a[..., i] * b[..., j] - a[..., j] * b[..., i] for i, j in turn], axis=-1)


def drawn(n: int, rng: np.random.Generator) -> dict:
    """Inputs of every sort: uniform, on a lattice, beside powers of two, with axes of different scales."""

    def numbers(*shape) -> np.ndarray:
        x = rng.uniform(-1, 1, shape)
        lattice = rng.integers(-4, 5, shape) / 4
        beside = np.ldexp(1.0 + rng.integers(-3, 4, shape) * 2.0**-52, -rng.integers(0, 3, shape))
        beside *= rng.choice([-1, 1], shape)
        sort = rng.integers(0, 4, (shape[0], *[1] * (len(shape) - 1)))
        return np.choose(sort, [x, lattice, beside, x * np.ldexp(1.0, -rng.integers(0, 12, shape))])

    k = rng.integers(0, 21, (2, n))
    return {
        "vertices_t0": numbers(n, 4, 3),
        "vertices_t1": numbers(n, 4, 3),
        "d": numbers(n, 3) + 2.0**-20,
        "margin": abs(numbers(n, 3)) + 2.0**-20,
        "h": numbers(n, 4),
        "u": rng.integers(0, 2**20 + 1, n) % (2 ** k[0] + 1) / 2.0 ** k[0],
        "v": rng.integers(0, 2**20 + 1, n) % (2 ** k[1] + 1) / 2.0 ** k[1],
        "t": rng.uniform(0, 1, n),
        "x": rng.uniform(0, 1, n),
        "facet": np.stack([rng.integers(-1, 3, n), rng.integers(0, 3, n)], axis=1).astype(np.int32),
    }
