"""What a Euclidean distance costs and how exactly it is kept: the tables of NOTES.md, by one command for each.

python -m ccd_warp.benchmarks.distances pairs      time of a pair, beside no distance and the maximum norm
python -m ccd_warp.benchmarks.distances steps      time of a step, likewise
python -m ccd_warp.benchmarks.distances turned     what turning a scene does to toi, against exact arithmetic
python -m ccd_warp.benchmarks.distances additive   step sizes beside those of ipctk's additive CCD

Times are those of the processor, for one thread: the least of interleaved rounds, which other work raises least.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import warp as wp
from ccd_warp.benchmarks import scenes
from ccd_warp.benchmarks.distance_oracle import exact_distance_tois
from ccd_warp.benchmarks.hard_cases import FAMILIES
from ccd_warp.benchmarks.methods import SOLVE
from ccd_warp.benchmarks.numbers import table

import ccd_warp as ccd

# In lengths of an edge of a pair, or of the mean edge of a scene.
DISTANCES = (1e-4, 1e-2, 0.3)
SETS = ("random", "random_colliding", "grazing_vertex")
KINDS = ("vertex-face", "edge-edge")
NUM_PAIRS, NUM_FACES = 40_000, 20_000
NUM_TURNED, NUM_TURNS = 100, 10
NUM_SCENES = 300


def least_times(calls: dict[Any, Callable[[], Any]], rounds: int) -> dict[Any, float]:
    """Least seconds of processor time of each call, after one to warm up."""
    seconds = dict.fromkeys(calls, np.inf)
    for k in range(rounds + 1):
        for name, call in calls.items():
            begin = time.process_time()
            call()
            if k:
                seconds[name] = min(seconds[name], time.process_time() - begin)
    return seconds


def distance_options(edge_length: float) -> dict[str, dict]:
    """Options of no distance, and of each distance as a ball and as a box of the same length."""
    options: dict[str, dict] = {"none": {}}
    for distance in DISTANCES:
        length = distance * edge_length
        options[f"{distance:g} ball"] = {"minimum_distance": length}
        options[f"{distance:g} box"] = {"minimum_separation": length, "length_scale": 1.0}
    return options


def mean_edge(start: np.ndarray, edges: np.ndarray) -> float:
    """Root of the mean squared length of some edges."""
    return float((np.diff(start[edges], axis=1) ** 2).sum(axis=-1).mean() ** 0.5)


def pairs_table(rounds: int) -> list[str]:
    """Nanoseconds a pair."""
    rows = []
    for precision in ("float64", "float32"):
        for family in SETS:
            for kind in KINDS:
                frames = FAMILIES[family](kind, NUM_PAIRS, np.random.default_rng(1))
                ends = (1, 2) if kind == "vertex-face" else (0, 1)
                length = mean_edge(frames[0].reshape(-1, 3), np.arange(4 * NUM_PAIRS).reshape(-1, 4)[:, ends])
                options = distance_options(length)
                common = {"precision": precision, "num_threads": 1, "device": "cpu"}
                calls = {
                    name: lambda o=o, k=kind, f=frames, c=common: SOLVE[k](*f, **o, **c) for name, o in options.items()
                }
                seconds = least_times(calls, rounds)
                rows.append([f"{family} {kind} {precision}", *(f"{1e9 * s / NUM_PAIRS:.0f}" for s in seconds.values())])
    return table(["ns a pair", *distance_options(1.0)], rows)


def steps_table(rounds: int) -> list[str]:
    """Milliseconds of `mesh_ccd`, and of `collision_free_step` behind it."""
    rows = []
    for make in (scenes.cloth_over_sphere, scenes.crumpled_cloth, scenes.long_step):
        scene = make(NUM_FACES)
        mesh = scene.mesh(ccd)
        frames = (scene.vertices_t0, scene.vertices_t1)
        options = distance_options(mean_edge(mesh.vertices, mesh.edges))
        calls: dict[Any, Callable[[], Any]] = {}
        for name, chosen in options.items():
            pipeline = ccd.CollisionPipeline(mesh, num_threads=1, device="cpu", **chosen)
            calls[name, 0] = lambda p=pipeline, f=frames: p.mesh_ccd(*f)
            calls[name, 1] = lambda p=pipeline, f=frames: p.collision_free_step(*f)
        seconds = least_times(calls, rounds)
        cells = (f"{1e3 * seconds[name, 0]:.3g}, {1e3 * seconds[name, 1]:.3g}" for name in options)
        rows.append([f"{scene.name}, {len(scene.faces):,} faces", *cells])
    return table(["ms a step", *distance_options(1.0)], rows)


def random_rotation(rng: np.random.Generator) -> np.ndarray:
    """A rotation, all of them equally likely; its entries are rounded."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else -q


def turned_table(rounds: int) -> list[str]:
    """Change of toi by a rotation, that of the exact time, and how far both differ; all of pairs that collide."""
    rows = []
    rng = np.random.default_rng(2)
    for kind in KINDS:
        frames = FAMILIES["random_colliding"](kind, NUM_TURNED, rng)
        for distance in DISTANCES:
            changes: dict[str, list[np.ndarray]] = {"ball": [], "exact": [], "beyond": [], "box": []}
            options = {"num_threads": 1, "device": "cpu"}
            box = {"minimum_separation": distance, "length_scale": 1.0, **options}
            ball = {"minimum_distance": distance, **options}

            def exact(points: list[np.ndarray], kind: str = kind, distance: float = distance) -> np.ndarray:
                return np.array([e.approx if e.hit else np.inf for e in exact_distance_tois(kind, *points, distance)])

            was = [SOLVE[kind](*frames, **ball).toi, exact(list(frames)), SOLVE[kind](*frames, **box).toi]
            for _ in range(NUM_TURNS * rounds):
                rotation = random_rotation(rng)
                turned = [np.einsum("ij,nkj->nki", rotation, x) for x in frames]
                now = [SOLVE[kind](*turned, **ball).toi, exact(turned), SOLVE[kind](*turned, **box).toi]
                both = np.isfinite(was).all(axis=0) & np.isfinite(now).all(axis=0) & (was[1] > 0)
                change = [(b - a)[both] for a, b in zip(was, now, strict=True)]
                changes["ball"].append(abs(change[0]))
                changes["exact"].append(abs(change[1]))
                changes["beyond"].append(abs(change[0] - change[1]))
                changes["box"].append(abs(change[2]))
            cells = []
            for values in changes.values():
                all_values = np.concatenate(values)
                cells.append(f"{np.median(all_values):.1e}, {all_values.max():.1e}")
            rows.append([f"{kind}, {distance:g}", *cells])
    header = ["median, largest", "change of toi", "of the exact time", "difference of the two", "change with a box"]
    return table(header, rows)


def additive_table(rounds: int) -> list[str]:
    """Step of ours and of additive CCD on random triangles, with the same distance."""
    import ipctk

    rows = []
    for distance in (1e-4, 1e-2, 0.05):
        ratios, longer = [], 0
        for seed in range(NUM_SCENES * rounds):
            rng = np.random.default_rng(seed)
            start = (rng.random((20, 1, 3)) + 0.02 * rng.normal(size=(20, 3, 3))).reshape(-1, 3)
            faces = np.arange(60).reshape(-1, 3)
            end = start + 0.3 * np.repeat(rng.normal(size=(20, 3)), 3, axis=0) + 0.01 * rng.normal(size=(60, 3))
            mesh = ccd.CollisionMesh.from_arrays([(start, faces)])
            ours = ccd.collision_free_step(mesh, start, end, minimum_distance=distance, device="cpu")
            if ours == 0.0 or ours == 1.0:
                continue  # it starts within the distance, or nothing comes within it
            theirs = ipctk.compute_collision_free_stepsize(
                ipctk.CollisionMesh(start, mesh.edges.astype(np.int32), faces.astype(np.int32)),
                start,
                end,
                min_distance=distance,
                narrow_phase_ccd=ipctk.AdditiveCCD(conservative_rescaling=0.9),
            )
            ratios.append(theirs / ours)
            longer += theirs > ours
        rows.append([f"{distance:g}", len(ratios), *(f"{f(ratios):.3f}" for f in (np.median, np.min, np.max)), longer])
    return table(["distance", "scenes", "additive / ours, median", "least", "largest", "longer than ours"], rows)


TABLES = {"pairs": pairs_table, "steps": steps_table, "turned": turned_table, "additive": additive_table}


def main() -> None:
    """Print one table."""
    parser = argparse.ArgumentParser(description="What a Euclidean distance costs and how exactly it is kept.")
    parser.add_argument("table", choices=TABLES)
    parser.add_argument("--rounds", type=int, help="rounds (default 9 for times, else 1)")
    arguments = parser.parse_args()
    wp.config.log_level = wp.LOG_WARNING
    is_timed = arguments.table in ("pairs", "steps")
    print("\n".join(TABLES[arguments.table](arguments.rounds or (9 if is_timed else 1))))


if __name__ == "__main__":
    main()
