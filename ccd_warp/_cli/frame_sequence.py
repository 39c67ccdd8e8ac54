"""The bodies of a sequence of frames, step by step."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ccd_warp._cli.solve import make_mesh
from ccd_warp._files.frames import Body, body_between
from ccd_warp._files.mesh import Mesh
from ccd_warp._files.opened import Stamp, noted_files
from ccd_warp._files.series import Series
from ccd_warp._input.messages import printable
from ccd_warp._mesh import CollisionMesh


class FrameSequence:
    """The steps of a sequence: its bodies at both ends of each, and their mesh, which is kept while it is the same."""

    def __init__(
        self,
        series: Sequence[Series],
        static: list[Body],
        *,
        self_collision: bool,
        radius: Sequence[str] = (),
        kinematic: Sequence[str] = (),
    ) -> None:
        self.series = series
        self.static = static
        self.self_collision = self_collision
        self.radius = radius
        self.kinematic = kinematic
        self.num_steps = len(series[0].labels) - 1
        self._read: dict[int, tuple[list[Mesh], list[Stamp]]] = {}
        self.first_bodies = self.bodies(0)
        self.first_mesh = self._make_mesh(self.first_bodies)

    def bodies(self, k: int) -> list[Body]:
        """The bodies in the step from frame ``k`` to the next; what both have in common is kept."""
        self._read = {n: self._read.get(n) or self._frame(n) for n in (k, k + 1)}
        (starts, _), (ends, _) = self._read.values()
        moving = [
            body
            for each, start, end in zip(self.series, starts, ends, strict=True)
            for body in replace(body_between(start, end), name=each.name).split()
        ]
        return moving + self.static

    def _frame(self, n: int) -> tuple[list[Mesh], list[Stamp]]:
        with noted_files() as stamps:
            return [each.read(n) for each in self.series], stamps

    @property
    def opened(self) -> list[Stamp]:
        """The stamps of all files from which the bodies were read that were asked for last."""
        return [each for _, stamps in self._read.values() for each in stamps]

    def mesh(self, bodies: list[Body]) -> CollisionMesh:
        """The mesh of these bodies: that of the first step, unless vertices are merged in another way."""
        same = len(bodies) == len(self.first_bodies) and all(
            len(a.vertices_t0) == len(b.vertices_t0) and np.array_equal(a.faces, b.faces)
            for a, b in zip(bodies, self.first_bodies, strict=False)
        )
        return self.first_mesh if same else self._make_mesh(bodies)

    def _make_mesh(self, bodies: list[Body]) -> CollisionMesh:
        return make_mesh(bodies, self_collision=self.self_collision, radius=self.radius, kinematic=self.kinematic)

    def labels(self, k: int) -> tuple[str, str]:
        """Names of the frames at both ends of step ``k``, those of the first body, without control characters."""
        start, end = self.series[0].labels[k : k + 2]
        return printable(start), printable(end)
