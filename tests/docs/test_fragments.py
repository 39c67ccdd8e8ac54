"""Fragments of the pages, marked `python3`, run as they stand between what they need and what they promise.

A block marked `python` stands for itself, and `test_docs.py` runs it. A fragment names what its page only tells of,
another program's objects or a tensor. One that calls another program alone is only parsed.
"""

import ast
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
import warp as wp

import ccd_warp as ccd

FRAGMENT = re.compile(r"^( *)```python3\n(.*?)^ *```$", re.DOTALL | re.MULTILINE)
BOX = trimesh.creation.box()
FRAGMENTS = [
    pytest.param(re.sub(f"^{indent}", "", code, flags=re.MULTILINE), id=f"{page.name}-{code.split(chr(10))[0][:40]}")
    for page in sorted((Path(__file__).resolve().parents[2] / "docs").rglob("*.md"))
    for indent, code in FRAGMENT.findall(page.read_text(encoding="utf-8"))
]


def boxes(height, **options):
    bodies = [(BOX.vertices + [0, 0, z], BOX.faces) for z in (height, 0.0)]
    return ccd.CollisionMesh.from_arrays(bodies, **options)


def of_torch():
    torch = pytest.importorskip("torch", reason="the extra interop is not installed")
    mesh = boxes(2.0, static=[1])
    dx = torch.tensor([0, 0, -2.0]) * torch.tensor(mesh.vertex_body == 0)[:, None].double()
    dx.requires_grad_()
    names = {"pipeline": ccd.CollisionPipeline(mesh), "x": torch.tensor(mesh.vertices), "dx": dx}
    return names, lambda names: 0.0 < names["step"].item() < 1.0 and bool(dx.grad.abs().sum() > 0)


def of_throws():
    pytest.importorskip("torch", reason="the extra interop is not installed")
    return {}, lambda names: (names["off"] < 1e-6).sum() > 900


def of_fcl():
    """A box that falls a metre on another, by how python-fcl names things."""
    names = {}
    for name, heights in (("a", (1.5, 0.5)), ("b", (0.0, 0.0))):
        names |= {f"vertices_{name}": BOX.vertices, f"faces_{name}": BOX.faces}
        names |= {f"position_{name}{k}": np.array([0, 0, z]) for k, z in enumerate(heights)}
        names |= {f"quaternion_{name}{k}": np.array([1.0, 0, 0, 0]) for k in range(2)}
    return names, lambda names: 0.5 - 1e-9 < names["stop"] <= 0.5


def of_newton():
    mesh = boxes(0.0, rigid=[0], static=[1])
    before, after = (SimpleNamespace(body_q=wp.array([[0, 0, 1.5, 0, 0, 0, 1]], dtype=wp.transform)) for _ in range(2))
    fallen = np.array([[0, 0, 0.5, 0, 0, 0, 1]], dtype=np.float32)
    names = {"solver": SimpleNamespace(step=lambda *_: after.body_q.assign(fallen)), "mesh": mesh, "dt": 0.01}
    names |= {"state_0": before, "state_1": after, "x0": mesh.vertices, "x1": mesh.vertices}
    names |= {"model": SimpleNamespace(body_com=wp.zeros(1, dtype=wp.vec3)), "control": None, "contacts": None}
    # float32, of a fall of a metre
    return names, lambda names: after.body_q.numpy()[0, 2] == pytest.approx(1.0, abs=1e-6)


# What comes before and after the fragment that begins so.
AROUND = {"import ccd_warp.torch": of_torch, "mesh = ccd.": of_fcl, "solver.step(": of_newton, "stream = torch": None}
AROUND |= {"import torch": of_throws}


@pytest.mark.parametrize("code", FRAGMENTS)
def test_a_fragment_runs_as_it_stands(code):
    (around,) = [around for begin, around in AROUND.items() if code.startswith(begin)]
    if around is None:
        ast.parse(code)
        return
    names, promised = around()
    names |= {"np": np, "ccd": ccd}
    exec(compile(code, "fragment", "exec"), names)
    assert promised(names)
