"""drake's checker of edges on the steps of the benchmark: a body that floats among shapes welded to the world."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from typing import Any

import numpy as np
from rigid_scenes import Boxes, RigidSteps, Spheres


def checkers(steps: RigidSteps) -> Iterator[tuple[float, Any, np.ndarray, np.ndarray]]:
    """A checker for each size of an edge step, that size, and configurations at both ends of each step."""
    from pydrake.geometry import Box, Sphere
    from pydrake.math import RigidTransform, RotationMatrix
    from pydrake.multibody.plant import CoulombFriction
    from pydrake.multibody.tree import SpatialInertia
    from pydrake.planning import RobotDiagramBuilder, SceneGraphCollisionChecker

    logging.getLogger("drake").setLevel(logging.WARNING)

    def add(plant: Any, body: Any, made_of: Boxes | Spheres, name: str) -> None:
        for k, center in enumerate(made_of.centers):
            shape = Box(*made_of.sizes[k]) if isinstance(made_of, Boxes) else Sphere(made_of.radius)
            friction = CoulombFriction(1.0, 1.0)
            plant.RegisterCollisionGeometry(body, RigidTransform(center), shape, f"{name}{k}", friction)

    def configurations(matrices: np.ndarray) -> np.ndarray:
        turns = [RotationMatrix(matrix[:3, :3]).ToQuaternion().wxyz() for matrix in matrices]
        return np.hstack([turns, matrices[:, :3, 3]])

    starts = configurations(np.stack([steps.poses_at(k, np.zeros(1))[0] for k in range(len(steps))]))
    ends = configurations(steps.ends())
    for size in steps.edge_steps:
        builder = RobotDiagramBuilder()
        plant = builder.plant()
        robot = plant.AddModelInstance("robot")
        body = plant.AddRigidBody("body", robot, SpatialInertia.SolidSphereWithMass(1.0, 0.01))
        add(plant, body, steps.body, "body")
        add(plant, plant.world_body(), steps.obstacles, "obstacle")
        plant.Finalize()
        checker = SceneGraphCollisionChecker(model=builder.Build(), robot_model_instances=[robot], edge_step_size=size)
        yield size, checker, starts, ends
