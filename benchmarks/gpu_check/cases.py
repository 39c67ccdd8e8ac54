"""What is asked of the device and of the CPU alike: every public call with every option, on scenes made by code.

A case is a name and a function of a device that returns arrays by name; the same arrays are expected of every device.
The calls are those of the tests of the emulated device (`calls`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import numpy as np
from ccd_warp.benchmarks.gpu_check.broad_phases import OPTION, choices
from ccd_warp.benchmarks.gpu_check.steps import all_steps
from hard_cases import FAMILIES
from laws import calls
from laws.outputs import Outputs

PRECISIONS = ("float64", "float32")
KINDS = ("vertex_face", "edge_edge", "point_segment", "point_point")
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
_CAPACITY, _SHORT_CAPACITY = 1 << 19, 1 << 15


@dataclass(frozen=True)
class Case:
    """A call to compare.

    Attributes:
        name: What is called on what.
        call: Called with the name of a device.
        make_inputs: Makes the arrays that the call is of, which other versions of NumPy may make in other bits.
    """

    name: str
    call: Callable[[str], Outputs]
    make_inputs: Callable[[], tuple[np.ndarray, ...]]

    @property
    def inputs(self) -> Outputs:
        """The arrays that the call is of."""
        return {str(k): array for k, array in enumerate(self.make_inputs())}


@cache
def pair_points(kind: str, count: int, dimension: int) -> tuple[np.ndarray, np.ndarray]:
    """Points of pairs of a kind at both ends of a step, of families from the plain case to the exactly degenerate."""
    rng = np.random.default_rng(11)
    names = ("random", "random_colliding", "cloth_like", "static_partner", "lattice", "collinear")
    parts = [FAMILIES[name](kind.replace("_", "-"), -(-count // len(names)), rng, dimension) for name in names]
    start, end = (np.concatenate(x) for x in zip(*parts, strict=True))
    return start, end


def pair_cases(is_short: bool) -> Iterator[Case]:
    """Every pair function with every option, in both precisions."""
    count = 120 if is_short else 20_000
    for precision in PRECISIONS:
        for kind in KINDS:
            dimensions = (3,) if kind in ("vertex_face", "edge_edge") else (2, 3)
            for name, options in _OPTIONS.items():
                dimension = dimensions[len(name) % len(dimensions)]
                points = partial(pair_points, kind, count // 20 if name == "bisection" else count, dimension)
                call = partial(calls.pairs, kind, *points(), precision, options)
                yield Case(f"{kind} in {dimension}D, {name}, {precision}", call, points)


def mesh_options(is_short: bool) -> dict[str, dict[str, Any]]:
    """The options that a mesh may have, its own among them."""
    return {
        **_OPTIONS,
        "little work": {"max_work": 500},
        "one kind": {"pair_kinds": ["vertex_face"]},
        "little memory": {"memory_limit": 1 << (21 if is_short else 24)},
        **{f"the {name}": {OPTION: name} for name in choices()[1:]},
    }


def calls_on(step: str, is_short: bool) -> Iterator[tuple[str, str, str, dict[str, Any]]]:
    """Call, precision, and options with their name, of what is asked of a step."""
    others = {f"the {name}": {OPTION: name} for name in choices()[1:]}  # broad phases beside the first
    for precision in PRECISIONS:
        for name, options in mesh_options(is_short).items():
            if name == "defaults" or step == "crowd" or (name != "bisection" and precision == "float64"):
                yield "steps", precision, name, options
        for call in ("launches", "line_searches", "launched_line_searches"):
            yield call, precision, "defaults", {}
    for name, options in {"defaults": {}, **others}.items():
        yield "searches", "float64", name, options
        if step == "crowd" or not is_short:
            yield "at_one_time", "float64", name, options
    for name, options in others.items():
        yield "launches", "float64", name, options
    for call in ("few_pairs", "not_a_number"):
        yield call, "float64", "defaults", {}


def mesh_cases(is_short: bool) -> Iterator[Case]:
    """Every call that takes a mesh, with every option, in both precisions."""
    for step, make in all_steps(is_short).items():

        def arrays(make: Callable[[], calls.Made] = make) -> tuple[np.ndarray, ...]:
            mesh, start, end = make()
            return start, end, mesh.vertices, mesh.edges, mesh.faces

        for call, precision, name, options in calls_on(step, is_short):
            case = calls.StepCase(make, options, _SHORT_CAPACITY if is_short else _CAPACITY, is_thorough=True)
            yield Case(f"{call}, {step}, {name}, {precision}", partial(getattr(calls, call), case, precision), arrays)


def all_cases(is_short: bool) -> Iterator[Case]:
    """All cases."""
    yield from pair_cases(is_short)
    yield from mesh_cases(is_short)
