"""A picture of a cut over eight ranks: to whose region each face belongs, and what one of the ranks has.

    python -m ccd_warp.benchmarks.distributed_regions docs/figures/distributed_regions.png

The plan is that of `ccd_warp.distributed`, made in one process as for `distributed_simulation`.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from ccd_warp.benchmarks import scenes
from ccd_warp.benchmarks.virtual_mesh import VirtualMesh, VirtualPlan

from ccd_warp.distributed import _partition as partition
from ccd_warp.distributed._plan import united
from ccd_warp.viz._camera import make_camera
from ccd_warp.viz._file import Picture
from ccd_warp.viz._window import ZOOM, drawn

NUM_RANKS, NUM_FACES = 8, 3_000
_SHOWN = 1  # the rank that is shown alone, whose region lies towards the viewer
_PALETTE = "Set2"  # of eight colours
_PANEL, _MARGINS = (640, 440), (14, 44, 14)
_TOWARDS = (-1.0, -0.62, 0.62)
_TITLE_SIZE, _FINE, _BOLD = 17, 0.5, 1.4
_LIGHT, _DARK = "#909090", "#202020"
_ABSENT = {"color": "#b8b8b8", "style": "wireframe", "opacity": 0.3}
_LOOK = {"ambient": 0.6, "diffuse": 0.6, "specular": 0.0, "reset_camera": False}
_LOOK |= {"smooth_shading": True, "split_sharp_edges": True, "feature_angle": 35.0}  # degrees


def regions_of_faces(mesh: VirtualMesh, plan: VirtualPlan) -> np.ndarray:
    """The rank in whose region each face lies: that of the lower corner of its box."""
    return partition.region_of(plan.regions, united(plan.lower, plan.upper, mesh.faces)[0])


def draw(mesh: VirtualMesh, plan: VirtualPlan) -> Picture:
    """The faces of all ranks, and beside them those of one rank, whose ghosts are outlined in both."""
    import matplotlib

    home = regions_of_faces(mesh, plan)
    colours = (255.0 * np.array(matplotlib.colormaps[_PALETTE].colors)[home]).astype(np.uint8)
    is_here = np.zeros(mesh.num_faces, dtype=bool)
    is_here[plan.items[_SHOWN]["face"]] = True
    is_ghost = is_here & (home != _SHOWN)
    num_own, num_ghosts = np.count_nonzero(is_here & ~is_ghost), np.count_nonzero(is_ghost)
    panels = (
        (f"{mesh.num_faces:,} faces in the colours of {NUM_RANKS} ranks", np.ones(mesh.num_faces, dtype=bool)),
        (f"one rank: {num_own:,} faces of its own, and {num_ghosts:,} ghosts, outlined", is_here),
    )
    view = make_camera(mesh.start, mesh.start, _TOWARDS, _PANEL, _MARGINS)

    def draw_panels(plotter: Any) -> None:
        from ccd_warp.viz._panel import add_lights, aim, write

        for k, (text, is_shown) in enumerate(panels):
            plotter.subplot(0, k)
            add_lights(plotter.renderer)
            aim(plotter.renderer.camera, view)
            plotter.renderer.camera.is_set = True  # PyVista would fit its own view
            for chosen, edge, width in ((is_shown & ~is_ghost, _LIGHT, _FINE), (is_ghost, _DARK, _BOLD)):
                surface = _surface(mesh, chosen)
                surface.cell_data["colour"] = colours[chosen]
                look = {"show_edges": True, "edge_color": edge, "line_width": width * ZOOM}
                plotter.add_mesh(surface, scalars="colour", rgb=True, preference="cell", **look, **_LOOK)
            if not is_shown.all():
                plotter.add_mesh(_surface(mesh, ~is_shown), **_ABSENT, **_LOOK)
            write(plotter.renderer, text, (0.5, 0.93), _TITLE_SIZE * ZOOM, is_centred=True)

    return Picture(drawn((len(panels) * _PANEL[0], _PANEL[1]), len(panels), draw_panels))


def _surface(mesh: VirtualMesh, chosen: np.ndarray) -> Any:
    """Some of the faces."""
    import pyvista

    return pyvista.PolyData.from_regular_faces(mesh.start, mesh.faces[chosen], deep=True)


def main() -> None:
    """Make the plan, and draw it."""
    parser = argparse.ArgumentParser(description="A picture of a cut over eight ranks.")
    parser.add_argument("path", type=Path, help="where the picture goes, PNG")
    options = parser.parse_args()
    mesh = VirtualMesh(scenes.cloth_over_sphere(NUM_FACES))
    plan = VirtualPlan.of(mesh, NUM_RANKS, None, mesh.owners(NUM_RANKS))
    print(draw(mesh, plan).save(options.path))


if __name__ == "__main__":
    main()
