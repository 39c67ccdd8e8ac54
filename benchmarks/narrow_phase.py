"""Benchmark of the narrow phase: speed against error, beside Tight-Inclusion, in one interleaved run.

    python benchmarks/narrow_phase.py --json benchmarks/results/narrow_phase.json     # everything, about ten minutes
    python benchmarks/narrow_phase.py --quick                                         # about a minute

Ours is the public call from NumPy arrays, conversion included, on batches of 100,000 made by tiling the queries of a
set, one thread, tolerance 1e-6, length_scale 1. The peer is `ipctk.tight_inclusion.point_triangle_ccd` and
`edge_edge_ccd` with tolerance 1e-6, one Python call a query; what that call costs for a query that is culled at once is
measured and subtracted. The peer takes queries in a fixed random order until its time budget is spent, in a process of
its own: a query that exceeds the cap is stopped and counts as having taken the cap, so that the ratio is a lower bound.

Ours and the peer take turns in every round; each figure of ours is a median over the rounds, a ratio of two of ours the
median of the rounds' ratios. Errors are against exact arithmetic, on the queries that the peer finished.
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import subprocess
import sys
import time
import warnings
from dataclasses import dataclass, field
from pathlib import Path

import ipctk
import numpy as np
import warp as wp
from machine import machine
from queries import FAMILIES, IN_PLANE, SOLVE, ExactToi, all_queries, exact_tois
from tqdm import tqdm

import ccd_warp as ccd

BATCH = 100_000
SCALE = 1.0
TOLERANCE = 1e-6
KINDS = ("vertex-face", "edge-edge")
# Variants of ours beside the default one, by the name of their figure.
VARIANTS = {
    "ours": {},
    "float32": {"precision": "float32"},
    "1e-9": {"tolerance": 1e-9},
    "1e-12": {"tolerance": 1e-12},
}
_PEER = {
    "vertex-face": ipctk.tight_inclusion.point_triangle_ccd,
    "edge-edge": ipctk.tight_inclusion.edge_edge_ccd,
}


@dataclass
class QuerySet:
    """Queries of one source and kind, with the exact answers."""

    group: str  # rows of one group add up to one line of the targets
    name: str
    kind: str
    points_t0: np.ndarray
    points_t1: np.ndarray
    exact: list[ExactToi]


@dataclass
class PeerRun:
    """Answers of the peer, in the order in which it took the queries."""

    query: list[int] = field(default_factory=list)
    toi: list[float] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    capped: list[int] = field(default_factory=list)


# ---- The peer --------------------------------------------------------------------------------------------------------


def _peer_calls(connection, kind: str, points: list[list[np.ndarray]]) -> None:
    """Loop of the peer's process: the connection asks for a span of time, and gets one message a query."""
    solve = _PEER[kind]
    queries = iter(points)
    while True:
        until = time.perf_counter() + connection.recv()
        while time.perf_counter() < until:
            arguments = next(queries, None)
            if arguments is None:
                connection.send("end")
                return
            begin = time.perf_counter()
            hit, toi, _ = solve(*arguments, tolerance=TOLERANCE)
            seconds = time.perf_counter() - begin
            connection.send((toi if hit else math.inf, seconds))
        connection.send("pause")


class Peer:
    """The peer on one set, in turns; stops a query at the cap and goes on with the next."""

    def __init__(self, queries: QuerySet, cap: float, rng: np.random.Generator) -> None:
        self.kind = queries.kind
        self.cap = cap
        self.order = rng.permutation(len(queries.points_t0)).tolist()
        self.points = [[*map(np.array, queries.points_t0[i]), *map(np.array, queries.points_t1[i])] for i in self.order]
        self.result = PeerRun()
        self.done = 0
        self.process = None

    def _start(self) -> None:
        # Forked, so that a restart after a capped query costs no imports; the child touches nothing of Warp.
        context = multiprocessing.get_context("fork")
        self.connection, theirs = context.Pipe()
        self.process = context.Process(target=_peer_calls, args=(theirs, self.kind, self.points[self.done :]))
        self.process.start()

    def _stop(self) -> None:
        if self.process is not None:
            self.process.kill()
            self.process.join()
            self.process = None

    def run(self, seconds: float) -> None:
        """Take queries for a while."""
        until = time.perf_counter() + seconds
        while self.done < len(self.order) and (left := until - time.perf_counter()) > 0:
            if self.process is None:
                self._start()
            self.connection.send(left)
            while True:
                if not self.connection.poll(self.cap):
                    self._stop()
                    self.result.capped.append(self.order[self.done])
                    self.result.seconds.append(self.cap)
                    self.done += 1
                    break
                message = self.connection.recv()
                if isinstance(message, str):
                    break
                self.result.query.append(self.order[self.done])
                self.result.toi.append(message[0])
                self.result.seconds.append(message[1])
                self.done += 1

    def close(self) -> PeerRun:
        self._stop()
        return self.result


def peer_overhead(kind: str) -> float:
    """Seconds of one Python call of the peer for a query that is culled at once."""
    x = np.random.default_rng(0).uniform(-1, 1, (4, 3))
    x[1:, 2] += 100.0
    if kind == "edge-edge":
        x[1, 2] -= 100.0
    points = list(x)
    times = []
    for _ in range(2000):
        begin = time.perf_counter()
        _PEER[kind](*points, *points, tolerance=TOLERANCE)
        times.append(time.perf_counter() - begin)
    return float(np.median(times))


# ---- Ours ------------------------------------------------------------------------------------------------------------


def ours(kind: str, points_t0: np.ndarray, points_t1: np.ndarray, **options):
    """The measured call; an option given here replaces the default of the benchmark."""
    return SOLVE[kind](
        points_t0, points_t1, **{"tolerance": TOLERANCE, "length_scale": SCALE, "num_threads": 1, **options}
    )


def seconds_of(kind: str, points_t0: np.ndarray, points_t1: np.ndarray, **options) -> float:
    begin = time.perf_counter()
    ours(kind, points_t0, points_t1, **options)
    return time.perf_counter() - begin


def tiled(points: np.ndarray, count: int) -> np.ndarray:
    return np.ascontiguousarray(np.resize(points, (count, *points.shape[1:])))


def faults(exact: list[ExactToi], toi: np.ndarray) -> dict:
    """Missed, late and phantom answers."""
    return {
        "missed": sum(e.hit and not np.isfinite(t) for e, t in zip(exact, toi, strict=True)),
        "late": sum(bool(np.isfinite(t)) and e.late(t) for e, t in zip(exact, toi, strict=True)),
        "phantom": sum(not e.hit and bool(np.isfinite(t)) for e, t in zip(exact, toi, strict=True)),
    }


def errors(exact: list[ExactToi], toi: np.ndarray) -> np.ndarray:
    """Exact minus reported toi, where both are finite: positive is early, negative is late."""
    return np.array([e.early_by(t) for e, t in zip(exact, toi, strict=True) if e.hit and np.isfinite(t)])


def error_statistics(signed: np.ndarray) -> dict:
    if not len(signed):
        return {"count": 0}
    size = np.abs(signed)
    return {
        "count": len(size),
        "median": float(np.median(size)),
        "p99": float(np.percentile(size, 99)),
        "max": float(size.max()),
        "least_signed": float(signed.min()),
    }


def median_ratio(rounds: dict[str, list[float]], a: str, b: str) -> float:
    return float(np.median(np.array(rounds[a]) / np.array(rounds[b])))


# ---- One set ---------------------------------------------------------------------------------------------------------


def measure(queries: QuerySet, seconds: float, cap: float, rounds: int, overhead: float) -> dict:
    """All figures of one set."""
    kind = queries.kind
    p0, p1 = (tiled(p, BATCH) for p in (queries.points_t0, queries.points_t1))
    peer = Peer(queries, cap, np.random.default_rng(0))
    # the bisection gets as many queries as fit into a third of a second
    few = min(8, len(queries.points_t0))
    bisection = {"method": "bisection", "max_iterations": 10_000}
    each = seconds_of(kind, queries.points_t0[:few], queries.points_t1[:few], **bisection) / few
    count = int(np.clip(0.3 / each, 1, len(queries.points_t0)))
    sample = np.random.default_rng(1).permutation(len(queries.points_t0))[:count]
    b0, b1 = (np.ascontiguousarray(p[sample]) for p in (queries.points_t0, queries.points_t1))

    times: dict[str, list[float]] = {name: [] for name in (*VARIANTS, "bisection", "clipping")}
    for options in VARIANTS.values():  # nothing is measured on a first call
        ours(kind, p0[:2], p1[:2], **options)
    for _ in range(rounds):
        for name, options in VARIANTS.items():
            times[name].append(seconds_of(kind, p0, p1, **options) / BATCH)
        times["bisection"].append(seconds_of(kind, b0, b1, **bisection) / count)
        # on the same queries, enough of them that the call does not count
        c0, c1 = (tiled(b, 20_000) for b in (b0, b1))
        times["clipping"].append(seconds_of(kind, c0, c1) / 20_000)
        peer.run(seconds / rounds)
    run = peer.close()

    both = {name: ours(kind, queries.points_t0, queries.points_t1, **VARIANTS[name]) for name in VARIANTS}
    plain = ours(kind, b0, b1, **bisection)
    finished = [queries.exact[i] for i in run.query]
    peer_toi = np.array(run.toi)
    per_query = float(np.mean(run.seconds)) - overhead if run.seconds else math.nan
    row = {
        "group": queries.group,
        "name": queries.name,
        "kind": kind,
        "queries": len(queries.exact),
        "collisions": sum(e.hit for e in queries.exact),
        "seconds": {name: float(np.median(values)) for name, values in times.items()},
        "rounds": times,
        "float32_speedup": median_ratio(times, "ours", "float32"),
        "ratio_1e-9": median_ratio(times, "1e-9", "ours"),
        "ratio_1e-12": median_ratio(times, "1e-12", "ours"),
        "bisection_ratio": median_ratio(times, "bisection", "clipping"),
        "bisection_queries": count,
        "bisection_capped": int((plain.status == ccd.CCDStatus.ITERATION_LIMIT).sum()),
        "bisection_iterations": float(plain.iterations.mean()),
        "faults": {name: faults(queries.exact, result.toi) for name, result in both.items()},
        "iterations": {
            "mean": float(both["ours"].iterations.mean()),
            "max": int(both["ours"].iterations.max()),
            "limits": int((both["ours"].status >= ccd.CCDStatus.ITERATION_LIMIT).sum()),
        },
        "peer": {
            "seconds": per_query,
            "median_seconds": float(np.median(run.seconds)) if run.seconds else math.nan,
            "queries": len(run.seconds),
            "capped": len(run.capped),
            "faults": faults(finished, peer_toi),
        },
        "ours_phantom_on_sample": faults(finished, both["ours"].toi[run.query])["phantom"],
        "ratio": per_query / float(np.median(times["ours"])),
    }
    row["_errors"] = {
        "ours": errors(finished, both["ours"].toi[run.query]),
        "peer": errors(finished, peer_toi),
        "float32": errors(queries.exact, both["float32"].toi),
        "1e-12": errors(queries.exact, both["1e-12"].toi),
    }
    row["error"] = {name: error_statistics(signed) for name, signed in row["_errors"].items()}
    return row


def pooled(rows: list[dict], name: str) -> dict:
    """One line for several sets: times weighted by the number of queries, counts added, errors pooled."""
    weight = np.array([row["queries"] for row in rows], dtype=float)

    def mean(values) -> float:
        return float(np.average(list(values), weights=weight))

    def added(pick) -> dict:
        return {key: sum(pick(row)[key] for row in rows) for key in pick(rows[0])}

    seconds = {key: mean(row["seconds"][key] for row in rows) for key in rows[0]["seconds"]}
    # the ratios between variants of ours are of weighted times as well, round by round
    rounds = {
        key: [mean(row["rounds"][key][i] for row in rows) for i in range(len(rows[0]["rounds"][key]))]
        for key in rows[0]["rounds"]
    }
    signed = {key: np.concatenate([row["_errors"][key] for row in rows]) for key in rows[0]["_errors"]}
    peer_seconds = mean(row["peer"]["seconds"] for row in rows)
    return {
        "group": rows[0]["group"],
        "name": name,
        "kind": rows[0]["kind"],
        "queries": int(weight.sum()),
        "collisions": sum(row["collisions"] for row in rows),
        "seconds": seconds,
        "float32_speedup": median_ratio(rounds, "ours", "float32"),
        "ratio_1e-9": median_ratio(rounds, "1e-9", "ours"),
        "ratio_1e-12": median_ratio(rounds, "1e-12", "ours"),
        "bisection_ratio": median_ratio(rounds, "bisection", "clipping"),
        "bisection_queries": sum(row["bisection_queries"] for row in rows),
        "bisection_capped": sum(row["bisection_capped"] for row in rows),
        "bisection_iterations": mean(row["bisection_iterations"] for row in rows),
        "faults": {key: added(lambda row, key=key: row["faults"][key]) for key in rows[0]["faults"]},
        "iterations": {
            "mean": mean(row["iterations"]["mean"] for row in rows),
            "max": max(row["iterations"]["max"] for row in rows),
            "limits": sum(row["iterations"]["limits"] for row in rows),
        },
        "peer": {
            "seconds": peer_seconds,
            "median_seconds": mean(row["peer"]["median_seconds"] for row in rows),
            "queries": sum(row["peer"]["queries"] for row in rows),
            "capped": sum(row["peer"]["capped"] for row in rows),
            "faults": added(lambda row: row["peer"]["faults"]),
        },
        "ours_phantom_on_sample": sum(row["ours_phantom_on_sample"] for row in rows),
        "ratio": peer_seconds / seconds["ours"],
        "error": {key: error_statistics(values) for key, values in signed.items()},
    }


# ---- Beyond single sets ----------------------------------------------------------------------------------------------


def measure_in_plane(rounds: int) -> list[dict]:
    """Time of a query in a common plane, as a multiple of that of a random one."""
    rows = []
    for kind in KINDS:
        points = {
            name: [tiled(p, BATCH) for p in FAMILIES[name](kind, 5000, np.random.default_rng(3))]
            for name in ("random", *IN_PLANE)
        }
        times = {name: [] for name in points}
        for _ in range(rounds):
            for name, (p0, p1) in points.items():
                times[name].append(seconds_of(kind, p0, p1) / BATCH)
        for name in IN_PLANE:
            rows.append(
                {
                    "name": name,
                    "kind": kind,
                    "seconds": float(np.median(times[name])),
                    "random": float(np.median(times["random"])),
                    "ratio": median_ratio(times, name, "random"),
                }
            )
    return rows


def measure_calls(rounds: int) -> dict:
    """Seconds of a warm call with few pairs, and of the first call of a process that finds its kernels compiled."""
    calls = {}
    for count in (1, 100, 10_000):
        p0, p1 = FAMILIES["random"]("vertex-face", count, np.random.default_rng(4))
        times = [seconds_of("vertex-face", p0, p1) for _ in range(rounds * (200 if count < 1000 else 10))]
        calls[str(count)] = float(np.median(times))
    code = (
        "import time, numpy as np, ccd_warp as ccd; x = np.zeros((1, 4, 3)); a = time.perf_counter(); "
        "ccd.vertex_face_ccd(x, x); print(time.perf_counter() - a)"
    )
    for _ in range(2):  # the first run compiles, should the kernels have changed
        output = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
        calls["first"] = float(output.split()[-1])
    return calls


def measure_threads(rounds: int) -> list[dict]:
    """Speed with two threads over that with one."""
    rows = []
    for kind in KINDS:
        p0, p1 = (
            tiled(p, 4 * BATCH) for p in FAMILIES["random_colliding"](kind, BATCH // 10, np.random.default_rng(5))
        )
        times: dict[str, list[float]] = {"1": [], "2": []}
        for _ in range(rounds):
            for threads in (1, 2):
                times[str(threads)].append(seconds_of(kind, p0, p1, num_threads=threads))
        rows.append({"kind": kind, "speedup": median_ratio(times, "1", "2")})
    return rows


# ---- Report ----------------------------------------------------------------------------------------------------------


def _faults(counts: dict) -> str:
    return f"{counts['missed']}/{counts['late']}/{counts['phantom']}"


def _error(statistics: dict) -> str:
    if not statistics["count"]:
        return "-"
    return f"{statistics['median']:.0e} {statistics['p99']:.0e} {statistics['max']:.0e}"


_COLUMNS = (
    ("set", 38, lambda r: f"{r['name']} {'VF' if r['kind'] == 'vertex-face' else 'EE'}"),
    ("n", 6, lambda r: r["queries"]),
    ("ours µs", 8, lambda r: f"{r['seconds']['ours'] * 1e6:.3f}"),
    ("peer µs", 9, lambda r: f"{r['peer']['seconds'] * 1e6:.1f}"),
    ("ratio", 8, lambda r: f"{'>' if r['peer']['capped'] else ''}{r['ratio']:.0f}"),
    ("peer n", 7, lambda r: r["peer"]["queries"]),
    ("capped", 6, lambda r: r["peer"]["capped"]),
    ("error: median p99 max", 21, lambda r: _error(r["error"]["ours"])),
    ("of the peer", 17, lambda r: _error(r["error"]["peer"])),
    ("m/l/p", 8, lambda r: _faults(r["faults"]["ours"])),
    ("float32", 8, lambda r: _faults(r["faults"]["float32"])),
    ("peer", 8, lambda r: _faults(r["peer"]["faults"])),
    ("its", 5, lambda r: f"{r['iterations']['mean']:.1f}"),
    ("max", 5, lambda r: r["iterations"]["max"]),
    ("lim", 3, lambda r: r["iterations"]["limits"]),
    ("f32 x", 5, lambda r: f"{r['float32_speedup']:.2f}"),
    ("1e-9", 5, lambda r: f"{r['ratio_1e-9']:.2f}"),
    ("1e-12", 5, lambda r: f"{r['ratio_1e-12']:.2f}"),
    ("bisect x", 8, lambda r: f"{r['bisection_ratio']:.0f}"),
    ("capped", 9, lambda r: f"{r['bisection_capped']}/{r['bisection_queries']}"),
)


def table(rows: list[dict]) -> str:
    lines = [" ".join(title.ljust(width) for title, width, _ in _COLUMNS)]
    lines += [" ".join(str(pick(row)).ljust(width) for _, width, pick in _COLUMNS) for row in rows]
    return "\n".join(lines)


def targets(published: list[dict], rows: list[dict], in_plane: list[dict]) -> list[tuple[str, str, bool]]:
    """What is to be reached, what was, and whether it is enough."""
    result = []
    for row in published:
        name = f"{row['name']} {row['kind']}"
        a, b = row["error"]["ours"], row["error"]["peer"]
        result.append((f"{name}: at least 1000 times the peer's speed", f"{row['ratio']:.0f}", row["ratio"] >= 1000))
        if a["count"] and b["count"]:
            found = f"{a['median']:.1e} to {b['median']:.1e}"
            result.append((f"{name}: median error a tenth of the peer's", found, 10 * a["median"] <= b["median"]))
            found = f"{a['max']:.1e} to {b['max']:.1e}"
            result.append((f"{name}: largest error not above the peer's", found, a["max"] <= b["max"]))
        ours_phantom, theirs = row["ours_phantom_on_sample"], row["peer"]["faults"]["phantom"]
        result.append(
            (f"{name}: no more phantoms than the peer", f"{ours_phantom} to {theirs}", ours_phantom <= theirs)
        )
        for key, most in (("1e-9", 1.3), ("1e-12", 1.5)):
            ratio = row[f"ratio_{key}"]
            result.append((f"{name}: tolerance {key} at most {most} times 1e-6", f"{ratio:.2f}", ratio <= most))
        speedup = row["float32_speedup"]
        result.append((f"{name}: float32 at least 1.5 times as fast", f"{speedup:.2f}", speedup >= 1.5))
    bad = sum(row["faults"][key][fault] for row in rows for key in VARIANTS for fault in ("missed", "late"))
    result.append(("none missed and none late, every set and variant", str(bad), bad == 0))
    limits = sum(row["iterations"]["limits"] for row in rows)
    result.append(("no limit reached", str(limits), limits == 0))
    for row in in_plane:
        result.append((f"{row['name']} {row['kind']}: at most 3 random ones", f"{row['ratio']:.2f}", row["ratio"] <= 3))
    return result


def main() -> int:
    parser = argparse.ArgumentParser(description="Narrow phase against Tight-Inclusion.")
    parser.add_argument("--quick", action="store_true", help="three rounds, a second of the peer a set, few families")
    parser.add_argument("--seconds", type=float, help="time of the peer on each published set (default 20, quick 2)")
    parser.add_argument("--cap", type=float, default=2.0, help="seconds after which the peer's query is stopped")
    parser.add_argument("--json", type=Path, help="file for the raw figures")
    parsed = parser.parse_args()
    rounds = 3 if parsed.quick else 5
    seconds = parsed.seconds or (2.0 if parsed.quick else 20.0)
    wp.config.log_level = wp.LOG_WARNING
    # the children that are forked run the peer alone, and no lock of a thread of ours
    warnings.filterwarnings("ignore", message=".*multi-threaded.*fork", category=DeprecationWarning)

    sets = []
    for q in all_queries():
        exact = exact_tois(q.kind, q.points_t0, q.points_t1)
        sets.append(QuerySet(q.name.split("/")[0], q.name, q.kind, q.points_t0, q.points_t1, exact))
    if not sets:
        print("the published sample queries are absent: families only", file=sys.stderr)
    names = ["random", "random_colliding", "cloth_like", "one_plane", "slivers"] if parsed.quick else list(FAMILIES)
    for name in names:
        for kind in KINDS:
            p0, p1 = FAMILIES[name](kind, 300, np.random.default_rng(2))
            sets.append(QuerySet("families", name, kind, p0, p1, exact_tois(kind, p0, p1)))

    overhead = {kind: peer_overhead(kind) for kind in KINDS}
    rows = []
    with tqdm(sets, file=sys.stderr, unit=" sets") as bar:
        for queries in bar:
            bar.set_postfix_str(f"{queries.name} {queries.kind}")
            budget = seconds if queries.group != "families" else seconds / 10
            rows.append(measure(queries, budget, parsed.cap, rounds, overhead[queries.kind]))
    published = []
    for group in ("handcrafted", "simulation"):
        for kind in KINDS:
            if chosen := [row for row in rows if row["group"] == group and row["kind"] == kind]:
                published.append(pooled(chosen, group))
    in_plane = measure_in_plane(rounds)
    calls = measure_calls(rounds)
    threads = measure_threads(rounds)

    about = machine()
    print(f"{about['cpu']}, {about['cores']} cores, {about['date']}, {about['versions']}")
    print(f"overhead of the peer's Python call: {', '.join(f'{k} {s * 1e6:.1f} µs' for k, s in overhead.items())}")
    print("m/l/p: missed, late, phantom. its, max, lim: iterations and answers at a limit. Ratios are to `ours`.\n")
    print(table(published + rows))
    print("\nin a common plane, as a multiple of a random query:")
    for row in in_plane:
        print(f"  {row['name']:28} {row['kind']:12} {row['seconds'] * 1e6:6.3f} µs  {row['ratio']:.2f}")
    print("\nwarm call: " + ", ".join(f"{n} pairs {s * 1e6:.0f} µs" for n, s in calls.items() if n != "first"))
    print(f"first call of a process, kernels compiled before: {calls['first']:.2f} s")
    print("two threads: " + ", ".join(f"{row['kind']} {row['speedup']:.2f} times" for row in threads) + "\n")
    found = targets(published, rows, in_plane)
    for text, value, is_met in found:
        print(f"{'met   ' if is_met else 'MISSED'}  {text}: {value}")

    if parsed.json:
        for row in rows:
            del row["_errors"]
        raw = {
            "machine": about,
            "arguments": {"rounds": rounds, "seconds": seconds, "cap": parsed.cap, "batch": BATCH},
            "peer_overhead": overhead,
            "published": published,
            "sets": rows,
            "in_plane": in_plane,
            "calls": calls,
            "threads": threads,
            "targets": [{"target": text, "found": value, "met": is_met} for text, value, is_met in found],
        }
        parsed.json.parent.mkdir(parents=True, exist_ok=True)
        parsed.json.write_text(json.dumps(raw, indent=1, default=lambda value: value.item()) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
