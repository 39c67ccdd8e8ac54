"""Random hard queries and options: those of the catalogue, and mutations of these and of published ones."""

from __future__ import annotations

import numpy as np
from hard_cases import FAMILIES, POINTS

MUTATIONS = ("published_noise", "published_crossover", "published_scaled_axes", "published_snapped", "family_mutated")
# Published queries by kind, at both ends of their steps; set by the process that draws.
PUBLISHED: dict[str, tuple[np.ndarray, np.ndarray]] = {}


def with_ulp_noise(points: np.ndarray, rng: np.random.Generator, share: float = 0.2) -> np.ndarray:
    """Some coordinates perturbed by up to three ulp, which leaves queries near their degeneracy but not on it."""
    ulps = rng.integers(-3, 4, points.shape) * (rng.random(points.shape) < share)
    return points + ulps * np.spacing(points)


def crossover(points: np.ndarray, other: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Queries with single points or single axes of other queries, the same at both ends of the step."""
    by_point = rng.random((*points.shape[:3], 1)) < 0.25
    by_axis = rng.random((len(points), 1, 1, points.shape[3])) < 0.25
    return np.where(np.where(rng.random((len(points), 1, 1, 1)) < 0.5, by_point, by_axis), other, points)


def with_scaled_axes(points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Each axis scaled by its own power of two: exact, so the truth stays, but the axes cannot share a bound."""
    reach = rng.choice([8, 40, 150, 500])
    return np.ldexp(points, rng.integers(-reach, reach + 1, (len(points), 1, 1, points.shape[3])))


def snapped(points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Coordinates on a coarse lattice of the query's own size: repeated points, common planes, exact contacts."""
    size = np.abs(points).max(axis=(1, 2, 3), keepdims=True)
    step = np.ldexp(1.0, np.frexp(size)[1] - rng.integers(2, 7, size.shape))
    return np.round(points / step) * step


def draw(source: str, kind: str, dimension: int, n: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Queries of a family or a mutation."""
    if source in FAMILIES:
        return FAMILIES[source](kind, n, rng, dimension=dimension)
    if source == "family_mutated":
        names = rng.choice(list(FAMILIES), 2)
        points, other = (np.stack(FAMILIES[name](kind, n, rng, dimension=dimension), axis=1) for name in names)
    else:
        # The first points of a published query make a pair of a smaller kind.
        frames = PUBLISHED[kind if POINTS[kind] == 4 else rng.choice(["vertex-face", "edge-edge"])]
        points, other = (
            np.stack([frame[chosen][:, : POINTS[kind], :dimension] for frame in frames], axis=1)
            for chosen in rng.integers(0, len(frames[0]), (2, n))
        )
    if source in ("published_crossover", "family_mutated"):
        points = crossover(points, other, rng)
    if source == "published_snapped" or (source == "family_mutated" and rng.random() < 0.3):
        points = snapped(points, rng)
    if source in ("published_noise", "published_crossover") or (source == "family_mutated" and rng.random() < 0.5):
        points = with_ulp_noise(points, rng)
    if source == "published_scaled_axes" or (source == "family_mutated" and rng.random() < 0.3):
        points = with_scaled_axes(points, rng)
    return np.ascontiguousarray(points[:, 0]), np.ascontiguousarray(points[:, 1])


def draw_options(arguments: dict, rng: np.random.Generator) -> dict:
    """Options of one batch; those given on the command line are fixed."""
    options = {"precision": str(rng.choice(arguments["precision"])), "num_threads": 1}
    options["tolerance"] = 1e-6 if rng.random() < 0.5 else float(10.0 ** rng.uniform(-14, -1))
    options["t_max"] = arguments["t_max"]
    if options["t_max"] is None:
        options["t_max"] = (
            1.0 if rng.random() < 0.7 else float(rng.choice([0.0, 1 - 2.0**-53, 0.5, rng.random(), 1e-9]))
        )
    separation = arguments["separation"]
    if separation is None:
        separation = 0.0 if rng.random() < 0.8 else float(10.0 ** rng.uniform(-12, 0))
    options["minimum_separation"] = separation
    if separation > 0.0 or rng.random() < 0.3:
        # a power of two: the product with the separation is exact, and the oracle gets the length that the kernel uses
        options["length_scale"] = float(2.0 ** rng.integers(-3, 4))
    if rng.random() < 0.05:
        options["max_iterations"] = int(rng.integers(1, 20))
    return options
