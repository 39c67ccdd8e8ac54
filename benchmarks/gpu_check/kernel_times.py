"""Stage: the scenes of the benchmark as launches, by events and kernel by kernel, and as calls of the host by stage."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import warp as wp
from ccd_warp.benchmarks.gpu_check.record import Cases, Record
from ccd_warp.benchmarks.gpu_check.target import Target, middle
from ccd_warp.benchmarks.scenes import Scene, all_scenes, cloth_over_sphere, pile

import ccd_warp as ccd

_REPEATS = 9
# In the order of what they say: the goal of a launch is stated for 200,000 faces.
_ORDER = (
    "cloth 200k",
    "pile 200k",
    "crumpled cloth 50k",
    "bodies through each other",
    "cloth 100k",
    "spheres 100k",
    "pile",
    "giant face 100k",
    "long step",
    "long step 50k",
    "cloth 10k",
    "cloth 1M",
)


def scenes(is_short: bool) -> list[tuple[str, Any]]:
    """Names of the scenes, and the functions that make them."""
    if is_short:
        return [("cloth", lambda: cloth_over_sphere(400)), ("pile", lambda: pile(8, 48))]
    made = dict(all_scenes(None, quick=False))
    made["cloth 200k"] = lambda: cloth_over_sphere(200_000)
    made["pile 200k"] = lambda: pile(1_000, 200)
    return [(name, made[name]) for name in _ORDER]


def cases(target: Target, **_: Any) -> Cases:
    """The scenes."""
    return {name: partial(measure, target, make) for name, make in scenes(target.is_short)}


def measure(target: Target, make: Callable[[], Scene], record: Record) -> None:
    """A launch of a scene, enlarged until everything fits, and the three calls of the host."""
    scene, repeats = make(), 2 if target.is_short else _REPEATS
    mesh = scene.mesh(ccd)
    pipeline = ccd.CollisionPipeline(mesh, device=target.device)
    reserve = target.seconds_on_host(lambda: pipeline.reserve(vertices=scene.vertices_t0), 1, warm_up=False)[0]
    start, end = (target.array(x, wp.vec3d) for x in (scene.vertices_t0, scene.vertices_t1))
    result = pipeline.launch(start, end)
    for _ in range(3):
        if not result.flags.numpy()[0]:
            break
        pairs, contacts = int(result.num_pairs.numpy().max()), int(result.contacts.count.numpy()[0])
        pipeline.reserve(max_pairs=max(2 * pairs, 1), max_contacts=max(2 * contacts, 1))
        result = pipeline.launch(start, end)
    launch = middle(target.seconds_on_device(lambda: pipeline.launch(start, end), repeats))
    with wp.ScopedCapture(device=target.device) as capture:
        pipeline.launch(start, end)
    replay = middle(target.seconds_on_device(lambda: wp.capture_launch(capture.graph), repeats))
    kernels = target.kernel_seconds(lambda: pipeline.launch(start, end))
    frames = (scene.vertices_t0, scene.vertices_t1)
    host, stages = {}, {}
    for name in ("mesh_ccd", "collision_free_step", "find_candidates"):
        if record.left() < 0.3:
            continue
        call = getattr(pipeline, name)
        host[name] = middle(target.seconds_on_host(lambda call=call: call(*frames), min(repeats, 3)))["median"]
        stages[name] = dict(pipeline.timings)
    slowest = ", ".join(f"{name} {seconds * 1e3:.3f}" for name, seconds in list(kernels.items())[:3])
    record.add(
        f"{scene.name}: launch {launch['median'] * 1e3:.3f} ms, replay {replay['median'] * 1e3:.3f}"
        + "".join(f", {name} {seconds * 1e3:.2f}" for name, seconds in host.items())
        + (f"; slowest kernels (ms): {slowest}" if slowest else ""),
        scene=scene.name,
        faces=len(scene.faces),
        pairs=int(np.sum(result.num_pairs.numpy())),
        candidates=sum(pipeline.counts.num_candidates.values()),
        contacts=int(result.contacts.count.numpy()[0]),
        flags=int(result.flags.numpy()[0]),
        reserve=reserve,
        launch=launch,
        replay=replay,
        kernels=kernels,
        host=host,
        stages=stages,
    )
