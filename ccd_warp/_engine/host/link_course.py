"""The course of a line search in which joints move links: a world goes on its motion, at a time of its own."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ccd_warp._engine.host.line_search import Course
from ccd_warp._mesh import CollisionMesh
from ccd_warp._mesh_paths import MeshPaths

if TYPE_CHECKING:
    from ccd_warp._joint_motion import JointMotion


class LinkEnd(NamedTuple):
    """The end of a step with joints.

    Attributes:
        vertices: Its positions; of links in their own frames.
        motion: The motion up to there.
    """

    vertices: NDArray[np.float64]
    motion: "JointMotion"


class LinkCourse(Course):
    """Where vertices are at fractions of the step, one for all free vertices of a world.

    Of contacts it has to tell only whether a fraction moves their vertices at all, and chords say that.
    """

    def __init__(
        self,
        mesh: CollisionMesh,
        given_t0: NDArray[np.float64],
        given_t1: NDArray[np.float64],
        motion: "JointMotion",
        paths_at: Callable[[Any], MeshPaths],
    ) -> None:
        """A course between given positions, of links in their own frames; ``paths_at`` has them at times of worlds."""
        self._mesh, self._given, self._motion, self._paths_at = mesh, given_t0, motion, paths_at
        self._is_link = mesh.rigid[mesh.vertex_body][:, None]
        at_rest = np.zeros(mesh.num_worlds)
        super().__init__(self._placed(given_t0, at_rest), self._placed(given_t1, at_rest + 1.0))

    def at(self, fraction: NDArray[np.float64]) -> NDArray[np.float64]:
        """The positions of all vertices at a fraction of each."""
        return self._placed(super().at(fraction), self.of_worlds(fraction))

    def step_to(self, vertices: NDArray[np.float64], fraction: NDArray[np.float64]) -> Any:
        """What a solver takes as the end of the step to positions that are those at a fraction of each."""
        own_frames = np.where(self._is_link, self._given, vertices)
        return LinkEnd(own_frames, self.shortened(fraction))

    def are_at_start(self, vertices: NDArray[np.float64], fraction: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which vertices have not moved; a link may come back to where it was."""
        of_links: NDArray[np.bool_] = (fraction == 0.0) | self._mesh.static[self._mesh.vertex_body]
        return np.where(self._is_link[:, 0], of_links, super().are_at_start(vertices, fraction))

    def shortened(self, fraction: NDArray[np.float64]) -> "JointMotion":
        """The motion up to fractions of the vertices."""
        return self._motion.shortened(self.of_worlds(fraction))

    def of_worlds(self, fraction: NDArray[np.float64]) -> NDArray[np.float64]:
        """The least fraction of the free vertices of each world, 1 of those without any."""
        least = np.ones(self._mesh.num_worlds)
        np.minimum.at(least, self._mesh.vertex_world, fraction)
        return least

    def _placed(self, vertices: NDArray[np.float64], times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Positions in which links are where joints have them at a time of each world."""
        placed = self._paths_at(times).at(self._mesh, self._given, self._given, 0.0)
        return np.where(self._is_link, placed, vertices)
