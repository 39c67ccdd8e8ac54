"""The lengths of a step in the unit of its files, and warnings of motions that hardly mean what they say."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ccd_warp._display import shown_range
from ccd_warp._input.options import Options
from ccd_warp._mesh import CollisionMesh

# Frames whose sizes differ by this factor are hardly in the same unit.
_OTHER_UNIT = 100.0
# An edge of which less than this share is left within the step is hardly meant to move on straight lines.
_SHRUNK = 0.1


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


def motion_warnings(
    mesh: CollisionMesh, vertices_t0: NDArray[np.float64], vertices_t1: NDArray[np.float64], t_max: float
) -> list[str]:
    """What is odd about a motion, a line each; of frames in different units nothing else is said."""
    moving = mesh.moving_vertices
    if not len(moving):
        return []
    vertices_t0, vertices_t1 = mesh._both_placed(vertices_t0, vertices_t1)
    with np.errstate(all="ignore"):
        sizes = [float(np.ptp(frame[moving], axis=0).max()) for frame in (vertices_t0, vertices_t1)]
        small, large = sorted(sizes)
        if large > 0.0 and small * _OTHER_UNIT <= large:
            return [
                f"the bodies that move are {sizes[0]:.6g} long at the start and {sizes[1]:.6g} at the end of the step; "
                "are both frames in the same unit?"
            ]
        return _shrunk_edges(mesh, vertices_t0, vertices_t1, t_max)


def _shrunk_edges(
    mesh: CollisionMesh, vertices_t0: NDArray[np.float64], vertices_t1: NDArray[np.float64], t_max: float
) -> list[str]:
    edges = mesh.edges[~mesh.static[mesh.edge_body]]
    unit = float(np.abs(vertices_t0).max()) or 1.0
    start, end = ((frame[edges[:, 1]] - frame[edges[:, 0]]) / unit for frame in (vertices_t0, vertices_t1))
    change = end - start
    # The square of the length is a parabola in t.
    squared = np.einsum("ij,ij->i", change, change)
    t = np.clip(-np.einsum("ij,ij->i", start, change) / np.where(squared > 0.0, squared, 1.0), 0.0, t_max)
    share = np.linalg.norm(start + t[:, None] * change, axis=1) / np.linalg.norm(start, axis=1)
    shrunk = np.flatnonzero(share <= _SHRUNK)  # not those without a length, whose share is not a number
    if not len(shrunk):
        return []
    k = shrunk[np.argmin(share[shrunk])]
    body = mesh.vertex_body[edges[k, 0]]
    a, b = (edges[k] - mesh.body_vertex_range[body]).tolist()
    return [
        f"{len(shrunk):,} of {len(edges):,} edges shrink to a tenth or less within the step, edge {a}-{b} of "
        f"{mesh.names[body]} to {share[k]:.2g} of its length at t = {t[k]:.2g}; vertices move on straight lines, and a "
        "rotation is replaced by its chords: take smaller steps"
    ]
