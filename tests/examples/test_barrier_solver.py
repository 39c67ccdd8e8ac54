"""The strip of the example folds in its glass, crosses nothing and comes to rest; with full steps it crosses both."""

import re
import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from conftest import loaded_example

import ccd_warp as ccd

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
# tetrahedra across, deep and along the strip: coarse, so that a step takes a hundredth of a second
CELLS = (1, 2, 20)
NUM_FRAMES, FOLDED = 80, 12


@pytest.fixture(scope="module")
def barrier_solver():
    """The example, on a path as where it runs: it imports what examples share, and one imports another."""
    for name in ("skfem", "igl.copyleft.cgal", "tqdm", "pyvista"):
        pytest.importorskip(name, reason="the extra examples is not installed")
    with pytest.MonkeyPatch.context() as patch, loaded_example("barrier_solver") as module:
        patch.syspath_prepend(EXAMPLES)
        module.CELLS = CELLS
        yield module


class Run(NamedTuple):
    """A scene at its end, the positions after each frame, and the fractions of Newton's steps in each."""

    scene: Any
    positions: list[np.ndarray]
    fractions: list[list[float]]


@pytest.fixture(scope="module")
def fold(barrier_solver):
    """The scene with CCD."""
    scene, positions, fractions = barrier_solver.Fold(), [], []
    for _ in range(NUM_FRAMES):
        fractions.append(scene.advance())
        positions.append(scene.x)
    return Run(scene, positions, fractions)


def crossings(x, mesh):
    """Pairs of an edge and a face without a common vertex that pass through each other, by the signs of volumes."""
    edges, faces = mesh.edges, mesh.faces
    a, b, c = (x[faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    heights = [np.einsum("efx,fx->ef", x[edges[:, k], None] - a, normal) for k in (0, 1)]
    e, f = np.nonzero(heights[0] * heights[1] < 0.0)
    apart = ~(edges[e][:, :, None] == faces[f][:, None]).any(axis=(1, 2))
    e, f = e[apart], f[apart]
    p, way = x[edges[e, 0]], x[edges[e, 1]] - x[edges[e, 0]]
    corners = [y[f] - p for y in (a, b, c)]
    sides = [np.einsum("nx,nx->n", way, np.cross(corners[k], corners[k - 1])) for k in range(3)]
    return int((np.abs(np.sign(sides).sum(axis=0)) == 3).sum())


def test_the_check_sees_a_crossing():
    faces = ([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    through = np.array([[0.2, 0.2, -1.0], [0.2, 0.2, 1.0], [0.4, 0.2, 1.0]])
    for shift, number in ((0.0, 2), (2.0, 0)):
        mesh = ccd.CollisionMesh.from_arrays([faces, (through + [shift, 0, 0], [[0, 1, 2]])])
        assert crossings(mesh.vertices, mesh) == number


def test_nothing_crosses(fold):
    assert [crossings(x, fold.scene.mesh) for x in fold.positions] == NUM_FRAMES * [0]


def test_the_strip_lands_and_folds_in_the_glass(barrier_solver, fold):
    strip = fold.positions[FOLDED][: len(fold.scene.velocity)]
    half = 0.5 * np.array(barrier_solver.GLASS)
    assert (np.abs(strip[:, :2]) < half[:2]).all() and strip[:, 2].min() > 0.0
    assert strip[:, 2].max() < 0.5 * barrier_solver.STRIP[2]
    near = ccd.find_proximity(fold.scene.mesh, fold.positions[FOLDED], barrier_solver.RANGE)
    assert (near.bodies == 0).all(axis=1).any() and (near.bodies == 1).any()  # on itself, and on the glass


def test_newtons_method_converges_in_every_frame(barrier_solver, fold):
    assert max(map(len, fold.fractions)) < barrier_solver.MOST_ITERATIONS
    assert all(0.0 < fraction <= 1.0 for fractions in fold.fractions for fraction in fractions)


def test_the_strip_comes_to_rest(fold):
    # the start of the last step is its end, within the tolerance
    assert fold.fractions[-1] == [] and not fold.scene.velocity.any()


def test_full_steps_cross(barrier_solver):
    scene = barrier_solver.Fold()
    scene.contact.free_step = lambda x, end: 1.0
    for _ in range(FOLDED):
        scene.advance()
    assert crossings(scene.x, scene.mesh) > 0


def test_gradients_are_derivatives_of_energies(barrier_solver, fold):
    scene, positions, _ = fold
    x = positions[4]
    direction = np.random.default_rng(0).normal(size=x.shape)
    direction[len(scene.velocity) :] = 0.0
    aim = positions[3][: len(scene.velocity)]

    def energies(t):
        energy, *_ = scene.state(x + t * direction, aim)
        barrier = scene.contact.energy(x + t * direction)[0]
        return np.array([energy - barrier, barrier])

    _, force, fields, near = scene.state(x, aim)
    strip = force + barrier_solver.GRADIENT.assemble(scene.basis, **fields)
    push, stiffness = scene.contact.derivatives(*near)
    assert (near[1] < 1.0).any()  # some edges are nearly parallel
    slopes = [strip @ direction.ravel()[: strip.size], push @ direction.ravel()]
    step = 1e-8  # of distances of 1e-3: the third derivative leaves 1e-8 of the slope, and rounding as much
    np.testing.assert_allclose((energies(step) - energies(-step)) / (2.0 * step), slopes, rtol=1e-5)
    assert np.linalg.eigvalsh(stiffness.toarray()).min() > -1e-9 * abs(stiffness).max()


def test_ipctk_has_the_same_energy_and_gradient(barrier_solver, fold):
    pytest.importorskip("ipctk", reason="the extra bench is not installed")
    scene, positions, _ = fold
    with loaded_example("barrier_ipctk") as module:
        theirs = module.IpctkBarrier(scene.mesh)
        for x in positions[2::4]:
            ours = scene.contact.energy(x)
            other = theirs.energy(x)
            # both add up some hundred terms, each rounded as its distance is, by 1e-16 of 0.6 over 1e-4 or more
            assert ours[0] == pytest.approx(other[0], rel=1e-10)
            moving = slice(scene.velocity.size)
            push, expected = scene.contact.derivatives(*ours[1])[0][moving], theirs.derivatives(*other[1])[0][moving]
            np.testing.assert_allclose(push, expected, rtol=0.0, atol=1e-10 * np.abs(expected).max())


def test_both_codes_agree_until_the_strip_buckles(barrier_solver, monkeypatch, capsys, tmp_path):
    pytest.importorskip("ipctk", reason="the extra bench is not installed")
    monkeypatch.setattr(sys, "argv", ["barrier_ipctk.py", "--frames", "4", "--output", str(tmp_path)])
    with loaded_example("barrier_ipctk") as module:
        module.main()
    output = capsys.readouterr().out
    assert all(f"{name}: 4 frames, 0 with faces that cross" in output for name in ("ccd_warp", "ipctk"))
    assert (tmp_path / "barrier_ipctk.png").stat().st_size > 10_000
    # both stop where the next step is less than this in a frame, and converge at least linearly
    tolerance = 1e3 * barrier_solver.TOLERANCE * barrier_solver.FRAME_TIME
    assert float(re.search(r"^at most (\S+) mm apart", output, re.MULTILINE)[1]) < 100.0 * tolerance


def test_it_prints_what_it_finds_and_draws(barrier_solver, monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(sys, "argv", ["barrier_solver.py", "--frames", "4", "--output", str(tmp_path)])
    barrier_solver.main()
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "with CCD: 4 frames, 0 with faces that cross, at most 0 pairs"
    assert re.match(r"without CCD: 4 frames, [1-4] with faces that cross, at most [1-9]", lines[3])
    assert (tmp_path / "barrier_solver.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("missing", "example", "extra"),
    [
        ("skfem", "barrier_solver", "examples"),
        ("ipctk", "barrier_ipctk", "bench"),
    ],
)
def test_a_missing_extra_is_named(barrier_solver, monkeypatch, missing, example, extra):
    monkeypatch.setitem(sys.modules, missing, None)
    monkeypatch.setitem(sys.modules, example, barrier_solver)  # what the import leaves behind is taken away
    with pytest.raises(SystemExit, match=rf"pip install 'ccd-warp\[{extra}\]'"), loaded_example(example):
        pass
