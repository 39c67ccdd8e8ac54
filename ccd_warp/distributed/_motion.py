"""Rigid bodies that turn on parts of a mesh: their paths, which all ranks have, and how far boxes have to reach."""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ccd_warp._rigid.mesh_paths import MeshPaths, check_motion, check_worlds_of
from ccd_warp._rigid.motion import RigidMotion
from ccd_warp._rigid.rotations import in_space, norms
from ccd_warp._scene.input.arguments import shown
from ccd_warp.distributed._mesh import DistributedMesh


class LocalPaths:
    """The motion of a call, and where the vertices of this rank are on it.

    Attributes:
        motion: The motion, the same on all ranks.
        paths: The paths of all bodies of the whole mesh.
        positions: The positions of this rank's vertices at both ends, of rigid bodies in their own frames.
    """

    def __init__(
        self, mesh: DistributedMesh, motion: Any, start: NDArray[np.float64], end: NDArray[np.float64]
    ) -> None:
        """Check the motion of a call, collectively.

        Raises:
            ValueError: If it is none that ranks take, does not fit the mesh, or differs between ranks.
        """
        if not isinstance(motion, RigidMotion):
            raise ValueError(
                f"motion is {shown(motion)}; expected a RigidMotion, the same on all ranks; bodies that stretch move "
                f"straight between rows of vertices_t0 and t1"
            )
        self._mesh, self.motion, self.positions = mesh, motion, (start, end)
        check_motion(mesh, motion._body_paths)  # type: ignore[arg-type]
        check_worlds_of(mesh.rigid, *mesh.worlds_of_bodies())
        self.paths = MeshPaths.of_checked(mesh, motion._body_paths)  # type: ignore[arg-type]
        text = b"".join(array.tobytes() for array in vars(motion._body_paths).values())
        digest = int.from_bytes(hashlib.sha256(text).digest()[:6], "big")
        if list(mesh.ranks.agree(digest, -digest)) != [digest, -digest]:
            raise ValueError("motion differs between ranks; expected the same on all, with a row for every rigid body")
        owned_rows = mesh.owned_rows
        self._rigid = owned_rows[mesh.rigid[mesh.bodies[owned_rows]]]
        self._searched = self._rigid[~mesh.is_unused[self._rigid]]
        differs = self._searched[(start[self._searched] != end[self._searched]).any(axis=1)]
        for row in differs[:1].tolist():
            raise ValueError(
                f"vertices_t1 has another row for the vertex with id {mesh.vertex_ids[row]} than vertices_t0, and its "
                f"body is rigid; expected its place in the body's own frame in both"
            )

    def at(self, t: Any) -> NDArray[np.float64]:
        """Where this rank's own vertices are in the world at a time, one for all or one each; ghosts are anywhere."""
        start, end = self.positions
        placed, owned_rows = np.zeros_like(start), self._mesh.owned_rows
        times = np.broadcast_to(t, len(start))[owned_rows]
        placed[owned_rows] = self.paths.places(self._mesh.bodies[owned_rows], start[owned_rows], end[owned_rows], times)
        return placed

    def turn(self, vertices: NDArray[np.float64], fraction: NDArray[np.float64]) -> None:
        """Let this rank's own vertices that turn be at a fraction of each, if that is not 0, as a course has them."""
        turns = self._rigid[fraction[self._rigid] != 0.0]
        vertices[turns] = self.at(fraction)[turns]

    def reach(self) -> float:
        """How far arcs and boxes of their slices are from the boxes of both ends at most, the same on all ranks.

        A point on an arc is off its chord by no more than its sagitta, and than the diameter of its circle; the boxes
        of a slice reach beyond by the sagitta of the slice, and by how far points may be from the arc. Rounded up to a
        power of two, so that a plan holds for some more steps.
        """
        rows = self._searched
        bodies, x = self._mesh.bodies[rows], self.positions[0][rows]
        x = in_space(x)
        turning = norms(self.paths.velocities(bodies, x, x, 0.0) - self.paths.velocity[bodies])
        angle = norms(self.paths.omega[bodies])
        with np.errstate(divide="ignore", invalid="ignore"):
            off = np.fmin(0.125 * angle * turning, 2.0 * turning / angle)
        off = off + self.paths.excess[bodies]
        largest = float(self._mesh.ranks.most(off.max(initial=0.0, keepdims=True))[0])
        return float(2.0 ** np.ceil(np.log2(2.0 * largest))) if largest > 0.0 else 0.0
