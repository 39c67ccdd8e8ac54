"""The leaflets of the example never cross and open again with CCD, and hook into each other without; and its flow."""

import itertools
import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from conftest import loaded_example

NUM_FRAMES = 42  # of 24 to a beat: closed, open and about to close again
COARSE = {"COLUMNS": 36, "ROWS": 12, "SEGMENTS": 20}


@pytest.fixture(scope="module")
def valve():
    for name in ("skfem", "matplotlib", "tqdm"):
        pytest.importorskip(name, reason="the extra examples is not installed")
    with loaded_example("valve") as module:
        vars(module).update(COARSE)
        yield module


@pytest.fixture(scope="module")
def flow(valve):
    return valve.Flow()


def crossings(segments):
    """Pairs of segments that cross, in rational arithmetic."""

    def side(a, b, c):
        (ax, ay), (bx, by), (cx, cy) = (map(Fraction, point) for point in (a, b, c))
        return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)

    count = 0
    for (a, b), (c, d) in itertools.combinations(segments.tolist(), 2):
        apart = any(max(a[k], b[k]) < min(c[k], d[k]) or max(c[k], d[k]) < min(a[k], b[k]) for k in (0, 1))
        if not apart and side(a, b, c) * side(a, b, d) < 0 and side(c, d, a) * side(c, d, b) < 0:
            count += 1
    return count


def run(module, flow, with_ccd):
    """After each frame: crossings, the opening at the tips, what flows in, and what flows out."""
    scene = module.Valve(flow, with_ccd=with_ccd)
    facets = flow.basis.mesh.facets_satisfying(lambda p: p[0] > module.LENGTH - 1e-9)
    outlet = module.fem.LinearForm(lambda v, w: v).assemble(flow.basis.boundary(facets))
    table = []
    for _ in range(NUM_FRAMES):
        scene.advance()
        count = crossings(scene.x[scene.mesh.edges])
        assert module.num_crossings(scene.mesh, scene.x) == count
        # they stay in the channel, and hardly stretch
        assert (np.abs(scene.x[scene.moves, 1]) < module.half_width(scene.x[scene.moves, 0])).all()
        assert np.abs(np.linalg.norm(scene.ways @ scene.x, axis=1) / scene.rest - 1.0).max() < 0.05
        if with_ccd:  # and keep their thickness
            least = scene.pipeline.find_proximity(scene.x, module.KEEP).distance.min(initial=np.inf)
            assert least > 2 * module.RADIUS * (1 - 1e-9)
        opening = scene.x[-1, 1] - scene.x[module.SEGMENTS, 1]
        table.append([count, opening, flow.inlet @ flow.u[0], outlet @ flow.u[0]])
    return np.array(table).T


def test_leaflets_never_cross_and_open_again(valve, flow):
    count, opening, inflow, outflow = run(valve, flow, True)
    assert count.max() == 0
    closed, opened = opening[18:26], opening[24 + 6 : 24 + 12]
    assert opening[:12].max() > 0.5 and closed.min() < 0.05 and opened.max() > 0.5
    # as much flows out as flows in; 1e-9 of the pressure is what the fluid can be compressed by
    np.testing.assert_allclose(inflow, outflow, atol=1e-6 * np.abs(inflow).max())
    # it is a valve: without leaflets as much would flow back as forth; and it opens for as much in every beat
    assert -inflow.clip(max=0.0).sum() < 0.15 * inflow.clip(min=0.0).sum()
    assert inflow[24:].max() > 0.8 * inflow[:24].max()


def test_leaflets_cross_without_ccd_and_the_valve_stays_shut(valve, flow):
    count, opening, inflow, _ = run(valve, flow, False)
    assert count[:18].max() == 0 and count[24:].min() > 0
    assert opening[24:].max() < 0.0 and np.abs(inflow[24:]).max() < 0.1 * inflow[:24].max()


def test_a_flow_between_plates_is_that_of_poiseuille(valve, monkeypatch):
    monkeypatch.setattr(valve, "half_width", lambda x: 0.5 + 0.0 * x)
    monkeypatch.setattr(valve, "PER_BEAT", 1)
    flow, pressure = valve.Flow(), 3.0
    for _ in range(60):  # what is not yet steady fades by 1 + π² ν dt = 1.39 a frame
        flow.u = flow.solve(flow.load(pressure))
    y = flow.nodes[1]
    speed = pressure / (2.0 * valve.VISCOSITY * valve.LENGTH) * (0.25 - y**2)
    np.testing.assert_allclose(flow.u, [speed, 0.0 * y], atol=1e-6 * speed.max())


def test_the_program_prints_and_draws_both_runs(valve, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(sys, "argv", ["valve.py", "--frames", "24", "--output", str(tmp_path / "out")])
    valve.main()
    output = capsys.readouterr().out
    assert "with CCD: 24 frames, 0 with crossings\n  beat 1:" in output
    assert "without CCD: 24 frames" in output and "without CCD: 24 frames, 0 with" not in output
    assert (tmp_path / "out" / "valve.png").read_bytes().startswith(b"\x89PNG")


def test_what_is_missing_is_named(tmp_path):
    program = Path(__file__).resolve().parents[2] / "examples" / "valve.py"
    code = f"import runpy, sys; sys.modules['skfem'] = None; runpy.run_path({str(program)!r}, run_name='__main__')"
    done = subprocess.run([sys.executable, "-P", "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr == "valve.py needs skfem; install with: pip install -e '.[examples]'\n"
