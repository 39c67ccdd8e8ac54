"""The bodies of a scene as one mesh, and CCD of its steps."""

import time
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ccd_warp import CollisionPipeline
from ccd_warp._cli.half_spaces import half_space_bodies
from ccd_warp._cli.motion import largest_displacement
from ccd_warp._cli.process import warnings_on_stderr
from ccd_warp._cli.progress import waiting
from ccd_warp._cli.scene import SceneArguments, StartContacts
from ccd_warp._cli.scope import check_kinds
from ccd_warp._contact_place import MovingVertices
from ccd_warp._files.frames import Body, make_body
from ccd_warp._input.options import Options
from ccd_warp._intersections import Intersections
from ccd_warp._mesh import CollisionMesh
from ccd_warp._motion import RigidMotion
from ccd_warp._results import MeshResult
from ccd_warp._runtime.kernel_cache import announced_compilation
from ccd_warp._runtime.progress_line import ProgressLine


@dataclass(frozen=True)
class SolvedStep:
    """A step and its result.

    Attributes:
        bodies: The scene, in the order of its vertices.
        mesh: The bodies as one mesh.
        vertices_t0: Start positions of all vertices, shape [V, 3].
        vertices_t1: End positions, shape [V, 3].
        options: Validated options.
        result: Of ``mesh_ccd``.
        start: What touches, or passes through another, at the start.
        ignored: What is left out of both, because it is in contact in the first frame; None if nothing is.
        timings: Seconds of each stage, in order.
        motion: How rigid bodies turn, whose positions are in their own frames; None where all vertices move straight.
    """

    bodies: Sequence[Body]
    mesh: CollisionMesh
    vertices_t0: NDArray[np.float64]
    vertices_t1: NDArray[np.float64]
    options: Options
    result: MeshResult
    start: Intersections
    ignored: StartContacts | None
    timings: dict[str, float]
    motion: RigidMotion | None = None

    @cached_property
    def moving(self) -> MovingVertices:
        """How the vertices move."""
        return moving_vertices(self.mesh, self.bodies, self.motion)

    @cached_property
    def displacement(self) -> float:
        """The largest distance of a vertex from its place at the start."""
        start = self.moving.all_at(0.0)
        return max(largest_displacement(start, self.moving.all_at(t)) for t in self.moving.times[1:])


def positions_of(bodies: Sequence[Body]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Positions of the vertices of all bodies at both ends of the step."""
    return np.vstack([body.vertices_t0 for body in bodies]), np.vstack([body.vertices_t1 for body in bodies])


def moving_vertices(mesh: CollisionMesh, bodies: Sequence[Body], motion: RigidMotion | None) -> MovingVertices:
    """How the vertices of all bodies move; those that take no part as others of their bodies do."""
    return MovingVertices.of(
        mesh, *mesh._both_placed(*positions_of(bodies)), None if motion is None else motion._body_paths
    )


def moving_bodies(bodies: Sequence[Body]) -> list[int]:
    """The bodies that are not static."""
    return [k for k, body in enumerate(bodies) if not body.is_static]


def make_options(given: dict[str, Any], mesh: CollisionMesh, start: NDArray[np.float64] | None = None) -> Options:
    """The options of the command line, with the length scale that they mean if they give none.

    It is that of the mesh: the longest side of the box around all bodies at the start, where ``start`` says where they
    are if they have frames of their own. The options are validated here,
    so that no message names a function that is not on the command line.

    Raises:
        ValueError: If an option is out of its range, or the bodies cannot form a kind of pair that it names.
    """
    options = Options(**given)
    check_kinds(mesh, options)
    if options.length_scale is not None:
        return options
    size = 0.0 if start is None else float(np.ptp(start, axis=0).max())
    return replace(options, length_scale=size if size > 0.0 and np.isfinite(size) else mesh.length_scale)


def solve(
    bodies: Sequence[Body],
    mesh: CollisionMesh,
    options: Options,
    line: ProgressLine,
    *,
    is_quiet: bool,
    ignored: StartContacts | None = None,
    motion: RigidMotion | None = None,
) -> SolvedStep:
    """Run ``mesh_ccd`` on a step of a mesh, whose bodies these are, with its progress on a line that stays there.

    What intersects at its start is found, too. ``ignored`` is what the mesh leaves out from the first frame on.
    """
    vertices_t0, vertices_t1 = positions_of(bodies)
    with CollisionPipeline.borrowed(mesh, options) as pipeline:
        pipeline._show_progress = line.show
        with warnings_on_stderr(line.clear, is_quiet=is_quiet):
            result = pipeline.mesh_ccd(vertices_t0, vertices_t1, motion=motion)
            timings = {name: seconds for name, seconds in result.timings.items() if name != "total"}
            begin = time.perf_counter()
            start = pipeline.find_intersections(moving_vertices(mesh, bodies, motion).all_at(0.0))
            timings["intersections at start"] = time.perf_counter() - begin
    start = start if ignored is None else ignored.others(start)
    return SolvedStep(bodies, mesh, vertices_t0, vertices_t1, options, result, start, ignored, timings, motion)


def solve_scene(
    bodies: Sequence[Body],
    given: dict[str, Any],
    *,
    scene: SceneArguments,
    is_quiet: bool,
    shows_progress: bool = True,
    ignores_start: bool = False,
    motion: RigidMotion | None = None,
) -> SolvedStep:
    """Make the mesh of one step and run ``mesh_ccd``; with a motion all bodies are rigid that are not static."""
    begin = time.perf_counter()
    with waiting("making the mesh", is_quiet=is_quiet or not shows_progress):
        mesh = scene.mesh(bodies, rigid=[] if motion is None else moving_bodies(bodies))
    build_seconds = time.perf_counter() - begin
    at_start = moving_vertices(mesh, bodies, motion).all_at(0.0)
    options = make_options(given, mesh, None if motion is None else at_start)
    line, ignored = ProgressLine(is_quiet or not shows_progress), None
    if ignores_start:
        with warnings_on_stderr(is_quiet=is_quiet):
            ignored = StartContacts.of(mesh, at_start, options)
        mesh = mesh.excluding(ignored.pairs)
    try:
        step = solve(bodies, mesh, options, line, is_quiet=is_quiet, ignored=ignored, motion=motion)
    finally:
        line.clear()
    return replace(step, timings={"build mesh": build_seconds, **step.timings})


def load_kernels(
    given: dict[str, Any],
    *,
    is_quiet: bool,
    has_radius: bool = False,
    has_half_space: bool = False,
    has_poses: bool = False,
) -> float:
    """Compile or load every kernel on a scene of two triangles, so that no stage's time holds a compilation."""
    begin = time.perf_counter()
    triangle = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    above = [[x, y + 0.1, 0.5] for x, y, _ in triangle]
    below = [[x, y + 0.1, -0.5] for x, y, _ in triangle]
    bodies = [
        make_body("moving", above, below, [[0, 1, 2]]),
        make_body("resting", triangle, None, [[0, 1, 2]], is_static=True),
    ]
    motion = None
    if has_poses:
        bodies[0] = make_body("moving", triangle, triangle, [[0, 1, 2]])
        motion = RigidMotion([[0.0, 0.1, 0.5, 0.0, 0.0, 0.0, 1.0]], [[0.0, 0.1, -0.5, 0.0, 0.0, 0.0, 1.0]])
    bodies += half_space_bodies(["0,0,0,0,0,1"]) if has_half_space else []
    chosen: dict[str, Any] = {name: given[name] for name in ("precision", "device") if name in given}
    announced = nullcontext() if is_quiet else announced_compilation()
    with announced, waiting("loading kernels", is_quiet=is_quiet):
        scene = SceneArguments(self_collision=False, radius=["0.1"] if has_radius else [])
        solve_scene(bodies, chosen, scene=scene, is_quiet=is_quiet, shows_progress=False, motion=motion)
    return time.perf_counter() - begin
