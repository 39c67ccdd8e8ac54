"""The benchmark: what it measures is judged right, an interruption loses nothing, and the docs hold its figures."""

import copy
import itertools
import json
import math
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from ccd_warp.benchmarks import command, require_extra
from exact import exact_tois
from hard_cases import FAMILIES

import ccd_warp as ccd
from ccd_warp._cli.command import main

pytest.importorskip("ipctk")
pytest.importorskip("matplotlib")

import ipctk
from ccd_warp.benchmarks import (
    bench,
    broad_phases,
    compare,
    device_step,
    figures,
    raw_file,
    report,
    scene_sections,
    scenes,
    separation,
    small_scenes,
    timing,
)
from ccd_warp.benchmarks.accuracy import ExactTimes, error_statistics, judged
from ccd_warp.benchmarks.interleaved import Effort, measure
from ccd_warp.benchmarks.memory import PeakMemory
from ccd_warp.benchmarks.methods import REFERENCE, Answer, Method, all_methods
from ccd_warp.benchmarks.numbers import bound
from ccd_warp.benchmarks.peers import Peer
from ccd_warp.benchmarks.query_sets import make_set
from ccd_warp.benchmarks.scene_sections import beside_the_other

from ccd_warp._files.journal import Journal

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "benchmarks" / "results"
TINY = Effort(rounds=2, batch=200, seconds=0.005, peer_seconds=0.02, cap=0.2)


def _set(family: str = "random_colliding", kind: str = "vertex-face", count: int = 40, **options):
    points = FAMILIES[family](kind, count, np.random.default_rng(1))
    return make_set(family, kind, *points, most=count, **options)


# ---- Accuracy --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("family", ["random_colliding", "touching_at_start", "lattice", "one_ulp_neighbours"])
def test_exact_times_decide_late_as_the_oracle_does(family):
    points = FAMILIES[family]("edge-edge", 60, np.random.default_rng(3))
    exact = exact_tois("edge-edge", *points)
    times = ExactTimes.from_oracle(exact)
    assert times.hit.tolist() == [e.hit for e in exact]
    for i, e in enumerate(exact):
        if not e.hit:
            continue
        below = float(times.below[i])
        for toi in (below, math.nextafter(below, -1), math.nextafter(below, 2), 0.0, 1.0):
            answer = np.full(len(exact), np.inf)
            answer[i] = toi
            assert times.faults(answer)["late"] == int(e.late(toi))
            # one rounding each of the rest, the difference and the sum; the oracle refines τ to 80 bits
            (signed,) = times.early_by(answer)
            assert signed == pytest.approx(e.early_by(toi), rel=4 * 2**-53, abs=2**-79)


def test_missed_late_and_phantom_are_counted_apart():
    times = ExactTimes(np.array([0.5, 0.5, 0.5, np.inf, np.inf]), np.zeros(5))
    toi = np.array([np.inf, 0.75, 0.25, 0.1, np.inf])
    found = judged(times, toi)
    assert {k: found[k] for k in ("missed", "late", "phantom")} == {"missed": 1, "late": 1, "phantom": 1}
    assert found["contacts"] == 3
    assert found["error"]["least_signed"] == -0.25
    assert found["error"]["max"] == 0.25
    assert error_statistics(np.empty(0)) is None


def test_a_toi_equal_to_an_irrational_one_rounded_up_is_late():
    """τ = 1 / 3 is no float64: the one below is early, the one above late."""
    third = Fraction(1, 3)
    v = [[0, 0, -1.0], [0, 0, 2.0]]  # crosses z = 0 at a third of the step
    face = [[-1.0, -1, 0], [1, -1, 0], [0, 1, 0]]
    p0, p1 = (np.array([[x, *face]]) for x in v)
    times = ExactTimes.of("vertex-face", p0, p1)
    assert Fraction(float(times.below[0])) < third < Fraction(math.nextafter(float(times.below[0]), 1))
    assert times.faults(times.below)["late"] == 0
    assert times.faults(np.nextafter(times.below, 1))["late"] == 1


# ---- One point -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["vertex-face", "edge-edge"])
def test_every_method_answers_a_set(kind):
    queries = _set(kind=kind)
    methods = all_methods(["cpu"])
    rows = measure(methods, queries, 1e-6, TINY)
    assert [row["method"] for row in rows] == [m.name for m in methods]
    for row in rows:
        assert row["seconds_low"] <= row["seconds"] <= row["seconds_high"]
        assert 0 < row["queries"] <= len(queries)
        assert row["missed"] <= row["contacts"]
        if row["method"].startswith("ours"):
            assert row["missed"] == row["late"] == row["limited"] == 0
    by = {row["method"]: row for row in rows}
    assert len(by[REFERENCE]["query_seconds"]) == by[REFERENCE]["timed_queries"]
    assert by[REFERENCE]["ours_on_the_same"]["queries"] == by[REFERENCE]["queries"]
    # it finds what is plainly there, and the discrete test does not
    assert by["cubic, closed form"]["missed"] < by["cubic, closed form"]["contacts"] / 10
    assert by["both ends"]["missed"] > by["both ends"]["contacts"] / 2


def test_a_method_that_misses_is_seen_to():
    queries = _set()

    def blind(kind, points_t0, points_t1, tolerance, separation, length_scale):
        return Answer(np.full(len(points_t0), np.inf))

    (row,) = measure([Method("blind", "baseline", "", blind)], queries, 1e-6, TINY)
    assert row["missed"] == row["contacts"] == queries.exact.hit.sum() > 0


def test_a_slow_method_gets_the_first_queries_only():
    queries = _set(count=40)

    def slow(kind, points_t0, points_t1, tolerance, separation, length_scale):
        import time

        time.sleep(0.001 * len(points_t0))
        return Answer(np.zeros(len(points_t0)))

    (row,) = measure([Method("slow", "baseline", "", slow)], queries, 1e-6, TINY)
    assert row["queries"] < len(queries)
    assert row["contacts"] == queries.exact.hit[: row["queries"]].sum()


def test_a_method_without_separation_is_left_out_where_one_is_asked_for():
    queries = _set(separation=0.01)
    names = [row["method"] for row in measure(all_methods(["cpu"]), queries, 1e-6, TINY)]
    assert "cubic, closed form" not in names
    assert REFERENCE in names


# ---- Peers -----------------------------------------------------------------------------------------------------------


def test_a_query_that_hangs_is_stopped_and_the_next_one_is_answered():
    """Parallel edges that pass through each other in one plane: Tight-Inclusion subdivides for minutes."""
    p0, p1 = FAMILIES["random_colliding"]("edge-edge", 6, np.random.default_rng(0))
    line = np.array([[0.0, 0, 0], [1, 0, 0], [0, 0, 0], [1, 0, 0]])
    p0[2] = line + np.array([[0, 0.3, 0], [0, 0.3, 0], [0, 0, 0], [0, 0, 0]])
    p1[2] = line - np.array([[0, 0.3, 0], [0, 0.3, 0], [0, 0, 0], [0, 0, 0]])
    peer = Peer("tight_inclusion", "edge-edge", p0, p1, 1e-12, np.ones(6), 0.0, cap=0.3)
    try:
        for _ in range(2):
            peer.run(30.0)
    finally:
        peer.close()
    answers = peer.answers
    assert answers.count == 6
    assert answers.capped == [2]
    assert math.isnan(answers.toi[2])
    assert np.isfinite(answers.toi[[0, 1, 3, 4, 5]]).all()
    assert [times[2] for times in answers.rounds] == [0.3, 0.3]


@pytest.mark.parametrize("name", ["tight_inclusion", "additive"])
def test_a_peer_repeats_the_queries_of_its_first_pass(name):
    queries = _set(count=30)
    peer = Peer(name, queries.kind, queries.points_t0, queries.points_t1, 1e-3, np.ones(30), 0.0, cap=1.0)
    try:
        for _ in range(3):
            peer.run(10.0)
    finally:
        peer.close()
    assert peer.answers.count == 30
    assert [len(times) for times in peer.answers.rounds] == [30] * 3
    assert queries.exact.faults(peer.answers.toi)["missed"] == 0


def test_additive_ccd_gets_a_fraction_and_not_a_length():
    """Its answers are those at unit size where a power of two scales query and unit; as a length they would be nan."""
    answers = []
    for scale in (1.0, 2.0**20):
        points = FAMILIES["random_colliding"]("vertex-face", 20, np.random.default_rng(1))
        queries = make_set("scaled", "vertex-face", *(scale * p for p in points), most=20, length_scale=None)
        frames = (queries.points_t0, queries.points_t1)
        peer = Peer("additive", queries.kind, *frames, 1e-3, queries.unit(), 0.0, cap=1.0)
        try:
            peer.run(10.0)
        finally:
            peer.close()
        answers.append(peer.answers.toi)
    assert np.isfinite(answers[0]).all()
    assert answers[1] == pytest.approx(answers[0], rel=1e-9)


def test_a_query_that_ends_the_process_has_no_answer_and_the_others_have():
    queries = _set(count=10)
    peer = Peer("additive", queries.kind, queries.points_t0, queries.points_t1, 1e-3, np.ones(10), 0.0, cap=1.0)
    try:
        peer.run(10.0)
        peer._process.kill()
        peer._process.join()
        peer.run(10.0)
    finally:
        peer.close()
    assert peer.answers.count == 10
    assert peer.answers.capped == [0], "the first query after the end is taken for the one that caused it"
    assert np.isfinite(peer.answers.toi[1:]).all()


def test_time_below_the_scatter_of_the_overhead_is_a_bound():
    """Tight-Inclusion at a tolerance as large as the queries says toi = 0 in less time than a Python call takes."""
    queries = _set("cloth_like")
    (row,) = [r for r in measure(all_methods(["cpu"]), queries, 10.0, TINY) if r["method"] == REFERENCE]
    assert row["seconds"] >= row["resolution"] > 0
    assert row["seconds_low"] > 0 and row["median_query_seconds"] > 0
    assert bound(row) == ("< " if row["below_resolution"] else "")


def test_peak_memory_sees_what_is_allocated_again_after_it_was_freed():
    size = 64 << 20
    np.ones(size, dtype=np.uint8).sum()
    memory = PeakMemory()
    if memory.bytes() is None:
        pytest.skip("this system does not say how much memory a process takes")
    np.ones(size, dtype=np.uint8).sum()
    assert memory.bytes() > 0.9 * size


# ---- A whole run -----------------------------------------------------------------------------------------------------


@pytest.fixture
def settings(tmp_path) -> bench.Settings:
    """All parts, each as small as can be."""
    made = bench.Settings.make(quick=True, data=None, devices=["cpu"], sections=("sweep", "cases", "batches"))
    return replace(
        made,
        tolerances=(1e-3, 1e-6),
        generated=(20, 1),
        sweep=TINY,
        case_queries=5,
        cases=replace(TINY, rounds=1),
        batches=(1, 10),
        rounds=2,
        growth=(),
    )


@pytest.fixture
def few_families(monkeypatch):
    """Three families in place of all."""
    chosen = {name: FAMILIES[name] for name in ("random", "one_plane", "separation_exactly_the_gap")}
    monkeypatch.setattr(bench, "FAMILIES", chosen)


@pytest.mark.long  # measures two whole runs
def test_a_run_is_kept_when_it_is_interrupted_and_resumed(settings, few_families, tmp_path, monkeypatch):
    calls = []
    stop_after = 5

    def counted(*arguments):
        if len(calls) == stop_after:
            raise KeyboardInterrupt
        calls.append(arguments[1].name)
        return measure(*arguments)

    monkeypatch.setattr(bench, "measure", counted)
    raw, complete = bench.run(settings, tmp_path, quiet=True)
    assert not complete and not raw["complete"]
    assert len(raw["sweep"]) == stop_after
    assert json.loads((tmp_path / bench.RAW).read_text())["sweep"] == raw["sweep"]
    first = copy.deepcopy(raw["sweep"])

    stop_after = 10**6
    raw, complete = bench.run(settings, tmp_path, quiet=True)
    assert complete and raw["complete"]
    assert raw["sweep"][: len(first)] == first, "what was measured is not measured again"
    assert len(raw["sweep"]) == 4 * 2 and len(raw["cases"]) == 3 * 2
    assert len(calls) == len(raw["sweep"]) + len(raw["cases"])
    assert not (tmp_path / bench.JOURNAL).exists()

    # the pictures and the page of it can be made
    assert {path.name for path in figures.draw_all(raw, tmp_path)} == {
        f"bench_{name}.png" for name in ("pareto", "phantoms", "cases", "scaling")
    }
    text = report.document(raw)
    assert "## Hard cases" in text and "one_plane VF" in text
    assert (tmp_path / "bench_sweep.csv").read_text().count("\n") == 1 + sum(len(u["rows"]) for u in raw["sweep"])
    # and it is no worse than itself
    assert compare.compare(raw, raw, 1.25)[1] is False


def test_a_journal_of_other_settings_is_set_aside_and_a_cut_line_is_not_taken(tmp_path):
    path = tmp_path / "j"
    journal = Journal(path, "a")
    journal.add("x", 1)
    journal.add("y", {"z": 2})
    with path.open("a") as file:
        file.write('{"key": "cut", "rec')
    again = Journal(path, "a")
    assert again.records == {"x": 1, "y": {"z": 2}} and again.set_aside is None
    other = Journal(path, "b")
    assert other.records == {}
    assert '"key": "y"' in other.set_aside.read_text(), "the measurement of the other run is kept"


def test_numpy_numbers_are_written(tmp_path):
    raw_file.write_raw(tmp_path / "r.json", {"sweep": [], "a": [np.float64(0.5), np.int64(3)]})
    assert json.loads((tmp_path / "r.json").read_text()) == {"sweep": [], "a": [0.5, 3]}


# ---- The guard -------------------------------------------------------------------------------------------------------


def _row(method: str, seconds: float, **values) -> dict:
    error = {"median": 1e-9, "p99": 1e-8, "max": 1e-7, "least_signed": 0.0}
    row = {
        "method": method,
        "seconds_low": seconds,
        "queries": 100,
        "contacts": 50,
        "missed": 0,
        "late": 0,
        "phantom": 3,
        "limited": 0,
    }
    return {**row, "error": error, **values}


def _raw(*, ours=1e-6, peer=1e-3, step=20.0, bound=0.5, small=2.0, single=3.0, **values) -> dict:
    unit = {
        "set": "a",
        "kind": "vertex-face",
        "tolerance": 1e-6,
        "points": "same",
        "rows": [_row("ours float64", ours, **values), _row(REFERENCE, peer, query_seconds=[peer] * 20)],
    }
    spread = {"peer build": [0.25 * step, 9.0], "peer step": [0.75 * step, 9.0], "mesh_ccd": [1.0, 9.0]}
    scene = {"scene": "s", "device": "cpu", "ratio": {"mesh_ccd": step}, "spread": spread}
    scene |= {"step": bound, "disagreements": 0}
    spread = {"LBVH, Tight-Inclusion": [1.0, 9.0], "LBVH, additive": [small, 9.0], "mesh_ccd": [1.0, 9.0]}
    few = {"scene": "few", "device": "cpu", "spread": spread, "step": bound}
    one = {"pair": "edge_edge", "device": "cpu", "spread": {"LBVH, additive": [single, 9.0], "ours": [1.0, 9.0]}}
    parts = {name: [] for name in ("methods", "sets", "cases", "batches", "start", "threads")}
    parts |= {"small": [few], "pairs": [one]}
    return {"machine": {}, "settings": {}, "complete": True, "sweep": [unit], "steps": [scene], **parts}


def _scenes(of_steps: float, of_broad: float, name: str = "s") -> dict:
    scene = {"scene": name, "device": "cpu"}
    return {
        "machine": {"date": "today"},
        "steps": [scene | {"seconds": {"peer build": 1.0 * of_steps, "find_candidates": 0.5 * of_steps}}],
        "broad": [scene | {"seconds": {"LBVH": 1.0 * of_broad, "tree find_candidates": 0.25 * of_broad}}],
    }


@pytest.mark.parametrize(
    ("times", "in_steps", "in_broad"),
    [
        ((1.0, 4.0), "There LBVH takes 4.0 to 4.0 times", "Here LBVH takes 4.0 to 4.0 times"),
        ((4.0, 1.0), "Here LBVH takes 4.0 to 4.0 times", "There LBVH takes 4.0 to 4.0 times"),
    ],
)
def test_two_tables_of_the_same_calls_say_how_they_differ(times, in_steps, in_broad):
    raw = _scenes(*times)
    for here, there, sentence in (("steps", "broad", in_steps), ("broad", "steps", in_broad)):
        (_, text) = beside_the_other(raw, here)
        assert f"(#{'broad-phases' if there == 'broad' else 'whole-steps'})" in text
        assert sentence in text and "compare within a table" in text
    alike = _scenes(1.0, 1.1)
    alike["broad"][0]["seconds"]["tree find_candidates"] = 0.5
    (_, text) = beside_the_other(alike, "steps")
    assert "There LBVH takes 1.1 to 1.1 times" in text and "compare within a table" not in text


def test_tables_of_other_scenes_say_nothing_of_each_other():
    raw = _scenes(1.0, 4.0)
    raw["broad"] = []
    assert beside_the_other(raw, "steps") == []


@pytest.mark.parametrize(
    ("new", "is_worse"),
    [
        (_raw(), False),
        (_raw(ours=3e-6, peer=3e-3), False),  # a machine three times slower
        (_raw(ours=1.2e-6), False),  # within the threshold
        (_raw(ours=1.4e-6), True),
        (_raw(ours=0.9e-6, peer=0.5e-3), True),  # faster, on a machine that is twice as fast
        (_raw(missed=1), True),
        (_raw(late=1), True),
        (_raw(phantom=4), False),
        (_raw(phantom=9), True),
        (_raw(error={"median": 1e-9, "p99": 1e-8, "max": 1e-6, "least_signed": 0.0}), True),
        (_raw(error={"median": 1e-10, "p99": 1e-8, "max": 1e-7, "least_signed": 0.0}), False),
        (_raw(step=10.0), True),
        (_raw(step=25.0), False),
        (_raw(bound=0.3), True),
        (_raw(limited=5), True),
        (_raw(small=1.5), True),
        (_raw(small=1.9, single=2.9), False),
        (_raw(single=2.0), True),
    ],
)
def test_compare_sees_what_became_worse(new, is_worse):
    lines, found = compare.compare(_raw(), new, 1.25)
    assert found is is_worse, "\n".join(lines)


def test_other_queries_under_the_same_name_are_not_compared():
    other = _raw(ours=1e-3, missed=7)
    other["sweep"][0]["points"] = "other"
    lines, is_worse = compare.compare(_raw(), other, 1.25)
    assert not is_worse and any("other queries in the two runs" in line for line in lines)


def test_runs_with_nothing_in_common_do_not_pass():
    other = _raw()
    other["sweep"][0]["set"] = "b"
    other["steps"] = other["small"] = other["pairs"] = []
    lines, is_worse = compare.compare(_raw(), other, 1.25)
    assert is_worse and "nothing to compare" in lines[-1]


def test_times_are_not_compared_where_the_peer_answered_too_little():
    old, new = _raw(), _raw(ours=1e-5)
    for raw in (old, new):
        raw["sweep"][0]["rows"][1]["query_seconds"] = [None] * 15 + [1e-3] * 5
    lines, is_worse = compare.compare(old, new, 1.25)
    assert not is_worse
    assert any("too few queries" in line for line in lines)


def test_compare_exits_with_1(tmp_path, capsys, monkeypatch):
    for name, raw in (("old", _raw()), ("new", _raw(ours=1e-5))):
        folder = tmp_path / name
        folder.mkdir()
        (folder / bench.RAW).write_text(json.dumps(raw))
    monkeypatch.setattr(figures, "draw_all", lambda raw, folder: [])
    monkeypatch.setattr(report, "document", lambda raw, figures="": "")
    monkeypatch.setattr(report, "summary", lambda raw: [])
    arguments = ["bench", "--render", "--compare", str(tmp_path / "old" / bench.RAW), "--output"]
    assert main([*arguments, str(tmp_path / "old")]) == 0
    assert main([*arguments, str(tmp_path / "new")]) == 1
    assert "a VF, ours float64: time" in capsys.readouterr().out
    assert main([*arguments, str(tmp_path / "new"), "--threshold", "20"]) == 0


# ---- The command -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--threshold", "1"], "threshold is 1.0; expected a number above 1"),
        (["--only", "everything"], "only holds 'everything'; expected some of sweep, cases"),
        (["--max-queries", "0"], "max-queries is 0; expected a positive integer"),
        (["--compare", "nowhere.json"], "nowhere.json cannot be read"),
        (["--data", "nowhere"], "data is nowhere; expected a folder"),
        (["--devices", "cuda:77"], "devices holds 'cuda:77'; expected some of cpu"),
        (["--render", "--output", "nowhere"], "bench.json cannot be read"),
        (["--docs", "nowhere"], "docs is nowhere; expected the root of a checkout"),
        (["--docs", str(ROOT), "--only", "start"], "docs are written from all parts"),
        (["--merge"], "merge is given without --only"),
        (["--merge", "--only", "pairs", "--output", "nowhere"], "bench.json cannot be read"),
    ],
)
def test_bad_arguments_are_named_before_anything_is_measured(arguments, message, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["bench", *arguments]) == 2
    error = capsys.readouterr().err
    assert error.startswith("ccd-warp: error: ") and error.count("\n") == 1
    assert message in error
    assert list(tmp_path.iterdir()) == []


def test_an_output_that_is_a_file_or_holds_more_is_refused(tmp_path, capsys):
    file = tmp_path / "file"
    file.touch()
    assert main(["bench", "--output", str(file)]) == 2
    assert "expected a folder to write to" in capsys.readouterr().err
    (tmp_path / bench.RAW).touch()
    assert main(["bench", "--output", str(tmp_path), "--only", "start"]) == 2
    assert "figures that --only would drop" in capsys.readouterr().err


def test_an_interruption_before_the_first_figure_leaves_what_there_was(settings, tmp_path, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    (tmp_path / bench.RAW).write_text("a complete run")
    monkeypatch.setattr(bench, "tasks", interrupted)
    assert bench.run(settings, tmp_path, quiet=True) == (None, False)
    assert (tmp_path / bench.RAW).read_text() == "a complete run"


def test_a_missing_extra_is_named_in_one_line(capsys, monkeypatch):
    monkeypatch.setattr("ccd_warp.benchmarks.find_spec", lambda name: None if name in ("ipctk", "flint") else name)
    assert main(["bench"]) == 2
    expected = "bench needs ipctk, python-flint; install with: pip install 'ccd-warp[bench]'"
    assert capsys.readouterr().err == f"ccd-warp: error: {expected}\n"
    with pytest.raises(ValueError, match="bench needs"):
        require_extra()


def test_no_raw_file_is_taken_for_one(tmp_path):
    path = tmp_path / "x.json"
    for text in ("", "[]", '{"machine": 1}'):
        path.write_text(text)
        with pytest.raises(ValueError, match=r"x\.json .*; expected a bench\.json|x\.json .*expected a bench\.json"):
            raw_file.read_raw(path)


def test_the_parts_of_the_help_are_those_there_are():
    assert ", ".join(bench.SECTIONS) == command.SECTIONS_HELP


# ---- Interleaved rounds ----------------------------------------------------------------------------------------------


def test_every_round_makes_every_call_in_turn_and_times_the_one_that_counts():
    now, made = iter(range(1000)), []
    calls = {name: lambda name=name: made.append(name) for name in "ab"}
    seconds = timing.interleaved(calls, 2, is_settled=True, clock=lambda: next(now), wait=lambda: made.append("-"))
    assert "".join(made) == "ab" + 2 * "a-a-b-b-"
    assert seconds == {"a": [1, 1], "b": [1, 1]}
    assert timing.figures({"a": [3.0, 1.0, 2.0]}) == {"seconds": {"a": 2.0}, "spread": {"a": [1.0, 3.0]}}


def test_a_short_call_is_repeated_and_its_mean_counts():
    made = []
    seconds = timing.interleaved({"a": lambda: made.append(0)}, 1, fill=1.0, clock=lambda: float(len(made)))
    assert (len(made), seconds) == (102, {"a": [1.0]})


# ---- Small scenes ----------------------------------------------------------------------------------------------------


def test_small_scenes_are_those_that_their_names_say():
    made = scenes.small_scenes()
    assert [len(scene.faces) for scene in made] == [int(scene.name.split(", ")[1].replace(",", "")) for scene in made]
    meshes = [scene.mesh(ccd) for scene in made]
    assert [mesh.num_bodies for mesh in meshes] == [2, 2, 2, 2, 20, 2]
    assert [mesh.static.any() for mesh in meshes] == [False] * 5 + [True]


def test_a_row_of_a_small_scene(monkeypatch):
    monkeypatch.setattr(small_scenes, "_SECONDS", 0.0)
    row = small_scenes.measure(scenes.two_small_spheres(0), "cpu", 1)
    assert row["launch_flags"] == 0 and row["contacts"] > 0
    # all answer the same question: ours to 1e-6 of the scene, the peers short of it by shares of the start gap
    assert row["step"] == row["toi"] == pytest.approx(row["launch_toi"], abs=1e-5)
    assert 0.8 * row["toi"] < row["additive_step"] < row["toi"] > row["peer_step"] > 0.99 * row["toi"]
    assert set(row["spread"]) == set(row["seconds"]) and len(row["seconds"]) == 7


def test_a_row_of_both_broad_phases_is_told_beside_the_peer():
    row = broad_phases.measure(scenes.two_small_spheres(1), "cpu", 0.0, 1)
    assert row["are_equal"] and row["disagreements"] == 0 and sum(row["candidates"]) > 0
    assert row["rounds"] == 1 and set(row["spread"]) == set(row["seconds"]) and len(row["seconds"]) == 9
    (line,) = scene_sections.broad({"broad": [row]})[2:]
    assert line.startswith(f"| {row['scene']} |") and line.endswith("| yes | 0 | 1 |")


def test_a_part_that_is_measured_apart_replaces_itself_alone(settings, tmp_path, monkeypatch):
    monkeypatch.setattr(small_scenes, "_SECONDS", 0.0)
    kept = raw_file.read_raw(RESULTS / bench.RAW)
    few = replace(settings, sections=("pairs",), small_rounds=1)
    raw, complete = bench.run(few, tmp_path, quiet=True, kept=kept)
    assert complete and raw["complete"]
    assert {key for key in raw if raw[key] != kept.get(key)} == {"pairs", "measured_apart"}
    assert [row["pair"] for row in raw["pairs"]] == list(small_scenes.PAIR_KINDS)
    lines = report.document(raw).splitlines()
    assert sum("Measured apart with `--quick`" in line and "--only pairs --merge" in line for line in lines) == 1
    assert any(line.startswith("| point-point |") for line in lines)


# ---- Scenes with large motion ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["crumpled cloth 50k", "bodies through each other"])
def test_the_narrow_phase_has_most_to_do_where_the_motion_is_large(name):
    scene = dict(scenes.all_scenes(None, quick=False))[name]()
    counts = ccd.mesh_ccd(scene.mesh(ccd), scene.vertices_t0, scene.vertices_t1).counts
    survivors, contacts = sum(counts.num_after_cull.values()), sum(counts.num_contacts.values())
    assert survivors >= 200_000
    assert 0.03 * survivors <= contacts <= 0.25 * survivors
    assert counts.num_contacts_at_start == counts.num_contacts_at_limit == 0


@pytest.mark.parametrize(
    "make",
    [lambda: scenes.crumpled_cloth(4_000), lambda: scenes.bodies_through_each_other(40, 100)],
    ids=["crumpled cloth", "bodies through each other"],
)
def test_scenes_with_large_motion_start_free_and_move_by_several_edge_lengths(make):
    scene = make()
    mesh = scene.mesh(ccd)
    toolkit = ipctk.CollisionMesh(scene.vertices_t0, np.asarray(mesh.edges, dtype=np.int32), scene.faces)
    assert not ipctk.has_intersections(toolkit, scene.vertices_t0)
    edges = np.linalg.norm(np.diff(scene.vertices_t0[mesh.edges], axis=1), axis=-1)
    moves = np.linalg.norm(scene.vertices_t1 - scene.vertices_t0, axis=1)
    assert np.quantile(moves, 0.9) > 2.5 * np.median(edges)
    assert np.array_equal(scene.vertices_t1, make().vertices_t1)  # the seed is fixed


# ---- Steps on the device ---------------------------------------------------------------------------------------------


def test_the_page_on_the_device_has_the_figures_of_the_steps_there():
    figures = json.loads((RESULTS / "device_step.json").read_text(encoding="utf-8"))
    text = (ROOT / "docs" / "on_device.md").read_text(encoding="utf-8")
    assert report.with_table(text, "steps on the device", device_step.rows_table(figures["rows"])) == text


def test_the_choosing_page_has_the_figures_of_the_separations():
    figures = json.loads((RESULTS / "separation.json").read_text(encoding="utf-8"))
    text = (ROOT / "docs" / "choosing.md").read_text(encoding="utf-8")
    assert report.with_table(text, "separation", separation.rows_table(figures["rows"])) == text


def test_a_larger_separation_is_met_earlier_and_brings_more_near(monkeypatch):
    monkeypatch.setattr(separation, "ROUNDS", 1)
    rows = separation.measure(5_000, (0.0, 1e-3, 1e-2))
    for name, sign in (("toi", -1), ("candidates", 1), ("contacts", 1)):
        assert all(sign * a[name] <= sign * b[name] for a, b in itertools.pairwise(rows)), name
        assert rows[0][name] != rows[-1][name]


def test_a_row_of_the_steps_on_the_device(monkeypatch):
    monkeypatch.setattr(device_step, "ROUNDS", 1)
    row = device_step.measure(*device_step.worlds(5), "cpu")
    assert row["worlds"] == 5 and row["contacts"] > 0
    assert row["different_toi"] == row["later_toi"] == 0
    assert set(row["seconds"]) == {"mesh_ccd", "launch", "replay", "line search"}


# ---- The docs --------------------------------------------------------------------------------------------------------


def test_docs_are_those_of_the_raw_figures():
    raw = raw_file.read_raw(RESULTS / bench.RAW)
    assert raw["complete"]
    page = (ROOT / "docs" / "benchmarks.md").read_text(encoding="utf-8")
    for ours, committed in itertools.zip_longest(report.document(raw).splitlines(), page.splitlines()):
        assert ours == committed
    for page in report.TABLES:
        text = (ROOT / page).read_text(encoding="utf-8")
        assert report.with_tables(page, text, raw) == text


def test_csv_files_are_those_of_the_raw_figures(tmp_path):
    raw_file.write_raw(tmp_path / bench.RAW, raw_file.read_raw(RESULTS / bench.RAW))
    for path in tmp_path.glob("*.csv"):
        assert path.read_text() == (RESULTS / path.name).read_text(), path.name
