"""The bullet of the literature: it touches no wall at either end of the step, yet it passes through one.

A point flies from x = 0.5 to x = 9.5 at height y = 3.5 within one step. A static wall stands at x = 5 from y = 1 to
y = 6 (here extruded along z, two triangles). A test at the start and at the end of the step finds nothing. Continuous
collision detection covers the whole step: the first contact is at t = 0.5. It is asked here for pairs of one's own, a
vertex and a face each.

    python examples/bullet_through_wall.py

takes some seconds, the loading of the kernels included. With `--output bullet` and `pip install -e '.[viz]'` it draws
bullet/bullet_through_wall.png: the step as the test sees it, and as CCD does.
"""

import argparse
from importlib.util import find_spec
from pathlib import Path

import numpy as np

import ccd_warp as ccd

BULLET_T0, BULLET_T1 = np.array([0.5, 3.5, 0.0]), np.array([9.5, 3.5, 0.0])
WALL = np.array([[5.0, 1.0, -2.0], [5.0, 6.0, -2.0], [5.0, 6.0, 1.0], [5.0, 1.0, 1.0]])
FACES = np.array([[0, 1, 2], [0, 2, 3]])


def test_at_one_instant(point: np.ndarray) -> str:
    """The result of a test at one instant: is the point on the wall's rectangle?"""
    low, high = WALL.min(axis=0), WALL.max(axis=0)
    return "HIT" if ((low <= point) & (point <= high)).all() else "MISS"


def draw(path: Path, toi: float) -> None:
    """Draw the step as a test at its ends sees it, and as CCD does."""
    from ccd_warp.viz import drawing_without_display

    tested = f"tested at t = 0: {test_at_one_instant(BULLET_T0)}, at t = 1: {test_at_one_instant(BULLET_T1)}"
    with drawing_without_display() as pyvista:
        plotter = pyvista.Plotter(off_screen=True, shape=(1, 2), window_size=(1100, 420), border=False)
        plotter.enable_anti_aliasing("ssaa")
        for k, (title, last) in enumerate(((tested, 1.0), (f"CCD: toi = {toi:.3f}", toi))):
            plotter.subplot(0, k)
            wall = pyvista.PolyData.from_regular_faces(WALL, FACES)
            plotter.add_mesh(wall, color="#c9a66b", lighting=False, opacity=0.8)
            places = [BULLET_T0, BULLET_T0 + last * (BULLET_T1 - BULLET_T0)]
            plotter.add_mesh(pyvista.lines_from_points(np.array(places)), color="#555555", line_width=2)
            for place in places:
                plotter.add_mesh(pyvista.Sphere(radius=0.25, center=place), color="#b03030")
            plotter.add_text(title, position=(12, 12), font_size=11, color="#222222")
            plotter.camera_position = [(-1.0, 7.0, 13.0), (5.0, 3.4, -0.5), (0.0, 1.0, 0.0)]
            plotter.background_color = "white"
        plotter.screenshot(path)
        plotter.close()


def main() -> None:
    """Test at both ends, ask CCD, print, and draw."""
    parser = argparse.ArgumentParser(description="A bullet that is in no wall at either end of a step; some seconds.")
    parser.add_argument("--output", type=Path, help="folder for bullet_through_wall.png (none is drawn without)")
    options = parser.parse_args()
    if options.output and find_spec("pyvista") is None:
        parser.error("--output needs pyvista; install it with: pip install 'ccd-warp[viz]'")
    # One query for each triangle: the point, then the triangle's corners; shape [2, 4, 3]. The wall is static.
    points_t0 = np.stack([[BULLET_T0, *WALL[face]] for face in FACES])
    points_t1 = np.stack([[BULLET_T1, *WALL[face]] for face in FACES])
    toi = ccd.vertex_face_ccd(points_t0, points_t1).toi.min()
    x, y, z = BULLET_T0 + toi * (BULLET_T1 - BULLET_T0)
    print("test at the start of the step:", test_at_one_instant(BULLET_T0))
    print("test at the end of the step:  ", test_at_one_instant(BULLET_T1))
    print(f"CCD over the whole step:       toi = {toi:.6f}, where the bullet is at ({x:.3f}, {y:.3f}, {z:.3f})")
    if options.output:
        options.output.mkdir(parents=True, exist_ok=True)
        draw(options.output / "bullet_through_wall.png", toi)


if __name__ == "__main__":
    main()
