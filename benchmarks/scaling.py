"""Dependence of the speed on the batch size, and the cost of the first call."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from functools import partial
from itertools import product

import checkout  # noqa: F401
import numpy as np
from hard_cases import FAMILIES
from methods import CUBIC, Method
from timing import interleaved

FAMILY = "random_colliding"
# A first call, between what prepares it and its seconds, of the clock and of the processor.
_FIRST_CALL = """
import json, time, numpy as np, ccd_warp as ccd, warp as wp
wp.config.log_level = wp.LOG_ERROR
options = {{"precision": "{precision}", "device": "{device}"}}
x = np.zeros((1, 4, 3))
mesh = ccd.CollisionMesh.from_arrays([([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])] * 2)
begin = time.perf_counter(), time.process_time()
{call}
print(json.dumps([time.perf_counter() - begin[0], time.process_time() - begin[1]]))
"""
_FIRST_CALLS = {
    "vertex_face_ccd": "ccd.vertex_face_ccd(x, x, **options)",
    "mesh_ccd": "ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices, **options)",
    "ccd-warp demo": "from ccd_warp._cli.command import main; main(['demo', '--quiet'] + "
    "[f'--{name}={value}' for name, value in options.items()])",
}


def measure_batches(methods: list[Method], counts: tuple[int, ...], rounds: int, memory_gib: int) -> list[dict]:
    """Seconds of a warm call for each number of pairs, for ours and the cubic; none beyond the memory."""
    few = FAMILIES[FAMILY]("vertex-face", 100_000, np.random.default_rng(4))
    chosen = [m for m in methods if m.group == "ours" or m.name == CUBIC]
    rows = []
    for count in counts:
        # positions of twelve float64 at both ends, once in NumPy and once in Warp, and as much again for results and
        # temporaries
        if count * 400 > 0.5 * memory_gib * 2**30:
            continue
        points = [np.ascontiguousarray(np.resize(p, (count, 4, 3))) for p in few]
        calls = {
            m.name: partial(m.solve, "vertex-face", *points, 1e-6, 0.0, 1.0)
            for m in chosen
            if m.group != "baseline" or count <= 1_000_000
        }
        times = interleaved(calls, rounds * (20 if count <= 1000 else 1))
        for name, seconds in times.items():
            rows.append({"method": name, "count": count, "seconds": float(np.median(seconds[len(seconds) // 4 :]))})
    return rows


def measure_start(devices: list[str]) -> list[dict]:
    """Seconds of the first call of a process without imports: with nothing compiled, and with cached kernels."""
    rows = []
    calls = [(name, precision) for precision in ("float64", "float32") for name in _FIRST_CALLS]
    for device, (name, precision) in product(devices, calls[: len(_FIRST_CALLS) + 1]):  # of float32 the first alone
        code = _FIRST_CALL.format(precision=precision, device=device, call=_FIRST_CALLS[name])
        with tempfile.TemporaryDirectory() as cache:
            environment = {**os.environ, "WARP_CACHE_PATH": cache}
            compiled, loaded = (_last_line(code, environment) for _ in range(2))
        rows.append(
            {
                "device": device,
                "precision": precision,
                "call": name,
                "compile": compiled[0],
                "load": loaded[0],
                "compile_processor": compiled[1],
                "load_processor": loaded[1],
            }
        )
    return rows


def _last_line(code: str, environment: dict[str, str]) -> list[float]:
    found: list[float] = json.loads(run_apart([sys.executable, "-P", "-c", code], environment).splitlines()[-1])
    return found


def run_apart(command: list[str], environment: dict[str, str] | None = None) -> str:
    """Run a command in a separate process and return its output.

    Raises:
        ValueError: If it fails; the message is the last line that it printed.
    """
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    if done.returncode != 0:
        said = done.stderr.strip().splitlines()[-1:] or ["nothing"]
        raise ValueError(f"a process of the benchmark ended with {done.returncode} and said: {said[0]}")
    return done.stdout
