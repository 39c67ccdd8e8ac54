"""The command `ccd-warp sequence`: every step of a sequence of frames, also where it is interrupted."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from mesh_files import ply

import ccd_warp as ccd
from ccd_warp._cli import solve as solve_module
from ccd_warp._cli.command import main

SHAPE, FLOOR = trimesh.creation.icosphere(subdivisions=1, radius=0.5), trimesh.creation.box(extents=(4.0, 4.0, 1.0))
FALL = [SHAPE.vertices + [0.1, 0.2, 3.25 - 0.5 * k] for k in range(11)]
BALLS = [f"ball_{k}.ply" for k in sorted(range(11), key=str)]  # as a shell lists them: 10 before 2
ON = ["--static", "floor.ply"]


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """Eleven frames of a ball that falls onto a box in the step from frame 5 to frame 6, and the box."""
    for k, vertices in enumerate(FALL):
        (tmp_path / f"ball_{k}.ply").write_bytes(ply(vertices, SHAPE.faces))
    (tmp_path / "floor.ply").write_bytes(ply(FLOOR.vertices - [0.0, 0.0, 0.5], FLOOR.faces))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(*arguments, status=0):
    assert main(["sequence", *map(str, arguments)]) == status


def rows(folder):
    with open(f"{folder}/steps.csv", newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


# Beside others, for each drawn sequence one of these.
OPTIONS = [
    {"minimum_separation": 0.01, "num_threads": 1},
    {"precision": "float32", "t_max": 0.5, "minimum_distance": 0.25, "start_gap_fraction": 0.5},
    {"method": "bisection", "broad_phase": "hash", "max_work": 100},
    {"pair_kinds": ["edge_edge"], "memory_limit": 64_000_000},
    {},
]


def _drawn(seed):
    """Frames of four triangles, and options: in families that rest, that meet on a grid, and any."""
    rng = np.random.default_rng(seed)
    first = rng.integers(-2, 3, (12, 3)) if seed % 3 == 1 else rng.uniform(-2, 2, (12, 3))
    steps = rng.integers(-1, 2, (int(rng.integers(1, 4)), 4, 3)) * (seed % 3 > 0) * rng.integers(0, 2, (4, 1))
    frames = [first, *(first + np.repeat(np.cumsum(steps, axis=0), 3, axis=1))]
    options = {"length_scale": 1.0, "max_iterations": int(rng.choice([2, 10_000])), "tolerance": 1e-9}
    return frames, options | OPTIONS[seed % 5]


def _expected(step, result):
    """The numbers of a row, as the library counts them."""
    crossing = int(ccd.find_intersections(step.mesh, step.vertices_t0).is_crossing.sum())
    kinds = [int((result.contacts.kind == kind).sum()) for kind in (ccd.PairKind.VERTEX_FACE, ccd.PairKind.EDGE_EDGE)]
    at_start = int((result.contacts.status == ccd.CCDStatus.INITIAL_CONTACT).sum())
    at_limit = int((result.contacts.status >= ccd.CCDStatus.ITERATION_LIMIT).sum())
    first = result.first.point.tolist() if result.hit else ["", "", ""]
    return [result.toi, len(result.contacts), *kinds, 0, at_start, crossing, at_limit, *first]


_OF_ROW = "toi contacts vertex_face edge_edge vertex_plane at_start crossing_at_start at_limit x y z".split()


def test_columns_and_statuses_are_those_of_the_library_for_drawn_sequences(capfd):
    seen = {"free": 0, "crossing alone": 0, "at_limit": 0, "at_start": 0}
    for seed in range(18):
        frames, options = _drawn(seed)
        for k, vertices in enumerate(frames):
            Path(f"{k}.ply").write_bytes(ply(vertices, np.arange(12).reshape(4, 3)))
        names = [f"{k}.ply" for k in range(len(frames))]
        words = [word for name, value in options.items() for word in (f"--{name.replace('_', '-')}", value)]
        words = ["edge-edge" if word == ["edge_edge"] else str(word) for word in words]
        steps = [*ccd.read_sequence(names).steps()]
        results = [ccd.mesh_ccd(step.mesh, step.vertices_t0, step.vertices_t1, **options) for step in steps]
        expected = [_expected(*each) for each in zip(steps, results, strict=True)]
        hits, crossing = ([row[k] for row in expected] for k in (1, 6))
        status = int(any(hits) or any(crossing))
        for flag in ([], ["--fail-on-contact"]):
            run(*names, *words, "--output", "-", "--quiet", *flag, status=status if flag else 0)
            found = [*csv.DictReader(capfd.readouterr().out.splitlines())]
            numbers = [[row[name] and float(row[name]) for name in _OF_ROW] for row in found]
            assert numbers == expected, seed
            if flag:
                command = ["run", *names[:2], *words, "--quiet", *flag, "--output", "run.json"]
                assert main(command) == int(hits[0] > 0 or crossing[0] > 0), seed
                data, first = json.loads(Path("run.json").read_text("utf-8")), results[0]
                assert (np.inf if data["toi"] is None else data["toi"]) == first.toi
                assert data["contact"]["toi"] == np.sort(first.contacts.toi).tolist()
                assert {name: data["options"][name] for name in options} == options
                assert data["counts"]["num_batches"] == first.counts.num_batches
        seen["free"] += not status
        seen["crossing alone"] += any(crossing) and not any(hits)
        seen["at_limit"] += any(row[7] for row in expected)
        seen["at_start"] += any(row[5] for row in expected)
    assert min(seen.values()) > 0, seen


def test_ctrl_c_keeps_the_rows_of_the_steps_so_far(monkeypatch, capfd):
    """Each is in the file as soon as its step is solved; what is left is a sequence of its own."""
    run(*BALLS, *ON, "--length-scale", "1", "--output", "whole", "--quiet")
    header, *lines = Path("whole/steps.csv").read_text("utf-8").splitlines(keepends=True)
    solve, seen = solve_module.solve, []

    def solve_or_press(*arguments, **options):
        seen.append(Path("out/steps.csv").read_text("utf-8") if Path("out").exists() else "")
        if len(seen) == 8:
            raise KeyboardInterrupt
        return solve(*arguments, **options)

    monkeypatch.setattr(solve_module, "solve", solve_or_press)
    for output in ("-", "out"):
        seen.clear()
        run(*BALLS, *ON, "--length-scale", "1", "--output", output, status=130)
        shown = capfd.readouterr()
        assert f"interrupted after 7 of 10 steps{'' if output == '-' else '; steps.csv holds these'}\n" in shown.err
        assert "steps with contacts  2 of 7: 5-6\n" in (shown.err if output == "-" else shown.out)
        assert output == "out" or shown.out == "".join([header, *lines[:7]])
    assert seen == ["".join([header, *lines[:k]]) for k in range(8)]
    assert sorted(path.name for path in Path("out").iterdir()) == ["steps.csv"]
    run(*(f"ball_{k}.ply" for k in range(7, 11)), *ON, "--length-scale", "1", "--output", "rest", "--quiet")
    tois = [[row["toi"] for row in rows(name)] for name in ("out", "rest", "whole")]
    assert tois[0] + tois[1] == tois[2]


def test_report_names_the_steps_with_contacts_and_the_first(capfd):
    run(*BALLS, *ON, "--output", "out", "--fail-on-contact", status=1)
    out = capfd.readouterr().out
    assert "11 frames of ball" in out and "steps with contacts  5 of 10: 5-9\n" in out
    (first,) = [line for line in out.splitlines() if line.startswith("the first")]
    assert first.startswith("the first  step 5, ball_5.ply -> ball_6.ply, toi 0.4999")
    assert "of ball" in out and "of floor.ply" in out and "not seen  what surfaces that cross" in out
    assert "surfaces cross at the start of  4 of 10 steps: 6-9\n" in out
    assert [row["start"] for row in rows("out")] == [f"ball_{k}.ply" for k in range(10)]
    run(*BALLS[:3], "--output", "-", "--pair-kinds", "edge-edge", "--fail-on-contact")
    shown = capfd.readouterr()  # standard output takes the CSV alone
    assert len([*csv.DictReader(shown.out.splitlines())]) == 2
    assert "none of 2   (certain for the pairs looked at: edge-edge, in [0, 1])" in shown.err
