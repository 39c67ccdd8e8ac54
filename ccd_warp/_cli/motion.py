"""The lengths of a step in the unit of its files."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ccd_warp._display import shown_range
from ccd_warp._input.options import Options


@dataclass(frozen=True)
class Lengths:
    """Lengths of a step.

    Attributes:
        extents: Sides of the box around all bodies at the start, shape [3].
        largest_displacement: Of a vertex over the whole step.
        length_scale: That of the options.
        tolerance: As a length.
        minimum_separation: Or the minimum distance, as a length.
        is_distance: Whether it is the distance.
    """

    extents: NDArray[np.float64]
    largest_displacement: float
    length_scale: float
    tolerance: float
    minimum_separation: float
    is_distance: bool

    @classmethod
    def of(cls, vertices_t0: NDArray[np.float64], largest_displacement: float, options: Options) -> "Lengths":
        """The lengths of a step, or of several with the same options."""
        scale = options.length_scale
        assert scale is not None, "chosen for the mesh if not given"
        with np.errstate(over="ignore"):
            extents = np.ptp(vertices_t0, axis=0)
        lengths = (options.tolerance * scale, options.separation(scale))
        return cls(extents, largest_displacement, scale, *lengths, options.minimum_distance > 0)

    def rows(self, radius: NDArray[np.float64] | None = None) -> list[tuple[str, str]]:
        """What they are called, and their values; with radii of vertices how large these are."""
        x, y, z = self.extents.tolist()
        is_distance = self.is_distance or radius is not None
        rows = [
            ("extents at the start", f"{x:.6g} x {y:.6g} x {z:.6g}"),
            ("largest displacement", f"{self.largest_displacement:.6g}"),
            ("length scale", f"{self.length_scale:.6g}"),
            ("tolerance", f"{self.tolerance:.6g}"),
            ("minimum distance" if is_distance else "minimum separation", f"{self.minimum_separation:.6g}"),
        ]
        if radius is not None:
            _, _, values = shown_range("radius", radius).partition(" ")
            rows.append(("radius", values))
        return rows


def largest_displacement(vertices_t0: NDArray[np.float64], vertices_t1: NDArray[np.float64]) -> float:
    """Of a vertex over the whole step."""
    with np.errstate(over="ignore"):
        return float(np.linalg.norm(vertices_t1 - vertices_t0, axis=1).max(initial=0.0))
