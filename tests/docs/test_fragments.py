"""Fragments of the pages, marked `python3`, run as they stand between what they need and what they promise.

A block marked `python` stands for itself, and `test_docs.py` runs it. A fragment names what its page only tells of,
another program's objects or a tensor. Those that call another program alone are only parsed.
"""

import ast
import re
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh
import warp as wp

import ccd_warp as ccd

ROOT = Path(__file__).resolve().parents[2]
FRAGMENT = re.compile(r"^( *)```python3\n(.*?)^ *```$", re.DOTALL | re.MULTILINE)
BOX = trimesh.creation.box()
OF_OTHERS = ("request = fcl.ContinuousCollisionRequest(", "free = checker.CheckEdgeCollisionFree(q0, q1)", "stream = ")
Names = dict[str, Any]


def _torch() -> tuple[Names, Callable[[Names], bool]]:
    torch = pytest.importorskip("torch", reason="the extra interop is not installed")
    mesh = ccd.CollisionMesh.from_arrays([(BOX.vertices + [0, 0, 2], BOX.faces), (BOX.vertices, BOX.faces)], static=[1])
    dx = torch.tensor([0, 0, -2.0]) * torch.tensor(mesh.vertex_body == 0)[:, None].double()
    dx.requires_grad_()
    names = {"pipeline": ccd.CollisionPipeline(mesh), "x": torch.tensor(mesh.vertices), "dx": dx}
    return names, lambda names: 0.0 < names["step"].item() < 1.0 and bool(dx.grad.abs().sum() > 0)


def _fcl() -> tuple[Names, Callable[[Names], bool]]:
    """A box that falls a metre on another, by how python-fcl names things."""
    names: Names = {}
    for name, start, end in (("a", (0, 0, 1.5), (0, 0, 0.5)), ("b", (0, 0, 0), (0, 0, 0))):
        names |= {f"vertices_{name}": BOX.vertices, f"faces_{name}": BOX.faces}
        names |= {f"position_{name}{k}": np.array(x, float) for k, x in enumerate((start, end))}
        names |= {f"quaternion_{name}{k}": np.array([1.0, 0, 0, 0]) for k in range(2)}
    return names, lambda names: 0.5 - 1e-9 < names["stop"] <= 0.5


def _drake() -> tuple[Names, Callable[[Names], bool]]:
    """A plant that gives poses as Drake does."""
    plant = SimpleNamespace(SetPositions=lambda context, q: context.update(q=q))

    def pose(context: Names, body: int) -> Any:
        height = context["q"] if body == 0 else 0.0
        return SimpleNamespace(GetAsMatrix4=lambda: trimesh.transformations.translation_matrix([0, 0, height]))

    plant.EvalBodyPoseInWorld = pose
    mesh = ccd.CollisionMesh.from_arrays([(BOX.vertices, BOX.faces)] * 2, rigid=[0, 1])
    names = {"plant": plant, "context": {}, "bodies": [0, 1], "q0": 1.5, "q1": 0.5, "mesh": mesh}
    return names, lambda names: not names["free"] and 0.5 - 1e-9 < names["result"].toi <= 0.5


def _newton() -> tuple[Names, Callable[[Names], bool]]:
    mesh = ccd.CollisionMesh.from_arrays([(BOX.vertices, BOX.faces)] * 2, rigid=[0], static=[1])
    states = [SimpleNamespace(body_q=wp.array([[0, 0, 1.5, 0, 0, 0, 1]], dtype=wp.transform)) for _ in range(2)]
    fallen = np.array([[0, 0, 0.5, 0, 0, 0, 1]], dtype=np.float32)
    names = {"solver": SimpleNamespace(step=lambda _, after, *__: after.body_q.assign(fallen)), "mesh": mesh}
    names |= {"state_0": states[0], "state_1": states[1], "control": None, "contacts": None, "dt": 0.01}
    names |= {"model": SimpleNamespace(body_com=wp.zeros(1, dtype=wp.vec3)), "x0": mesh.vertices, "x1": mesh.vertices}
    # float32, of a fall of a metre
    return names, lambda names: states[1].body_q.numpy()[0, 2] == pytest.approx(1.0, abs=1e-6)


# What comes before and after the fragment that begins with a line.
AROUND = {
    "import ccd_warp.torch": _torch,
    "mesh = ccd.CollisionMesh.from_arrays([(vertices_a, faces_a), (vertices_b, faces_b)], rigid=[0, 1])": _fcl,
    "def poses(q):": _drake,
    "solver.step(state_0, state_1, control, contacts, dt)": _newton,
}
FRAGMENTS = [
    pytest.param(re.sub(f"^{indent}", "", code, flags=re.MULTILINE), id=f"{page.name}-{code.split(chr(10))[0][:40]}")
    for page in sorted((ROOT / "docs").rglob("*.md"))
    for indent, code in FRAGMENT.findall(page.read_text(encoding="utf-8"))
]


@pytest.mark.parametrize("code", FRAGMENTS)
def test_a_fragment_runs_as_it_stands(code):
    if code.startswith(OF_OTHERS):
        ast.parse(code)
        return
    names, promised = AROUND[code.splitlines()[0]]()
    names |= {"np": np, "ccd": ccd}
    exec(compile(code, "fragment", "exec"), names)
    assert promised(names)
