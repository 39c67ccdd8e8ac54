"""What stays from step to step: a mesh's topology on a device, the boxes of what rests, buffers."""

from typing import Any

import numpy as np

from ccd_warp._engine.boxes import StepBoxes
from ccd_warp._engine.buffers import Buffers
from ccd_warp._engine.topology import Topology
from ccd_warp._mesh import CollisionMesh
from ccd_warp._runtime.threads import StopFlag


class Workspace:
    """A mesh's own on a device; used by one step at a time.

    A step that does not end well leaves it half-made: it is dropped then, and the next step makes one anew.
    """

    def __init__(self, mesh: CollisionMesh, device: Any) -> None:
        self.topology = Topology.of(mesh, device)
        self.buffers = Buffers(device)
        self.flag = StopFlag(device)
        self.boxes = StepBoxes(self.topology, self.buffers)
        self._body_hull: Workspace | None = None

    def body_hull(self) -> "Workspace":
        """The workspace of a mesh of one point a body, for the search among the boxes of bodies."""
        if self._body_hull is None:
            mesh = self.topology.mesh
            points = np.zeros((mesh.num_bodies, 3))
            every = np.ones(mesh.num_bodies, dtype=bool)
            hull = CollisionMesh(
                vertices=points,
                faces=np.zeros((0, 3), dtype=np.int32),
                body_vertex_range=np.arange(mesh.num_bodies + 1, dtype=np.int32),
                static=~every,
                self_collision=every,
                given_edges=np.zeros((0, 2), dtype=np.int32),
                with_codimensional_points=every,
                body_pairs=mesh.body_pairs,
                exclusion_rings=1,
                vertex_world=np.zeros(mesh.num_bodies, dtype=np.int32),
            )
            self._body_hull = Workspace(hull, self.topology.device)
        return self._body_hull
