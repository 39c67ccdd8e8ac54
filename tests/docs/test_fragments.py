"""Fragments of the pages, marked `python3`, run as they stand between what they need and what they promise.

A block marked `python` stands for itself, and `test_docs.py` runs it. A fragment names things that its page only tells
of: files, another program's objects, the positions of a rank. No other Python is on a page.
"""

import ast
import itertools
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh
import warp as wp

import ccd_warp as ccd

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
FENCE = re.compile(r"^( *)```([\w-]*)\n(.*?)^ *```$", re.DOTALL | re.MULTILINE)
Names = dict[str, Any]
Setup = Callable[[Path], Iterator[Names]]
SETUPS: dict[str, Setup] = {}


def before(first_line: str) -> Callable[[Setup], Setup]:
    """Registers what comes before and after the fragment that begins with a line."""

    def register(setup: Setup) -> Setup:
        SETUPS[first_line] = setup
        return setup

    return register


def box(size: Any = (1.0, 1.0, 1.0), at: Any = (0.0, 0.0, 0.0)) -> trimesh.Trimesh:
    return trimesh.creation.box(extents=size, transform=trimesh.transformations.translation_matrix(at))


@before('sequence = ccd.read_poses("robot.obj", "path.json", static=["shelf.ply"])')
def _poses(folder: Path) -> Iterator[Names]:
    (folder / "robot.obj").write_text("o arm\n" + trimesh.exchange.obj.export_obj(box((0.1, 0.1, 1.0)), header=None))
    box((2.0, 2.0, 0.1), (0, 0, -1.0)).export(folder / "shelf.ply")
    rows = [
        f'{{"t": {t}, "body": 0, "px": 0, "py": 0, "pz": {-t}, "qx": 0, "qy": 0, "qz": 0, "qw": 1}}' for t in (0, 1)
    ]
    (folder / "path.json").write_text(f"[{', '.join(rows)}]")
    names: Names = {"ccd": ccd}
    yield names
    assert names["mesh"].rigid.tolist() == [True, False] and names["time"] == 0.0


@before('sequence = ccd.read_sequence("flag.pvd", surface=True, displacement="U", static=["wall.ply"])')
def _sequence(folder: Path) -> Iterator[Names]:
    meshio = pytest.importorskip("meshio", reason="the extra examples is not installed")
    nodes = np.array(list(itertools.product((0.0, 1.0), repeat=3)))
    hexahedron = [("hexahedron", np.array([[0, 4, 6, 2, 1, 5, 7, 3]]))]
    entries = ""
    for k in range(3):
        moved = np.tile([[2.0 * k, 0, 0]], (8, 1))
        meshio.Mesh(nodes, hexahedron, point_data={"U": moved}).write(folder / f"flag_{k}.vtu")
        entries += f'<DataSet timestep="{0.5 * k}" part="0" file="flag_{k}.vtu"/>'
    (folder / "flag.pvd").write_text(f'<VTKFile type="Collection"><Collection>{entries}</Collection></VTKFile>')
    box((0.1, 3.0, 3.0), (4.0, 0.5, 0.5)).export(folder / "wall.ply")
    names: Names = {"ccd": ccd, "itertools": itertools}
    yield names
    assert names["time"] == 0.5 and 0.4 < names["pipeline"].mesh_ccd(names["x0"], names["x1"]).toi < 0.5


@before("from mpi4py import MPI")
def _ranks(_: Path) -> Iterator[Names]:
    pytest.importorskip(
        "mpi4py.MPI", reason="the extra mpi, or an MPI, is not installed", exc_type=(ImportError, RuntimeError)
    )
    falling, floor = box(at=(0, 0, 1.0)), box((3.0, 3.0, 0.1))
    whole = ccd.CollisionMesh.from_arrays([(each.vertices, each.faces) for each in (falling, floor)], static=[1])
    end = whole.vertices - [0, 0, 1.0] * (whole.vertex_body == 0)[:, None]
    names: Names = {"vertices": whole.vertices, "faces": whole.faces, "ids": np.arange(whole.num_vertices)}
    names |= {"bodies": whole.vertex_body, "vertices_t0": whole.vertices, "vertices_t1": end}
    yield names
    assert names["result"].toi == ccd.mesh_ccd(whole, whole.vertices, end).toi < 1.0 and len(names["every"]) > 0


@before("import ccd_warp.torch")
def _torch(_: Path) -> Iterator[Names]:
    torch = pytest.importorskip("torch", reason="the extra interop is not installed")
    falling, floor = box(at=(0, 0, 1.0)), box((3.0, 3.0, 0.1))
    mesh = ccd.CollisionMesh.from_arrays([(each.vertices, each.faces) for each in (falling, floor)], static=[1])
    x = torch.tensor(mesh.vertices, dtype=torch.float64)
    dx = torch.tensor([0, 0, -1.0]) * torch.tensor(mesh.vertex_body == 0)[:, None].double()
    dx.requires_grad_()
    names: Names = {"pipeline": ccd.CollisionPipeline(mesh, device="cpu"), "x": x, "dx": dx}
    yield names
    assert 0.0 < names["step"].item() < 1.0 and torch.isfinite(dx.grad).all() and dx.grad.abs().sum() > 0


@before("stream = torch.cuda.Stream()")
def _stream(_: Path) -> Iterator[Names]:
    torch = pytest.importorskip("torch", reason="the extra interop is not installed")
    if not (wp.is_cuda_available() and torch.cuda.is_available()):
        pytest.skip("needs a GPU")
    filled = wp.zeros(3, dtype=float, device="cuda")
    with wp.ScopedCapture(device="cuda") as capture:
        filled.fill_(1.0)
    yield {"torch": torch, "wp": wp, "graph": capture.graph}
    torch.cuda.synchronize()
    assert filled.numpy().tolist() == [1.0] * 3


def two_boxes() -> Names:
    """A box that falls a metre on another, by how python-fcl and drake name things."""
    names: Names = {"np": np, "ccd": ccd}
    for name, start, end in (("a", (0, 0, 1.5), (0, 0, 0.5)), ("b", (0, 0, 0), (0, 0, 0))):
        names |= {f"vertices_{name}": box().vertices, f"faces_{name}": box().faces}
        names |= {f"position_{name}{k}": np.array(x, float) for k, x in enumerate((start, end))}
        names |= {f"quaternion_{name}{k}": np.array([1.0, 0, 0, 0]) for k in range(2)}
    return names


@before("request = fcl.ContinuousCollisionRequest(")
def _fcl(_: Path) -> Iterator[Names]:
    fcl = pytest.importorskip("fcl", reason="the extra rigid-peers is not installed")
    names = two_boxes() | {"fcl": fcl}
    for name in "ab":
        names[f"model_{name}"] = model = fcl.BVHModel()
        model.beginModel(12, 8)
        model.addSubModel(names[f"vertices_{name}"], names[f"faces_{name}"])
        model.endModel()
    yield names
    assert 0.5 <= names["stop"] < 0.51


@before("mesh = ccd.CollisionMesh.from_arrays([(vertices_a, faces_a), (vertices_b, faces_b)], rigid=[0, 1])")
def _not_fcl(_: Path) -> Iterator[Names]:
    names = two_boxes()
    yield names
    assert 0.5 - 1e-9 < names["stop"] <= 0.5


def drake() -> Names:
    """A box that floats above another one in a plant of drake."""
    pytest.importorskip("pydrake", reason="the extra rigid-peers is not installed")
    from pydrake.geometry import Box
    from pydrake.math import RigidTransform
    from pydrake.multibody.plant import CoulombFriction
    from pydrake.multibody.tree import SpatialInertia
    from pydrake.planning import RobotDiagramBuilder, SceneGraphCollisionChecker

    builder = RobotDiagramBuilder()
    plant = builder.plant()
    robot = plant.AddModelInstance("robot")
    body = plant.AddRigidBody("body", robot, SpatialInertia.SolidSphereWithMass(1.0, 0.01))
    for of, name in ((body, "body"), (plant.world_body(), "obstacle")):
        plant.RegisterCollisionGeometry(of, RigidTransform(), Box(1.0, 1.0, 1.0), name, CoulombFriction(1.0, 1.0))
    plant.Finalize()
    model = builder.Build()
    checker = SceneGraphCollisionChecker(model=model, robot_model_instances=[robot], edge_step_size=0.1)
    ends = {f"q{k}": np.array([1.0, 0, 0, 0, 0, 0, z]) for k, z in enumerate((1.5, 0.5))}
    context = plant.CreateDefaultContext()
    return {
        "checker": checker,
        "plant": plant,
        "context": context,
        "bodies": [body, plant.world_body()],
        "np": np,
        "ccd": ccd,
        **ends,
    }


@before("free = checker.CheckEdgeCollisionFree(q0, q1)  # at steps of edge_step_size")
def _drake(_: Path) -> Iterator[Names]:
    names = drake()
    yield names
    assert names["free"] is False


@before("def poses(q):")
def _not_drake(_: Path) -> Iterator[Names]:
    names = drake()
    bodies = [(box().vertices, box().faces)] * 2
    names["mesh"] = ccd.CollisionMesh.from_arrays(bodies, rigid=[0, 1])
    yield names
    assert not names["free"] and 0.5 - 1e-9 < names["result"].toi <= 0.5


@before("solver.step(state_0, state_1, control, contacts, dt)")
def _newton(_: Path) -> Iterator[Names]:
    bodies = [(box().vertices, box().faces)] * 2
    mesh = ccd.CollisionMesh.from_arrays(bodies, rigid=[0], static=[1])
    states = [SimpleNamespace(body_q=wp.array([[0, 0, 1.5, 0, 0, 0, 1]], dtype=wp.transform)) for _ in range(2)]

    def step(_: Any, after: Any, *__: Any) -> None:
        after.body_q.assign(np.array([[0, 0, 0.5, 0, 0, 0, 1]], dtype=np.float32))

    names: Names = dict(zip(("state_0", "state_1"), states, strict=True)) | {"np": np, "ccd": ccd, "mesh": mesh}
    names |= {"solver": SimpleNamespace(step=step), "control": None, "contacts": None, "dt": 0.01}
    names |= {"model": SimpleNamespace(body_com=wp.zeros(1, dtype=wp.vec3)), "x0": mesh.vertices, "x1": mesh.vertices}
    yield names
    assert states[1].body_q.numpy()[0, 2] == pytest.approx(1.0, abs=1e-6)  # float32, of a fall of a metre


def _fragments() -> list[Any]:
    found = []
    for page in PAGES:
        for indent, language, text in FENCE.findall(page.read_text(encoding="utf-8")):
            if language == "python3":
                code = re.sub(f"^{indent}", "", text, flags=re.MULTILINE)
                found.append(pytest.param(code, id=f"{page.name}-{code.splitlines()[0][:40]}"))
    return found


@pytest.mark.parametrize("code", _fragments())
def test_a_fragment_runs_as_it_stands(code, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    around = SETUPS[code.splitlines()[0]](tmp_path)
    names = next(around)
    exec(compile(code, "fragment", "exec"), names)
    assert next(around, None) is None


def test_what_is_prepared_is_of_a_fragment():
    assert SETUPS.keys() == {param.values[0].splitlines()[0] for param in _fragments()}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_no_python_hides_in_a_fence_that_nothing_runs(page):
    """What a block prints may look like Python, and stands after its words."""
    text = page.read_text(encoding="utf-8")
    for fence in FENCE.finditer(text):
        if fence[2] in ("python", "python3", "sh") or re.search(r"It prints:\n+$", text[: fence.start()]):
            continue
        try:
            nodes = ast.walk(ast.parse(re.sub(f"^{fence[1]}", "", fence[3], flags=re.MULTILINE)))
        except SyntaxError:
            continue
        assert not any(isinstance(node, (ast.Call, ast.Assign, ast.Import, ast.ImportFrom)) for node in nodes), fence[0]
