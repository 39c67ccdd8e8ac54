"""Stage: the machine, its GPU, and the versions of what runs on it."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import shutil
import subprocess
from pathlib import Path
from typing import Any

import warp as wp
from ccd_warp.benchmarks.gpu_check.record import Record
from ccd_warp.benchmarks.gpu_check.target import Target

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


def run(target: Target, record: Record, **_: Any) -> None:
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
    said = nvidia_smi()
    if said is None:
        record.leave_out("nvidia-smi", "it is not installed, or failed")
    else:
        record.add(said, nvidia_smi=said)


def processor() -> dict[str, Any]:
    """The processor, its cores, the system and Python."""
    name = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        lines = (line for line in info.read_text(errors="replace").splitlines() if line.startswith("model name"))
        name = next((line.split(":")[1].strip() for line in lines), name)
    return {
        "cpu": name,
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
    }


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


def nvidia_smi() -> str | None:
    """What ``nvidia-smi`` says of the GPUs, on one line each; None where it says nothing."""
    tool = shutil.which("nvidia-smi")
    if tool is None:
        return None
    try:
        command = [tool, f"--query-gpu={_QUERY}", "--format=csv,noheader"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=8)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout.strip() if done.returncode == 0 and done.stdout.strip() else None
