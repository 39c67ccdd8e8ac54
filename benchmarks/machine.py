"""The machine on which the figures were measured."""

from __future__ import annotations

import datetime
import importlib.metadata
import os
import platform
from pathlib import Path

import warp as wp

_PACKAGES = ("ccd-warp", "warp-lang", "numpy", "ipctk")


def processor() -> dict:
    """Name of the processor, its cores, the system and Python."""
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


def machine() -> dict:
    """The processor and the GPUs, memory, versions, date."""
    return {
        **processor(),
        "memory_gib": round(_memory() / 2**30),
        "gpus": [device.name for device in wp.get_cuda_devices()],
        "versions": {package: importlib.metadata.version(package) for package in _PACKAGES},
        "date": datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d"),
    }


def _memory() -> int:
    """Bytes that this process may use: those of the machine, or fewer in a container."""
    import psutil  # of the extra

    total = psutil.virtual_memory().total
    limit = Path("/sys/fs/cgroup/memory.max")
    text = limit.read_text().strip() if limit.exists() else ""
    return min(total, int(text)) if text.isdigit() else total


def describe(about: dict) -> str:
    """One line on a machine."""
    versions = ", ".join(f"{package} {version}" for package, version in about["versions"].items())
    gpus = "".join(f", {name}" for name in about["gpus"])
    return (
        f"{about['cpu']}, {about['cores']} cores{gpus}, {about['memory_gib']} GiB, {about['system']}, "
        f"Python {about['python']}, {versions}, {about['date']}"
    )
