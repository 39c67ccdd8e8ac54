"""Stage: a million and ten million queries of the pair functions, in both precisions, by threads a block."""

from __future__ import annotations

import statistics
from collections.abc import Iterator
from functools import lru_cache, partial
from typing import Any

import numpy as np
import warp as wp
from ccd_warp.benchmarks.gpu_check.cases import PRECISIONS
from ccd_warp.benchmarks.gpu_check.record import Cases, Record
from ccd_warp.benchmarks.gpu_check.target import Target, launched_with, middle
from ccd_warp.benchmarks.gpu_check.variants import BLOCK_DIMS
from ccd_warp.benchmarks.methods import SOLVE
from hard_cases import FAMILIES

COLLIDING, CULLED = "colliding", "culled"
MANY, FEW = 10_000_000, 1_000_000
_REPEATS = 5
_KEPT_BYTES = 8 << 30
_DIFFERENT = 100_000  # queries that are different; the others are copies of them at other places in memory


def cases(target: Target, **_: Any) -> Cases:
    """First what the goals are stated for, then the other kinds, sizes and blocks."""
    if target.is_real:  # what a call allocates is not given back between two calls
        wp.set_mempool_release_threshold(target.device, _KEPT_BYTES)
    counts = (2_000, 200) if target.is_short else (MANY, FEW)
    return {
        f"{count:,} {what} {kind} queries, {precision}, {block_dim or 'its own'} threads a block": partial(
            measure, target, counts[0], what, kind, count, precision, block_dim
        )
        for what, kind, count, precision, block_dim in plan(counts)
    }


@lru_cache(maxsize=1)  # the largest take 4 GB
def points_on(target: Target, what: str, kind: str, count: int) -> list[wp.array]:
    """Points of so many queries on the device."""
    return [tiled(target, x, count) for x in some_points(what, kind, min(count, _DIFFERENT))]


def plan(counts: tuple[int, int]) -> Iterator[tuple[str, str, int, str, int | None]]:
    """What, kind, number, precision and threads a block of every measurement, in order of importance."""
    many, few = counts
    kinds = ("vertex-face", "edge-edge")
    for kind in kinds:
        for what in (COLLIDING, CULLED):
            for precision in PRECISIONS:
                for block_dim in (None, *BLOCK_DIMS):  # its own first
                    for count in (many, few):
                        yield what, kind, count, precision, block_dim


def some_points(what: str, kind: str, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Different queries: all of them touch, or none does and the first direction proves it."""
    rng = np.random.default_rng(3)
    start, end = FAMILIES["random_colliding"](kind, count, rng)
    if what == COLLIDING:
        return start, end
    first = slice(0, 1) if kind == "vertex-face" else slice(0, 2)
    for points in (start, end):  # one side is far above the other throughout
        size = np.abs(points).max(axis=(1, 2))
        points[:, first, 2] += 4.0 * np.maximum(size, 1.0)[:, None]
    return start, end


def tiled(target: Target, points: np.ndarray, count: int) -> wp.array:
    """Points on the device, repeated up to a number of queries."""
    some = target.array(points, wp.vec3d)
    all_points = wp.empty((count, points.shape[1]), dtype=wp.vec3d, device=target.device)
    for begin in range(0, count, len(points)):
        part = all_points[begin : min(begin + len(points), count)]
        wp.copy(part, some[: part.shape[0]])
    return all_points


def measure(
    target: Target, most: int, what: str, kind: str, count: int, precision: str, block_dim: int | None, record: Record
) -> None:
    """One measurement, by events, with the share of the queries that touch."""
    start, end = (array[:count] for array in points_on(target, what, kind, most))
    results = []

    def call() -> None:
        results[:] = [SOLVE[kind](start, end, precision=precision, length_scale=1.0)]  # type: ignore[arg-type]

    repeats = 2 if target.is_short else _REPEATS
    with launched_with(block_dim):
        seconds = middle(target.seconds_on_device(call, repeats))
        kernels = [sum(target.kernel_seconds(call).values()) for _ in range(repeats if target.is_real else 0)]
    # between the events of a call the host allocates and launches, which counts where there are few queries
    best = statistics.median(kernels) if kernels else seconds["median"]
    touching = int(np.isfinite(results[0].toi[: min(count, _DIFFERENT)].numpy()).sum())
    record.add(
        f"{count:,} {what} {kind}, {precision}, {block_dim or 'its own'} threads a block: "
        f"{count / best / 1e9:.3f} G queries a second",
        what=what,
        kind=kind,
        count=count,
        precision=precision,
        block_dim=block_dim,
        seconds=seconds,
        kernels=best if kernels else None,
        queries_a_second=count / best,
        share_touching=touching / min(count, _DIFFERENT),
    )
