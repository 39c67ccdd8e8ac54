"""The same calls on the CPU and on the emulated device, and whether they return the same bits."""

import hashlib
import os
import pickle
from collections import Counter
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import scenes
from ccd_warp.benchmarks.cuda_modules import cuda_modules
from laws import calls
from laws.outputs import Outputs, different

from emulated.device import Emulation, emulation
from emulated.steps import STEPS, THICK

PRECISIONS = ("float64", "float32")
# The folder in which processes keep the answers of the CPU for each other, as those of `planted` do, which launch few
# kernels; every module is then compiled when it is first launched.
_KEPT = os.environ.get("CCD_WARP_KEPT_ANSWERS")


def answer_of_cpu(case: object, call: Callable[[], Outputs]) -> Outputs:
    """What a call returns on the CPU, or has returned there in another process."""
    if not _KEPT:
        return call()
    path = Path(_KEPT, hashlib.sha256(repr(case).encode()).hexdigest())
    if not path.exists():
        path.write_bytes(pickle.dumps(call()))
    answer: Outputs = pickle.loads(path.read_bytes())
    return answer


# Scenes for what takes longer, and for both precisions: with worlds, bodies and every kind of pair.
_SOME = ("crowd", "every kind, one body static", "in the plane, one body static", "worlds in one place")
_PLAN = {
    "on_the_host": tuple(step for step in STEPS if step != "trees of four levels"),
    "launches": tuple(STEPS),
    "batches": ("crowd", "excluded pairs", "in the plane"),
    "line_searches": _SOME,
    "launched_line_searches": (*_SOME, "half-spaces", "kinematic bodies", "little work"),
    "at_one_time": (
        *("worlds in one place", "excluded pairs", "spatial hash", "half-spaces", "kinematic bodies"),
        "vertices of no face",
    ),
    "replays": ("sheet over a static ball", "worlds", "spatial hash"),
    "with_radii": ("radii",),
    "gradients": ("every kind, one body static", "in the plane, one body static", "radii"),
    "line_searches_with_radii": ("radii",),
    "searches_with_radii": ("radii, spatial hash, excluded pairs",),
    "on_arcs": ("bodies that turn", "bodies that turn, a distance"),
}
# Steps of the other calls that another of them has, or a kernel does not need: they are run with what is marked long.
_LONG = {
    "batches": ("crowd",),
    "line_searches": ("every kind, one body static", "worlds in one place"),
    "launched_line_searches": ("crowd", "little work"),
    "at_one_time": ("kinematic bodies",),
    "replays": ("sheet over a static ball",),
}
# Steps that every run has in both calls; of the last one the host alone looks which bodies are near.
_OF_BOTH = ("every kind, one body static", "spatial hash", "bodies far apart")


def _plan() -> Iterator[tuple[tuple[str, str, str], bool]]:
    """A call, a step and a precision, and whether every run of the tests has it, not only what is marked long.

    Both precisions are planned for the calls that most others build on, by turns for the others. Every run has each
    step in one of these two calls, by turns, and in one precision, likewise; more where kernels need it.
    """
    more = [("launches", step) for step in ("in the plane", "spatial hash, excluded pairs", "trees of four levels")]
    more += [("launches", "needles side by side")]
    more += [(call, step) for call in ("on_the_host", "launches") for step in _OF_BOTH]
    for call, steps in _PLAN.items():
        for k, step in enumerate(steps):
            is_basic = call in ("on_the_host", "launches")
            by_turns = PRECISIONS[k % 2 if call != "on_arcs" else 0]
            if step == "every kind, one body static" and is_basic:
                by_turns = "float64"
            for precision in PRECISIONS if step in _SOME and is_basic else (by_turns,):
                has_turn = call == ("on_the_host", "launches")[k // 2 % 2] or (call, step) in more
                is_daily = precision == by_turns and (has_turn if is_basic else step not in _LONG.get(call, ()))
                is_daily |= (call, step) == ("launches", "in the plane, one body static")
                yield (call, step, precision), is_daily


_IS_DAILY = dict(_plan())
PLAN = list(_IS_DAILY)
DAILY = [case for case, is_daily in _IS_DAILY.items() if is_daily]
# What options of the pair functions do to a pair: where it ends, what counts as contact, how much is done.
PAIR_OPTIONS: dict[str, dict[str, Any]] = {
    "default": {},
    "separation": {"minimum_separation": 0.02, "start_gap_fraction": 0.5, "t_max": 0.6},
    "scale": {"length_scale": 2.0, "tolerance": 1e-3},
    "bisection": {"method": "bisection", "max_iterations": 500},
    "limit": {"max_iterations": 2},
}
PAIRS = [
    (kind, dimension, options, precision)
    for kind, dimensions in (
        ("vertex_face", [3]),
        ("edge_edge", [3]),
        ("point_segment", [2, 3]),
        ("point_point", [2, 3]),
    )
    for dimension in dimensions
    for k, options in enumerate(PAIR_OPTIONS)
    for precision in (PRECISIONS if k == 0 else (PRECISIONS[(k + dimension) % 2],))
]
# A distance has kernels of its own, which no mesh with radii runs, as points have none; in one precision.
PAIR_OPTIONS["distance"] = {"minimum_distance": 0.02, "t_max": 0.6}
PAIRS += [(kind, 3, "distance", "float64") for kind in ("vertex_face", "edge_edge")]
# Kernels of modules for CUDA that the CPU alone launches.
CPU_ALONE = {
    "sort_range": "a counting sort by threads of the CPU; CUDA takes Warp's radix sort",
    **dict.fromkeys(["fill_blocks", "refresh_blocks", "apply_order"], "a block in an item; CUDA takes a thread a box"),
    **dict.fromkeys(
        ["unite_blocks", "unite_levels", "refresh_levels"], "a box or all levels; CUDA takes a thread a row"
    ),
    "split_segments": "the order at rest by selection; CUDA sorts keys",
}
# Of modules for distances, ends of the names of those that are not run, and the ones that run what is theirs.
RUN_ELSEWHERE = {
    **dict.fromkeys(["float32 euclidean", "float32 arc_box", "float32 arc_ball"], "those of float64"),
    "own_box": "boxes are those of the maximum norm, and a separation of each pair is that of radii",
    **dict.fromkeys(["measure_pairs box", "near_contacts box"], "those of a ball, but for the distance of a pair"),
    "search_trees boxes True thick": "the spatial hash has radii with lists, the tree each of them alone",
    "search_trees cull True thick": "likewise",
    "search_hashes boxes False thick": "likewise, the other way round",
    "search_hashes cull False thick": "likewise",
}


class Comparison:
    """Runs calls on both devices, each once.

    Attributes:
        emulated: The emulated device.
        num_arrays: Arrays that were compared.
    """

    def __init__(self, is_sanitized: bool = False) -> None:
        self.emulated = Emulation(is_sanitized)
        self.num_arrays = 0
        self._found: dict[Any, list[str]] = {}
        self._is_built = _KEPT is not None

    def of_step(self, call: str, step: str, precision: str) -> list[str]:
        """What a call of `gpu_check.calls` does not return in the same bits."""
        return self._of((call, step, precision), getattr(calls, call), (STEPS | THICK)[step], precision)

    def of_pairs(self, kind: str, dimension: int, options: str, precision: str) -> list[str]:
        """What a pair function does not return in the same bits."""
        case = (kind, dimension, options, precision)
        points = scenes.random_pairs(kind, 300, seed=31, dimension=dimension)
        return self._of(case, calls.pairs, kind, *points, precision, PAIR_OPTIONS[options])

    def of_every_kernel(self) -> list[str]:
        """What any call that every run has does not return in the same bits."""
        lines = [f"{case}: {line}" for case in DAILY for line in self.of_step(*case)]
        return lines + [f"{case}: {line}" for case in PAIRS for line in self.of_pairs(*case)]

    def build(self) -> None:
        """Compile all modules at once."""
        if not self._is_built:
            self.emulated.build_all(cuda_modules().values())
        self._is_built = True

    def not_run(self) -> list[str]:
        """The kernels for CUDA that no call so far has launched, with the names of their modules."""
        return [
            f"{name}: {key}"
            for name, module in cuda_modules(with_distances=True).items()
            if not name.endswith(tuple(RUN_ELSEWHERE))
            for key in (kernel.key.split("__")[-1] for kernel in module.kernels.values())
            if key not in CPU_ALONE and not self._num_launches[module.name, key]
        ]

    @property
    def num_kernels(self) -> int:
        """Kernels that were launched."""
        return len(self._num_launches)

    @property
    def num_launches(self) -> int:
        """How often, in all."""
        return sum(self._num_launches.values())

    @property
    def _num_launches(self) -> Counter[tuple[str, str]]:
        counts: Counter[tuple[str, str]] = Counter()
        for (module, key), count in self.emulated.launches.items():
            counts[module, key.split("__")[-1]] += count
        return counts

    def _of(self, case: tuple[Any, ...], call: Any, *arguments: Any) -> list[str]:
        if case not in self._found:
            expected = answer_of_cpu(case, lambda: call(*arguments))
            self.build()
            with emulation(self.emulated):
                found = call(*arguments)
            self.num_arrays += len(found)
            self._found[case] = different(found, expected)
        return self._found[case]


@cache
def shared() -> Comparison:
    """The comparison of this process."""
    return Comparison()


def summary(comparison: Comparison) -> str:
    """What was run and compared, in a line."""
    return (
        f"emulated CUDA: {comparison.num_kernels} kernels launched {comparison.num_launches:,} times, "
        f"{comparison.num_arrays:,} arrays compared with those of the CPU"
    )
