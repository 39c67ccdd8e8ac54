"""Programs that users take for rigid bodies in motion, on the same steps; a program that is not installed is left out.

Each takes the bodies as it does best: python-fcl and coal as hierarchies of triangles, drake and parry as boxes. What
is made once for a scene is not timed, nor are the poses along a step, which a planner has anyway. One thread each.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from typing import Any

import numpy as np
from rigid_scenes import Boxes, RigidSteps

# Modules of the peers, by the name under which they are installed.
PEERS = {"python-fcl": "fcl", "coal": "coal", "drake": "pydrake", "py-parry3d": "py_parry3d"}
SAMPLES = (10, 100, 1_000)
# Gap at which an advancement takes bodies for touching, and the most steps that it makes.
_GAP, _MOST_STEPS = 1e-6, 1_000
# What a peer says of the steps: the tois, inf where it finds none. A checker of samples says the first that touches.
Solve = Callable[[], np.ndarray]


def peers_of(steps: RigidSteps) -> Iterator[tuple[str, Solve]]:
    """The peers that are installed and know such steps, each with a name and a call."""
    makers: dict[str, Callable[[RigidSteps], Iterator[tuple[str, Solve]]]] = {
        "python-fcl": _fcl,
        "coal": _coal,
        "drake": _drake,
        "py-parry3d": _parry,
    }
    for name, make in makers.items():
        if find_spec(PEERS[name]) is not None:
            yield from make(steps)


def _each(steps: RigidSteps, toi_of: Callable[[int], float]) -> Solve:
    return lambda: np.array([toi_of(k) for k in range(len(steps))])


def _samples_of(steps: RigidSteps, count: int) -> tuple[np.ndarray, np.ndarray]:
    times = np.linspace(0.0, 1.0, count)
    return times, np.stack([steps.poses_at(k, times) for k in range(len(steps))])


def _fcl(steps: RigidSteps) -> Iterator[tuple[str, Solve]]:
    """python-fcl: its conservative advancement, and its naive solver, which tests samples."""
    import fcl

    def model(body: Boxes) -> fcl.BVHModel:
        vertices, faces = body.mesh
        made = fcl.BVHModel()
        made.beginModel(len(vertices), len(faces))
        made.addSubModel(vertices, faces)
        made.endModel()
        return made

    def transform(matrix: np.ndarray) -> fcl.Transform:
        return fcl.Transform(np.ascontiguousarray(matrix[:3, :3]), matrix[:3, 3])

    body, obstacles = model(steps.body), fcl.CollisionObject(model(steps.obstacles))
    first = [fcl.CollisionObject(body, transform(steps.poses_at(k, np.zeros(1))[0])) for k in range(len(steps))]
    last = [transform(matrix) for matrix in steps.ends()]
    motions = fcl.CCDMotionType.CCDM_LINEAR, fcl.CCDMotionType.CCDM_SCREW
    motion = motions[steps.path == "screw"]

    def solve(request: fcl.ContinuousCollisionRequest) -> Solve:
        def toi_of(k: int) -> float:
            result = fcl.ContinuousCollisionResult()
            fcl.continuousCollide(first[k], last[k], obstacles, fcl.Transform(), request, result)
            return result.time_of_contact if result.is_collide else np.inf

        return _each(steps, toi_of)

    def request(solver: int, iterations: int) -> fcl.ContinuousCollisionRequest:
        return fcl.ContinuousCollisionRequest(
            num_max_iterations=iterations, toc_err=1e-6, ccd_motion_type=motion, ccd_solver_type=solver
        )

    yield "python-fcl, defaults", solve(fcl.ContinuousCollisionRequest())
    advancement = fcl.CCDSolverType.CCDC_CONSERVATIVE_ADVANCEMENT
    yield f"python-fcl, advancement, {steps.path}", solve(request(advancement, _MOST_STEPS))
    for count in SAMPLES:
        yield f"python-fcl, naive, {count:,} samples", solve(request(fcl.CCDSolverType.CCDC_NAIVE, count))


def _coal(steps: RigidSteps) -> Iterator[tuple[str, Solve]]:
    """coal, which has no continuous query: advancement by its distance and a bound of the speed of all points."""
    import coal

    def model(body: Boxes) -> coal.BVHModelOBBRSS:
        made = coal.BVHModelOBBRSS()
        vertices, faces = body.mesh
        made.beginModel(len(faces), len(vertices))
        made.addVertices(vertices)
        for face in faces:
            made.addTriangle(*(vertices[i] for i in face))
        made.endModel()
        return made

    body, obstacles, at_origin = model(steps.body), model(steps.obstacles), coal.Transform3s()
    reach = steps.body.reach
    speeds = np.linalg.norm(steps.moves, axis=1) + np.linalg.norm(steps.omega, axis=1) * reach
    if steps.path == "screw":  # the origin moves on a helix, longer than its chord by half the angle over its sine
        angles = np.linalg.norm(steps.omega, axis=1)
        speeds += np.linalg.norm(steps.moves, axis=1) * (0.5 * angles / np.sin(0.5 * angles) - 1.0)

    def toi_of(k: int) -> float:
        t = 0.0
        for _ in range(_MOST_STEPS):
            matrix = steps.poses_at(k, np.array([t]))[0]
            placed = coal.Transform3s(np.ascontiguousarray(matrix[:3, :3]), matrix[:3, 3])
            result = coal.DistanceResult()
            gap = coal.distance(body, placed, obstacles, at_origin, coal.DistanceRequest(), result)
            if gap <= _GAP:
                break
            t += gap / speeds[k]
            if t > 1.0:
                return np.inf
        return t

    yield "coal, advancement by distance", _each(steps, toi_of)


def _parry(steps: RigidSteps) -> Iterator[tuple[str, Solve]]:
    """py-parry3d, a checker of poses, many in a call."""
    import py_parry3d as parry

    parry.set_num_threads(1)

    def group(name: str, body: Boxes, **options: Any) -> parry.CollisionGroup:
        boxes = [
            parry.CollisionObject(parry.Box(list(0.5 * size)), parry.transform(translation=list(center)))
            for size, center in zip(body.sizes, body.centers, strict=True)
        ]
        return parry.CollisionGroup(name, boxes, **options)

    world = parry.CollisionWorld(
        [group("body", steps.body), group("obstacles", steps.obstacles, static=True, transform=np.eye(4))]
    )

    def solve(count: int) -> Solve:
        times, poses = _samples_of(steps, count)

        def toi_of(k: int) -> float:
            touching = world.check({"body": poses[k]}, [("body", "obstacles", 0.0)])[:, 0]
            return times[touching.argmax()] if touching.any() else np.inf

        return _each(steps, toi_of)

    for count in SAMPLES:
        yield f"py-parry3d, {count:,} samples", solve(count)


def _drake(steps: RigidSteps) -> Iterator[tuple[str, Solve]]:
    """drake's checker of edges between configurations of a floating body, by the size of its steps."""
    from pydrake.geometry import Box
    from pydrake.math import RigidTransform, RotationMatrix
    from pydrake.multibody.plant import CoulombFriction
    from pydrake.multibody.tree import SpatialInertia
    from pydrake.planning import RobotDiagramBuilder, SceneGraphCollisionChecker

    logging.getLogger("drake").setLevel(logging.WARNING)

    def add(plant: Any, body: Any, made_of: Boxes, name: str) -> None:
        for k, center in enumerate(made_of.centers):
            box, friction = Box(*made_of.sizes[k]), CoulombFriction(1.0, 1.0)
            plant.RegisterCollisionGeometry(body, RigidTransform(center), box, f"{name}{k}", friction)

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

        def toi_of(k: int, checker: Any = checker) -> float:
            measure = checker.MeasureEdgeCollisionFree(starts[k], ends[k])
            return np.inf if measure.completely_free() else measure.alpha_or(0.0)

        yield f"drake, edge steps of {size:g}", _each(steps, toi_of)
