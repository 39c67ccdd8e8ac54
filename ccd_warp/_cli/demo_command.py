"""``ccd-warp demo``: the built-in scenes, solved, reported, written and drawn."""

import argparse
from pathlib import Path

from ccd_warp._cli.arguments import given_options
from ccd_warp._cli.demo import DemoScene, bullet_scene, cloth_scene, static_test
from ccd_warp._cli.output import make_folder, write_result
from ccd_warp._cli.pictures import check_picture, draw_step
from ccd_warp._cli.process import start_quietly
from ccd_warp._cli.report import format_report, format_toi
from ccd_warp._cli.scene import SceneArguments
from ccd_warp._cli.solve import SolvedStep, load_kernels, solve_scene
from ccd_warp._files.frames import write_mesh
from ccd_warp._input.messages import printable


def run_demo(arguments: argparse.Namespace) -> int:
    """Solve the scenes one after the other; the exit status is 0."""
    start_quietly(arguments.device)
    folder, pictures = arguments.output_dir, arguments.pictures
    scenes = (bullet_scene(), cloth_scene())
    if folder is not None:
        make_folder(folder, "--output-dir")
    if pictures is not None:
        make_folder(pictures, "--pictures")
        for scene in scenes:
            check_picture(pictures / f"{scene.name}.png", "--pictures")
    options = given_options(arguments)
    timings = {"load kernels": load_kernels(options, is_quiet=arguments.quiet)}
    for number, scene in enumerate(scenes):
        step = solve_scene(
            scene.bodies,
            options,
            scene=SceneArguments(self_collision=scene.self_collision),
            is_quiet=arguments.quiet,
        )
        if not arguments.quiet:
            _print(number, scene, step, {**timings, **step.timings} if number == 0 else step.timings, arguments.verbose)
        if pictures is not None:
            draw_step(pictures / f"{scene.name}.png", step, is_quiet=arguments.quiet)
        if folder is not None:
            _write(folder, scene, step)
    if folder is not None and not arguments.quiet:
        print(f"\nwrote the meshes and results to {printable(str(folder))}")
    if pictures is not None and not arguments.quiet:
        print(f"\nwrote the pictures to {printable(str(pictures))}")
    return 0


def _print(number: int, scene: DemoScene, step: SolvedStep, timings: dict[str, float], is_verbose: bool) -> None:
    if number:
        print()
    print(format_report(f"demo {number + 1}: {scene.title}", step, timings, is_verbose=is_verbose))
    if scene.compare_static_test:
        at_start, at_end = static_test(scene.bodies)
        print()
        print(f"  test at the start of the step  {'HIT' if at_start else 'MISS'}")
        print(f"  test at the end of the step    {'HIT' if at_end else 'MISS'}")
        print(f"  CCD over the whole step        toi = {format_toi(step.result.toi)}")


def _write(folder: Path, scene: DemoScene, step: SolvedStep) -> None:
    for body in scene.bodies:
        write_mesh(folder / f"{scene.name}_{body.name}_t0.ply", body.vertices_t0, body.faces)
        if not body.is_static:
            write_mesh(folder / f"{scene.name}_{body.name}_t1.ply", body.vertices_t1, body.faces)
    write_result(folder / f"{scene.name}.json", step)
