"""A call that fails half-way, or is interrupted, and is made again answers what it does on fresh objects, bit by bit.

What fails: a use of Warp or of threads, before it is carried out or after (`helpers/faults.py`); or an interrupt comes
between two bytecodes, or while kernels run, as by Ctrl-C in a notebook.
"""

import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp
from daily import marked
from faults import Scenario, alarm, wrong_after_events, wrong_after_interrupts
from hard_cases import FAMILIES
from scenes import crowd_of_three

import ccd_warp as ccd
from laws.calls import AT_ONE_TIME, on_device, on_host
from laws.outputs import different, outputs_of

THREADS = {"num_threads": 2}
SMALL, ALONE = (
    (lambda: crowd_of_three(60, 12, static=[1])),
    (lambda: crowd_of_three(60, 12, static=[1], self_collision=False)),
)
LARGE = lambda: crowd_of_three(700, 20, size=0.04, static=[1])  # noqa: E731


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
    other = SimpleNamespace(found=None, error=None)

    def ask():
        try:
            other.found = ccd.collision_free_step(o.mesh, x, y, **o.options)
        except BaseException as error:
            other.error = error

    thread = threading.Thread(target=ask)
    try:
        thread.start()
        own = o.pipeline.mesh_ccd(x, y)
    finally:
        if thread.ident:
            thread.join()
    if other.error:
        raise other.error
    return {"own": own, "other": other.found}


def of_host(name, of):
    """One of the calls on the host, of the mesh or of the pipeline."""
    return lambda o, x, y: on_host(name, vars(o)[of], x, y, 0.05, **(o.options if of == "mesh" else {}))


MADE = {
    **{
        name: of_host(name, "mesh")
        for name in ("mesh_ccd", "collision_free_step", "find_candidates", "line_search vertex")
    },
    **{name: of_host(name, "pipeline") for name in AT_ONE_TIME},
    "pipeline.mesh_ccd": of_host("mesh_ccd", "pipeline"),
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
    call = MADE[name]
    before = {"first": None, "again": lambda o: call(o, *o.here), "moved": lambda o: call(o, *o.elsewhere)}[when]
    return Scenario(lambda: objects(make, **options), lambda o: call(o, *o.here), before or (lambda o: None))


def of_pairs(kind, count=1, as_arrays=False):
    """A pair function of many pairs."""
    start, end = FAMILIES["random_colliding"](kind.replace("_", "-"), 3000, np.random.default_rng(1))
    convert = on_device if as_arrays else np.array
    call = getattr(ccd, f"{kind}_ccd")
    return Scenario(lambda: (convert(start), convert(end)), lambda x: call(*x, minimum_separation=0.02, **THREADS))


SCENARIOS = {f"{when} {name}": scenario(name, when) for when in ("first", "moved") for name in MADE}
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
@pytest.mark.parametrize("every", [2, pytest.param(None, marks=pytest.mark.long)])
@pytest.mark.parametrize("name", marked(list(SCENARIOS), list(SCENARIOS)[::2]))
def test_a_call_that_fails_at_any_use_of_warp_is_made_again(name, every, pytestconfig):
    """At every second line, or at every event; on a slow device at some of them."""
    is_emulated = pytestconfig.getoption("device") == "emulated"
    assert wrong_after_events(SCENARIOS[name], every=20 if is_emulated else every) == []


@pytest.mark.parametrize("name", marked(list(SCENARIOS), list(SCENARIOS)[1::2]))
def test_a_cell_that_is_interrupted_between_any_two_lines_is_run_again(name, pytestconfig):
    is_emulated = pytestconfig.getoption("device") == "emulated"
    assert wrong_after_interrupts(SCENARIOS[name], len(name), 2 if is_emulated else 8) == []


@pytest.mark.parametrize("name", ["mesh_ccd", "launch", "pairs"])
def test_an_interrupted_cell_is_answered_soon_and_can_be_run_again(name, pytestconfig):
    """Each pair may take some milliseconds, and all of them minutes; the answer is due within half a second."""
    if pytestconfig.getoption("device") != "cpu":
        pytest.skip("on a device a kernel runs to its end")
    o, needles = objects(LARGE), FAMILIES["needle_against_needle"]("edge-edge", 2000, np.random.default_rng(2))
    long = {"method": "bisection", "tolerance": 1e-15, "max_iterations": 100_000, "minimum_separation": 1e-3}
    pipeline, short = (
        ccd.CollisionPipeline(o.mesh, max_pairs=60_000, max_contacts=60_000, **THREADS, **long),
        o.pipeline,
    )

    def asked(**options):
        if name == "pairs":
            return ccd.edge_edge_ccd(*needles, **THREADS, **options)
        o.pipeline = pipeline if options else short
        return MADE["pipeline.mesh_ccd" if name == "mesh_ccd" else name](o, *o.here)

    truth = outputs_of(asked())
    for _ in range(2):
        begin = time.monotonic()
        with pytest.raises(KeyboardInterrupt), alarm(0.3, KeyboardInterrupt):
            asked(**long)
        assert time.monotonic() - begin < 60.0  # a guard against hanging, not the demand
        assert different(outputs_of(asked()), truth) == []
