"""The bodies of a scene as one mesh, and CCD of its steps."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ccd_warp import CollisionPipeline
from ccd_warp._cli.half_spaces import half_space_bodies
from ccd_warp._cli.process import notice, warnings_on_stderr
from ccd_warp._cli.progress import ProgressLine
from ccd_warp._cli.radii import radii_of
from ccd_warp._cli.scope import check_kinds
from ccd_warp._files.frames import Body, make_body
from ccd_warp._input.messages import InputError, printable
from ccd_warp._input.names import distinct_names
from ccd_warp._input.options import Options
from ccd_warp._intersections import Intersections
from ccd_warp._mesh import CollisionMesh
from ccd_warp._results import MeshResult


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
        timings: Seconds of each stage, in order.
    """

    bodies: Sequence[Body]
    mesh: CollisionMesh
    vertices_t0: NDArray[np.float64]
    vertices_t1: NDArray[np.float64]
    options: Options
    result: MeshResult
    start: Intersections
    timings: dict[str, float]


def make_mesh(
    bodies: Sequence[Body], *, self_collision: bool, radius: Sequence[str] = (), kinematic: Sequence[str] = ()
) -> CollisionMesh:
    """The bodies as one mesh, with the radii and the kinematic bodies of the command line."""
    names = distinct_names([body.name for body in bodies])
    return CollisionMesh.from_arrays(
        [body.half_space or (body.vertices_t0, body.faces) for body in bodies],
        static=[k for k, body in enumerate(bodies) if body.is_static],
        self_collision=self_collision,
        kinematic=_kinematic_bodies(kinematic, names, bodies),
        names=names,
        radius=radii_of(radius, names, [body.half_space is not None for body in bodies]),
    )


def _kinematic_bodies(given: Sequence[str], names: Sequence[str], bodies: Sequence[Body]) -> list[int]:
    """The bodies that ``--kinematic`` names, each of which moves."""
    moving = [name for name, body in zip(names, bodies, strict=True) if not body.is_static]
    for name in given:
        if name not in moving:
            known = ", ".join(map(printable, moving[:8])) + (", …" if len(moving) > 8 else "")
            raise InputError(
                f"--kinematic {printable(name)}: no body that moves has this name; expected one of {known}"
            )
    return [names.index(name) for name in given]


def positions_of(bodies: Sequence[Body]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Positions of the vertices of all bodies at both ends of the step."""
    return np.vstack([body.vertices_t0 for body in bodies]), np.vstack([body.vertices_t1 for body in bodies])


def make_options(given: dict[str, Any], mesh: CollisionMesh) -> Options:
    """The options of the command line, with the length scale that they mean if they give none.

    It is that of the mesh: the longest side of the box around all bodies at the start. The options are validated here,
    so that no message names a function that is not on the command line.

    Raises:
        ValueError: If an option is out of its range, or the bodies cannot form a kind of pair that it names.
    """
    options = Options(**given)
    check_kinds(mesh, options)
    return options if options.length_scale is not None else replace(options, length_scale=mesh.length_scale)


def solve(
    bodies: Sequence[Body], mesh: CollisionMesh, options: Options, line: ProgressLine, *, is_quiet: bool
) -> SolvedStep:
    """Run ``mesh_ccd`` on a step of a mesh, whose bodies these are, with its progress on a line that stays there.

    What intersects at its start is found, too.
    """
    vertices_t0, vertices_t1 = positions_of(bodies)
    with CollisionPipeline.borrowed(mesh, options) as pipeline:
        pipeline._show_progress = line.show
        with warnings_on_stderr(line.clear, is_quiet=is_quiet):
            result = pipeline.mesh_ccd(vertices_t0, vertices_t1)
            timings = {name: seconds for name, seconds in result.timings.items() if name != "total"}
            begin = time.perf_counter()
            start = pipeline.find_intersections(vertices_t0)
            timings["intersections at start"] = time.perf_counter() - begin
    return SolvedStep(bodies, mesh, vertices_t0, vertices_t1, options, result, start, timings)


def solve_scene(
    bodies: Sequence[Body],
    given: dict[str, Any],
    *,
    self_collision: bool,
    is_quiet: bool,
    radius: Sequence[str] = (),
    kinematic: Sequence[str] = (),
) -> SolvedStep:
    """Make the mesh of one step and run ``mesh_ccd``."""
    begin = time.perf_counter()
    mesh = make_mesh(bodies, self_collision=self_collision, radius=radius, kinematic=kinematic)
    build_seconds = time.perf_counter() - begin
    options, line = make_options(given, mesh), ProgressLine(is_quiet)
    try:
        step = solve(bodies, mesh, options, line, is_quiet=is_quiet)
    finally:
        line.clear()
    return replace(step, timings={"build mesh": build_seconds, **step.timings})


def load_kernels(
    given: dict[str, Any], *, is_quiet: bool, has_radius: bool = False, has_half_space: bool = False
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
    bodies += half_space_bodies(["0,0,0,0,0,1"]) if has_half_space else []
    chosen: dict[str, Any] = {name: given[name] for name in ("precision", "device") if name in given}
    with notice("compiling kernels (first run only) …", seconds=2.0, is_quiet=is_quiet):
        radius = ["0.1"] if has_radius else []
        solve_scene(bodies, chosen, self_collision=False, is_quiet=True, radius=radius)
    return time.perf_counter() - begin
