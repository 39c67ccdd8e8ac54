"""What gradients of times of impact cost: launches and line searches on a tape, and their backward passes.

Processor time on one thread. A round makes each call without a tape, on a tape, and its backward pass; a figure is the
median over rounds, and a part of the call without a tape is the quotient of two of them.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import scenes
import warp as wp
from timing import interleaved, medians

import ccd_warp as ccd

PLAIN, TAPED, BACKWARD = "plain", "on a tape", "backward"


def all_scenes(scale: float) -> list[scenes.Scene]:
    """The scenes that are measured, of sizes in proportion to the scale."""
    sizes = (round(scale * n) for n in (10_000, 30_000, 100_000))
    pressed = scenes.spheres_through_each_other(round(scale * 40_000), "spheres pressed together", 0.51, 0.11)
    return [*map(scenes.cloth_over_sphere, sizes), pressed]


class Measured:
    """A scene with its pipeline, and the calls that are timed on it."""

    def __init__(self, scene: scenes.Scene) -> None:
        self.mesh = scene.mesh(ccd)
        self.pipeline = ccd.CollisionPipeline(self.mesh, device="cpu", num_threads=1)
        self._ends = [self._array(x) for x in (scene.vertices_t0, scene.vertices_t1)]
        self._given = [self._array(x, requires_grad=True) for x in (scene.vertices_t0, scene.vertices_t1)]
        self._plain = wp.clone(self._ends[1])
        self._ones = wp.full(self.mesh.num_vertices, value=1.0, dtype=wp.float64, device="cpu")
        self._of_end = self._array(np.random.default_rng(0).standard_normal(scene.vertices_t0.shape))
        found = self.pipeline.launch(*self._ends).to_host()
        self.contacts = found.num_contacts
        self.pipeline.reserve(max_pairs=2 * max(found.num_pairs.values()), max_contacts=2 * self.contacts + 1)
        self._tape: wp.Tape

    def _array(self, values: np.ndarray, *, requires_grad: bool = False) -> wp.array:
        return wp.array(values, dtype=wp.vec3d, device="cpu", requires_grad=requires_grad)

    def launch(self, name: str) -> dict[str, Callable[[], Any]]:
        """A launch without and on a tape, and the gradient of the sum of the tois of a field of its result."""
        ones = self._ones[:1] if name == "toi" else self._ones

        def taped() -> None:
            self._tape = wp.Tape()
            with self._tape:
                self._result = self.pipeline.launch(*self._given)

        def backward() -> None:
            self._tape.backward(grads={getattr(self._result, name): ones})

        return {PLAIN: lambda: self.pipeline.launch(*self._ends), TAPED: taped, BACKWARD: backward}

    def line_search(self, per: Any) -> dict[str, Callable[[], Any]]:
        """A line search without and on a tape, and the gradient of a sum of all shortened coordinates."""

        def plain() -> None:
            wp.copy(self._plain, self._ends[1])
            self.pipeline.launch_line_search(self._ends[0], self._plain, per=per)

        def taped() -> None:
            wp.copy(self._given[1], self._ends[1])
            self._tape = wp.Tape()
            with self._tape:
                self.pipeline.launch_line_search(*self._given, per=per)

        def backward() -> None:
            wp.copy(self._given[1].grad, self._of_end)
            self._tape.backward()

        return {PLAIN: plain, TAPED: taped, BACKWARD: backward}


def measure(scene: scenes.Scene, rounds: int) -> list[dict]:
    """A row for each kind of call."""
    measured = Measured(scene)
    calls = {"`launch`, gradient of `toi`": measured.launch("toi")}
    calls["`launch`, gradients of every `vertex_toi`"] = measured.launch("vertex_toi")
    calls |= {f"`launch_line_search`, per {per}": measured.line_search(per) for per in ("scene", "vertex")}
    rows = []
    for name, of_call in calls.items():
        seconds = medians(interleaved(of_call, rounds, clock=time.process_time))
        rows.append({"scene": scene.name, "contacts": measured.contacts, "call": name, "seconds": seconds})
    return rows
