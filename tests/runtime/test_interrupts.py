"""Ctrl-C at random times, and the cell run again: real signals, from another process, in a process of their own.

`python tests/runtime/test_interrupts.py --count 300 --threads 2 4` prints how long the answers took, for the notes.
"""

import argparse
import json
import math
import mmap
import os
import signal
import struct
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1] / "helpers"))

import faults
import numpy as np
import pytest
import warp as wp
from fine_meshes import spheres_through_each_other
from hard_cases import FAMILIES

import ccd_warp as ccd

# Waits for (seconds, gap) a line, and sends SIGINT then, and once more after the gap unless that is 0. What it has done
# it writes to shared memory, which an interrupted process can read as often as it needs to.
_SENDER = """
import mmap, os, signal, struct, sys, time
pid, path = int(sys.argv[1]), sys.argv[2]
with open(path, "r+b") as file:
    memory = mmap.mmap(file.fileno(), 16)
for count, line in enumerate(sys.stdin):
    delay, gap = map(float, line.split())
    time.sleep(delay)
    struct.pack_into("d", memory, 8, time.monotonic())
    os.kill(pid, signal.SIGINT)
    if gap > 0:
        time.sleep(gap)
        os.kill(pid, signal.SIGINT)
    struct.pack_into("q", memory, 0, count + 1)
"""
_GAP = 1e-3
# A guard against hanging, not a demand: the answer is due within half a second.
_MOST_SECONDS = 60.0


class Sender:
    """A process that sends signals to this one."""

    def __init__(self):
        self._file = tempfile.NamedTemporaryFile()
        self._file.write(bytes(16))
        self._file.flush()
        self._memory = mmap.mmap(self._file.fileno(), 16)
        command = [sys.executable, "-c", _SENDER, str(os.getpid()), self._file.name]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, text=True, start_new_session=True)
        self._count = 0

    def ask(self, delay, gap):
        """Have a signal sent so many seconds from now."""
        self._count += 1
        self._process.stdin.write(f"{delay} {gap}\n")
        self._process.stdin.flush()

    def is_done(self):
        return struct.unpack_from("q", self._memory, 0)[0] == self._count

    def time_sent(self):
        """When the first of the last signals was sent."""
        return struct.unpack_from("d", self._memory, 8)[0]

    def close(self):
        self._process.stdin.close()
        self._process.wait()


class Handler:
    """The handler of SIGINT: an interrupt reaches the call alone, not what waits for its end."""

    is_armed = False

    def __call__(self, *_):
        if self.is_armed:
            raise KeyboardInterrupt


_handler = Handler()


def interrupted(sender, call, delay, gap):
    """Seconds from a signal in the middle of a call until the caller had control again, or None if it came too late."""
    back = None
    has_ended = False
    sender.ask(delay, gap)
    try:
        try:
            _handler.is_armed = True
            call()
            has_ended = True
            _handler.is_armed = False
        except KeyboardInterrupt:
            back = time.monotonic()
            _handler.is_armed = False
    except KeyboardInterrupt:  # the second one, while the first was caught; no third one is sent
        back = back or time.monotonic()
        _handler.is_armed = False
    while not sender.is_done():
        time.sleep(1e-3)
    time.sleep(3e-3)  # a signal that was sent has arrived by then
    return None if has_ended or back is None else back - sender.time_sent()


# --- what is interrupted: for each name, the call and the one that is compared after it ---

# Each pair may take some milliseconds, and all of them minutes.
_LONG = {"method": "bisection", "tolerance": 1e-15, "max_iterations": 100_000, "minimum_separation": 1e-3}


def _intersections(mesh, start, end, **options):
    found = ccd.find_intersections(mesh, end, **options)
    return [found.kind, found.primitives, found.parameters, found.points]


def _proximities(mesh, start, end, **options):
    found = ccd.find_proximity(mesh, end, 0.001, **options)
    bounds = ccd.displacement_bounds(mesh, end, 0.001, **options)
    return [found.kind, found.primitives, found.parameters, found.distance, bounds]


class Steps:
    """Calls on a sphere that flies into a static one, on the host and on the device.

    The static sphere is at one of two places, in turn: a call must not use what an earlier one has kept of it.
    """

    def __init__(self, num_faces, num_threads):
        scene = spheres_through_each_other(num_faces)
        half = len(scene.vertices_t0) // 2
        self.mesh = replace(scene, static=(1,)).mesh(ccd)
        self.frames = []
        for place in ([0, 0, 0], [0, 0.2, 0.1]):
            start = scene.vertices_t0.copy()
            start[half:] += place
            end = start.copy()
            end[:half] += [0.3, 0, 0]
            self.frames.append((start, end))
        self.place = 0
        self.threads = num_threads
        self.host = [np.array(x) for x in self.frames[0]]
        self.vertices_t0, self.vertices_t1 = (wp.array(x, dtype=wp.vec3d, device="cpu", copy=False) for x in self.host)
        options = {"device": "cpu", "length_scale": 1.0, "num_threads": num_threads}
        options |= {"max_pairs": 20 * num_faces, "max_contacts": 20 * num_faces}
        self.pipeline, self.long = (ccd.CollisionPipeline(self.mesh, **options, **more) for more in ({}, _LONG))

    def of_mesh(self, call, **options):
        options |= {"device": "cpu", "num_threads": self.threads}
        return lambda: call(self.mesh, *self.frames[self.place], **options)

    def put(self, share=1.0):
        """Fill the arrays of the device with a share of the step."""
        start, end = self.frames[self.place]
        self.host[0][:], self.host[1][:] = start, start + share * (end - start)

    def launch(self, pipeline, share=1.0):
        self.put(share)
        return faults.arrays_of(pipeline.launch(self.vertices_t0, self.vertices_t1))

    def launch_line_search(self):
        self.put()
        return faults.arrays_of(
            [self.pipeline.launch_line_search(self.vertices_t0, self.vertices_t1, per="vertex"), self.vertices_t1]
        )

    def calls(self):
        """Calls that end, which are compared themselves."""
        calls = {
            "mesh_ccd": self.of_mesh(ccd.mesh_ccd),
            "collision_free_step": self.of_mesh(ccd.collision_free_step),
            "find_candidates": self.of_mesh(ccd.find_candidates),
            "find_intersections": self.of_mesh(_intersections),
            "find_proximity": self.of_mesh(_proximities),
            "line_search": self.of_mesh(ccd.line_search, per="vertex"),
            "launch": lambda: self.launch(self.pipeline),
            "launch_line_search": self.launch_line_search,
        }
        return {name: (call, call) for name, call in calls.items()}

    def long_calls(self):
        """Calls that no one waits for, with shorter ones on the same objects."""
        calls = {"mesh_ccd": ccd.mesh_ccd, "collision_free_step": ccd.collision_free_step}
        long = {f"long {name}": (self.of_mesh(call, **_LONG), self.of_mesh(call)) for name, call in calls.items()}
        # hardly a step: few pairs are left
        return long | {"long launch": (lambda: self.launch(self.long), lambda: self.launch(self.long, 1e-3))}


def pairs(count, num_threads):
    """Many pairs, few that take long (needles, to a tolerance that bisection does not get to), and many of these."""
    rng = np.random.default_rng(0)
    start = rng.uniform(-1, 1, (1000 * count, 4, 3))
    end = start[:, ::-1] + 0.1
    options = {"num_threads": num_threads, "device": "cpu"}

    def needles(n):
        x = FAMILIES["needle_against_needle"]("edge-edge", n, np.random.default_rng(0))
        return lambda: ccd.edge_edge_ccd(*x, **options, **_LONG | {"minimum_separation": 0.0})

    def many():
        return ccd.vertex_face_ccd(start, end, **options)

    return {
        "pairs": (many, many),
        "slow pairs": (needles(count),) * 2,
        "long pairs": (needles(500 * count), needles(2)),
    }


def run(count, num_threads, num_faces, num_pairs, only=None):
    """Interrupt each call in turn; prints a line of JSON for each signal that came in time."""
    # a shell that starts the tests in the background may have them ignore it
    signal.signal(signal.SIGINT, _handler)
    steps = Steps(num_faces, num_threads)
    calls = steps.calls() | steps.long_calls() | pairs(num_pairs, num_threads)
    calls = {name: call for name, call in calls.items() if only in (None, name)}
    truth, seconds = {}, {}
    for name, (call, compared) in calls.items():
        for steps.place in (1, 0):
            truth[name, steps.place] = faults.arrays_of(compared())
        begin = time.monotonic()
        compared()
        seconds[name] = time.monotonic() - begin if call is compared else 0.3
    sender = Sender()
    rng = np.random.default_rng(num_threads)
    num_sent = 0
    while num_sent < count:
        steps.place = 1 - steps.place
        for name, (call, compared) in calls.items():
            gap = _GAP if rng.random() < 1 / 3 else 0.0
            wait = interrupted(sender, call, rng.uniform(0, 0.9) * seconds[name], gap)
            found = faults.difference(faults.arrays_of(compared()), truth[name, steps.place])
            if wait is not None:
                num_sent += 1
                line = {"name": name, "wait": wait, "twice": gap > 0, "wrong": found, "seconds": seconds[name]}
                print(json.dumps(line), flush=True)
    sender.close()


def in_own_process(count, num_threads, num_faces, num_pairs, timeout, only=None):
    """The signals of `run` and how the process ended: 0, the negative number of a signal, or "hung"."""
    numbers = [str(n) for n in (count, num_threads, num_faces, num_pairs)]
    command = [sys.executable, "-X", "faulthandler", __file__, "--run", *numbers, *([only] if only else [])]
    # a session of its own, so that what hangs is ended with what it has started
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    try:
        output, errors = process.communicate(timeout=timeout)
        ended = process.returncode
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        output, errors = process.communicate()
        ended = "hung"
    return [json.loads(line) for line in output.splitlines()], ended, errors


def report(signals):
    """Median and most of the seconds from the signal to the caller, in words."""
    waits = sorted(line["wait"] for line in signals) or [math.nan]
    wrong = sum(bool(line["wrong"]) for line in signals)
    return (
        f"{len(signals)} signals, {wrong} wrong answers, control back after "
        f"{1e3 * waits[len(waits) // 2]:.0f} ms in the median, {1e3 * waits[-1]:.0f} ms at most"
    )


@pytest.mark.skipif(not hasattr(os, "killpg"), reason="signals of POSIX")
@pytest.mark.parametrize(("count", "num_faces"), [(25, 40_000), pytest.param(100, 100_000, marks=pytest.mark.long)])
def test_interrupted_cell_is_answered_soon_and_can_be_run_again(count, num_faces):
    signals, ended, errors = in_own_process(count, 4, num_faces, 10, timeout=600)
    print(report(signals))
    assert ended == 0, f"the process ended with {ended} after {len(signals)} signals: {errors[-2000:]}"
    assert len(signals) >= count
    for line in signals:
        assert not line["wrong"], f"{line['name']}: {line['wrong']}"
        assert line["wait"] < _MOST_SECONDS, f"{line['name']}: control back after {line['wait']:.1f} s"


def main():
    if sys.argv[1:2] == ["--run"]:
        wp.config.log_level = wp.LOG_ERROR
        run(*map(int, sys.argv[2:6]), *sys.argv[6:])
        return
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--threads", type=int, nargs="*", default=[2, 4])
    parser.add_argument("--faces", type=int, default=400_000)
    parser.add_argument("--pairs", type=int, default=20, help="pairs that take long")
    parser.add_argument("--timeout", type=float, default=900.0, help="seconds after which a run is taken to hang")
    parser.add_argument("--only", help="one call")
    arguments = parser.parse_args()
    for num_threads in arguments.threads:
        signals, ended, errors = in_own_process(
            arguments.count, num_threads, arguments.faces, arguments.pairs, arguments.timeout, arguments.only
        )
        print(f"{num_threads} threads: {report(signals)}")
        for name in dict.fromkeys(line["name"] for line in signals):
            of_name = [line for line in signals if line["name"] == name]
            print(f"    {name} of {1e3 * of_name[0]['seconds']:.0f} ms: {report(of_name)}")
        if ended != 0:
            print(f"    the process ended with {ended}: {errors[-3000:]}")


if __name__ == "__main__":
    main()
