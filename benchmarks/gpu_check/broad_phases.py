"""Stage: the broad phases beside each other, in time and in what they find."""

from __future__ import annotations

from typing import Any, get_args, get_type_hints

import numpy as np
import warp as wp
from ccd_warp.benchmarks.gpu_check.record import Record
from ccd_warp.benchmarks.gpu_check.target import Target, middle
from ccd_warp.benchmarks.scenes import bodies_through_each_other, cloth_over_sphere, ground_under_cloth, long_step, pile

import ccd_warp as ccd

OPTION = "broad_phase"
_REPEATS = 5


def choices() -> tuple[str, ...]:
    """The broad phases that this version has; the tree alone where it has no such option."""
    annotation = get_type_hints(ccd.MeshOptions).get(OPTION)
    named = [name for part in (annotation, *get_args(annotation)) for name in (part, *get_args(part))]
    return tuple(dict.fromkeys(name for name in named if isinstance(name, str))) or ("tree",)


def run(target: Target, record: Record, **_: Any) -> None:
    """Each scene with every broad phase: launches, candidates, and whether all results are the same bits."""
    names = choices()
    if len(names) < 2:
        record.leave_out("the hash", f"this version has no option {OPTION}")
    made = (
        [lambda: cloth_over_sphere(400)]
        if target.is_short
        else [
            lambda: cloth_over_sphere(200_000),
            lambda: pile(1_000, 100),
            lambda: bodies_through_each_other(300, 100),
            lambda: ground_under_cloth(100_000),
            lambda: long_step(20_000),
        ]
    )
    for make in made:
        scene = make()
        first: dict[str, np.ndarray] | None = None
        for name in names:
            if not record.begins(f"{scene.name}, {name}", 0.2 if target.is_short else 1.5):
                continue
            options: dict[str, Any] = {OPTION: name} if len(names) > 1 else {}
            row, found = measure(target, scene, options, 2 if target.is_short else _REPEATS)
            if first is None:
                first = found
            differing = [key for key in first if not np.array_equal(first[key], found[key], equal_nan=True)]
            record.add(
                f"{scene.name}, {name}: launch {row['launch']['median'] * 1e3:.3f} ms, "
                f"find_candidates {row['find_candidates']['median'] * 1e3:.2f} ms"
                + (f"; DIFFERENT: {', '.join(differing)}" if differing else ""),
                scene=scene.name,
                broad_phase=name,
                different=differing,
                **row,
            )


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
