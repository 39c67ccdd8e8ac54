"""The stages of the check, in their order, each with its share of the time."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ccd_warp.benchmarks.gpu_check import (
    against,
    bits,
    broad_phases,
    graphs,
    kernel_times,
    machine,
    modules,
    newton_cloth,
    queries,
    reserve,
    sanitizer,
    static_body,
)
from ccd_warp.benchmarks.gpu_check.record import Cases

# Tests with the fixture `device` have "cuda:0" in their names; the emulation and the compilation to PTX need no GPU.
_CHOSEN = "cuda and not emulated"
_WITHOUT = ("kernels/test_cuda.py", "benchmarks/test_cuda_code.py", "benchmarks/test_gpu_check.py")
_PROCESSES = 6


@dataclass(frozen=True)
class Stage:
    """A stage.

    Attributes:
        name: Its name in the file of records.
        about: What it does, for people.
        cases: Returns its cases; called with the target, and by keyword ``tests``, ``examples``, ``answers``.
        share: Its part of the time: seconds, where all stages together have eight minutes.
        least: Seconds without which none of its cases begins.
        needs_gpu: Whether it says nothing without a GPU.
        has_reference: Whether it compares with the CPU, and says itself when the device is the one that is checked.
        arguments: Of a stage that consists of tests of pytest, which arguments choose them.
    """

    name: str
    about: str
    cases: Callable[..., Cases]
    share: float
    least: float = 0.0
    needs_gpu: bool = False
    has_reference: bool = False
    arguments: Callable[..., list[str]] | None = None


def tests_on_cuda(*, tests: Path, **_: Any) -> list[str]:
    """Arguments of pytest for the tests of a checkout that run on the device, on several processes if it can."""
    several = ["-n", str(_PROCESSES)] if importlib.util.find_spec("xdist") else []
    return [str(tests), "-k", _CHOSEN, *(f"--ignore={tests / name}" for name in _WITHOUT), *several]


STAGES = (
    Stage("machine", "what it is", machine.cases, 10),
    Stage("modules", "load every kernel, compile what no cubin was made for", modules.cases, 70),
    Stage("tests", "the tests on the CUDA device", dict, 75, needs_gpu=True, arguments=tests_on_cuda),
    Stage("bits", "every call on the device against the CPU, bit by bit", bits.cases, 55, has_reference=True),
    Stage("graphs", "capture every kind of launch and replay it", graphs.cases, 45, has_reference=True),
    Stage("sanitizer", "compute-sanitizer on a small scene", sanitizer.cases, 35, 2.0, needs_gpu=True),
    Stage("kernels", "times of whole steps and of their kernels", kernel_times.cases, 50, 3.0),
    Stage("queries", "many queries, by threads a block", queries.cases, 40, 1.0),
    Stage("against", "the same steps on the CPU, and what newton has for them", against.cases, 20, 3.0),
    Stage("broad phases", "the tree and the hash", broad_phases.cases, 25, 3.0),
    Stage("reserve", "the time that reserve() takes", reserve.cases, 25, 2.0),
    Stage("static body", "launches that move a static body", static_body.cases, 10),
    Stage("newton", "newton's cloth", newton_cloth.cases, 20),
)
NAMES = tuple(stage.name for stage in STAGES)
