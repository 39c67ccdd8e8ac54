"""Stage: launches in which a static body moves, so that its boxes are made anew, beside those in which it stays."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pytest
import warp as wp
from ccd_warp.benchmarks.gpu_check.record import Cases, Record
from ccd_warp.benchmarks.gpu_check.target import Target, middle
from ccd_warp.benchmarks.scenes import grid, sphere

import ccd_warp as ccd

_REPEATS = 9


def cases(target: Target, **_: Any) -> Cases:
    """One scene."""
    return {"a static ball": partial(measure, target)}


def measure(target: Target, record: Record) -> None:
    """Move a static ball of many faces to and fro, and compare with a launch that has never seen it elsewhere."""
    num_faces = 400 if target.is_short else 200_000
    repeats = 2 if target.is_short else _REPEATS
    ball, faces = sphere(num_faces, 0.5)
    sheet, sheet_faces = grid(20, 20)
    sheet = sheet + [0, 0, 0.53]
    mesh = ccd.CollisionMesh.from_arrays([(sheet, sheet_faces), (ball, faces)], static=[1])
    is_static = np.repeat([0.0, 1.0], [len(sheet), len(ball)])[:, None]
    start = np.concatenate([sheet, ball])
    end = start - 0.02 * (1 - is_static) * [0, 0, 1]
    shifts = 0.01 * is_static * np.arange(2)[:, None, None]
    steps = [(target.array(start + shift, wp.vec3d), target.array(end + shift, wp.vec3d)) for shift in shifts]
    pipeline = ccd.CollisionPipeline(mesh, device=target.device)
    turn = iter(range(10**9))
    calls = {
        "stays": lambda: pipeline.launch(*steps[0]),
        "moves": lambda: pipeline.launch(*steps[next(turn) % 2]),
    }
    seconds, kernels = {}, {}
    for name, call in calls.items():
        seconds[name] = middle(target.seconds_on_device(call, repeats))
        call()
        kernels[name] = target.kernel_seconds(call)
    toi = pipeline.launch(*steps[1]).vertex_toi.numpy()
    fresh = ccd.CollisionPipeline(mesh, device=target.device).launch(*steps[1]).vertex_toi.numpy()
    num_different = int((toi != fresh).sum())
    record.add(
        f"static body of {len(faces):,} faces: {seconds['stays']['median'] * 1e3:.3f} ms a launch where it stays, "
        f"{seconds['moves']['median'] * 1e3:.3f} ms where it moves; {num_different} tois differ",
        faces=len(faces),
        seconds=seconds,
        kernels=kernels,
        touching=int(np.isfinite(toi).sum()),
    )
    if num_different:
        pytest.fail(f"{num_different} tois differ from those of a launch that has not seen the body elsewhere")
