"""`ccd-warp bench`: the truth of its queries is the oracle's, wrong answers are counted, and a quick run says all."""

import numpy as np
import pytest
import warp as wp
from exact import exact_tois

from ccd_warp._cli import bench
from ccd_warp._cli.command import main


@pytest.mark.parametrize("kind", bench.KINDS)
@pytest.mark.parametrize("family", bench.FAMILIES)
def test_times_by_construction_are_those_of_the_oracle(family, kind):
    queries = bench.queries_of(family, kind, 200)
    truth = exact_tois(kind, queries.points_t0, queries.points_t1)
    assert [e.compare(t) for e, t in zip(truth, queries.toi, strict=True)] == [0] * 200
    assert 20 < np.isfinite(queries.toi).sum() < 180
    rounded = queries.points_t0.astype(np.float32)
    assert (rounded == queries.points_t0).all()  # float32 has the same queries


def test_missed_late_phantom_and_early_answers_are_counted_apart():
    truth = np.array([0.5, 0.5, 0.5, np.inf, np.inf, 0.25])
    found = bench.judged(np.array([np.inf, np.nextafter(0.5, 1), 0.25, 0.1, np.inf, np.nan]), truth)
    assert [found[name] for name in ("queries", "missed", "late", "phantom", "early_most")] == [5, 1, 1, 1, 0.25]


def test_a_quick_run_writes_a_table(tmp_path, capsys, monkeypatch):
    of_peer = bench.peer  # which has seconds for each row, and takes all of them
    monkeypatch.setattr(bench, "peer", lambda queries, tolerance, _, name: of_peer(queries, tolerance, 0.005, name))
    assert main(["bench", "--quick", "--output", str(tmp_path)]) == 0
    out, num_devices = capsys.readouterr().out, len(wp.get_devices())
    assert f"{36_000 * num_devices:,} answers of ours: 0 missed, 0 late" in out
    assert "mesh_ccd, cpu" in out
    assert (tmp_path / "bench.csv").read_text("utf-8").count("ours float32") == 6 * 3 * num_devices


def test_without_the_extra_there_is_a_table_and_a_missed_collision_is_the_exit_status(tmp_path, capsys, monkeypatch):
    row = {"family": "general", "kind": "edge-edge", "tolerance": 1e-6, "method": "ours float64", "seconds": 1e-6}
    wrong = bench.judged(np.array([np.inf, 0.75]), np.array([0.5, 0.5]))
    monkeypatch.setattr(bench, "query_rows", lambda *_: iter([row | wrong]))
    monkeypatch.setattr(bench, "step_rows", lambda *_: iter([]))
    monkeypatch.setattr(bench, "find_spec", lambda name: None)
    assert main(["bench", "--output", str(tmp_path)]) == 1
    out = capsys.readouterr().out
    assert "2 answers of ours: 1 missed, 1 late" in out
    assert out.count("install with: pip install 'ccd-warp[bench]'") == 1
    assert main(["bench", "--devices", "none", "--output", str(tmp_path)]) == 2
