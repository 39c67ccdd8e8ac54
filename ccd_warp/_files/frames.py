"""Both ends of a step as a mesh and two frames of positions."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ccd_warp._files.bodies import Body
from ccd_warp._scene.mesh import CollisionMesh


@dataclass(frozen=True, eq=False, repr=False)
class Frames:
    """A step read from files.

    Attributes:
        mesh: The bodies, called by the names of their files, objects or nodes: first those that move, then the static
            ones.
        vertices_t0: Start positions, float64, in the files' length unit, shape [V, 3].
        vertices_t1: End positions, shape [V, 3]; static bodies are where they were.
        source_index: Index of each vertex in its file, the first one of merged vertices, int64, shape [V].
        num_merged: Number of vertices of each body that were merged into others, int64, shape [B].
    """

    mesh: CollisionMesh
    vertices_t0: NDArray[np.float64]
    vertices_t1: NDArray[np.float64]
    source_index: NDArray[np.int64]
    num_merged: NDArray[np.int64]

    @classmethod
    def of(
        cls, mesh: CollisionMesh, bodies: Sequence[Body], start: NDArray[np.float64], end: NDArray[np.float64]
    ) -> "Frames":
        """The step of a mesh between two positions; ``bodies`` are those of the mesh."""
        source_index = np.concatenate([body.source_index for body in bodies]).astype(np.int64)
        return cls(mesh, start, end, source_index, np.array([body.num_merged for body in bodies], dtype=np.int64))

    def __repr__(self) -> str:
        merged = f", {self.num_merged.sum():,} vertices merged" if self.num_merged.any() else ""
        return f"Frames({self.mesh!r}{merged})"
