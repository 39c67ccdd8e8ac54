"""Fuzz driver: random hard queries and options against the exact oracle, until something breaks.

    python benchmarks/fuzz.py --queries 300000        # about five minutes on two cores
    python benchmarks/fuzz.py --queries 0             # until interrupted

Every batch draws a kind, a source of queries, a precision and options. A query fails if it is

- missed: the exact trajectories touch (or come within the separation), and toi is inf;
- late: toi is after the exact time of impact;
- phantom: at a finite toi, no limit reached, the exact gap is above separation + tolerance + 100 u · size. The kernel
  accepts at ten rounding bounds of at most 8.25 u each (kernels/pair/rounding.py), so 100 u of the pair's size and
  separation cover them;
- capped: the default max_iterations was reached, or the resolution's limit though the tolerance is above 100 u · size;
- gap: the reported bound of the gap is below the exact gap;
- insane: a status that contradicts toi, toi outside [0, t_max], or parameters that are not finite.

One batch in four is also put side by side into one mesh, where `mesh_ccd` and `collision_free_step` must neither miss a
query nor be late for one. This covers boxes, tree, filter and cull at all scales and positions.

Failing queries are saved as .npz beside a JSON with the options; the exit status is then 1.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import sys
import threading
import time
from collections import Counter
from pathlib import Path

import numpy as np
import warp as wp
from ccd_warp.benchmarks.fuzz_queries import MUTATIONS, PUBLISHED, draw, draw_options
from ccd_warp.benchmarks.methods import SOLVE
from ccd_warp.benchmarks.query_sets import default_data, size_of_motion
from hard_cases import FAMILIES, POINTS
from oracle import exact_gap, exact_tois
from tqdm import tqdm

import ccd_warp as ccd
from ccd_warp import datasets

KINDS = tuple(SOLVE)
UNIT_ROUNDOFF = {"float64": 2.0**-53, "float32": 2.0**-24}
CHECKS = ("missed", "late", "phantom", "capped", "gap", "insane")
BATCH = 100
MESH_SHARE = 0.25
ROUNDING = {name: 100 * u for name, u in UNIT_ROUNDOFF.items()}
# A reported gap is formed from a separation rounded up by 8 u (kernels/pair/rounding.py, step 6).
SEPARATION_ROUNDING = {name: 16 * u for name, u in UNIT_ROUNDOFF.items()}

# ---- Checks ----------------------------------------------------------------------------------------------------------


def check(kind: str, points_t0: np.ndarray, points_t1: np.ndarray, options: dict) -> tuple[list, dict]:
    """Failures of a batch as (query, check, message), and counts."""
    result = SOLVE[kind](points_t0, points_t1, **options)
    scale = options.get("length_scale")
    separation = options["minimum_separation"] * (scale or 1.0)
    t_max = options["t_max"]
    exact = exact_tois(kind, points_t0, points_t1, separation, t_max)
    size = size_of_motion(points_t0, points_t1)
    precision = options["precision"]
    failures = []
    counts = Counter(queries=len(exact), collisions=sum(e.hit for e in exact), hits=int(result.hit.sum()))
    for i, (truth, toi, status) in enumerate(zip(exact, result.toi.tolist(), result.status.tolist(), strict=True)):
        hit = np.isfinite(toi)
        if truth.hit and not hit:
            failures.append((i, "missed", f"exact {truth!r}, toi inf"))
        elif truth.late(toi):
            failures.append((i, "late", f"toi {toi!r} is late by {-truth.early_by(toi):.3e}"))
        rounding = ROUNDING[precision] * (size[i] + separation)
        tolerance = options["tolerance"] * (scale or size[i])
        limited = status == ccd.CCDStatus.ITERATION_LIMIT
        unresolved = status == ccd.CCDStatus.RESOLUTION_LIMIT
        counts["unresolved"] += unresolved
        if (limited and "max_iterations" not in options) or (unresolved and tolerance > rounding):
            failures.append((i, "capped", f"status {status} after {result.iterations[i]} iterations"))
        if (status == ccd.CCDStatus.NO_COLLISION) == hit or status == ccd.CCDStatus.INVALID:
            failures.append((i, "insane", f"status {status} with toi {toi}"))
        if hit and not 0.0 <= toi <= t_max:
            failures.append((i, "insane", f"toi {toi!r} outside [0, {t_max!r}]"))
        if not (np.isfinite(result.parameters[i]).all() and result.gap[i] >= 0 and result.width[i] >= 0):
            failures.append((i, "insane", f"parameters {result.parameters[i]}, gap {result.gap[i]}"))
        if not hit:
            continue
        counts["phantoms"] += not truth.hit
        gap = exact_gap(kind, points_t0[i], points_t1[i], toi)
        reported = float(result.gap[i])
        # 1e-15: the oracle's gap is rounded once; 5e-324: it may be subnormal
        if gap > (separation + reported) * (1 + 1e-15) + SEPARATION_ROUNDING[precision] * separation + 5e-324:
            failures.append((i, "gap", f"gap {gap!r} above separation + reported gap {reported!r}"))
        bound = separation + tolerance + rounding
        # an answer at the resolution limit may exceed the bound, and its status says so: it is counted, not hidden
        counts["unresolved_beyond"] += int(unresolved and gap > bound)
        if gap > bound and not (limited or unresolved):
            failures.append((i, "phantom", f"gap {gap!r} above {bound!r} at toi {toi!r}"))
    return failures, counts


def check_mesh(kind: str, points_t0: np.ndarray, points_t1: np.ndarray, options: dict) -> list:
    """Failures of a batch whose queries are put into one mesh, where they also form pairs with each other."""
    options = {"length_scale": 1.0, **options}
    separation = options["minimum_separation"] * options["length_scale"]
    exact = exact_tois(kind, points_t0, points_t1, separation, options["t_max"])
    first = 4 * np.arange(len(points_t0))[:, None]
    faces = first + [1, 2, 3] if kind == "vertex-face" else np.concatenate([first + [0, 1, 1], first + [2, 3, 3]])
    start, end = points_t0.reshape(-1, 3), points_t1.reshape(-1, 3)
    mesh = ccd.CollisionMesh.from_arrays([(start, faces)], codimensional_points=kind == "vertex-face")
    contacts = ccd.mesh_ccd(mesh, start, end, **options).contacts
    step = ccd.collision_free_step(mesh, start, end, **options)
    wanted = ccd.PairKind[kind.replace("-", "_").upper()]
    pairs, tois = contacts.primitives[contacts.kind == wanted], contacts.toi[contacts.kind == wanted]
    if kind == "vertex-face":
        corners = np.concatenate([pairs[:, :1], mesh.faces[pairs[:, 1]]], axis=1)
    else:
        corners = mesh.edges[pairs].reshape(-1, 4)
    query = corners.min(axis=1) // 4
    own = corners.max(axis=1) // 4 == query
    found = dict(zip(query[own].tolist(), tois[own].tolist(), strict=True))
    failures = []
    for i, truth in enumerate(exact):
        if truth.hit and i not in found:
            failures.append((i, "missed", f"exact {truth!r}, no contact in the mesh"))
        elif truth.late(found.get(i, 0.0)) or truth.late(step):
            failures.append((i, "late", f"in a mesh: toi {found.get(i)!r}, step {step!r}"))
    return failures


def start_worker(published: dict) -> None:
    """Set-up of a worker process."""
    wp.config.log_level = wp.LOG_WARNING
    PUBLISHED.update(published)


def run_batch(task: tuple) -> dict:
    """Run one batch in a worker; it is drawn from its own seed, so that it can be repeated alone."""
    seed, index, kind, dimension, source, arguments = task
    rng = np.random.default_rng([seed, index])
    options = draw_options(arguments, rng)
    points_t0, points_t1 = draw(source, kind, dimension, BATCH, rng)
    report = {"index": index, "kind": kind, "source": source, "dimension": dimension, "options": options}
    failures, report["counts"] = check(kind, points_t0, points_t1, options)
    if POINTS[kind] == 4 and rng.random() < MESH_SHARE:
        failures += check_mesh(kind, points_t0, points_t1, options)
        report["counts"]["in_meshes"] = len(points_t0)
    report["failures"] = [(i, name, message, points_t0[i], points_t1[i]) for i, name, message in failures]
    return report


def tasks(seed: int, batches: int, sources: list[str], kinds: list[str], arguments: dict, slots: threading.Semaphore):
    """Batches in turn over kinds, dimensions and sources, so that each combination gets its share; 0 is endless.

    A pool draws tasks as fast as it can, so each waits for a free slot, which a finished task releases.
    """
    shapes = [(kind, d) for kind in kinds for d in ((3,) if POINTS[kind] == 4 else (2, 3))]
    # most users have pairs of four points, so these get three batches for each one of the others
    shapes = [shape for shape in shapes for _ in range(3 if POINTS[shape[0]] == 4 else 1)]
    combinations = [(*shape, source) for source in sources for shape in shapes]
    index = 0
    while index < batches or batches == 0:
        slots.acquire()
        kind, dimension, source = combinations[index % len(combinations)]
        yield seed, index, kind, dimension, source, arguments
        index += 1


def save(folder: Path, seed: int, report: dict) -> Path:
    """Save the failing queries of a batch as arrays, and everything needed to repeat them as JSON."""
    folder.mkdir(parents=True, exist_ok=True)
    queries = {i: (p0, p1) for i, _, _, p0, p1 in report["failures"]}
    points_t0, points_t1 = (np.stack(points) for points in zip(*queries.values(), strict=True))
    options = report["options"]
    separation = options["minimum_separation"] * options.get("length_scale", 1.0)
    truth = [e.hit for e in exact_tois(report["kind"], points_t0, points_t1, separation, options["t_max"])]
    path = folder / f"seed{seed}_batch{report['index']}_{report['kind']}_{report['source']}.npz"
    np.savez(path, points_t0=points_t0, points_t1=points_t1, truth=np.array(truth))
    rows = {i: row for row, i in enumerate(queries)}
    failures = [
        {"row": rows[i], "query": i, "check": name, "message": text} for i, name, text, *_ in report["failures"]
    ]
    about = {key: report[key] for key in ("kind", "dimension", "source", "index", "options")}
    path.with_suffix(".json").write_text(json.dumps({"seed": seed, **about, "failures": failures}, indent=1))
    return path


def main() -> int:
    parser = argparse.ArgumentParser(description="Fuzz pairs and meshes against exact arithmetic.")
    parser.add_argument("--queries", type=int, default=300_000, help="number of queries; 0 goes on until interrupted")
    parser.add_argument("--seed", type=int, help="seed of the run; by default a fresh one, printed")
    parser.add_argument("--families", nargs="+", choices=[*FAMILIES, *MUTATIONS], help="sources; by default all")
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS))
    parser.add_argument("--precision", nargs="+", choices=list(UNIT_ROUNDOFF), default=list(UNIT_ROUNDOFF))
    parser.add_argument("--separation", type=float, help="minimum separation of every batch; by default drawn")
    parser.add_argument("--t-max", type=float, help="t_max of every batch; by default drawn")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--save", type=Path, default=Path("fuzz_failures"), help="folder of the failing queries")
    parser.add_argument("--json", type=Path, help="file for the counts")
    parsed = parser.parse_args()

    seed = int(np.random.SeedSequence().generate_state(1)[0]) if parsed.seed is None else parsed.seed
    print(f"seed {seed}")
    sources = parsed.families or [*FAMILIES, *MUTATIONS]
    published = {}
    folder = default_data()
    if folder is not None:
        sets = datasets.find_queries(folder)
        for kind in ("vertex-face", "edge-edge"):
            parts = [(q.points_t0, q.points_t1) for q in sets if q.kind == kind]
            published[kind] = tuple(np.concatenate(frames) for frames in zip(*parts, strict=True))
    else:
        sources = [source for source in sources if not source.startswith("published")]
        print("the published sample queries are absent: their mutations are left out")
    wp.config.log_level = wp.LOG_WARNING
    for precision in parsed.precision:  # compile once here, so that the workers find the kernels in the cache
        SOLVE["vertex-face"](np.zeros((1, 4, 3)), np.zeros((1, 4, 3)), precision=precision)

    arguments = {"precision": parsed.precision, "separation": parsed.separation, "t_max": parsed.t_max}
    batches = -(-parsed.queries // BATCH)
    counts: Counter = Counter()
    checks: Counter = Counter()
    by_source: Counter = Counter()
    begin = time.perf_counter()
    slots = threading.Semaphore(8 * parsed.processes)
    context = multiprocessing.get_context("spawn")  # a forked Warp would share its threads' locks
    with (
        context.Pool(parsed.processes, start_worker, (published,)) as pool,
        tqdm(total=parsed.queries or None, unit=" queries", file=sys.stderr) as bar,
    ):
        try:
            queue = tasks(seed, batches, sources, parsed.kinds, arguments, slots)
            for report in pool.imap_unordered(run_batch, queue):
                slots.release()
                counts.update(report["counts"])
                for key in ("kind", "source"):
                    by_source[report[key]] += BATCH
                by_source[report["options"]["precision"]] += BATCH
                if report["failures"]:
                    checks.update(name for _, name, *_ in report["failures"])
                    path = save(parsed.save, seed, report)
                    _, name, message, *_ = report["failures"][0]
                    tqdm.write(f"{name} in {path.name}: {message}", file=sys.stderr)
                bar.set_postfix(failures=checks.total(), refresh=False)
                bar.update(BATCH)
        except KeyboardInterrupt:
            slots.release(10**6)  # releases the feeding thread of the pool
            pool.terminate()
    seconds = time.perf_counter() - begin

    rate = counts["queries"] / seconds
    print(
        f"{counts['queries']} queries in {seconds:.0f} s ({rate:.0f} a second, {parsed.processes} processes), "
        f"{counts['collisions']} exact collisions, {counts['hits']} hits, {counts['phantoms']} phantoms, "
        f"{counts['unresolved']} at the limit of the resolution, {counts['unresolved_beyond']} beyond the bound, "
        f"{counts['in_meshes']} queries in meshes as well"
    )
    print(", ".join(f"{by_source[name]} {name}" for name in (*parsed.kinds, *parsed.precision)))
    print(", ".join(f"{name}: {checks[name]}" for name in CHECKS))
    if parsed.json:
        summary = {
            "seed": seed,
            "seconds": seconds,
            "version": ccd.__version__,
            **counts,
            "failures": dict(checks),
            "of": dict(by_source),
        }
        parsed.json.write_text(json.dumps(summary, indent=1))
    return 1 if checks.total() else 0


if __name__ == "__main__":
    sys.exit(main())
