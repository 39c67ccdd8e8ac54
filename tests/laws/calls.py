"""Every public call on a step or on pairs as a row of one table, and what it returns on the device that Warp takes."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
import warp as wp

import ccd_warp as ccd
from laws.outputs import Outputs, outputs_of, rows_in_order

Made = tuple[ccd.CollisionMesh, np.ndarray, np.ndarray]

PRECISIONS = ("float64", "float32")
EVERY_PER = ("scene", "world", "body", "vertex")
VECTORS = {("float64", 3): wp.vec3d, ("float32", 3): wp.vec3f, ("float64", 2): wp.vec2d, ("float32", 2): wp.vec2f}
# The calls on the host by their names, line searches with what they are made per.
AT_ONE_TIME = ("find_proximity", "displacement_bounds", "find_intersections")
SCALARS = ("collision_free_step", "is_step_collision_free")
SEARCHES = tuple(f"line_search {per}" for per in EVERY_PER)
ON_HOST = ("mesh_ccd", "find_candidates", *AT_ONE_TIME, *SCALARS, *SEARCHES)
OF_SEARCH = ("broad_phase", "pair_kinds", "num_threads")


@dataclass(frozen=True)
class StepCase:
    """A step, and what is passed along with it.

    Attributes:
        make: Returns the mesh and the positions at both ends; anew, as a mesh keeps what it was used with.
        options: Options of the calls.
        capacity: Pairs and contacts that a launch has space for.
    """

    make: Callable[[], Made]
    options: dict[str, Any] = field(default_factory=dict)
    capacity: int = 3_000

    # What a drawn scene may have besides: what all lengths are in proportion to, and the motion of rigid bodies, anew.
    size = 1.0
    make_motion = None

    def motion(self) -> dict[str, Any]:
        """The motion as an argument, if there is one."""
        return {} if self.make_motion is None else {"motion": self.make_motion()}

    def only(self, *names: str) -> dict[str, Any]:
        """Those of the options that have one of the names."""
        return {name: self.options[name] for name in names if name in self.options}

    def pipeline(self, mesh: ccd.CollisionMesh, precision: str, *left_out: str, **more: Any) -> ccd.CollisionPipeline:
        """A pipeline with the options but for some, and with the capacities."""
        given = {name: value for name, value in self.options.items() if name not in left_out}
        given |= {"max_pairs": self.capacity, "max_contacts": self.capacity // 2, "precision": precision} | more
        return ccd.CollisionPipeline(mesh, **given)


def on_host(name: str, of: Any, start: np.ndarray, end: np.ndarray, distance: float = 0.0, **options: Any) -> Any:
    """One of the calls on the host, of a pipeline or a mesh: of a step, or of its end alone, and within a distance."""
    name, _, per = name.partition(" ")
    call = partial(getattr(ccd, name), of) if isinstance(of, ccd.CollisionMesh) else getattr(of, name)
    positions = (end,) if name in AT_ONE_TIME else (start, end)
    within = (distance,) if name in ("find_candidates", *AT_ONE_TIME[:2]) else ()
    return call(*positions, *within, **({"per": per} if per else {}), **options)


Call = Callable[[StepCase, str], Outputs]
CALLS: dict[str, Call] = {}


def row(call: Call) -> Call:
    """A row of the table."""
    CALLS[call.__name__] = call
    return call


@row
def steps(case: StepCase, precision: str) -> Outputs:
    """Whole steps, one of them twice, as the second meets what the first has left."""
    mesh, start, end = case.make()
    given = {**case.options, **case.motion(), "precision": precision}
    found: Outputs = {}
    for name in ("mesh_ccd", *SCALARS):
        found |= outputs_of(on_host(name, mesh, start, end, **given), name)
    found |= outputs_of(ccd.mesh_ccd(mesh, end, start, **given), "mesh_ccd back")
    pipeline = ccd.CollisionPipeline(mesh, **case.options, precision=precision)
    found |= outputs_of(pipeline.mesh_ccd(start, end[mesh.moving_vertices], **case.motion()), "pipeline.mesh_ccd")
    return found | outputs_of(pipeline.counts, "counts")


@row
def searches(case: StepCase, precision: str) -> Outputs:
    """Candidates of a step, and intersections at both of its ends."""
    mesh, start, end = case.make()
    given = case.only(*OF_SEARCH)
    found: Outputs = {}
    for share in (0.0, 0.02):
        candidates = ccd.find_candidates(mesh, start, end, share * case.size, **given, **case.motion())
        found |= outputs_of(candidates, f"find_candidates {share}")
    for k, positions in enumerate((start, end)):
        found |= outputs_of(ccd.find_intersections(mesh, positions), f"find_intersections {k}")
    return found


@row
def at_one_time(case: StepCase, precision: str) -> Outputs:
    """What is near, and how far vertices may move, on the host and in launches, also of static bodies that moved."""
    mesh, start, end = case.make()
    given = {"max_pairs": case.capacity, "max_contacts": case.capacity, **case.only("broad_phase", "num_threads")}
    pipeline = ccd.CollisionPipeline(mesh, **given)
    found: Outputs = {}
    for k, (positions, share) in enumerate(((start, 0.03), (end, 0.03), (start, 0.08))):
        distance = share * case.size
        found |= outputs_of(pipeline.find_proximity(positions, distance), f"find_proximity {k}")
        found |= outputs_of(pipeline.displacement_bounds(positions, distance), f"displacement_bounds {k}")
        array = on_device(positions + 0.01 * case.size * k, precision)
        result = pipeline.launch_proximity(array, distance)
        found |= outputs_of([result.flags.numpy()[0], result.count.numpy()[0]], f"launch_proximity {k} counts")
        found |= outputs_of(result.to_host(), f"launch_proximity {k}")
        once = pipeline.find_proximity(positions, distance, unique=True)
        found |= outputs_of(once, f"find_proximity {k} unique")
        columns = result.kind.numpy(), result.primitives.numpy(), result.shared_by().numpy()
        pairs = np.column_stack(columns)[result.unique().numpy()]
        found |= outputs_of(pairs[np.lexsort(pairs.T[::-1])], f"launch_proximity {k} unique")
        found |= outputs_of(pipeline.launch_displacement_bounds(array, distance).bounds, f"launched bounds {k}")
    return found


@row
def line_searches(case: StepCase, precision: str) -> Outputs:
    """The line search on the host, whose fractions are those of the scene, of worlds, bodies and vertices."""
    mesh, start, end = case.make()
    given = {name: value for name, value in case.options.items() if name != "t_max"}
    given |= {**case.motion(), "precision": precision}
    found: Outputs = {}
    for name in SEARCHES:
        found |= outputs_of(on_host(name, mesh, start, end, **given), name)
    return found


@row
def launches(case: StepCase, precision: str) -> Outputs:
    """Launches of positions: whole, as displacements, of moving vertices alone, with other radii."""
    mesh, start, end = case.make()
    pipeline, motion = case.pipeline(mesh, precision), case.motion()
    found: Outputs = {}
    t0, t1 = (on_device(x, precision) for x in (start, end))
    result = pipeline.launch(t0, t1, **motion)
    found |= outputs_of(result, "launch") | outputs_of(result.to_host(), "to_host")
    # a static body that is moved, and stays there
    moved = (on_device(x + 0.01 * case.size, precision) for x in (start, end))
    found |= outputs_of(pipeline.launch(*moved, **motion), "launch elsewhere")
    own0, own1 = (on_device(x[mesh.moving_vertices], precision) for x in (start, end))
    found |= outputs_of(pipeline.launch(own0, t1, **motion), "launch of moving vertices to where all are")
    result = pipeline.launch(own0, own1, **motion)
    found |= outputs_of(result, "launch of moving vertices")
    if not motion:
        found |= outputs_of(_points_at(result.contacts, t0, t1), "points_at")
        moves = on_device(end - start, precision)
        found |= outputs_of(pipeline.launch(t0, displacements=moves), "launch of displacements")
    pipeline.reserve(vertices=end)
    t0, t1 = on_device(start, "float64"), on_device(end, "float64")
    found |= outputs_of(pipeline.launch(t0, t1, **motion), "laid out anew")
    if mesh.radius is not None:
        for share in (0.25, 1.5):
            pipeline.radius.assign(share * mesh.radius)
            found |= outputs_of(pipeline.launch(t0, t1, **motion), f"launch with {share} of the radii")
            near = pipeline.launch_proximity(t0, 0.02 * case.size)
            found |= outputs_of(near.to_host(), f"launch_proximity with {share} of the radii")
    return found


@row
def launched_line_searches(case: StepCase, precision: str) -> Outputs:
    """The line searches on the device, with the positions that they leave."""
    mesh, start, end = case.make()
    pipeline = case.pipeline(mesh, precision, "t_max")
    found: Outputs = {}
    for k, per in enumerate(EVERY_PER):
        t0, t1 = (on_device(x, PRECISIONS[k % 2]) for x in (start, end))
        result = pipeline.launch_line_search(t0, t1, per=per, num_rounds=5, **case.motion())
        found |= outputs_of(result, f"launch_line_search {per}") | outputs_of(t1, f"launch_line_search {per} positions")
    return found


@row
def gradients(case: StepCase, precision: str) -> Outputs:
    """Gradients of a launch and of a line search on a tape by both ends and radii, for positions of both types."""
    mesh, start, end = case.make()
    gap = case.options.get("start_gap_fraction", "hold")
    gap = "hold" if isinstance(gap, float) else gap  # a share of the distance at the start would change with it
    found: Outputs = {}
    for k, dtype in enumerate(PRECISIONS * 2):
        is_search, per = k >= 2, EVERY_PER[2 + k % 2]
        pipeline = case.pipeline(mesh, precision, *["t_max"] * is_search, start_gap_fraction=gap)
        t0, t1 = (on_device(x, dtype, requires_grad=True) for x in (start, end))
        given = {"t0": t0, "t1": t1}
        if pipeline.radius is not None:
            pipeline.radius.requires_grad = True
            given["radius"] = pipeline.radius
        with wp.Tape() as tape:
            result = pipeline.launch_line_search(t0, t1, per=per) if is_search else pipeline.launch(t0, t1)
        of_result = [t1] if is_search else [result.vertex_toi, result.body_toi, result.world_toi, result.toi]
        for m, array in enumerate(of_result):
            array.grad.assign(np.cos(np.arange(array.numpy().size) + m).reshape(array.numpy().shape))
        tape.backward()
        flags = {f"is_regular {of}": result.is_regular(*of).numpy() for of in ([()] if is_search else zip(EVERY_PER))}
        found |= outputs_of({name: array.grad.numpy() for name, array in given.items()} | flags, f"gradients {k}")
    return found


@row
def replays(case: StepCase, precision: str, *, is_captured: bool = True) -> Outputs:
    """Launches that a graph holds, replayed with other positions in the same arrays; or the launches themselves."""
    mesh, start, end = case.make()
    # what a pipeline launches shares its results
    pipeline, searcher = (case.pipeline(mesh, precision, "t_max") for _ in range(2))
    finder = ccd.CollisionPipeline(mesh, max_pairs=case.capacity, max_contacts=case.capacity)
    pipeline.reserve()
    searcher.reserve()
    t0, t1, shortened = (on_device(x, "float64") for x in (start, end, end))
    distance = 0.03 * case.size

    def launch() -> tuple[Any, ...]:
        result = pipeline.launch(t0, t1)
        of_contacts = {name: getattr(result.contacts, name) for name in ("points", "vertices", "bodies", "world")}
        of_contacts["points at"] = result.contacts.points_at(t0, shortened)
        near, bounds = finder.launch_proximity(t1, distance), finder.launch_displacement_bounds(t1, distance)
        searched = searcher.launch_line_search(t0, shortened, per="world")
        return result, of_contacts, near, bounds, searched

    launched = launch()
    if is_captured:
        with wp.ScopedCapture() as capture:
            launched = launch()
    found: Outputs = {}
    for k, share in enumerate((1.0, 0.3, 0.0)):
        for array in (t1, shortened):
            array.assign(start + share * (end - start))
        if is_captured:
            wp.capture_launch(capture.graph)
        else:
            launched = launch()
        result, of_contacts, near, bounds, searched = launched
        first = rows_in_order(result.contacts)
        found |= {f"replay {k} {name}": array.numpy()[first] for name, array in of_contacts.items()}
        found |= outputs_of(result, f"replay {k}") | outputs_of(searched, f"replay {k} of a line search")
        found |= outputs_of(near.to_host(), f"replay {k} near") | outputs_of(bounds.bounds, f"replay {k} bounds")
        found |= outputs_of(shortened, f"replay {k} positions")
    return found


@row
def few_pairs(case: StepCase, precision: str) -> Outputs:
    """Launches with too little capacity: what is certain of them whatever the order of the threads.

    Which pairs find no place depends on the order; that the flag is set, that all pairs are counted, and that no toi is
    late, does not. Contacts that find no place leave every toi as it is.
    """
    mesh, start, end = case.make()
    truth = case.pipeline(mesh, precision).mesh_ccd(start, end).vertex_toi
    t0, t1 = (on_device(x, "float64") for x in (start, end))
    found: Outputs = {}
    for most in (1, 37):
        result = case.pipeline(mesh, precision, max_pairs=most).launch(t0, t1)
        found |= outputs_of({"flags": result.flags, "num_pairs": result.num_pairs}, f"launch with {most} pairs")
        found |= outputs_of((result.vertex_toi.numpy() > truth).any(), f"is late with {most} pairs")
    result = case.pipeline(mesh, precision, max_contacts=2).launch(t0, t1)
    names = ("flags", "toi", "vertex_toi", "body_toi", "world_toi")
    return found | outputs_of({name: getattr(result, name) for name in names}, "launch with few contacts")


@row
def not_a_number(case: StepCase, precision: str) -> Outputs:
    """Launches in which a coordinate is not a number; contacts are undefined there."""
    mesh, start, end = case.make()
    pipeline, end = case.pipeline(mesh, precision, "t_max"), end.copy()
    end[mesh.moving_vertices[-1], 0] = np.nan
    t0, t1 = (on_device(x, "float64") for x in (start, end))
    found = outputs_of(pipeline.launch(t0, t1), "launch")
    found |= outputs_of(pipeline.launch_line_search(t0, t1, per="world"), "line search") | outputs_of(t1, "positions")
    return {name: array for name, array in found.items() if ".contacts" not in name}


@row
def batches(case: StepCase, precision: str, *, is_limited: bool = True, with_order: bool = False) -> Outputs:
    """The calls on the host with as little memory as they can do with, and with twice that; or with enough.

    The order of candidates may be compared between calls on the CPU; a GPU has its own.
    """
    mesh, start, end = case.make()
    found: Outputs = {}
    for name in (name for name in ON_HOST if name not in SEARCHES):
        is_step = name == "mesh_ccd" or name in SCALARS
        given, least = {**case.options, "precision": precision} if is_step else case.only(*OF_SEARCH), 1
        for times in (1, 2):
            while True:
                pipeline = ccd.CollisionPipeline(
                    mesh, **given, **({"memory_limit": times * least} if is_limited else {})
                )
                try:
                    result = on_host(name, pipeline, start, end, 0.03 * case.size)
                    break
                except ValueError as error:  # each device counts by itself what it needs
                    least = int(re.search(r"at least (\d+)", str(error))[1])  # type: ignore[index]
            found |= outputs_of(result, f"{name} in {times} of the memory")
            if with_order and isinstance(result, ccd.Candidates):
                found |= outputs_of(vars(result), f"order in {times} of the memory")
    return found


def pairs(kind: str, start: np.ndarray, end: np.ndarray, precision: str, options: dict[str, Any]) -> Outputs:
    """The pair function of a kind, with arrays of NumPy, few and many, and of Warp, with a coordinate that is none."""
    call, options = getattr(ccd, f"{kind}_ccd"), {**options, "precision": precision}
    found = outputs_of(call(start, end, **options), "many") | outputs_of(call(start[:3], end[:3], **options), "few")
    start, end = start.copy(), end.copy()
    start[-2, 0, 0], end[-1, -1, -1] = np.nan, np.inf
    has_gradient = "start_gap_fraction" not in options
    ends = [on_device(x, "float64", requires_grad=has_gradient) for x in (start, end)]
    with wp.Tape() as tape:
        result = call(*ends, **options)
    found |= outputs_of(result, "of Warp") | outputs_of(result.hit, "hit")
    if has_gradient:
        result.toi.grad.fill_(1.0)
        tape.backward()
        found |= outputs_of({f"t{k}": end.grad.numpy() for k, end in enumerate(ends)}, "gradients")
    return found


def on_device(positions: np.ndarray, dtype: str = "float64", **options: Any) -> wp.array:
    """Positions as an array of Warp."""
    vector = VECTORS[dtype, positions.shape[-1]]
    return wp.array(np.ascontiguousarray(positions, dtype=dtype), dtype=vector, **options)


def _points_at(contacts: ccd.DeviceContacts, t0: wp.array, t1: wp.array) -> np.ndarray:
    """Points of the contacts in another step, in the order of `Contacts`."""
    count = min(int(contacts.count.numpy()[0]), len(contacts.kind))
    pairs = np.column_stack([contacts.kind.numpy(), contacts.primitives.numpy()])[:count]
    return contacts.points_at(t0, t1).numpy()[:count][np.lexsort(pairs.T[::-1])]
