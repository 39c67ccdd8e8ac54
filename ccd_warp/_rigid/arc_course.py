"""The course of a line search in which bodies turn: a body goes on its path, and stays rigid."""

import numpy as np
from numpy.typing import NDArray

from ccd_warp._engine.host.course import Course, Ends
from ccd_warp._rigid.mesh_paths import MeshPaths
from ccd_warp._rigid.motion import RigidMotion
from ccd_warp._scene.mesh import CollisionMesh


class ArcCourse(Course):
    """Where vertices are at fractions of their motion, which are the same for all vertices of a rigid body."""

    def __init__(
        self,
        mesh: CollisionMesh,
        vertices_t0: NDArray[np.float64],
        vertices_t1: NDArray[np.float64],
        paths: MeshPaths,
        motion: RigidMotion,
    ) -> None:
        """A course between given positions, of rigid bodies in their own frames, which have a motion on paths."""
        self._mesh, self._vertices, self._paths, self._motion = mesh, (vertices_t0, vertices_t1), paths, motion
        super().__init__(paths.at(mesh, vertices_t0, vertices_t1, 0.0), paths.at(mesh, vertices_t0, vertices_t1, 1.0))
        self._is_rigid = paths.is_rigid[mesh.vertex_body]

    def at(self, fraction: NDArray[np.float64], vertices: NDArray[np.integer] | None = None) -> NDArray[np.float64]:
        """The positions of vertices, an array of any shape, at a fraction of each; of all by default."""
        vertices = np.arange(len(self.start)) if vertices is None else vertices
        straight = super().at(fraction, vertices)
        turned = self._paths.at(self._mesh, *self._vertices, fraction.ravel(), vertices.ravel()).reshape(straight.shape)
        turns = self._is_rigid[vertices] & (fraction != 0.0)
        return np.where(turns[..., None], turned, straight)

    def step_to(self, vertices: NDArray[np.float64], fraction: NDArray[np.float64]) -> Ends:
        """The step to positions that are those at a fraction of each."""
        own_frames = np.where(self._is_rigid[:, None], self._vertices[0], vertices)
        return Ends(self._vertices[0], own_frames, self._paths.shortened(self._of_bodies(fraction)))

    def motion_to(self, fraction: NDArray[np.float64]) -> RigidMotion:
        """The motion of the call up to a fraction of each vertex."""
        of_rigid = self._of_bodies(fraction)[self._mesh.rigid]
        return self._motion.shortened(of_rigid.reshape(self._motion.turns.shape))

    def are_at_start(self, vertices: NDArray[np.float64], fraction: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which vertices have not moved; on an arc one may come back to where it was."""
        of_rigid: NDArray[np.bool_] = (fraction == 0.0) | ~self._paths.moves[self._mesh.vertex_body]
        return np.where(self._is_rigid, of_rigid, super().are_at_start(vertices, fraction))

    def may_stay(self, fraction: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which vertices may be where they start; on an arc one may come back there."""
        return self._is_rigid | super().may_stay(fraction)

    def _of_bodies(self, fraction: NDArray[np.float64]) -> NDArray[np.float64]:
        """The least fraction of the vertices of each body, 1 of those without any."""
        return self._least_of_bodies(fraction, 1.0)

    def shared(self, least: NDArray[np.float64]) -> NDArray[np.float64]:
        """A value of each vertex, which the vertices of a rigid body share."""
        of_body = self._least_of_bodies(least, np.inf)
        return np.where(self._is_rigid, of_body[self._mesh.vertex_body], least)

    def _least_of_bodies(self, values: NDArray[np.float64], start: float) -> NDArray[np.float64]:
        """The least value of the vertices of each body, and no more than ``start``."""
        least = np.full(self._mesh.num_bodies, start)
        np.minimum.at(least, self._mesh.vertex_body, values)
        return least
