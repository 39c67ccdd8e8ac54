"""Whole steps against ipc-toolkit: broad phase, collision-free step, all contacts; and how the cost grows.

    pip install -e '.[test,bench]' && python benchmarks/whole_step.py --json benchmarks/results/whole_step.json

Peer: `Candidates.build` with `LBVH`, its fastest, then `compute_collision_free_stepsize` with `TightInclusionCCD`, both
on all cores. Each round calls the peer and ours in turn on the same two frames; medians. The time of a mesh's
construction counts for neither; the first step, which orders the mesh once, is given apart.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import warp as wp
from machine import machine
from scenes import Scene, all_scenes, cloth_over_sphere
from tqdm import tqdm

import ccd_warp as ccd

GROWTH = (10_000, 30_000, 100_000, 300_000, 1_000_000, 2_000_000)


def timed(function):
    """Result and seconds of a call that is made twice in a row.

    The second counts: threads of the library that ran before spin for a while, and its data is in the caches.
    """
    function()
    begin = time.perf_counter()
    result = function()
    return result, time.perf_counter() - begin


def median(values: list[float]) -> float:
    return statistics.median(values)


class Peer:
    """ipc-toolkit on one scene. A sheet and a sphere are one mesh to it, and what rests moves by nothing."""

    def __init__(self, scene: Scene, mesh: ccd.CollisionMesh) -> None:
        import ipctk

        self.toolkit = ipctk
        self.scene = scene
        edges = np.asarray(mesh.edges, dtype=np.int32)
        self.mesh = ipctk.CollisionMesh(scene.vertices_t0, edges, scene.faces.astype(np.int32))

    def build(self):
        """The candidates of its fastest broad phase."""
        candidates = self.toolkit.Candidates()
        candidates.build(self.mesh, self.scene.vertices_t0, self.scene.vertices_t1, broad_phase=self.toolkit.LBVH())
        return candidates

    def step(self, candidates) -> float:
        """The collision-free step of Tight-Inclusion."""
        return candidates.compute_collision_free_stepsize(
            self.mesh,
            self.scene.vertices_t0,
            self.scene.vertices_t1,
            narrow_phase_ccd=self.toolkit.TightInclusionCCD(),
        )


def measure(scene: Scene, budget: float) -> dict:
    """One row: medians of interleaved rounds, at least three and as many as fit the seconds."""
    mesh = scene.mesh(ccd)
    frames = (scene.vertices_t0, scene.vertices_t1)
    pipeline = ccd.CollisionPipeline(mesh)
    calls = {
        "find_candidates": lambda: pipeline.find_candidates(*frames),
        "collision_free_step": lambda: pipeline.collision_free_step(*frames),
        "mesh_ccd": lambda: pipeline.mesh_ccd(*frames),
    }
    first = {}
    for name, call in calls.items():
        begin = time.perf_counter()
        call()
        first[name] = time.perf_counter() - begin
    peer = Peer(scene, mesh)
    seconds: dict[str, list[float]] = {name: [] for name in ("peer build", "peer step", *calls)}
    stages: dict[str, dict[str, list[float]]] = {name: {} for name in calls}
    results = {}
    begin = time.perf_counter()
    while len(seconds["peer build"]) < 3 or time.perf_counter() - begin < budget:
        candidates, t = timed(peer.build)
        seconds["peer build"].append(t)
        results["peer step"], t = timed(lambda found=candidates: peer.step(found))
        seconds["peer step"].append(t)
        for name, call in calls.items():
            results[name], t = timed(call)
            seconds[name].append(t)
            for stage, value in pipeline.timings.items():
                stages[name].setdefault(stage, []).append(value)
    found, contacts = results["find_candidates"], results["mesh_ccd"]
    middle = {name: median(values) for name, values in seconds.items()}
    whole = middle["peer build"] + middle["peer step"]
    return {
        "scene": scene.name,
        "faces": len(scene.faces),
        "rounds": len(seconds["peer build"]),
        "seconds": middle,
        "spread": {name: [min(values), max(values)] for name, values in seconds.items()},
        "first": first,
        "stages": {name: {s: median(v) for s, v in by_stage.items()} for name, by_stage in stages.items()},
        "ratio": {
            "find_candidates": middle["peer build"] / middle["find_candidates"],
            "collision_free_step": whole / middle["collision_free_step"],
            "mesh_ccd": whole / middle["mesh_ccd"],
        },
        "candidates": [len(found.vertex_face), len(found.edge_edge)],
        "disagreements": disagreements(scene, mesh, found, candidates),
        "peer_candidates": [len(candidates.fv_candidates), len(candidates.ee_candidates)],
        "contacts": len(contacts.contacts),
        "step": results["collision_free_step"],
        "toi": contacts.toi,
        "peer_step": results["peer step"],
        "threads": by_threads(scene, mesh),
    }


def disagreements(scene: Scene, mesh: ccd.CollisionMesh, found: ccd.Candidates, peer) -> int:
    """Candidates that only one of the two has, less those of the peer whose boxes do not overlap in float64."""
    frames = np.stack(mesh.frames(scene.vertices_t0, scene.vertices_t1))
    count = 0
    kinds = (
        (found.vertex_face, [(c.vertex_id, c.face_id) for c in peer.fv_candidates], None, mesh.faces),
        (found.edge_edge, [sorted((c.edge0_id, c.edge1_id)) for c in peer.ee_candidates], mesh.edges, mesh.edges),
    )
    for ours, theirs, first, second in kinds:
        theirs = np.asarray(theirs, dtype=np.int64).reshape(-1, 2)
        keys = [pairs[:, 0].astype(np.int64) << 32 | pairs[:, 1] for pairs in (ours, theirs)]
        count += int((~np.isin(keys[0], keys[1])).sum())
        more = theirs[~np.isin(keys[1], keys[0])]
        corners = [more[:, :1] if first is None else first[more[:, 0]], second[more[:, 1]]]
        low, high = zip(*((frames[:, c].min(axis=(0, 2)), frames[:, c].max(axis=(0, 2))) for c in corners), strict=True)
        count += int(((low[0] <= high[1]) & (low[1] <= high[0])).all(axis=1).sum())
    return count


def by_threads(scene: Scene, mesh: ccd.CollisionMesh) -> dict[str, dict[str, float]]:
    """Speed-up of each stage of ``mesh_ccd`` on all threads over one."""
    frames = (scene.vertices_t0, scene.vertices_t1)
    every = ccd.CollisionPipeline(mesh)
    one = ccd.CollisionPipeline(mesh, num_threads=1)
    times: dict[str, dict[str, list[float]]] = {"one": {}, "all": {}}
    for _ in range(4):
        for name, pipeline in (("one", one), ("all", every)):
            pipeline.mesh_ccd(*frames)
            for stage, value in pipeline.timings.items():
                times[name].setdefault(stage, []).append(value)
    return {
        stage: {"one": median(values[1:]), "all": median(times["all"][stage][1:])}
        for stage, values in times["one"].items()
    }


def resident_bytes(name: str) -> int:
    """Memory of this process that Linux calls so: VmRSS now, VmHWM at the peak."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith(name))


def forget_peak() -> int:
    """Make now the peak of memory; the bytes resident."""
    Path("/proc/self/clear_refs").write_text("5")
    return resident_bytes("VmRSS")


def grow(num_faces: int) -> dict:
    """Time and memory of one size, in a process of its own."""
    scene = cloth_over_sphere(num_faces)
    mesh = scene.mesh(ccd)
    frames = (scene.vertices_t0, scene.vertices_t1)
    few = cloth_over_sphere(2_000)  # kernels are loaded, which takes 100 MiB
    small = ccd.CollisionPipeline(few.mesh(ccd))
    for call in (small.collision_free_step, small.mesh_ccd, small.find_candidates):
        call(few.vertices_t0, few.vertices_t1)
    before = forget_peak()
    pipeline = ccd.CollisionPipeline(mesh)
    row: dict = {"faces": len(scene.faces), "seconds": {}}
    for name in ("collision_free_step", "mesh_ccd", "find_candidates"):
        call = getattr(pipeline, name)
        times = [timed(lambda call=call: call(*frames))[1] for _ in range(6)]
        row["seconds"][name] = median(times[1:])
    row["peak_bytes_above_input"] = resident_bytes("VmHWM") - before
    return row


def growth(sizes: tuple[int, ...]) -> dict:
    """Cost against size, with the exponents fitted to it."""
    rows = []
    for size in tqdm(sizes, file=sys.stderr, unit=" sizes", desc="growth"):
        out = subprocess.run(
            [sys.executable, __file__, "--grow", str(size)], capture_output=True, text=True, check=True
        )
        rows.append(json.loads(out.stdout.splitlines()[-1]))
    faces = np.log([row["faces"] for row in rows])
    names = rows[0]["seconds"]
    exponents = {n: float(np.polyfit(faces, np.log([row["seconds"][n] for row in rows]), 1)[0]) for n in names}
    exponents["peak memory"] = float(
        np.polyfit(faces, np.log([max(row["peak_bytes_above_input"], 1) for row in rows]), 1)[0]
    )
    return {"rows": rows, "exponents": exponents}


def targets(rows: list[dict], grown: dict | None) -> list[tuple[str, str, bool]]:
    """What was aimed at, what was found."""
    found = []
    for row in rows:
        ratio = row["ratio"]
        for name, least in (("find_candidates", 1.0), ("collision_free_step", 10.0), ("mesh_ccd", 5.0)):
            found.append(
                (f"{row['scene']}: {name} at least {least:g} times", f"{ratio[name]:.2f}", ratio[name] >= least)
            )
        disagreed = row["disagreements"]
        found.append((f"{row['scene']}: the candidates are those of the peer", str(disagreed), disagreed == 0))
    for name, exponent in (grown["exponents"] if grown else {}).items():
        found.append((f"{name} grows linearly (exponent at most 1.1)", f"{exponent:.2f}", exponent <= 1.1))
    return found


def table(rows: list[dict]) -> str:
    """Milliseconds, and ratios to the peer."""
    lines = [
        f"{'scene':32} {'peer build':>10} {'+ step':>9} {'find':>9} {'step':>9} {'ccd':>9}   "
        f"{'find':>6} {'step':>6} {'ccd':>6}"
    ]
    for row in rows:
        s, r = row["seconds"], row["ratio"]
        times = "".join(f"{1e3 * s[name]:9.2f} " for name in ("peer step", "find_candidates", "collision_free_step"))
        lines.append(
            f"{row['scene']:32} {1e3 * s['peer build']:10.2f} {times}{1e3 * s['mesh_ccd']:9.2f}   "
            f"{r['find_candidates']:6.2f} {r['collision_free_step']:6.1f} {r['mesh_ccd']:6.1f}"
        )
    return "\n".join(lines)


def write_readme(path: Path, rows: list[dict]) -> None:
    """Put the table between its two marks."""
    lines = [
        "| scene, faces | LBVH | `find_candidates` | LBVH and step | `collision_free_step` | `mesh_ccd` |",
        "|---|---|---|---|---|---|",
    ]
    for row in rows:
        s = row["seconds"]
        whole = s["peer build"] + s["peer step"]
        values = (s["peer build"], s["find_candidates"], whole, s["collision_free_step"], s["mesh_ccd"])
        lines.append(f"| {row['scene']} | " + " | ".join(f"{1e3 * value:.1f}" for value in values) + " |")
    begin, end = "<!-- whole steps: begin -->\n", "<!-- whole steps: end -->"
    before, rest = path.read_text(encoding="utf-8").split(begin)
    path.write_text(before + begin + "\n".join(lines) + "\n" + end + rest.split(end)[1], encoding="utf-8")


def speedups(rows: list[dict]) -> str:
    """Stages of `mesh_ccd` on all threads against one."""
    lines = []
    for row in rows:
        stages = {s: v["one"] / v["all"] for s, v in row["threads"].items() if v["all"] > 1e-4}
        lines.append(f"{row['scene']:32} " + ", ".join(f"{stage} {ratio:.2f}" for stage, ratio in stages.items()))
    return "\n".join(lines)


def main() -> int:
    parser = argparse.ArgumentParser(description="Whole steps against ipc-toolkit.")
    parser.add_argument("--quick", action="store_true", help="the small scenes, no growth")
    parser.add_argument("--seconds", type=float, default=20.0, help="time of the rounds of a scene")
    parser.add_argument("--only", help="scenes whose name holds this")
    parser.add_argument("--json", type=Path, help="file for the raw figures")
    parser.add_argument(
        "--readme", type=Path, help="README whose table to write, from the file of --json, measuring nothing"
    )
    parser.add_argument("--grow", type=int, help=argparse.SUPPRESS)
    parsed = parser.parse_args()
    wp.config.log_level = wp.LOG_WARNING
    if parsed.grow:
        print(json.dumps(grow(parsed.grow)))
        return 0
    if parsed.readme:
        write_readme(parsed.readme, json.loads(parsed.json.read_text())["scenes"])
        return 0
    rows = []
    with tqdm(all_scenes(parsed.quick), file=sys.stderr, unit=" scenes") as bar:
        for make in bar:
            scene = make()
            bar.set_postfix_str(scene.name)
            if not parsed.only or parsed.only in scene.name:
                rows.append(measure(scene, parsed.seconds if not parsed.quick else 3.0))
    grown = None if parsed.quick or parsed.only else growth(GROWTH)
    about = machine()
    print(f"{about['cpu']}, {about['cores']} cores, {about['date']}, {about['versions']}")
    print("milliseconds; the last three columns are ratios: peer build : find, peer build + step : step, and : ccd\n")
    print(table(rows))
    found = targets(rows, grown)
    print("\nspeed-up of the stages of mesh_ccd by all threads, where they take a tenth of a millisecond:\n")
    print(speedups(rows))
    print()
    for text, value, is_met in found:
        print(f"{'met   ' if is_met else 'MISSED'}  {text}: {value}")
    if parsed.json:
        raw = {
            "machine": about,
            "scenes": rows,
            "growth": grown,
            "targets": [{"target": text, "found": value, "met": is_met} for text, value, is_met in found],
        }
        parsed.json.parent.mkdir(parents=True, exist_ok=True)
        parsed.json.write_text(json.dumps(raw, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
