"""Bodies that are near the paths of a motion, not on them: each of their points swings about its place."""

import inspect
import sys

import numpy as np
from flint import arb

from laws import trajectories
from laws.moving import Moves
from laws.trajectories import add, exact, precise, scaled, sine_and_cosine

_SHARE = 1.0 - 1e-9  # of the largest length, so that the axes of a swing may be rounded


class NearPaths(Moves):
    """A step whose bodies swing beside their paths, by no more than some lengths.

    Args:
        within: How far points of each rigid body swing.
        seed: Of their axes, phases and speeds.
        others: What `Moves` takes; the share of a body is that of its swing, too.
    """

    def __init__(self, mesh, start, end, motion: dict, within, seed: int, shares=None) -> None:
        rng, count = np.random.default_rng(seed), int(mesh.rigid.sum())
        axes = rng.standard_normal((count, 3, 2))
        axes[:, mesh.dimension :] = 0.0
        self.axes = np.linalg.qr(axes)[0].transpose(0, 2, 1)
        self.phase, self.speed = rng.uniform(0, 6, mesh.num_vertices), rng.uniform(-6, 6, count)
        self.within = within
        # what answers are kept by
        swings = {"swings": [inspect.getsource(sys.modules[__name__]), within, self.axes, self.phase, self.speed]}
        super().__init__(mesh, start, end, motion | swings, shares)

    @precise
    def primitive(self, vertices) -> trajectories.Trajectory:
        """Vertices of one body."""
        on_path, body = super().primitive(vertices), self.mesh.vertex_body[vertices[0]]
        if not self.mesh.rigid[body] or self.within[self.row[body]] == 0.0:
            return on_path
        row = self.row[body]
        speed = arb(float(self.speed[row] * self.shares[body]))
        axes = [scaled(arb(float(self.within[row] * _SHARE)), exact(axis)) for axis in self.axes[row]]

        def points(t):
            swings = [sine_and_cosine(t * speed + arb(float(self.phase[v]))) for v in vertices]
            offsets = [add(*(scaled(x, axis) for x, axis in zip(swing, axes, strict=True))) for swing in swings]
            return [add(place, offset) for place, offset in zip(on_path(t), offsets, strict=True)]

        return points
