"""Every public call with every option on scenes made by code: what is asked of the device and of the CPU alike.

A case is a name and a function of a device that returns arrays by name; the same arrays are expected of every device.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import numpy as np
import warp as wp
from ccd_warp.benchmarks.gpu_check.broad_phases import OPTION, choices
from ccd_warp.benchmarks.gpu_check.steps import Step, all_steps
from ccd_warp.benchmarks.hard_cases import FAMILIES

import ccd_warp as ccd

Arrays = dict[str, np.ndarray]
PRECISIONS = ("float64", "float32")
PER = ("scene", "world", "body", "vertex")
PAIRS = {
    "vertex-face": ccd.vertex_face_ccd,
    "edge-edge": ccd.edge_edge_ccd,
    "point-segment": ccd.point_segment_ccd,
    "point-point": ccd.point_point_ccd,
}
# Options of all calls that compute a toi, each unlike its default in one respect.
_OPTIONS: dict[str, dict[str, Any]] = {
    "defaults": {},
    "tolerance": {"tolerance": 1e-3},
    "separation": {"minimum_separation": 1e-3},
    "start gap": {"minimum_separation": 1e-2, "start_gap_fraction": 0.5},
    "half a step": {"t_max": 0.5},
    "few iterations": {"max_iterations": 6},
    "length scale": {"length_scale": 3.0},
    "bisection": {"method": "bisection", "max_iterations": 3000},
}


@dataclass(frozen=True)
class Case:
    """A call to compare.

    Attributes:
        name: What is called on what.
        call: Called with the name of a device.
    """

    name: str
    call: Callable[[str], Arrays]

    @property
    def inputs(self) -> Arrays:
        """The arrays that the call is of, which other versions of NumPy may make in other bits."""
        arrays: Arrays = {}
        for k, value in enumerate(self.call.args):  # type: ignore[attr-defined]
            if isinstance(value, Step):
                value = (value.start, value.end, value.mesh.vertices, value.mesh.edges, value.mesh.faces)
            parts = value if isinstance(value, tuple) else ()
            arrays |= {f"{k} {n}": part for n, part in enumerate(parts) if isinstance(part, np.ndarray)}
        return arrays


# --- pairs ---


@cache
def pair_points(kind: str, count: int, dimension: int) -> tuple[np.ndarray, np.ndarray]:
    """Points of pairs of a kind at both ends of a step, of families from the plain case to the exactly degenerate."""
    rng = np.random.default_rng(11)
    names = ("random", "random_colliding", "cloth_like", "static_partner", "lattice", "collinear")
    parts = [FAMILIES[name](kind, -(-count // len(names)), rng, dimension) for name in names]
    start, end = (np.concatenate(x) for x in zip(*parts, strict=True))
    return start, end


def solve_pairs(kind: str, points: tuple, on_device: bool, options: dict[str, Any], device: str) -> Arrays:
    """A pair function, of arrays of NumPy or of the device."""
    if on_device:
        dtype = wp.vec3d if points[0].shape[2] == 3 else wp.vec2d
        points = tuple(wp.array(x, dtype=dtype, device=device) for x in points)
    result = PAIRS[kind](*points, device=device, **options)
    names = ("toi", "status", "parameters", "gap", "width", "iterations", "hit")
    return {name: host(getattr(result, name)) for name in names}


def pair_cases(is_short: bool) -> Iterator[Case]:
    """Every pair function with every option, in both precisions."""
    count = 120 if is_short else 20_000
    for precision in PRECISIONS:
        for kind in PAIRS:
            dimensions = (3,) if kind in ("vertex-face", "edge-edge") else (2, 3)
            for name, options in _OPTIONS.items():
                dimension = dimensions[len(name) % len(dimensions)]
                points = pair_points(kind, count // 20 if name == "bisection" else count, dimension)
                call = partial(solve_pairs, kind, points, name != "defaults", {**options, "precision": precision})
                yield Case(f"{kind} in {dimension}D, {name}, {precision}", call)


# --- meshes ---


def host(values: Any) -> np.ndarray:
    """An array of the device as one of NumPy."""
    return values.numpy() if isinstance(values, wp.array) else np.asarray(values)


def contact_arrays(contacts: Any) -> Arrays:
    """Contacts with all that they are asked for."""
    names = ("kind", "primitives", "toi", "parameters", "normal", "status", "gap", "width", "points", "vertices")
    return {f"contacts.{name}": np.asarray(getattr(contacts, name)) for name in (*names, "bodies", "world")}


def on_host(step: Step, options: dict[str, Any], device: str) -> Arrays:
    """The calls that give NumPy arrays."""
    pipeline = ccd.CollisionPipeline(step.mesh, device=device, **options)
    result = pipeline.mesh_ccd(step.start, step.end)
    names = ("toi", "vertex_toi", "body_toi", "world_toi", "vertex_contact", "body_contact")
    arrays = {name: np.asarray(getattr(result, name)) for name in names} | contact_arrays(result.contacts)
    arrays["collision_free_step"] = np.float64(pipeline.collision_free_step(step.start, step.end))
    arrays["is_step_collision_free"] = np.bool_(pipeline.is_step_collision_free(step.start, step.end))
    return arrays


def candidates(step: Step, inflation: float, options: dict[str, Any], device: str) -> Arrays:
    """The candidates of a step, in order."""
    frames = (step.start, step.end)
    found = ccd.find_candidates(step.mesh, *frames, inflation=inflation, device=device, **options).sorted()
    kinds = ("vertex_face", "edge_edge", "point_segment", "point_point", "vertex_plane")
    return {kind: np.asarray(getattr(found, kind)) for kind in kinds if getattr(found, kind, None) is not None}


def line_search(step: Step, per: str, precision: str, device: str) -> Arrays:
    """The line search that gives NumPy arrays."""
    found = ccd.line_search(step.mesh, step.start, step.end, per=per, precision=precision, device=device)  # type: ignore[arg-type]
    return {name: np.asarray(value) for name, value in vars(found).items() if isinstance(value, (np.ndarray, float))}


def positions(step: Step, real: Any, device: str) -> tuple[wp.array, wp.array]:
    """Positions on the device."""
    vectors = {2: {np.float32: wp.vec2f, np.float64: wp.vec2d}, 3: {np.float32: wp.vec3f, np.float64: wp.vec3d}}
    dtype = vectors[step.start.shape[1]][real]
    start, end = (wp.array(np.asarray(x, dtype=real), dtype=dtype, device=device) for x in (step.start, step.end))
    return start, end


def launched(result: ccd.LaunchResult, *, with_contacts: bool = True) -> Arrays:
    """The arrays of a launch; its contacts as they are copied to the host, and as the device computes them."""
    names = ("toi", "vertex_toi", "body_toi", "world_toi", "flags", "world_flags", "num_pairs")
    arrays = {name: host(getattr(result, name)) for name in names}
    if not with_contacts:
        return arrays
    contacts = result.contacts
    count = int(host(contacts.count)[0])
    kind, primitives = host(contacts.kind)[:count], host(contacts.primitives)[:count]
    order = np.lexsort((*primitives.T[::-1], kind))  # that of the list depends on the threads
    for name in ("points", "vertices", "bodies", "world"):
        arrays[f"device contacts.{name}"] = host(getattr(contacts, name))[:count][order]
    earliest = host(contacts.order_by_toi())[:count]
    arrays["device contacts.toi in order"] = host(contacts.toi)[:count][earliest]
    return arrays | contact_arrays(result.to_host().contacts)


def launch(step: Step, real: Any, options: dict[str, Any], how: str, device: str) -> Arrays:
    """A launch: of positions, or as ``how`` says."""
    pipeline = ccd.CollisionPipeline(step.mesh, device=device, **step.capacities, **options)
    pipeline.reserve(vertices=step.start)
    start, end = positions(step, real, device)
    if how == "displacements":
        moved = Step(step.name, step.mesh, step.start, step.end - step.start)
        return launched(pipeline.launch(start, displacements=positions(moved, real, device)[1]))
    if how == "static body moved":
        pipeline.launch(start, end)
        is_static = np.asarray(step.mesh.static)[step.mesh.vertex_body]
        shift = 0.01 * is_static[:, None]
        moved = Step(step.name, step.mesh, step.start + shift, step.end + shift)
        return launched(pipeline.launch(*positions(moved, real, device)))
    if how == "not a number":
        lost = step.end.copy()
        lost[step.mesh.moving_vertices[3], 0] = np.nan
        lost_step = Step(step.name, step.mesh, step.start, lost)
        return launched(pipeline.launch(*positions(lost_step, real, device)), with_contacts=False)
    return launched(pipeline.launch(start, end))


def overflow(step: Step, device: str) -> Arrays:
    """Launches with a capacity that is too small: what is certain of them whatever the order of the threads.

    Which pairs find no place depends on the order; that the flag is set, that all pairs are counted, and that no toi is
    late, does not. Contacts that find no place leave every toi as it is.
    """
    expected = ccd.mesh_ccd(step.mesh, step.start, step.end, device="cpu")
    frames = positions(step, np.float64, device)
    few_pairs = {**step.capacities, "max_pairs": 4}
    result = ccd.CollisionPipeline(step.mesh, device=device, **few_pairs).launch(*frames)
    arrays = {
        "flags of few pairs": host(result.flags),
        "num_pairs": host(result.num_pairs),
        "is late": np.array([(host(result.vertex_toi) > expected.vertex_toi).any()]),
    }
    few_contacts = {**step.capacities, "max_contacts": 2}
    result = ccd.CollisionPipeline(step.mesh, device=device, **few_contacts).launch(*frames)
    return arrays | {"flags of few contacts": host(result.flags), "vertex_toi": host(result.vertex_toi)}


def launch_line_search(step: Step, per: str, real: Any, device: str) -> Arrays:
    """The line search on the device, in place."""
    pipeline = ccd.CollisionPipeline(step.mesh, device=device, **step.capacities)
    start, end = positions(step, real, device)
    result = pipeline.launch_line_search(start, end, per=per)  # type: ignore[arg-type]
    return {"vertices_t1": host(end), "world_toi": host(result.world_toi), "flags": host(result.flags)}


def at_one_time(step: Step, options: dict[str, Any], device: str) -> Arrays:
    """What is near at the start, and how far vertices may move, on the host and by launches."""
    pipeline = ccd.CollisionPipeline(step.mesh, device=device, **step.capacities, **options)
    distance = 0.02 * float(np.ptp(step.start, axis=0).max())
    start = positions(step, np.float64, device)[0]
    names = ("kind", "primitives", "parameters", "distance", "direction", "features", "points")
    arrays = {"bounds": np.asarray(pipeline.displacement_bounds(step.start, distance))}
    arrays["launched bounds"] = pipeline.launch_displacement_bounds(start, distance).to_host()
    result = pipeline.launch_proximity(start, distance)
    arrays["flags"] = host(result.flags)
    for label, found in (("near", pipeline.find_proximity(step.start, distance)), ("launched", result.to_host())):
        arrays |= {f"{label}.{name}": np.asarray(getattr(found, name)) for name in names}
    return arrays


def mesh_options(is_short: bool) -> dict[str, dict[str, Any]]:
    """The options that a mesh may have, its own among them."""
    return {
        **_OPTIONS,
        "little work": {"max_work": 500},
        "one kind": {"pair_kinds": ["vertex_face"]},
        "little memory": {"memory_limit": 1 << (21 if is_short else 24)},
        **{f"the {name}": {OPTION: name} for name in choices()[1:]},
    }


def mesh_cases(is_short: bool) -> Iterator[Case]:
    """Every call that takes a mesh, with every option, in both precisions."""
    others = [{OPTION: name} for name in choices()[1:]]  # broad phases beside the first
    for step in all_steps(is_short):
        for inflation, options in [(0.0, {}), (0.01, {}), *((0.0, other) for other in others)]:
            name = f"find_candidates, {step.name}, inflation {inflation}{''.join(f', {x}' for x in options.values())}"
            yield Case(name, partial(candidates, step, inflation, options))
        for options in ({}, *others) if step.name == "crowd" or not is_short else ():
            name = f"find_proximity and displacement_bounds, {step.name}{''.join(f', {x}' for x in options.values())}"
            yield Case(name, partial(at_one_time, step, options))
        for other in others:
            name = f"launch, {step.name}, {other[OPTION]}"
            yield Case(name, partial(launch, step, np.float64, other, "positions"))
        for precision in PRECISIONS:
            for name, options in mesh_options(is_short).items():
                if name != "defaults" and (name == "bisection" or precision == "float32") and step.name != "crowd":
                    continue
                call = partial(on_host, step, {**options, "precision": precision})
                yield Case(f"mesh_ccd and steps, {step.name}, {name}, {precision}", call)
            options = {"precision": precision}
            for real in (np.float64, np.float32):
                call = partial(launch, step, real, options, "positions")
                yield Case(f"launch, {step.name}, {precision}, {real.__name__} arrays", call)
            for per in PER:
                call = partial(line_search, step, per, precision)
                yield Case(f"line_search per {per}, {step.name}, {precision}", call)
        for how in ("displacements", "static body moved", "not a number"):
            yield Case(f"launch, {step.name}, {how}", partial(launch, step, np.float64, {}, how))
        yield Case(f"launch, {step.name}, capacities too small", partial(overflow, step))
        for per in PER:
            for real in (np.float64, np.float32):
                call = partial(launch_line_search, step, per, real)
                yield Case(f"launch_line_search per {per}, {step.name}, {real.__name__} arrays", call)


def all_cases(is_short: bool) -> Iterator[Case]:
    """All cases."""
    yield from pair_cases(is_short)
    yield from mesh_cases(is_short)
