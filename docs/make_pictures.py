"""Draw the pictures of the README: ``python docs/make_pictures.py [FOLDER]``, with ``pip install -e '.[viz]'``.

One is of the demo's cloth; the other of the first block of Python that the README has, run as it stands.
"""

import contextlib
import io
import re
import sys
from pathlib import Path

import ccd_warp as ccd
from ccd_warp import viz
from ccd_warp._cli.demo import DemoScene, cloth_scene

ROOT = Path(__file__).resolve().parents[1]
FIGURES = ROOT / "docs" / "figures"


def draw_scene(scene: DemoScene, path: Path) -> None:
    frames = scene.frames
    result = ccd.mesh_ccd(frames.mesh, frames.vertices_t0, frames.vertices_t1)
    viz.render_step(frames.mesh, frames.vertices_t0, frames.vertices_t1, result, path)


def draw_first_block(page: Path, path: Path) -> None:
    """Run the first block of Python of a page, which leaves a mesh, its positions and a result, and draw these."""
    block = re.search(r"^```python\n(.*?)^```$", page.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    assert block is not None, page
    left: dict[str, object] = {}
    with contextlib.redirect_stdout(io.StringIO()):
        exec(compile(block[1], page.name, "exec"), left)
    viz.render_step(*(left[name] for name in ("mesh", "start", "end", "result")), path)  # type: ignore[arg-type]


def main() -> None:
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else FIGURES)
    draw_scene(cloth_scene(), folder / "demo_cloth.png")
    draw_first_block(ROOT / "README.md", folder / "readme_bullet.png")
    for name in ("demo_cloth.png", "readme_bullet.png"):
        print(f"{name}  {(folder / name).stat().st_size // 1000} kB")


if __name__ == "__main__":
    main()
