"""How fast a GPU is: launches kernel by kernel, the calls of the host, both broad phases, options, queries, worlds.

    python benchmarks/gpu_times.py [--device cuda:0] [--quick] [--published FOLDER] [--only launches …] [--output FILE]

Each line of the output is a measurement, written when it is done; what is begun is said before, so that a process that
is killed has named it. Ends with 1 if a broad phase or the device changes a bit. docs/cuda.md says what to expect, and
how Nsight Compute counts what `--only counters` launches.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from datetime import date
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests" / "helpers"))
from hard_cases import FAMILIES
from machine import commit, processor
from scenes import (
    bodies_through_each_other,
    cloth_over_sphere,
    crumpled_cloth,
    grid,
    ground_under_cloth,
    long_step,
    pile,
    published_scenes,
    sphere,
    worlds,
)

import ccd_warp as ccd

SCENES: dict[str, Callable[[], Any]] = {
    "cloth 200k": partial(cloth_over_sphere, 200_000),
    "pile 200k": partial(pile, 1_000, 200),
    "crumpled cloth 50k": partial(crumpled_cloth, 50_000),
    "bodies through each other": partial(bodies_through_each_other, 300, 100),
    "ground under cloth 100k": partial(ground_under_cloth, 100_000),
    "long step 20k": partial(long_step, 20_000),
    "cloth 10k": partial(cloth_over_sphere, 10_000),
    "1,000 worlds of 400": partial(worlds, 1_000),
    "cloth 1M": partial(cloth_over_sphere, 1_000_000),
}
QUICK: dict[str, Callable[[], Any]] = {"pile": partial(pile, 8, 48), "worlds": partial(worlds, 3)}
COUNTED = ("cloth 200k", "crumpled cloth 50k", "pile 200k", "1,000 worlds of 400")
PRECISIONS, BROAD_PHASES = ("float64", "float32"), ("tree", "hash")
CALLS = ("mesh_ccd", "collision_free_step", "find_candidates")
_DIFFERENT = 100_000  # queries that are different; the others are copies of them at other places in memory


class Clock:
    """Times calls on a device, by events on a GPU and by the clock elsewhere."""

    def __init__(self, device: str, repeats: int) -> None:
        self.device, self.repeats = wp.get_device(device), repeats

    def host(self, call: Callable[[], Any], repeats: int = 3) -> float:
        """Seconds of a call by the clock, the wait for the device included: the median."""
        seconds = []
        for _ in range(repeats):
            begin = time.perf_counter()
            call()
            wp.synchronize_device(self.device)
            seconds.append(time.perf_counter() - begin)
        return statistics.median(seconds)

    def events(self, call: Callable[[], Any]) -> float:
        """Seconds of a call on the device: the median."""
        call()
        wp.synchronize_device(self.device)
        if not self.device.is_cuda:
            return self.host(call, self.repeats)
        events = [[wp.Event(self.device, enable_timing=True) for _ in range(2)] for _ in range(self.repeats)]
        for begin, end in events:
            self.device.stream.record_event(begin)
            call()
            self.device.stream.record_event(end)
        wp.synchronize_device(self.device)
        return statistics.median(wp.get_event_elapsed_time(*pair) * 1e-3 for pair in events)

    def kernels(self, call: Callable[[], Any]) -> dict[str, Any]:
        """Seconds of each kernel of a call, the slowest first, from events around every launch; none on the CPU.

        Two events by themselves take as long as the shortest launch, of a kernel that finds nothing to do. That is
        taken from each, and stands beside them with the number of launches.
        """
        if not self.device.is_cuda:
            return {"kernels": {}}
        wp.timing_begin(cuda_filter=wp.TIMING_ALL)
        call()
        results = wp.timing_end()
        shortest, seconds = min((result.elapsed for result in results), default=0.0), dict[str, float]()
        for result in results:
            name = result.name.removeprefix("forward kernel ")
            seconds[name] = seconds.get(name, 0.0) + (result.elapsed - shortest) * 1e-3
        kernels = dict(sorted(seconds.items(), key=lambda item: -item[1]))
        return {"kernels": kernels, "starts": len(results), "two events": 1e-3 * shortest}

    def replay(self, call: Callable[[], Any]) -> float:
        """Seconds of a call in a graph."""
        with wp.ScopedCapture(device=self.device) as capture:
            call()
        return self.events(partial(wp.capture_launch, capture.graph))

    def memory(self) -> int:
        """Bytes of a GPU that nobody has reserved."""
        return int(self.device.free_memory) if self.device.is_cuda else 0


def fitting(pipeline: ccd.CollisionPipeline, launch: Callable[[], ccd.LaunchResult]) -> ccd.LaunchResult:
    """A launch, after which everything has a place."""
    result = launch()
    for _ in range(3):
        if not result.flags.numpy()[0]:
            break
        pairs, contacts = int(result.num_pairs.numpy().max()), int(result.contacts.count.numpy()[0])
        pipeline.reserve(max_pairs=max(2 * pairs, 1), max_contacts=max(2 * contacts, 1))
        result = launch()
    return result


def device_arrays(ends: tuple[np.ndarray, ...], device: Any) -> list[wp.array]:
    return [wp.array(x, dtype=wp.vec3d, device=device) for x in ends]


def answers_of(
    pipeline: ccd.CollisionPipeline, result: ccd.LaunchResult, ends: tuple[np.ndarray, ...]
) -> dict[str, bytes]:
    """The bits that no broad phase and no device may change."""
    found = {name: getattr(result, name).numpy().tobytes() for name in ("toi", "vertex_toi", "num_pairs", "flags")}
    return found | {name: pairs.tobytes() for name, pairs in vars(pipeline.find_candidates(*ends).sorted()).items()}


def launches(clock: Clock, scenes: dict[str, Callable[[], Any]]) -> Iterator[dict[str, Any]]:
    """A launch of each scene with each broad phase, and on the CPU; and the calls of the host."""
    for name, make in scenes.items():
        first: dict[str, bytes] = {}
        for device, broad_phase in (*((str(clock.device), each) for each in BROAD_PHASES), ("cpu", "tree")):
            print(f"{name}, {broad_phase} on {device} …", flush=True)
            scene, own = make(), Clock(device, clock.repeats)
            ends = (scene.vertices_t0, scene.vertices_t1)
            before = own.memory()
            pipeline = ccd.CollisionPipeline(scene.mesh(ccd), device=device, broad_phase=broad_phase)
            reserve = own.host(partial(pipeline.reserve, vertices=ends[0]), 1)
            launch = partial(pipeline.launch, *device_arrays(ends, device))
            result = fitting(pipeline, launch)
            row: dict[str, Any] = {
                "scene": name,
                "device": device,
                "broad_phase": broad_phase,
                "launch": own.events(launch),
            }
            row["replay"] = own.replay(launch)
            row |= {call: own.host(partial(getattr(pipeline, call), *ends)) for call in CALLS}
            row |= own.kernels(launch) | {"reserve": reserve, "bytes": before - own.memory()}
            row |= {"faces": scene.worlds * len(scene.faces), "pairs": int(result.num_pairs.numpy().sum())}
            found = answers_of(pipeline, launch(), ends)
            first = first or found
            row["different"] = [key for key in first if first[key] != found[key]]
            yield row


def ways(clock: Clock, scene: Any, num_bodies: int) -> Iterator[dict[str, Any]]:
    """What a launch takes with a distance, radii, float32, a line search, in a graph, too, and of bodies that turn."""
    ends = scene.vertices_t0, scene.vertices_t1
    corners = ends[0][scene.faces]
    distance = 0.02 * float(np.median(np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1)))
    meshes = scene.mesh(ccd), scene.mesh(ccd, radius=distance)
    ball, faces = sphere(200, 0.5)
    side = round(num_bodies**0.5)
    places, _ = grid(side, side, 1.02 * (side - 1), 1.02 * (side - 1))
    rows = np.column_stack([places, np.zeros((num_bodies, 3)), np.ones(num_bodies)])
    turning = ccd.CollisionMesh.from_arrays([(ball, faces)] * num_bodies, rigid=range(num_bodies), self_collision=False)
    motion = ccd.RigidMotion(rows, twist=0.3 * np.random.default_rng(0).standard_normal((num_bodies, 6)))
    launch = ccd.CollisionPipeline.launch

    def line_search(pipeline: ccd.CollisionPipeline, start: wp.array, end: wp.array) -> ccd.LaunchResult:
        wp.copy(shortened, end)  # as it is shortened where it is
        return pipeline.launch_line_search(start, shortened)

    for name, mesh, options, call, further in (
        ("as it is", meshes[0], {}, launch, {}),
        ("a distance", meshes[0], {"minimum_distance": distance}, launch, {}),
        ("radii", meshes[1], {}, launch, {}),
        ("float32", meshes[0], {"precision": "float32"}, launch, {}),
        ("a line search", meshes[0], {}, line_search, {}),
        ("bodies that turn", turning, {}, launch, {"motion": motion}),
    ):
        first: list[bytes] = []
        for device in (str(clock.device), "cpu"):
            print(f"{name} on {device} …", flush=True)
            own, pipeline = Clock(device, clock.repeats), ccd.CollisionPipeline(mesh, device=device, **options)
            of_ends = ends if mesh is not turning else (mesh.vertices, mesh.vertices)
            *arrays, shortened = device_arrays((*of_ends, of_ends[1]), device)
            work = partial(call, pipeline, *arrays, **further)
            result = fitting(pipeline, work)
            row: dict[str, Any] = {"way": name, "device": device, "launch": own.events(work)}
            row["replay"] = None if further else own.replay(work)  # the host reads a motion, which no graph does
            row |= own.kernels(work) | {"faces": mesh.num_faces, "pairs": int(result.num_pairs.numpy().sum())}
            found = [getattr(result, key).numpy().tobytes() for key in ("vertex_toi", "num_pairs", "flags")]
            first = first or found
            yield row | {"different": [] if first == found else ["tois, pairs or flags"]}


def counters(clock: Clock, scenes: dict[str, Callable[[], Any]]) -> Iterator[dict[str, Any]]:
    """One launch of some scenes, with a distance and float32, too, between marks for a profiler."""
    driver: Any = ctypes.CDLL("libcuda.so.1") if clock.device.is_cuda else None
    options: dict[str, dict[str, Any]] = {"": {}, ", a distance": {"minimum_distance": 1e-4}}
    options[", float32"] = {"precision": "float32"}
    for name, make in scenes.items():
        scene = make()
        for how, given in options.items() if name.startswith("crumpled") else [("", {})]:
            pipeline = ccd.CollisionPipeline(scene.mesh(ccd), device=str(clock.device), **given)
            pipeline.reserve(vertices=scene.vertices_t0)
            launch = partial(pipeline.launch, *device_arrays((scene.vertices_t0, scene.vertices_t1), clock.device))
            result = fitting(pipeline, launch)
            wp.synchronize_device(clock.device)
            if driver:
                driver.cuProfilerStart()
            launch()
            wp.synchronize_device(clock.device)
            if driver:
                driver.cuProfilerStop()
            yield {"counted": name + how, "pairs": int(result.num_pairs.numpy().sum())}


def points_of(kind: str, touching: bool, count: int, device: Any) -> list[wp.array]:
    """Queries that touch, or of which the first direction proves that they do not; copies of some different ones."""
    found = []
    start, end = FAMILIES["random_colliding"](kind, min(count, _DIFFERENT), np.random.default_rng(3))
    for points in (start, end):
        if not touching:  # one side is far above the other throughout
            size = np.abs(points).max(axis=(1, 2))
            points[:, : 1 if kind == "vertex-face" else 2, 2] += 4.0 * np.maximum(size, 1.0)[:, None]
        some = wp.array(points, dtype=wp.vec3d, device=device)
        array = wp.empty((count, points.shape[1]), dtype=wp.vec3d, device=device)
        for begin in range(0, count, len(points)):
            part = array[begin : min(begin + len(points), count)]
            wp.copy(part, some[: part.shape[0]])
        found.append(array)
    return found


def queries(clock: Clock, counts: tuple[int, ...]) -> Iterator[dict[str, Any]]:
    """Queries of both kinds, touching or not, in both precisions."""
    solve = {"vertex-face": ccd.vertex_face_ccd, "edge-edge": ccd.edge_edge_ccd}
    for kind in solve:
        for touching in (True, False):
            for count in counts:
                arrays = points_of(kind, touching, count, clock.device)
                for precision in PRECISIONS:
                    print(f"{count:,} {kind} {precision} …", flush=True)
                    call = partial(solve[kind], *arrays, precision=precision, length_scale=1.0)
                    seconds = clock.events(call)
                    kernels = sum(clock.kernels(call)["kernels"].values())  # without what the host does in between
                    row = {"queries": count, "kind": kind, "touching": touching, "precision": precision}
                    row |= {"seconds": seconds, "kernels": kernels}
                    yield row | {"queries_a_second": count / (kernels or seconds)}


def first(clock: Clock, counts: tuple[int, ...]) -> Iterator[dict[str, Any]]:
    """What a first call of each kind takes in many worlds, and the memory that it leaves reserved."""
    for count in counts:
        print(f"{count:,} worlds …", flush=True)
        scene, before = worlds(count), clock.memory()
        pipeline = ccd.CollisionPipeline(scene.mesh(ccd), device=str(clock.device))
        arrays = device_arrays((scene.vertices_t0, scene.vertices_t1), clock.device)
        calls: dict[str, Callable[[], Any]] = {
            "reserve": pipeline.reserve,
            "first launch": partial(pipeline.launch, *arrays),
            "launch": partial(pipeline.launch, *arrays),
            "first line search": partial(pipeline.launch_line_search, *arrays, per="world"),
        }
        row: dict[str, Any] = {"worlds": count, **{name: clock.host(call, 1) for name, call in calls.items()}}
        yield row | {"bytes": before - clock.memory()}


def shown(row: dict[str, Any]) -> str:
    """A measurement in a line: seconds as milliseconds, and the slowest kernels."""
    said = []
    for name, value in row.items():
        if name == "kernels" and isinstance(value, dict):
            said += [f"{kernel} {1e3 * seconds:.3f} ms" for kernel, seconds in list(value.items())[:3]]
        elif name == "queries_a_second":
            said.append(f"{value / 1e9:.3f} G queries a second")
        elif isinstance(value, float):
            said.append(f"{name} {1e3 * value:.3f} ms")
        elif value not in (None, []):
            said.append(f"{name} {value}")
    return ", ".join(said)


def main(arguments: list[str] | None = None) -> int:
    """Measure, print and write; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--device", default="cuda:0", help="Warp device (cuda:0); cpu rehearses")
    parser.add_argument("--quick", action="store_true", help="small scenes and few queries")
    parts = ("launches", "ways", "queries", "first")
    parser.add_argument("--only", nargs="+", choices=(*parts, "counters"), default=parts)
    parser.add_argument("--published", type=Path, help="folder of steps in the public formats")
    parser.add_argument("--minutes", type=float, default=8.0, help="after which nothing is begun (8)")
    parser.add_argument("--output", type=Path, default=Path("gpu_times.json"), help="a line for each measurement")
    given = parser.parse_args(arguments)
    wp.config.log_level = wp.LOG_WARNING
    if folder := os.environ.get("CCD_WARP_CUBINS"):  # of gpu_pack.py
        wp.config.kernel_cache_dir, wp.config.cuda_output = folder, "cubin"
    wp.init()
    if given.device not in (names := [device.alias for device in wp.get_devices()]):
        print(f"error: device is {given.device!r}; expected one of {', '.join(names)}", file=sys.stderr)
        return 2
    end, clock = time.perf_counter() + 60 * given.minutes, Clock(given.device, 2 if given.quick else 9)
    scenes = (QUICK if given.quick else SCENES) | dict(published_scenes(given.published))
    rows = {
        "launches": launches(clock, scenes),
        "ways": ways(clock, pile(8, 48) if given.quick else crumpled_cloth(50_000), 9 if given.quick else 900),
        "counters": counters(clock, {name: make for name, make in scenes.items() if given.quick or name in COUNTED}),
        "queries": queries(clock, (2_000,) if given.quick else (10_000_000, 1_000_000)),
        "first": first(clock, (6,) if given.quick else (1_000, 10_000)),
    }
    is_different = False
    with given.output.open("w", encoding="utf-8") as file:
        about = {"device": clock.device.name, "arch": clock.device.arch, "warp": wp.config.version, **processor()}
        about |= {"date": f"{date.today()}", "commit": commit()}
        if clock.device.is_cuda:
            query = ["nvidia-smi", "--query-gpu=driver_version,clocks.sm,clocks.max.sm,clocks.mem", "--format=csv"]
            smi = subprocess.run(query, capture_output=True, text=True, check=False).stdout.splitlines()
            about |= {"cuda": wp.get_cuda_driver_version(), "driver and clocks": smi}
        file.write(json.dumps(about) + "\n")
        for name in given.only:
            for row in rows[name]:
                print(shown(row), flush=True)
                file.write(json.dumps(row) + "\n")
                file.flush()
                is_different |= bool(row.get("different"))
                if time.perf_counter() > end:
                    print(f"{name}: no time for the rest")
                    break
    return int(is_different)


if __name__ == "__main__":
    sys.exit(main())
