"""``ccd-warp bench``: how fast this machine is, and whether an answer is missed or late, compared with ipc-toolkit.

The truth of the queries is known by construction. One primitive keeps a height above the plane of the other, within
which both move and deform; the height falls on a line and is zero at the time k/D. All of it is integers, so that it is
decided exactly whether the primitives meet then, and k/D is exact. An integer matrix tilts and shears all of it, and a
motion that all points share is added, which changes neither.
"""

import argparse
import csv
import time
from collections.abc import Callable, Iterator
from functools import partial
from importlib.metadata import version
from importlib.util import find_spec
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import warp as wp

from ccd_warp._calls.pair_ccd import edge_edge_ccd, vertex_face_ccd
from ccd_warp._calls.pipeline import CollisionPipeline
from ccd_warp._cli.demo import cloth_scene
from ccd_warp._cli.process import make_folder, start_quietly, teller
from ccd_warp._runtime.version import __version__

SIDE = 1024  # of the primitives, which is the unit of the tolerance
KINDS = {"vertex-face": vertex_face_ccd, "edge-edge": edge_edge_ccd}
# Of each family D, the largest motion within the plane (0: any) and the largest common motion.
FAMILIES = {"general": (1024, 256, 0), "cloth-like": (32, 16, 1 << 12), "near-degenerate": (1024, 0, 1 << 20)}
DEFAULT_TOLERANCE = 1e-6
MOST_ITERATIONS = 100_000  # of ipc-toolkit on a query, which else may take minutes


class Queries(NamedTuple):
    """Pairs of one family and kind with their exact times of impact, inf where they do not meet."""

    kind: str
    points_t0: np.ndarray
    points_t1: np.ndarray
    toi: np.ndarray


def queries_of(family: str, kind: str, count: int) -> Queries:
    """So many pairs whose contact is certain or impossible."""
    rng = np.random.default_rng(len(family))
    denominator, motion, common = FAMILIES[family]
    size = (8 * count, 4, 2)
    if motion:
        start = rng.integers(-SIDE // 2, SIDE // 2, size)
        _aim(kind, start, rng)
        end = start + rng.integers(-motion, motion + 1, size)
        k = rng.integers(-denominator // 5, denominator + denominator // 5, size[0])
    else:  # on a lattice, or by one off it: repeated points, corners that meet, contacts at both ends of the step
        start, end = (rng.integers(0, 4, size) * (SIDE // 4) + rng.integers(-1, 2, (size[0], 1, 1)) for _ in range(2))
        start[::3, 3] = start[::3, 2] + rng.integers(-1, 2, start[::3, 3].shape)  # slivers and short edges
        k = np.clip(rng.integers(0, 5, size[0]) * (denominator // 4) + rng.integers(-1, 2, size[0]), 0, None)
    meets, is_certain = _meets(kind, start * denominator + (end - start) * k[:, None, None])
    meets, certain = meets & (k >= 0) & (k <= denominator), np.flatnonzero(is_certain)[:count]
    places, tilt = [], rng.integers(-3, 4, (size[0], 3, 3))
    tilt[np.abs(np.linalg.det(tilt)) < 0.5] = np.eye(3, dtype=int)
    is_above = np.arange(4) < (1 if kind == "vertex-face" else 2)
    for plane, height in ((start, k), (end, k - denominator)):
        points = np.concatenate([plane, (height[:, None] * is_above)[..., None]], axis=2)
        places.append((points @ tilt + rng.integers(-common, common + 1, (size[0], 1, 3)))[certain].astype(float))
    return Queries(kind, places[0], places[1], np.where(meets, k / denominator, np.inf)[certain])


def _aim(kind: str, points: np.ndarray, rng: np.random.Generator) -> None:
    """Bring three of four pairs to where they meet, or nearly."""
    some, weights = rng.random(len(points)) < 0.75, rng.dirichlet(np.ones(3), len(points))[:, :, None]
    if kind == "vertex-face":
        points[some, 0] = np.round((points[:, 1:] * weights).sum(axis=1))[some]
    else:
        crossing = points[:, 0] * weights[:, 0] + points[:, 1] * (1 - weights[:, 0])
        points[some, 3] = np.round(crossing + (crossing - points[:, 2]) * rng.uniform(0.1, 1))[some]


def _meets(kind: str, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Whether the primitives, in one plane, meet; and whether that is certain: the face has an area, edges cross."""

    def side(i: int, j: int, k: int) -> np.ndarray:
        (ax, ay), (bx, by), (cx, cy) = (points[:, n].T for n in (i, j, k))
        return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)

    if kind == "vertex-face":
        area = side(1, 2, 3)
        return np.all([side(0, *of) * np.sign(area) >= 0 for of in ((1, 2), (2, 3), (3, 1))], axis=0), area != 0
    a, b, c, d = side(0, 1, 2), side(0, 1, 3), side(2, 3, 0), side(2, 3, 1)
    return (np.sign(a) * np.sign(b) <= 0) & (np.sign(c) * np.sign(d) <= 0), a != b


def judged(toi: np.ndarray, truth: np.ndarray) -> dict[str, Any]:
    """What is wrong with some answers, and by how much the others are early; one at nan is undecided, and left out."""
    toi, truth = toi[~np.isnan(toi)], truth[~np.isnan(toi)]
    is_reported, is_hit = np.isfinite(toi), np.isfinite(truth)
    early = truth[is_reported & is_hit] - toi[is_reported & is_hit]
    return {
        "queries": len(toi),
        "missed": int((is_hit & ~is_reported).sum()),
        "late": int((early < 0).sum()),
        "phantom": int((is_reported & ~is_hit).sum()),
        "early_99": float(np.quantile(early, 0.99)) if len(early) else 0.0,
        "early_most": float(early.max(initial=0.0)),
    }


def timed(call: Callable[[], Any], rounds: int) -> tuple[float, Any]:
    """Median seconds of a call, which is made once before, and its result."""
    call()  # compiles, loads and reserves
    seconds = []
    for _ in range(rounds):
        begin = time.perf_counter()
        result = call()
        seconds.append(time.perf_counter() - begin)
    return float(np.median(seconds)), result


def ours(queries: Queries, rounds: int, batch: int, **options: Any) -> dict[str, Any]:
    """One row: seconds of a query in a batch, and what the answers are worth."""
    points = [np.resize(x, (batch, 4, 3)) for x in (queries.points_t0, queries.points_t1)]
    seconds, result = timed(partial(KINDS[queries.kind], *points, length_scale=SIDE, **options), rounds)
    return {"seconds": seconds / batch, **judged(result.toi[: len(queries.toi)], queries.toi)}


def peer(queries: Queries, tolerance: float, budget: float, name: str) -> dict[str, Any]:
    """One row of ipc-toolkit, called query by query for some seconds; less the time of a call that does nothing."""
    import ipctk

    ipctk.set_logger_level(ipctk.LoggerLevel.off)
    word = "point_triangle_ccd" if queries.kind == "vertex-face" else "edge_edge_ccd"
    if name == "Tight-Inclusion":
        call = getattr(ipctk.tight_inclusion, word)
        options = {"tolerance": tolerance * SIDE, "max_iterations": MOST_ITERATIONS}
    else:  # it has no tolerance: it stops where this fraction of the gap is left
        call, options = getattr(ipctk.AdditiveCCD(MOST_ITERATIONS, 1 - tolerance), word), {}
    seconds, toi, until = [], [], time.perf_counter() + budget
    for points in np.concatenate([queries.points_t0, queries.points_t1], axis=1):
        begin = time.perf_counter()
        is_hit, at = call(*points, **options)[:2]
        seconds.append(time.perf_counter() - begin)
        toi.append(at if is_hit else np.inf)
        if time.perf_counter() > until:
            break
    still = np.tile(np.eye(4, 3)[[3, 0, 1, 2] if queries.kind == "vertex-face" else [0, 0, 1, 1]], (2, 1))
    overhead, _ = timed(partial(call, *still, **options), 100)  # of primitives that do not move
    a_query = max(float(np.mean(seconds)) - overhead, 0.05 * overhead)
    return {"seconds": a_query, **judged(np.array(toi), queries.toi[: len(toi)])}


def query_rows(is_quick: bool, devices: list[str], has_peer: bool) -> Iterator[dict[str, Any]]:
    """A row for each family, kind, tolerance and method."""
    count, batch, rounds, budget = (1_000, 20_000, 3, 0.1) if is_quick else (10_000, 200_000, 7, 1.5)
    tolerances = (1e-2, 1e-4, DEFAULT_TOLERANCE) if is_quick else (1e-2, 1e-3, 1e-4, 1e-5, DEFAULT_TOLERANCE, 1e-8)
    of_ours = [(precision, device) for precision in ("float64", "float32") for device in devices]
    for family, kind in product(FAMILIES, KINDS):
        queries = queries_of(family, kind, count)
        for tolerance in tolerances:
            about = {"family": family, "kind": kind, "tolerance": tolerance}
            for precision, device in of_ours:
                options = {"precision": precision, "device": device} | ({"num_threads": 1} if device == "cpu" else {})
                name = f"ours {precision}" + ("" if device == "cpu" else f", {device}")
                yield about | {"method": name} | ours(queries, rounds, batch, tolerance=tolerance, **options)
            for name in ("Tight-Inclusion", "additive CCD") if has_peer else ():
                yield about | {"method": name} | peer(queries, tolerance, budget, name)


def step_rows(is_quick: bool, devices: list[str], has_peer: bool) -> Iterator[tuple[str, str, float]]:
    """Seconds of a whole step of a cloth over a sphere: scene, call and median of some rounds."""
    for cells in (71,) if is_quick else (71, 223):
        scene = cloth_scene(cells).frames
        mesh, frames = scene.mesh, (scene.vertices_t0, scene.vertices_t1)
        calls: dict[str, Callable[[], Any]] = {}
        for device, name in product(devices, ("collision_free_step", "mesh_ccd")):
            calls[f"{name}, {device}"] = partial(getattr(CollisionPipeline(mesh, device=device), name), *frames)
        if has_peer:
            import ipctk

            peer_mesh, candidates = ipctk.CollisionMesh(frames[0], mesh.edges, mesh.faces), ipctk.Candidates()
            calls["ipctk: LBVH"] = partial(candidates.build, peer_mesh, *frames, broad_phase=ipctk.LBVH())
            calls["ipctk: Tight-Inclusion"] = partial(candidates.compute_collision_free_stepsize, peer_mesh, *frames)
        for name, call in calls.items():
            yield f"cloth over sphere, {len(mesh.faces):,} faces", name, timed(call, 2 if is_quick else 9)[0]


def table_of(rows: list[dict[str, Any]], of_steps: list[tuple[str, str, float]]) -> list[str]:
    """The figures at the default tolerance, and the whole steps."""
    header = ["queries", "method", "a query", "99 in 100 early by", "all by", "missed", "late", "phantom", "of"]
    lines = []
    for row in (row for row in rows if row["tolerance"] == DEFAULT_TOLERANCE):
        lines.append([f"{row['family']}, {row['kind']}", row["method"], f"{1e9 * row['seconds']:,.0f} ns"])
        lines[-1] += [f"{row[name]:.0e}" for name in ("early_99", "early_most")]
        lines[-1] += [str(row[name]) for name in ("missed", "late", "phantom", "queries")]
    steps = [[scene, name, f"{1e3 * seconds:.1f} ms"] for scene, name, seconds in of_steps]
    return [*_aligned([header, *lines]), "", *_aligned([["a whole step", "call", "time"], *steps])]


def _aligned(rows: list[list[str]]) -> list[str]:
    """Lines of columns side by side."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  " + "  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]


def run(arguments: argparse.Namespace) -> int:
    """Measure, print a table, write bench.csv; 1 where an answer of ours is missed or late, else 0."""
    start_quietly(None)
    present = [device.alias for device in wp.get_devices()]
    devices = arguments.devices or present
    if unknown := set(devices).difference(present):
        raise ValueError(f"--devices {min(unknown)}: expected some of {', '.join(present)}")
    folder: Path = arguments.output
    make_folder(folder, "--output")
    tell = teller(None, is_quiet=arguments.quiet)
    has_peer = find_spec("ipctk") is not None
    title = f"ccd-warp {__version__}" + (f", ipctk {version('ipctk')}" if has_peer else "")
    tell(title := f"{title}; {', '.join(wp.get_device(name).name for name in devices)}, one thread of a CPU")
    tell("measuring queries and steps, which takes a minute or more" if not arguments.quick else "measuring")
    rows = list(query_rows(arguments.quick, devices, has_peer))
    of_steps = list(step_rows(arguments.quick, devices, has_peer))
    with (folder / "bench.csv").open("w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows([rows[0].keys(), *(row.values() for row in rows)])
    tell("\n".join(table_of(rows, of_steps)))
    tell(f"wrote bench.csv in {folder}")
    if not has_peer:
        tell("not installed: ipctk, to stand beside ours; install with: pip install 'ccd-warp[bench]'")
    of_ours = [row for row in rows if row["method"].startswith("ours")]
    wrong = [sum(row[fault] for row in of_ours) for fault in ("missed", "late")]
    tell(f"{sum(row['queries'] for row in of_ours):,} answers of ours: {wrong[0]} missed, {wrong[1]} late")
    return int(any(wrong))
