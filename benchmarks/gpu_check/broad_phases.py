"""Stage: the broad phases beside each other, in time and in what they find."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, get_args

import numpy as np
import pytest
import warp as wp
from ccd_warp.benchmarks.gpu_check.record import Cases, Record
from ccd_warp.benchmarks.gpu_check.target import Target, middle
from ccd_warp.benchmarks.scenes import (
    Scene,
    bodies_through_each_other,
    cloth_over_sphere,
    ground_under_cloth,
    long_step,
    pile,
)

import ccd_warp as ccd
from ccd_warp._input.option_types import BroadPhase

OPTION = "broad_phase"
_REPEATS = 5


def choices() -> tuple[str, ...]:
    """The broad phases that there are."""
    return get_args(BroadPhase)


def cases(target: Target, **_: Any) -> Cases:
    """The scenes."""
    made: list[Callable[[], Scene]] = [partial(cloth_over_sphere, 400)]
    if not target.is_short:
        made = [
            partial(cloth_over_sphere, 200_000),
            partial(pile, 1_000, 100),
            partial(bodies_through_each_other, 300, 100),
            partial(ground_under_cloth, 100_000),
            partial(long_step, 20_000),
        ]
    return {" ".join(map(str, (make.func.__name__, *make.args))): partial(compare, target, make) for make in made}


def compare(target: Target, make: Callable[[], Scene], record: Record) -> None:
    """A scene with every broad phase: launches, candidates, and whether all results are the same bits."""
    scene, first = make(), None
    for name in choices():
        row, found = measure(target, scene, {OPTION: name}, 2 if target.is_short else _REPEATS)
        first = first or found
        differing = [key for key in first if not np.array_equal(first[key], found[key], equal_nan=True)]
        record.add(
            f"{scene.name}, {name}: launch {row['launch']['median'] * 1e3:.3f} ms, "
            f"find_candidates {row['find_candidates']['median'] * 1e3:.2f} ms",
            scene=scene.name,
            broad_phase=name,
            **row,
        )
        if differing:
            pytest.fail(f"{name} finds others of {', '.join(differing)}")


def measure(target: Target, scene: Any, options: dict, repeats: int) -> tuple[dict, dict[str, np.ndarray]]:
    """Times of a launch and of the candidates, and what was found."""
    capacities = {"max_pairs": 1 << 24, "max_contacts": 1 << 22} if not target.is_short else {"max_pairs": 1 << 16}
    pipeline = ccd.CollisionPipeline(scene.mesh(ccd), device=target.device, **capacities, **options)
    pipeline.reserve(vertices=scene.vertices_t0)
    start, end = (target.array(x, wp.vec3d) for x in (scene.vertices_t0, scene.vertices_t1))
    launch = middle(target.seconds_on_device(lambda: pipeline.launch(start, end), repeats))
    kernels = target.kernel_seconds(lambda: pipeline.launch(start, end))
    result = pipeline.launch(start, end)
    found = {name: getattr(result, name).numpy() for name in ("toi", "vertex_toi", "flags", "num_pairs")}
    frames = (scene.vertices_t0, scene.vertices_t1)
    candidates = target.seconds_on_host(lambda: pipeline.find_candidates(*frames), min(repeats, 3))
    pairs = pipeline.find_candidates(*frames).sorted()
    found |= {kind: getattr(pairs, kind) for kind in ("vertex_face", "edge_edge")}
    return {"launch": launch, "kernels": kernels, "find_candidates": middle(candidates)}, found
