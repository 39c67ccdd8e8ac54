"""Precisions and kinds of pairs by name, and numbers as fractions."""

import numpy as np
import warp as wp
from flint import fmpq

REALS = {"float64": wp.float64, "float32": wp.float32}
KINDS = {"vertex-face": 0, "edge-edge": 1}
# the corners of a pair, from the definition of its kind
CORNERS = {"vertex-face": ((0, 1), (0, 2), (0, 3)), "edge-edge": ((0, 2), (0, 3), (1, 2), (1, 3))}


def rational(x: float) -> fmpq:
    """The same number as a fraction."""
    return fmpq(*float(x).as_integer_ratio())


def exactly(values: np.ndarray) -> np.ndarray:
    """The same numbers as fractions."""
    flat = [rational(x) for x in np.asarray(values, dtype=np.float64).ravel().tolist()]
    return np.array(flat, dtype=object).reshape(np.shape(values))
