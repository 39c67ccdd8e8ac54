"""``ccd-warp demo``: a bullet through a thin wall, and a cloth over a sphere."""

import argparse
from dataclasses import dataclass
from functools import partial

import numpy as np
import trimesh

from ccd_warp import CollisionPipeline
from ccd_warp._cli.arguments import given_options
from ccd_warp._cli.output import write_result
from ccd_warp._cli.pictures import check_picture, draw_step
from ccd_warp._cli.process import make_folder, start_quietly, teller
from ccd_warp._cli.report import format_report, format_toi
from ccd_warp._cli.solve import SolvedStep, load_kernels, positions_of, solve_scene
from ccd_warp._files.frames import Body, make_body, write_mesh
from ccd_warp._files.mesh_frames import mesh_of
from ccd_warp._scene.input.messages import printable


@dataclass(frozen=True)
class DemoScene:
    """A scene of the demo.

    Attributes:
        name: Short name, also of its files.
        title: What it shows.
        bodies: Moving and static bodies.
        self_collision: Whether a body may touch itself.
    """

    name: str
    title: str
    bodies: list[Body]
    self_collision: bool


def bullet_scene() -> DemoScene:
    """A ball of radius 0.1 flies nine units in one step through a wall 0.02 thick."""
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.1)
    wall = trimesh.creation.box(extents=(0.02, 5.0, 5.0))
    start = ball.vertices + [0.5, 3.5, 0.0]
    end = ball.vertices + [9.5, 3.5, 0.0]
    return DemoScene(
        name="bullet",
        title="bullet through a thin wall, one step",
        bodies=[
            make_body("bullet", start, end, ball.faces),
            # Off the bullet's line, so that it does not hit the diagonal between two faces of the wall.
            make_body("wall", wall.vertices + [5.0, 3.5, 0.4], None, wall.faces, is_static=True),
        ],
        self_collision=False,
    )


def cloth_scene(cells: int = 71) -> DemoScene:
    """A rippled square cloth of ``2 cells²`` faces drops onto a sphere of radius 1."""
    steps = np.linspace(-1.5, 1.5, cells + 1)
    x, y = (grid.reshape(-1) for grid in np.meshgrid(steps, steps, indexing="ij"))
    ripple = 0.02 * np.sin(5.0 * x) * np.cos(4.0 * y)
    start = np.column_stack([x, y, 1.15 + ripple])
    # Free fall of the middle while the corners lag: the step deforms the cloth and ends inside the sphere.
    end = np.column_stack([0.99 * x, 0.99 * y, start[:, 2] - 0.35 + 0.05 * (x * x + y * y)])
    corner = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).reshape(-1)
    faces = np.vstack(
        [
            np.column_stack([corner, corner + cells + 1, corner + 1]),
            np.column_stack([corner + 1, corner + cells + 1, corner + cells + 2]),
        ]
    )
    sphere = trimesh.creation.icosphere(subdivisions=4, radius=1.0)
    return DemoScene(
        name="cloth",
        title="cloth over a sphere, one step",
        bodies=[
            make_body("cloth", start, end, faces),
            make_body("sphere", sphere.vertices, None, sphere.faces, is_static=True),
        ],
        self_collision=True,
    )


def run(arguments: argparse.Namespace) -> int:
    """Solve the scenes one after the other; the exit status is 0."""
    start_quietly(arguments.device)
    folder, pictures, is_quiet = arguments.output_dir, arguments.pictures, arguments.quiet
    scenes = (bullet_scene(), cloth_scene())
    for path, option in ((folder, "--output-dir"), (pictures, "--pictures")):
        if path is not None:
            make_folder(path, option)
    for scene in scenes if pictures is not None else ():
        check_picture(pictures / f"{scene.name}.png", "--pictures")
    tell, options = teller(None, is_quiet=is_quiet), given_options(arguments)
    timings = {"load kernels": load_kernels(options, is_quiet=is_quiet)}
    for number, scene in enumerate(scenes, 1):
        make_mesh = partial(mesh_of, self_collision=scene.self_collision)
        step = solve_scene(scene.bodies, options, make_mesh, is_quiet=is_quiet)
        title = f"demo {number}: {scene.title}"
        tell(f"{format_report(title, step, timings | step.timings, is_verbose=arguments.verbose)}\n")
        timings = {}
        if scene.name == "bullet":
            at_start, at_end = _tests_at_both_ends(step)
            tell(f"  test at the start of the step  {at_start}\n  test at the end of the step    {at_end}")
            tell(f"  CCD over the whole step        toi = {format_toi(step.result.toi)}\n")
        if pictures is not None:
            draw_step(pictures / f"{scene.name}.png", step, is_quiet=is_quiet)
        for body in scene.bodies if folder is not None else ():
            for time in (0,) if body.is_static else (0, 1):
                positions = body.vertices_t1 if time else body.vertices_t0
                write_mesh(folder / f"{scene.name}_{body.name}_t{time}.ply", positions, body.faces)
        if folder is not None:
            write_result(folder / f"{scene.name}.json", step)
    for path, what in ((folder, "meshes and results"), (pictures, "pictures")):
        if path is not None:
            tell(f"wrote the {what} to {printable(str(path))}")
    return 0


def _tests_at_both_ends(step: SolvedStep) -> list[str]:
    """What a simulation without CCD finds: whether surfaces cross at the start, and whether they do at the end."""
    with CollisionPipeline.borrowed(step.mesh, step.options) as pipeline:
        found = [pipeline.find_intersections(vertices).num_crossing for vertices in positions_of(step.bodies)]
    return ["HIT" if count else "MISS" for count in found]
