"""The stages of the check, in their order, each with its share of the time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

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
    suite,
)


@dataclass(frozen=True)
class Stage:
    """A stage.

    Attributes:
        name: Its name in the file of records.
        about: What it does, for people.
        run: Called with the target, the record, and by keyword ``tests``, ``examples``, ``answers``.
        share: Its part of the time: seconds, where all stages together have eight minutes.
        needs_gpu: Whether it says nothing without a GPU.
        has_reference: Whether it compares with the CPU, and says itself when the device is the one that is checked.
    """

    name: str
    about: str
    run: Callable[..., None]
    share: float
    needs_gpu: bool = False
    has_reference: bool = False


STAGES = (
    Stage("machine", "what it is", machine.run, 10),
    Stage("modules", "load every kernel, compile what no cubin was made for", modules.run, 70),
    Stage("tests", "the tests on the CUDA device", suite.run, 75, needs_gpu=True),
    Stage("bits", "every call on the device against the CPU, bit by bit", bits.run, 55, has_reference=True),
    Stage("graphs", "capture every kind of launch and replay it", graphs.run, 45, has_reference=True),
    Stage("sanitizer", "compute-sanitizer on a small scene", sanitizer.run, 35, needs_gpu=True),
    Stage("kernels", "times of whole steps and of their kernels", kernel_times.run, 50),
    Stage("queries", "many queries, by threads a block", queries.run, 40),
    Stage("against", "the same steps on the CPU, and what newton has for them", against.run, 20),
    Stage("broad phases", "the tree and the hash", broad_phases.run, 25),
    Stage("reserve", "the time that reserve() takes", reserve.run, 25),
    Stage("static body", "launches that move a static body", static_body.run, 10),
    Stage("newton", "newton's cloth", newton_cloth.run, 20),
)
NAMES = tuple(stage.name for stage in STAGES)
