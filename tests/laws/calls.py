"""Every public call on a step or on pairs, and what it returns: asked of a GPU, an emulated one and the CPU alike."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh
import warp as wp

import ccd_warp as ccd
from laws.outputs import Outputs, outputs_of

Made = tuple[ccd.CollisionMesh, np.ndarray, np.ndarray]

EVERY_PER = ("scene", "world", "body", "vertex")
_OF_SEARCH = ("broad_phase", "pair_kinds", "num_threads")
VECTORS = {("float64", 3): wp.vec3d, ("float32", 3): wp.vec3f, ("float64", 2): wp.vec2d, ("float32", 2): wp.vec2f}


@dataclass(frozen=True)
class StepCase:
    """A step, and what is passed along with it.

    Attributes:
        make: Returns the mesh and the positions at both ends; anew, as a mesh keeps what it was used with.
        options: Options of the calls.
        capacity: Pairs and contacts that a launch has space for.
        is_thorough: Whether launches take positions of both types in every form.
    """

    make: Callable[[], Made]
    options: dict[str, Any]
    capacity: int = 10_000
    is_thorough: bool = False

    @property
    def capacities(self) -> dict[str, int]:
        """The capacity as options."""
        return {"max_pairs": self.capacity, "max_contacts": self.capacity}


def on_the_host(case: StepCase, precision: str, device: str = "cpu") -> Outputs:
    """The calls that take and return NumPy arrays."""
    return steps(case, precision, device) | searches(case, precision, device)


def steps(case: StepCase, precision: str, device: str = "cpu") -> Outputs:
    """Whole steps, one of them twice, as the second meets what the first has left."""
    mesh, start, end = case.make()
    options = {**case.options, "precision": precision, "device": device}
    found = outputs_of(ccd.mesh_ccd(mesh, start, end, **options), "mesh_ccd")
    found |= outputs_of(ccd.mesh_ccd(mesh, end, start, **options), "mesh_ccd back")
    found |= outputs_of(ccd.collision_free_step(mesh, start, end, **options), "collision_free_step")
    found |= outputs_of(ccd.is_step_collision_free(mesh, start, end, **options), "is_step_collision_free")
    pipeline = ccd.CollisionPipeline(mesh, **options)
    found |= outputs_of(pipeline.mesh_ccd(start, end[mesh.moving_vertices]), "pipeline.mesh_ccd")
    return found | outputs_of(pipeline.counts, "counts")


def searches(case: StepCase, precision: str, device: str = "cpu") -> Outputs:
    """Candidates of a step, and intersections at both of its ends."""
    mesh, start, end = case.make()
    of_search = {name: case.options[name] for name in _OF_SEARCH if name in case.options}
    found: Outputs = {}
    for inflation in (0.0, 0.02):
        candidates = ccd.find_candidates(mesh, start, end, inflation, device=device, **of_search)
        found |= outputs_of(candidates, f"find_candidates {inflation}")
    for positions in (start, end):
        intersections = ccd.find_intersections(mesh, positions, device=device)
        names = ("kind", "primitives", "parameters", "edge_parameter", "points")
        arrays = {name: getattr(intersections, name) for name in names}
        found |= outputs_of(arrays, f"find_intersections {'at the end' if positions is end else ''}")
    return found


def with_radii(case: StepCase, precision: str, device: str = "cpu") -> Outputs:
    """Calls on a mesh with radii, and launches between which these change, of the static body, too."""
    mesh, start, end = case.make()
    options = {**case.options, "precision": precision, "device": device}
    found = outputs_of(ccd.mesh_ccd(mesh, start, end, **options), "mesh_ccd")
    found |= outputs_of(ccd.collision_free_step(mesh, start, end, **options), "collision_free_step")
    found |= outputs_of(ccd.find_candidates(mesh, start, end, device=device), "find_candidates")
    pipeline = ccd.CollisionPipeline(mesh, **case.capacities, **options)
    t0, t1 = _on_device(start, "float64", device), _on_device(end, "float64", device)
    for share in (1.0, 0.25, 1.5):
        pipeline.radius.assign(share * mesh.radius)
        found |= outputs_of(pipeline.launch(t0, t1), f"launch with {share} of the radii")
        near, bounds = pipeline.launch_proximity(t0, 0.02), pipeline.launch_displacement_bounds(t0, 0.05)
        found |= outputs_of(_rows(near.to_host()), f"launch_proximity with {share} of the radii")
        found |= outputs_of(bounds.bounds, f"launch_displacement_bounds with {share} of the radii")
    return found | _with_little_capacity(pipeline, t0, t1)


def line_searches_with_radii(case: StepCase, precision: str, device: str = "cpu") -> Outputs:
    """Line searches in which pairs start within their distances, on the host and on the device."""
    mesh, start, end = case.make()
    pipeline = ccd.CollisionPipeline(mesh, device=device, **case.capacities, precision=precision, **case.options)
    found: Outputs = {}
    for per in ("world", "vertex"):
        found |= outputs_of(pipeline.line_search(start, end, per=per), f"line_search {per}")
        t0, t1 = _on_device(start, "float64", device), _on_device(end, "float64", device)
        launched = pipeline.launch_line_search(t0, t1, per=per)
        found |= outputs_of({"positions": t1, "flags": launched.flags}, f"launch_line_search {per}")
    return found


def on_arcs(case: StepCase, precision: str, device: str = "cpu") -> Outputs:
    """Calls with a motion, whose rigid bodies turn: on screws by less than a slice, on linear paths by several."""
    mesh, start, end = case.make()
    options = {**case.options, "precision": precision, "device": device}
    rng = np.random.default_rng(33)
    end = np.where(mesh.rigid[mesh.vertex_body][:, None], start, end)
    found: Outputs = {}
    for path, turn in (("screw", 0.05), ("linear", 0.25)):
        poses = np.hstack([0.02 * rng.standard_normal((int(mesh.rigid.sum()), 3)), rng.standard_normal((1, 4))])
        twist = np.hstack([0.1 * rng.standard_normal((len(poses), 3)), turn * rng.standard_normal((len(poses), 3))])
        motion = ccd.RigidMotion(poses, twist=twist, path=path)
        found |= outputs_of(ccd.mesh_ccd(mesh, start, end, motion=motion, **options), f"mesh_ccd {path}")
        # without planes, in whose solids some vertices start, so that pairs are looked at
        kinds = ["vertex_face", "edge_edge", "point_segment", "point_point"]
        step = ccd.collision_free_step(mesh, start, end, motion=motion, pair_kinds=kinds, **options)
        found |= outputs_of(step, f"collision_free_step {path}")
    searched = ccd.line_search(mesh, start, end, motion=motion, per="body", **options)
    found |= outputs_of(searched.vertices, "line_search")
    candidates = ccd.find_candidates(mesh, start, end, motion=motion, device=device)
    pipeline = ccd.CollisionPipeline(mesh, **case.capacities, **options)
    launched = pipeline.launch(_on_device(start, "float64", device), _on_device(end, "float64", device), motion=motion)
    tois = {"vertices": launched.vertex_toi, "bodies": launched.body_toi, "flags": launched.flags}
    found |= outputs_of(launched.contacts.to_host(), "contacts of a launch")
    for per in ("body", "vertex"):
        written = _on_device(end, "float64", device)
        shortened = pipeline.launch_line_search(_on_device(start, "float64", device), written, per=per, motion=motion)
        found |= outputs_of({"vertices": written, "bodies": shortened.body_fraction}, f"launch_line_search {per}")
    found |= outputs_of(_on_joints(options), "joints")
    return found | outputs_of(candidates, "find_candidates") | outputs_of(tois, "launch")


def _on_joints(options: dict[str, Any]) -> ccd.MeshResult:
    """An arm of two links beside a ball that stands, in three worlds of a mesh of one."""
    box = trimesh.creation.box([0.5, 0.1, 0.1])
    bodies = [box.copy().apply_translation([0.25, 0, 0]) for _ in range(2)]
    bodies.append(trimesh.creation.icosphere(subdivisions=2, radius=0.2).apply_translation([0.7, 0.7, 0.05]))
    mesh = ccd.CollisionMesh.from_trimesh(
        bodies,
        rigid=[0, 1],
        static=[2],
        self_collision=False,
        body_pairs=np.array([[0, 0, 1], [0, 0, 1], [1, 1, 0]], dtype=bool),
    )
    joints = [
        ccd.Joint("turn", "base", "arm", "revolute", (0, 0, 1)),
        ccd.Joint("bend", "arm", "hand", "revolute", (0, 1, 0), (0.5, 0, 0, 0, 0, 0, 1)),
    ]
    end = [[1.0, 0.2], [0.5, -0.5], [0.4, 1.5]]
    motion = ccd.JointMotion(joints, np.zeros((3, 2)), end, links=["arm", "hand"])
    return ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices, motion=motion, **options)


def searches_with_radii(case: StepCase, precision: str, device: str = "cpu") -> Outputs:
    """The searches that a mesh with radii has of its own, one of which culls where it finds."""
    mesh, start, end = case.make()
    of_search = {"broad_phase": case.options["broad_phase"]}
    found = outputs_of(ccd.find_candidates(mesh, start, end, device=device, **of_search), "find_candidates")
    pipeline = ccd.CollisionPipeline(mesh, precision=precision, device=device, **case.options)
    return found | _with_little_capacity(pipeline, *(_on_device(x, "float64", device) for x in (start, end)))


def _with_little_capacity(pipeline: ccd.CollisionPipeline, t0: wp.array, t1: wp.array) -> Outputs:
    """How many pairs a launch finds that has so little capacity that candidates are searched for again, and culled.

    Which of them find a place depends on the order of threads.
    """
    pipeline.reserve(max_pairs=20)
    return outputs_of({"num_pairs": pipeline.launch(t0, t1).num_pairs}, "launch with little capacity")


def line_searches(case: StepCase, precision: str, device: str = "cpu") -> Outputs:
    """The line search on the host, whose fractions are those of the scene, of worlds, bodies and vertices."""
    mesh, start, end = case.make()
    options = {**case.options, "precision": precision, "device": device}
    options.pop("t_max", None)
    found: Outputs = {}
    for per in EVERY_PER:
        found |= outputs_of(ccd.line_search(mesh, start, end, per=per, **options), f"line_search {per}")
    return found


# What a memory limit divides, with all options of a step, or with those of a search alone.
_DIVIDED: dict[str, Callable[[ccd.CollisionPipeline, np.ndarray, np.ndarray], Any]] = {
    "mesh_ccd": lambda pipeline, start, end: pipeline.mesh_ccd(start, end),
    "collision_free_step": lambda pipeline, start, end: pipeline.collision_free_step(start, end),
    "is_step_collision_free": lambda pipeline, start, end: pipeline.is_step_collision_free(start, end),
}
_DIVIDED_SEARCHES: dict[str, Callable[[ccd.CollisionPipeline, np.ndarray, np.ndarray], Any]] = {
    "find_candidates": lambda pipeline, start, end: pipeline.find_candidates(start, end, 0.02),
    "find_intersections": lambda pipeline, start, end: pipeline.find_intersections(end),
    "find_proximity": lambda pipeline, start, end: _rows(pipeline.find_proximity(end, 0.03)),
    "displacement_bounds": lambda pipeline, start, end: pipeline.displacement_bounds(end, 0.03),
}


def batches(
    case: StepCase, precision: str, device: str = "cpu", *, is_limited: bool = True, with_order: bool = False
) -> Outputs:
    """The calls on the host with as little memory as they can do with, and with twice that; or with enough.

    The order of candidates may be compared between calls on the CPU; a GPU has its own.
    """
    mesh, start, end = case.make()
    options = {**case.options, "precision": precision, "device": device}
    of_search = {"device": device} | {name: case.options[name] for name in _OF_SEARCH if name in case.options}
    found: Outputs = {}
    for name, call in {**_DIVIDED, **_DIVIDED_SEARCHES}.items():
        least = 1
        for size in ("the least memory", "twice that"):
            while True:
                limit = {"memory_limit": least if size == "the least memory" else 2 * least} if is_limited else {}
                pipeline = ccd.CollisionPipeline(mesh, **(options if name in _DIVIDED else of_search), **limit)
                try:
                    result = call(pipeline, start, end)
                    found |= outputs_of(result, f"{name} in {size}")
                    if with_order and isinstance(result, ccd.Candidates):
                        found |= outputs_of(vars(result), f"order in {size}")
                    break
                except ValueError as error:  # each device counts by itself what it needs
                    least = int(re.search(r"at least (\d+)", str(error))[1])  # type: ignore[index]
    return found


def launches(case: StepCase, precision: str, device: str = "cpu") -> Outputs:
    """The launches on the device, with positions of both types: whole, as displacements, of moving vertices alone."""
    mesh, start, end = case.make()
    pipeline = ccd.CollisionPipeline(mesh, precision=precision, device=device, **case.capacities, **case.options)
    found: Outputs = {}
    # both where both precisions are asked for; elsewhere positions have that of the solver
    for dtype in ("float64", "float32") if case.is_thorough else (precision,):
        t0, t1, moves = (_on_device(x, dtype, device) for x in (start, end, end - start))
        found |= outputs_of(pipeline.launch(t0, t1), f"launch {dtype}")
        found |= outputs_of(pipeline.launch(t0, displacements=moves), f"launch of displacements {dtype}")
        # a static body that is moved, and stays there
        moved = _on_device(start + 0.01, dtype, device)
        found |= outputs_of(pipeline.launch(moved, _on_device(end + 0.01, dtype, device)), f"launch elsewhere {dtype}")
        own0, own1 = (_on_device(x[mesh.moving_vertices], dtype, device) for x in (start, end))
        found |= outputs_of(pipeline.launch(own0, t1), f"launch of moving vertices to where all are {dtype}")
        result = pipeline.launch(own0, own1)
        found |= outputs_of(result, f"launch of moving vertices {dtype}")
        found |= outputs_of(_points_at(result.contacts, t0, t1), f"points_at {dtype}")
        found |= outputs_of(result.to_host(), f"to_host {dtype}")
    pipeline.reserve(vertices=end)
    return found | outputs_of(
        pipeline.launch(_on_device(start, "float64", device), _on_device(end, "float64", device)), "laid out anew"
    )


def gradients(case: StepCase, precision: str, device: str = "cpu") -> Outputs:
    """Gradients of a launch and of a line search on a tape by both ends and radii, for positions of both types."""
    mesh, start, end = case.make()
    found: Outputs = {}
    for dtype, per in (("float64", "body"), ("float32", "vertex")):
        pipeline = ccd.CollisionPipeline(mesh, **case.options, **case.capacities, precision=precision, device=device)
        t0, t1 = (_on_device(x, dtype, device) for x in (start, end))
        given = {"t0": t0, "t1": t1} | ({} if pipeline.radius is None else {"radius": pipeline.radius})
        for array in given.values():
            array.requires_grad = True
        tape = wp.Tape()
        with tape:
            result = pipeline.launch(t0, t1)
        for k, array in enumerate((result.vertex_toi, result.body_toi, result.world_toi, result.toi)):
            array.grad.assign(np.cos(np.arange(len(array)) + k))
        tape.backward()
        flags = {f"is_regular {of}": result.is_regular(of).numpy() for of in ("scene", "world", "body", "vertex")}
        found |= outputs_of({name: array.grad.numpy() for name, array in given.items()} | flags, f"gradients {dtype}")
        tape = wp.Tape()
        with tape:
            result = pipeline.launch_line_search(t0, t1, per=per)
        tape.zero()
        t1.grad.assign(np.cos(np.arange(t1.numpy().size)).reshape(t1.numpy().shape))
        tape.backward()
        flags = {"is_regular": result.is_regular().numpy()}
        found |= outputs_of({name: array.grad.numpy() for name, array in given.items()} | flags, f"search {dtype}")
    return found


def launched_line_searches(case: StepCase, precision: str, device: str = "cpu") -> Outputs:
    """The line searches on the device, with the positions that they leave."""
    mesh, start, end = case.make()
    options = {name: value for name, value in case.options.items() if name != "t_max"}
    pipeline = ccd.CollisionPipeline(mesh, precision=precision, device=device, **case.capacities, **options)
    found: Outputs = {}
    for k, per in enumerate(EVERY_PER):
        for dtype in ("float64", "float32") if case.is_thorough else (("float64", "float32")[k % 2],):
            t0, t1 = _on_device(start, dtype, device), _on_device(end, dtype, device)
            result = pipeline.launch_line_search(t0, t1, per=per, num_rounds=5)
            found |= outputs_of(result, f"launch_line_search {per} {dtype}")
            found |= outputs_of(t1, f"launch_line_search {per} {dtype} positions")
    return found


def at_one_time(case: StepCase, precision: str, device: str = "cpu") -> Outputs:
    """What is near, and how far vertices may move, on the host and in launches, also of static bodies that moved."""
    mesh, start, end = case.make()
    of_search = {name: case.options[name] for name in ("broad_phase", "num_threads") if name in case.options}
    pipeline = ccd.CollisionPipeline(mesh, device=device, **case.capacities, **of_search)
    found: Outputs = {}
    for k, (positions, distance) in enumerate(((start, 0.03), (end, 0.03), (start, 0.08))):
        found |= outputs_of(_rows(pipeline.find_proximity(positions, distance)), f"find_proximity {k}")
        found |= outputs_of(pipeline.displacement_bounds(positions, distance), f"displacement_bounds {k}")
        array = _on_device(positions + 0.01 * k, precision, device)
        result = pipeline.launch_proximity(array, distance)
        found |= outputs_of([result.flags.numpy()[0], result.count.numpy()[0]], f"launch_proximity {k} counts")
        found |= outputs_of(_rows(result.to_host()), f"launch_proximity {k}")
        pairs = np.column_stack([result.kind.numpy(), result.primitives.numpy()])[result.unique().numpy()]
        found |= outputs_of(pairs[np.lexsort(pairs.T[::-1])], f"launch_proximity {k} unique")
        found |= outputs_of(pipeline.launch_displacement_bounds(array, distance).bounds, f"launched bounds {k}")
    return found


def replays(case: StepCase, precision: str, device: str = "cpu", *, is_captured: bool = True) -> Outputs:
    """Launches that a graph holds, replayed with other positions in the same arrays; or the launches themselves."""
    mesh, start, end = case.make()
    options = {name: value for name, value in case.options.items() if name != "t_max"}
    options |= {"precision": precision, "device": device, **case.capacities}
    # what a pipeline launches shares its results
    pipeline, searcher = (ccd.CollisionPipeline(mesh, **options) for _ in range(2))
    of_search = {name: case.options[name] for name in ("broad_phase", "num_threads") if name in case.options}
    finder = ccd.CollisionPipeline(mesh, device=device, **case.capacities, **of_search)
    pipeline.reserve()
    searcher.reserve()
    t0, t1, shortened = (_on_device(x, "float64", device) for x in (start, end, end))

    def launch() -> tuple[Any, ...]:
        result = pipeline.launch(t0, t1)
        of_contacts = {name: getattr(result.contacts, name) for name in ("points", "vertices", "bodies", "world")}
        of_contacts["points at"] = result.contacts.points_at(t0, shortened)
        order = result.contacts.order_by_toi()
        near, bounds = finder.launch_proximity(t1, 0.03), finder.launch_displacement_bounds(t1, 0.03)
        searched = searcher.launch_line_search(t0, shortened, per="world")
        return result, of_contacts, order, near, bounds, searched

    launched = launch()
    if is_captured:
        with wp.ScopedCapture(device=device) as capture:
            launched = launch()
    found: Outputs = {}
    for k, share in enumerate((1.0, 0.3, 0.0)):
        for array in (t1, shortened):
            array.assign(start + share * (end - start))
        if is_captured:
            wp.capture_launch(capture.graph)
        else:
            launched = launch()
        result, of_contacts, order, near, bounds, searched = launched
        first = order.numpy()[: result.contacts.count.numpy()[0]]
        found |= {f"replay {k} {name}": array.numpy()[first] for name, array in of_contacts.items()}
        found |= outputs_of(result, f"replay {k}") | outputs_of(searched, f"replay {k} of a line search")
        found |= outputs_of(_rows(near.to_host()), f"replay {k} near") | outputs_of(bounds.bounds, f"replay {k} bounds")
        found |= outputs_of(shortened, f"replay {k} positions")
    return found


def few_pairs(case: StepCase, precision: str, device: str = "cpu") -> Outputs:
    """Launches whose capacity is too small: what is certain of them whatever the order of the threads.

    Which pairs find no place depends on the order; that the flag is set, that all pairs are counted, and that no toi is
    late, does not. Contacts that find no place leave every toi as it is.
    """
    mesh, start, end = case.make()
    options = {**case.options, "precision": precision}
    expected = ccd.mesh_ccd(mesh, start, end, device="cpu", **options).vertex_toi
    t0, t1 = (_on_device(x, "float64", device) for x in (start, end))
    pipeline = ccd.CollisionPipeline(mesh, device=device, **{**case.capacities, "max_pairs": 4}, **options)
    result = pipeline.launch(t0, t1)
    found = outputs_of({"flags": result.flags, "num_pairs": result.num_pairs}, "launch with few pairs")
    found |= outputs_of((result.vertex_toi.numpy() > expected).any(), "is late")
    pipeline = ccd.CollisionPipeline(mesh, device=device, **{**case.capacities, "max_contacts": 2}, **options)
    result = pipeline.launch(t0, t1)
    return found | outputs_of({"flags": result.flags, "toi": result.vertex_toi}, "launch with few contacts")


def not_a_number(case: StepCase, precision: str, device: str = "cpu") -> Outputs:
    """A launch in which a coordinate is not a number; contacts are undefined there."""
    mesh, start, end = case.make()
    pipeline = ccd.CollisionPipeline(mesh, precision=precision, device=device, **case.capacities, **case.options)
    end = end.copy()
    end[mesh.moving_vertices[3], 0] = np.nan
    result = pipeline.launch(_on_device(start, "float64", device), _on_device(end, "float64", device))
    return {name: array for name, array in outputs_of(result, "launch").items() if ".contacts" not in name}


def pairs(
    kind: str, start: np.ndarray, end: np.ndarray, precision: str, options: dict[str, Any], device: str = "cpu"
) -> Outputs:
    """The pair function of a kind, with arrays of NumPy, few and many, and of Warp, with a coordinate that is none."""
    call = getattr(ccd, f"{kind}_ccd")
    options = {**options, "precision": precision, "device": device}
    found = outputs_of(call(start, end, **options), "many") | outputs_of(call(start[:3], end[:3], **options), "few")
    start, end = start.copy(), end.copy()
    start[-2, 0, 0], end[-1, -1, -1] = np.nan, np.inf
    dtype = VECTORS["float64", start.shape[2]]
    has_gradient = "start_gap_fraction" not in options
    ends = [wp.array(x, dtype=dtype, device=device, requires_grad=has_gradient) for x in (start, end)]
    tape = wp.Tape()
    with tape:
        result = call(*ends, **options)
    found |= outputs_of(result, "of Warp") | outputs_of(result.hit, "hit")
    if has_gradient:
        result.toi.grad.fill_(1.0)
        tape.backward()
        found |= outputs_of({f"t{k}": end.grad.numpy() for k, end in enumerate(ends)}, "gradients")
    return found


def _rows(proximities: ccd.Proximities) -> dict[str, np.ndarray]:
    names = ("kind", "primitives", "parameters", "distance", "direction", "features", "points")
    return {name: getattr(proximities, name) for name in names}


def _points_at(contacts: ccd.DeviceContacts, t0: wp.array, t1: wp.array) -> np.ndarray:
    """Points of the contacts in another step, in the order of `Contacts`."""
    count = min(int(contacts.count.numpy()[0]), len(contacts.kind))
    pairs = np.column_stack([contacts.kind.numpy(), contacts.primitives.numpy()])[:count]
    return contacts.points_at(t0, t1).numpy()[:count][np.lexsort(pairs.T[::-1])]


def _on_device(positions: np.ndarray, dtype: str, device: str) -> wp.array:
    vector = VECTORS[dtype, positions.shape[1]]
    return wp.array(np.ascontiguousarray(positions, dtype=dtype), dtype=vector, device=device)
