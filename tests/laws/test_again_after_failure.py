"""A call that fails half-way, or is interrupted, and is made again answers what it does on fresh objects, bit by bit.

What fails: a use of Warp or of threads, before it is carried out or after (`helpers/faults.py`); or an interrupt comes,
between two bytecodes, or at a random time, as by Ctrl-C in a notebook.
"""

import signal
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp
from daily import marked
from faults import Scenario, wrong_after_events, wrong_after_interrupts
from hard_cases import FAMILIES

import ccd_warp as ccd
from laws.calls import on_device
from laws.outputs import different, outputs_of
from laws.test_other_ways import crowd

THREADS = {"num_threads": 2}
SMALL, ALONE = (lambda: crowd(60, 12, static=[1])), (lambda: crowd(60, 12, static=[1], self_collision=False))
LARGE = lambda: crowd(700, 20, size=0.04, static=[1])  # noqa: E731


def objects(make=SMALL, **options):
    """A mesh, a pipeline, arrays on the device, and positions; elsewhere is where the static body was before."""
    mesh, start, end = make()
    o = SimpleNamespace(mesh=mesh, here=(start, end), elsewhere=(start, end))
    move = np.array([0.0, 0.0, -3.0]) * mesh.static[mesh.vertex_body][:, None]
    o.elsewhere = (start + move, end + move)
    given = {"max_pairs": 60_000, "max_contacts": 60_000, "length_scale": 1.0, **THREADS, **options}
    o.pipeline, o.options = ccd.CollisionPipeline(mesh, **given), {**THREADS, **options}
    o.arrays = [wp.empty(len(start), dtype=wp.vec3d) for _ in range(2)]
    return o


def put(o, x, y):
    """The arrays of the device, with positions."""
    for array, values in zip(o.arrays, (x, y), strict=True):
        array.assign(values)
    return o.arrays


def gradient(o, x, y):
    for array in put(o, x, y):
        array.requires_grad = True
        array.grad.zero_()
    with wp.Tape() as tape:
        result = o.pipeline.launch(*o.arrays)
    result.vertex_toi.grad.fill_(1.0)
    tape.backward()
    return {str(k): array.grad for k, array in enumerate(o.arrays)}


def two_at_once(o, x, y):
    """Threads of the user on one pipeline and one mesh, of which this one fails."""
    others = []

    def ask():
        try:
            others.append(ccd.collision_free_step(o.mesh, x, y, **o.options))
        except BaseException as error:
            others.append(error)

    other = threading.Thread(target=ask)
    try:
        other.start()
        own = o.pipeline.mesh_ccd(x, y)
    finally:
        if other.ident:
            other.join()
    if isinstance(others[0], BaseException):
        raise others[0]
    return {"own": own, "other": others[0]}


def of_mesh(name):
    return lambda o, x, y: getattr(ccd, name)(o.mesh, x, y, **o.options)


CALLS = {
    **{name: of_mesh(name) for name in ("mesh_ccd", "collision_free_step", "find_candidates")},
    "line_search": lambda o, x, y: ccd.line_search(o.mesh, x, y, per="vertex", **o.options),
    "find_intersections": lambda o, x, y: o.pipeline.find_intersections(y),
    "find_proximity": lambda o, x, y: o.pipeline.find_proximity(x, 0.05),
    "displacement_bounds": lambda o, x, y: o.pipeline.displacement_bounds(x, 0.05),
    "pipeline.mesh_ccd": lambda o, x, y: o.pipeline.mesh_ccd(x, y),
    "launch": lambda o, x, y: o.pipeline.launch(*put(o, x, y)),
    "launch_line_search": lambda o, x, y: {
        "result": o.pipeline.launch_line_search(*put(o, x, y), per="body", num_rounds=4),
        "positions": o.arrays[1],
    },
    "launch_proximity": lambda o, x, y: o.pipeline.launch_proximity(put(o, x, y)[0], 0.05).to_host(),
    "launch_displacement_bounds": lambda o, x, y: o.pipeline.launch_displacement_bounds(put(o, x, y)[0], 0.05).bounds,
    "reserve and launch": lambda o, x, y: (
        o.pipeline.reserve(max_pairs=70_000, vertices=x), o.pipeline.launch(*put(o, x, y)))[1],
    "gradient": gradient,
    "two threads": two_at_once,
}  # fmt: skip


def scenario(name, when, make=SMALL, **options):
    """A call that is the first, is made again, or comes after the static body has moved."""
    call = CALLS[name]
    before = {"first": None, "again": lambda o: call(o, *o.here), "moved": lambda o: call(o, *o.elsewhere)}[when]
    return Scenario(lambda: objects(make, **options), lambda o: call(o, *o.here), before or (lambda o: None))


def of_pairs(kind, count=1, as_arrays=False):
    """A pair function of many pairs."""
    start, end = FAMILIES["random_colliding"](kind.replace("_", "-"), 3000, np.random.default_rng(1))
    convert = on_device if as_arrays else np.array
    call = getattr(ccd, f"{kind}_ccd")
    return Scenario(lambda: (convert(start), convert(end)), lambda x: call(*x, minimum_separation=0.02, **THREADS))


SCENARIOS = {f"{when} {name}": scenario(name, when) for when in ("first", "moved") for name in CALLS}
SCENARIOS |= {
    "large mesh_ccd": scenario("mesh_ccd", "moved", LARGE),
    "large collision_free_step": scenario("collision_free_step", "again", LARGE),
    "large launch": scenario("launch", "moved", LARGE),
    "large find_candidates, hash": scenario("find_candidates", "again", LARGE, broad_phase="hash"),
    "launch, hash": scenario("launch", "moved", broad_phase="hash"),
    "bodies alone": scenario("mesh_ccd", "moved", ALONE),
    "little memory": scenario("pipeline.mesh_ccd", "first", LARGE, memory_limit=5_000_000),
    "vertex_face_ccd": of_pairs("vertex_face"),
    "edge_edge_ccd on the device": of_pairs("edge_edge", as_arrays=True),
    "point_segment_ccd": of_pairs("point_segment"),
    "point_point_ccd": of_pairs("point_point"),
}


# Every run of the tests has each scenario with one of the two kinds of faults: as the calls are an odd number, one that
# is the first with one, and one that comes later with the other.
@pytest.mark.parametrize("name", marked(list(SCENARIOS), list(SCENARIOS)[::2]))
def test_a_call_that_fails_at_any_use_of_warp_is_made_again(name, pytestconfig):
    """At every second line; on a slow device at some of them."""
    is_emulated = pytestconfig.getoption("device") == "emulated"
    assert wrong_after_events(SCENARIOS[name], every=20 if is_emulated else 2) == []


@pytest.mark.long
@pytest.mark.parametrize("name", SCENARIOS)
def test_a_call_that_fails_at_every_event_is_made_again(name):
    assert wrong_after_events(SCENARIOS[name]) == []


@pytest.mark.parametrize("name", marked(list(SCENARIOS), list(SCENARIOS)[1::2]))
def test_a_cell_that_is_interrupted_between_any_two_lines_is_run_again(name, pytestconfig):
    is_emulated = pytestconfig.getoption("device") == "emulated"
    assert wrong_after_interrupts(SCENARIOS[name], len(name), 2 if is_emulated else 8) == []


# --- at random times ---

# Each pair may take some milliseconds, and all of them minutes.
_LONG = {"method": "bisection", "tolerance": 1e-15, "max_iterations": 100_000, "minimum_separation": 1e-3}


class Ctrl_C:
    """Interrupts after some seconds, as a signal of another process does; perhaps twice, a millisecond apart."""

    def __init__(self, seconds, is_twice):
        self.seconds, self.gap, self.left = seconds, 1e-3 if is_twice else 0.0, 1 + is_twice
        self.at = None

    def __enter__(self):
        self.before = signal.signal(signal.SIGALRM, self.arrive)
        signal.setitimer(signal.ITIMER_REAL, self.seconds, self.gap)
        return self

    def arrive(self, *_):
        self.at = self.at or time.monotonic()
        self.left -= 1
        if self.left == 0:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
        if self.left >= 0:
            raise KeyboardInterrupt

    def __exit__(self, kind, *_):
        back = time.monotonic()
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, self.before)
        # a guard against hanging, not a demand: the answer is due within half a second
        assert self.at is None or back - self.at < 60.0
        return kind is KeyboardInterrupt


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="signals of POSIX")
@pytest.mark.parametrize("count", [2, pytest.param(20, marks=pytest.mark.long)])
def test_an_interrupted_cell_is_answered_soon_and_can_be_run_again(count):
    o, rng, num_interrupted = objects(LARGE), np.random.default_rng(count), 0
    needles = FAMILIES["needle_against_needle"]("edge-edge", 2000, rng)
    long = {
        "mesh_ccd": lambda: ccd.mesh_ccd(o.mesh, *o.here, **THREADS, **_LONG),
        "launch": lambda: o.long.launch(*put(o, *o.here)),
        "pairs": lambda: ccd.edge_edge_ccd(*needles, **THREADS, **_LONG),
    }
    o.long = ccd.CollisionPipeline(o.mesh, max_pairs=60_000, max_contacts=60_000, **THREADS, **_LONG)
    for name, call in CALLS.items():
        truth = outputs_of(call(o, *o.here))
        begin = time.monotonic()
        call(o, *o.here)
        seconds = time.monotonic() - begin
        for k in range(count):
            call(o, *o.elsewhere)
            is_long = name in long and k % 2 == 1
            with Ctrl_C(0.3 if is_long else max(rng.uniform(0, 0.9) * seconds, 1e-4), k % 3 == 1) as interrupt:
                long[name]() if is_long else call(o, *o.here)
            num_interrupted += interrupt.at is not None
            assert different(outputs_of(call(o, *o.here)), truth) == [], name
    with Ctrl_C(0.3, False) as interrupt:
        long["pairs"]()
    assert interrupt.at and num_interrupted > count * len(CALLS) / 4
