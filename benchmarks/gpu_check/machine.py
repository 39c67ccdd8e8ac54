"""Stage: the machine, its GPU, and the versions of what runs on it."""

from __future__ import annotations

import importlib.metadata
import shutil
import subprocess
from functools import partial
from typing import Any

import pytest
import warp as wp
from ccd_warp.benchmarks.gpu_check.record import Cases, Record
from ccd_warp.benchmarks.gpu_check.target import Target
from ccd_warp.benchmarks.machine import processor

_PACKAGES = (
    "ccd-warp",
    "warp-lang",
    "numpy",
    "trimesh",
    "pytest",
    "torch",
    "jax",
    "cupy-cuda12x",
    "cupy-cuda13x",
    "newton",
)
_QUERY = "name,driver_version,memory.total,clocks.sm,clocks.max.sm,clocks.mem,power.limit"


def cases(target: Target, **_: Any) -> Cases:
    """The machine, and where there is one what its driver says."""
    found: Cases = {"machine": partial(describe, target)}
    return found | ({"nvidia-smi": ask_driver} if target.is_real else {})


def describe(target: Target, record: Record) -> None:
    """Say what the machine is."""
    host = processor()
    record.add(f"{host['cpu']}, {host['cores']} cores, {host['system']}, Python {host['python']}", host=host)
    versions = installed_versions()
    record.add(", ".join(f"{name} {version}" for name, version in versions.items()), versions=versions)
    device = wp.get_device(target.device)
    if not target.is_real:
        record.add(f"{device.alias} ({target.kind})", device={"name": device.name, "kind": target.kind})
        return
    about = {
        "name": device.name,
        "kind": target.kind,
        "arch": device.arch,
        "multiprocessors": device.sm_count,
        "memory_bytes": device.total_memory,
        "free_bytes": device.free_memory,
        "driver": ".".join(map(str, device.runtime.driver_version or ())),
        "toolkit": ".".join(map(str, device.runtime.toolkit_version or ())),
        "output": device.get_cuda_output_format(),
    }
    record.add(
        f"{about['name']}, sm_{about['arch']}, {about['multiprocessors']} multiprocessors, "
        f"{about['memory_bytes'] / 2**30:.1f} GiB of which {about['free_bytes'] / 2**30:.1f} are free, "
        f"driver {about['driver']}, toolkit of Warp {about['toolkit']}",
        device=about,
    )


def ask_driver(record: Record) -> None:
    """What ``nvidia-smi`` says of the GPUs, on one line each."""
    tool = shutil.which("nvidia-smi") or pytest.skip("it is not installed")
    command = [tool, f"--query-gpu={_QUERY}", "--format=csv,noheader"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=8)
    said = done.stdout.strip() if done.returncode == 0 else pytest.skip("it failed")
    record.add(said, nvidia_smi=said)


def installed_versions() -> dict[str, str]:
    """Versions of the packages that take part, of those that are installed."""
    versions = {}
    for name in _PACKAGES:
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    versions.setdefault("warp-lang", wp.config.version)
    return versions
