"""Calls that fail half-way, and the same calls made again: what an interrupted cell of a notebook leaves behind.

`python tests/calls/test_faults.py [--samples N] [--every-event] [--every-error] [NAME …]` injects more, each scenario
in a process of its own.
"""

import argparse
import json
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace

sys.path.append(str(Path(__file__).resolve().parents[1] / "helpers"))

import faults
import numpy as np
import pytest
import warp as wp
from daily import marked
from faults import Scenario, inject_events, inject_interrupts, unwatched
from scenes import random_pairs, sheet

import ccd_warp as ccd

FOLDERS = tuple(str(Path(module.__file__).parent) + "/" for module in (ccd, ccd.kernels))
THREADS = {"num_threads": 2}
CAPACITIES = {"max_pairs": 20_000, "max_contacts": 20_000}


class Step:
    """A sheet of (n + 1)² vertices that falls onto a static wavy floor; the floor was once ``aside``."""

    def __init__(self, n=10, aside=(0.0, 0.0, -3.0), self_collision=True):
        upper, upper_faces = sheet(n)
        lower, lower_faces = sheet(8, 1.3)
        lower[:, 2] = 0.05 * np.sin(9 * lower[:, 0]) * np.cos(8 * lower[:, 1]) - 0.2
        self.bodies = [(upper, upper_faces), (lower, lower_faces)]
        self.options = {"static": [1], "self_collision": self_collision}
        self.start = np.concatenate([upper + [0.013, 0.007, 0.1], lower])
        self.end = self.start.copy()
        self.end[: len(upper)] += [0.02, 0.01, -0.45]
        move = np.zeros_like(self.start)
        move[len(upper) :] = aside
        # where the floor was, the sheet met nothing
        self.earlier = self.start + move, self.end + move

    def mesh(self):
        return ccd.CollisionMesh.from_arrays(self.bodies, **self.options)


STEP = Step()
LARGE = Step(n=46)
SMALL = Step(n=7)
ALONE = Step(self_collision=False)


def of_mesh(call, step=STEP, **options):
    """A function on a mesh, as a call of it for the frames of a step."""
    return lambda mesh, frames=None: call(mesh, *(frames or (step.start, step.end)), **THREADS, **options)


def before(call, step=STEP):
    """The same function where the floor was before."""
    return lambda objects: call(objects, step.earlier)


def first(call, step=STEP):
    """The first call on a mesh."""
    return Scenario(step.mesh, call)


def later(call, step=STEP):
    """The same call again."""
    return Scenario(step.mesh, call, lambda mesh: call(mesh))


def moved(call, step=STEP):
    """A call after the static body has moved."""
    return Scenario(step.mesh, call, before(call, step))


class OnDevice:
    """A pipeline with the arrays that it is launched on."""

    def __init__(self, step=STEP, dtype=wp.vec3d, **options):
        self.step = step
        self.pipeline = ccd.CollisionPipeline(
            step.mesh(), device="cpu", length_scale=1.0, **THREADS, **CAPACITIES, **options
        )
        self.host = [np.zeros(step.start.shape, np.float64 if dtype is wp.vec3d else np.float32) for _ in range(2)]
        self.vertices_t0, self.vertices_t1 = (wp.array(x, dtype=dtype, device="cpu", copy=False) for x in self.host)

    def put(self, frames=None):
        """Fill the arrays."""
        for array, values in zip(self.host, frames or (self.step.start, self.step.end), strict=True):
            array[:] = values


def launch(objects, frames=None):
    objects.put(frames)
    return objects.pipeline.launch(objects.vertices_t0, objects.vertices_t1)


def launch_line_search(objects, frames=None, **options):
    objects.put(frames)
    result = objects.pipeline.launch_line_search(
        objects.vertices_t0, objects.vertices_t1, per="body", num_rounds=4, **options
    )
    return {"result": result, "vertices_t1": objects.vertices_t1}


def reserve_and_launch(objects):
    objects.pipeline.reserve(max_pairs=30_000, vertices=STEP.start)
    return launch(objects)


def two_kinds_of_launch(objects, frames=None):
    return [faults.arrays_of(launch(objects, frames)), faults.arrays_of(launch_line_search(objects, frames))]


def of_pipeline(name, step=STEP, **options):
    """A method of a pipeline that works on the host."""
    return lambda pipeline: getattr(pipeline, name)(step.start, step.end, **options)


def pipeline(step=STEP, **options):
    return lambda: ccd.CollisionPipeline(step.mesh(), **THREADS, **options)


def together(*calls):
    """Results of calls that threads of the user make at the same time, one of them this one."""
    results = [None] * len(calls)

    def call(k):
        try:
            results[k] = faults.arrays_of(calls[k]())
        except BaseException as error:
            results[k] = error

    with unwatched():
        threads = [threading.Thread(target=call, args=[k]) for k in range(1, len(calls))]
        for thread in threads:
            thread.start()
    try:
        results[0] = faults.arrays_of(calls[0]())
    finally:
        for thread in threads:
            thread.join()
    for result in results:
        if isinstance(result, BaseException):
            raise result
    return results


def shared(objects):
    """Two threads on one pipeline, each with a step of its own."""
    lower = STEP.end - [0, 0, 0.1] * (STEP.start != STEP.end).any(axis=1)[:, None]
    return together(lambda: objects.mesh_ccd(STEP.start, STEP.end), lambda: objects.mesh_ccd(STEP.start, lower))


def same_mesh(mesh):
    """Two threads on one mesh."""
    return together(
        lambda: ccd.mesh_ccd(mesh, STEP.start, STEP.end, **THREADS),
        lambda: ccd.collision_free_step(mesh, STEP.start, STEP.end, **THREADS),
    )


def turned(step):
    """Positions at which neighbours of the rest configuration are far from each other."""
    order = np.random.default_rng(0).permutation(len(step.start) - 81)
    order = np.concatenate([order, np.arange(len(order), len(step.start))])
    return step.start[order], step.end[order]


def pairs(kind, on_device=False):
    """A function on pairs."""
    options = {"minimum_separation": 0.02, **THREADS}
    call = getattr(ccd, f"{kind}_ccd")

    def fresh():
        arrays = random_pairs(kind, 3000, 1)
        if not on_device:
            return arrays
        return [wp.array(x, dtype=wp.vec3d, device="cpu") for x in arrays]

    return Scenario(fresh, lambda arrays: call(*arrays, **options))


MESH_CCD = of_mesh(ccd.mesh_ccd)
GROWN = np.concatenate([STEP.end[:-81] * [1, 1, 1] - [0, 0, 0.3], STEP.end[-81:]])
SCENARIOS = {
    "first mesh_ccd": first(MESH_CCD),
    "mesh_ccd again": later(MESH_CCD),
    "mesh_ccd after the floor has moved": moved(MESH_CCD),
    "mesh_ccd of a large sheet after the floor has moved": moved(of_mesh(ccd.mesh_ccd, LARGE), LARGE),
    "mesh_ccd of a body that comes near after the floor has moved": moved(of_mesh(ccd.mesh_ccd, ALONE), ALONE),
    "mesh_ccd with a spatial hash after the floor has moved": moved(of_mesh(ccd.mesh_ccd, broad_phase="hash")),
    "mesh_ccd that sorts anew": Scenario(
        SMALL.mesh, lambda mesh: MESH_CCD(mesh, turned(SMALL)), before(MESH_CCD, SMALL)
    ),
    "mesh_ccd that needs more memory than before": Scenario(
        LARGE.mesh, of_mesh(ccd.mesh_ccd, LARGE), lambda mesh: ccd.mesh_ccd(mesh, *LARGE.earlier, num_threads=1)
    ),
    "mesh_ccd with a separation after one without": Scenario(
        STEP.mesh, of_mesh(ccd.mesh_ccd, minimum_separation=0.01), lambda mesh: MESH_CCD(mesh)
    ),
    "mesh_ccd of a pipeline with little memory": Scenario(
        pipeline(LARGE, memory_limit=5_000_000), of_pipeline("mesh_ccd", LARGE)
    ),
    "first collision_free_step": first(of_mesh(ccd.collision_free_step)),
    "collision_free_step after the floor has moved": moved(of_mesh(ccd.collision_free_step)),
    "collision_free_step of a large sheet": later(of_mesh(ccd.collision_free_step, LARGE), LARGE),
    "find_candidates after the floor has moved": moved(of_mesh(ccd.find_candidates)),
    "find_candidates after mesh_ccd": Scenario(STEP.mesh, of_mesh(ccd.find_candidates), before(MESH_CCD)),
    "find_candidates of a large sheet with a spatial hash": later(
        of_mesh(ccd.find_candidates, LARGE, broad_phase="hash"), LARGE
    ),
    "line_search after the floor has moved": moved(of_mesh(ccd.line_search, per="vertex")),
    "first launch": Scenario(OnDevice, launch),
    "first launch of float32": Scenario(lambda: OnDevice(dtype=wp.vec3f), launch),
    "launch again": Scenario(OnDevice, launch, launch),
    "launch after the floor has moved": Scenario(OnDevice, launch, before(launch)),
    "launch with a spatial hash after the floor has moved": Scenario(
        lambda: OnDevice(broad_phase="hash"), launch, before(launch)
    ),
    "launch of a large sheet after the floor has moved": Scenario(
        lambda: OnDevice(LARGE), launch, before(launch, LARGE)
    ),
    "first launch_line_search": Scenario(OnDevice, launch_line_search),
    "launch_line_search after the floor has moved": Scenario(OnDevice, launch_line_search, before(launch_line_search)),
    "launch_line_search between launches": Scenario(OnDevice, two_kinds_of_launch, before(two_kinds_of_launch)),
    "reserve after the floor has moved": Scenario(OnDevice, reserve_and_launch, before(launch)),
    "vertex_face_ccd": pairs("vertex_face"),
    "edge_edge_ccd on the device": pairs("edge_edge", on_device=True),
    "point_segment_ccd": pairs("point_segment"),
    "point_point_ccd": pairs("point_point"),
    "a pipeline that two threads share": Scenario(pipeline(), shared),
    "a mesh that two threads share": Scenario(STEP.mesh, same_mesh, before(MESH_CCD)),
}


# Every run of the tests has each scenario with one of the two kinds of faults.
@pytest.mark.parametrize("name", marked(list(SCENARIOS), list(SCENARIOS)[::2]))
def test_call_that_fails_at_any_use_of_warp_is_made_again(name):
    inject_events(SCENARIOS[name]).check()


@pytest.mark.long
@pytest.mark.parametrize("name", SCENARIOS)
def test_call_that_fails_at_every_event_is_made_again(name):
    inject_events(SCENARIOS[name], at_every_event=True).check()


@pytest.mark.parametrize("name", marked(list(SCENARIOS), list(SCENARIOS)[1::2]))
def test_cell_that_is_interrupted_between_any_two_lines_is_run_again(name):
    inject_interrupts(SCENARIOS[name], name, 8, FOLDERS).check()


# --- the harness itself ---


class Toy:
    """A cache that forgets to fill what it has a key for, in the way that ``fault`` says."""

    def __init__(self, fault):
        self.fault = fault
        self.key = None
        self.value = wp.zeros(1)
        self.lock = threading.Lock()

    def call(self, key=2.0):
        if self.fault == "swallows":
            try:
                return float(wp.full(1, key).numpy()[0])
            except BaseException:
                return key
        if self.fault == "keeps its lock":
            self.lock.acquire()
            self.value = wp.full(1, key)
            self.lock.release()
            return float(self.value.numpy()[0])
        if self.key != key:
            if self.fault == "key before value":
                self.key = key
            self.value = wp.full(1, key)
            self.key = key
        return {"value": self.value}


def toy(fault):
    return Scenario(lambda: Toy(fault), Toy.call, lambda toy: toy.call(1.0))


def test_harness_finds_a_key_that_is_stored_before_its_value():
    # before wp.full is carried out, and directly after: both leave the old value
    for at_every_event, count in ((False, 1), (True, 2)):
        findings = inject_events(toy("key before value"), at_every_event=at_every_event)
        assert (findings.num_faults, len(findings.wrong)) == (count, count)
        assert "differs" in findings.wrong[0]
    assert inject_interrupts(toy("key before value"), "toy", 30, (__file__,)).wrong


def test_harness_finds_nothing_where_the_value_comes_first():
    for at_every_event, count in ((False, 3), (True, 6)):
        findings = inject_events(toy(""), at_every_event=at_every_event, every_error=True)
        findings.check()
        assert findings.num_faults == count
    findings = inject_interrupts(toy(""), "toy", 30, (__file__,))
    findings.check()
    assert findings.num_faults == 30


def test_harness_finds_an_exception_that_does_not_reach_the_caller():
    findings = inject_events(toy("swallows"), at_every_event=True, every_error=True)
    # a call that gets on without memory, and answers rightly, may; after a read nothing is other than before it
    assert (findings.num_faults, len(findings.wrong)) == (9, 6)
    assert "did not reach" in findings.wrong[0]


def test_harness_finds_a_call_that_hangs(monkeypatch):
    monkeypatch.setattr(faults, "_PATIENCE", (0.2, 0.2))
    findings = inject_events(toy("keeps its lock"))
    assert any("Hung" in wrong for wrong in findings.wrong)


def test_harness_takes_the_error_of_a_lock_of_python_for_the_interrupt_that_it_hides():
    scenario = Scenario(dict, lambda _: threading.Event().wait(1e-6))
    findings = inject_interrupts(scenario, "wait", 200, (__file__,))
    findings.check()
    assert findings.num_faults == 200


# --- by hand ---


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", default=list(SCENARIOS))
    parser.add_argument("--samples", type=int, default=200, help="interrupts a scenario")
    parser.add_argument("--every-event", action="store_true", help="not only the first event from each line")
    parser.add_argument("--every-error", action="store_true", help="each error at each event")
    parser.add_argument("--timeout", type=float, default=900.0, help="seconds after which a scenario is taken to hang")
    parser.add_argument("--one", action="store_true", help="in this process, as JSON")
    arguments = parser.parse_args()
    wp.config.log_level = wp.LOG_ERROR
    if arguments.one:
        begin = time.perf_counter()
        for kind in ("events", "interrupts"):
            for name in arguments.names:
                if kind == "events":
                    found = inject_events(
                        SCENARIOS[name], at_every_event=arguments.every_event, every_error=arguments.every_error
                    )
                else:
                    found = inject_interrupts(SCENARIOS[name], name, arguments.samples, FOLDERS)
                seconds = time.perf_counter() - begin
                line = SimpleNamespace(kind=kind, seconds=seconds, **vars(found))
                print(json.dumps(vars(line)), flush=True)
        return
    total = [0, 0]
    for name in arguments.names:
        options = ["--one", "--samples", str(arguments.samples)]
        options += ["--every-event"] * arguments.every_event + ["--every-error"] * arguments.every_error
        try:
            done = subprocess.run(
                [sys.executable, __file__, *options, name],
                capture_output=True,
                text=True,
                check=False,
                timeout=arguments.timeout,
            )
            output, ended = done.stdout, done.returncode
        except subprocess.TimeoutExpired as expired:
            output, ended = (expired.stdout or b"").decode(), "hung"
        for line in output.splitlines():
            found = json.loads(line)
            total[0] += found["num_faults"]
            total[1] += len(found["wrong"])
            counts = f"{len(found['wrong']):4d} wrong of {found['num_faults']:4d}"
            print(f"{counts} {found['kind']:10s} {found['seconds']:6.1f} s  {name}", flush=True)
            for wrong in found["wrong"][:3]:
                print(f"       {wrong[:300]}")
        if ended != 0:
            print(f"       the process ended with {ended}: {done.stderr[-300:] if ended != 'hung' else ''}")
    print(f"{total[1]} wrong of {total[0]} faults")


if __name__ == "__main__":
    main()
