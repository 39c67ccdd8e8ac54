"""Draw the demo's scenes for README and docs: ``python docs/make_pictures.py``, with ``pip install -e '.[viz]'``."""

from pathlib import Path

import numpy as np

import ccd_warp as ccd
from ccd_warp import viz
from ccd_warp._cli.demo import DemoScene, bullet_scene, cloth_scene

FIGURES = Path(__file__).parent / "figures"


def draw(scene: DemoScene) -> Path:
    mesh = ccd.CollisionMesh.from_arrays(
        [(body.vertices_t0, body.faces) for body in scene.bodies],
        static=[k for k, body in enumerate(scene.bodies) if body.is_static],
        self_collision=scene.self_collision,
        names=[body.name for body in scene.bodies],
    )
    vertices_t0, vertices_t1 = (
        np.vstack([getattr(body, frame) for body in scene.bodies]) for frame in ("vertices_t0", "vertices_t1")
    )
    result = ccd.mesh_ccd(mesh, vertices_t0, vertices_t1)
    path = FIGURES / f"demo_{scene.name}.png"
    viz.render_step(mesh, vertices_t0, vertices_t1, result, path)
    return path


def main() -> None:
    FIGURES.mkdir(exist_ok=True)
    for scene in (bullet_scene(), cloth_scene()):
        path = draw(scene)
        print(f"{path.relative_to(FIGURES.parent)}  {path.stat().st_size // 1000} kB")


if __name__ == "__main__":
    main()
