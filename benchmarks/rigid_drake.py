"""drake's checker of edges on the steps of the benchmark: a body that floats among boxes welded to the world."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from typing import Any

import numpy as np
from ccd_warp.benchmarks.rigid_scenes import Boxes, RigidSteps


def checkers(steps: RigidSteps) -> Iterator[tuple[float, Any, np.ndarray, np.ndarray]]:
    """A checker for each size of an edge step, that size, and configurations at both ends of each step."""
    from pydrake.geometry import Box
    from pydrake.math import RigidTransform, RotationMatrix
    from pydrake.multibody.plant import CoulombFriction
    from pydrake.multibody.tree import SpatialInertia
    from pydrake.planning import RobotDiagramBuilder, SceneGraphCollisionChecker

    logging.getLogger("drake").setLevel(logging.WARNING)

    def add_boxes(plant: Any, body: Any, boxes: Boxes, name: str) -> None:
        for k, (size, center) in enumerate(zip(boxes.sizes, boxes.centers, strict=True)):
            plant.RegisterCollisionGeometry(
                body, RigidTransform(center), Box(*size), f"{name}{k}", CoulombFriction(1.0, 1.0)
            )

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
        add_boxes(plant, body, steps.body, "body")
        add_boxes(plant, plant.world_body(), steps.obstacles, "obstacle")
        plant.Finalize()
        checker = SceneGraphCollisionChecker(model=builder.Build(), robot_model_instances=[robot], edge_step_size=size)
        yield size, checker, starts, ends
