"""The machine on which the figures were measured."""

from __future__ import annotations

import datetime
import importlib.metadata
import os
import platform
import subprocess
from pathlib import Path

import warp as wp

_PACKAGES = ("ccd-warp", "warp-lang", "numpy", "ipctk", "python-fcl", "coal", "drake", "py-parry3d")


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
    """The processor and the GPUs, memory, versions, date and code."""
    return {
        **processor(),
        "memory_gib": round(_memory() / 2**30),
        "gpus": " and ".join(device.name for device in wp.get_cuda_devices()),
        "versions": ", ".join(filter(None, map(_version, _PACKAGES))),
        "date": datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d"),
        "code": _commit(),
    }


def _version(package: str) -> str:
    try:
        return f"{package} {importlib.metadata.version(package)}"
    except importlib.metadata.PackageNotFoundError:
        return ""


def _memory() -> int:
    """Bytes that this process may use: those of the machine, or fewer in a container."""
    total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    limit = Path("/sys/fs/cgroup/memory.max")
    text = limit.read_text().strip() if limit.exists() else ""
    return min(total, int(text)) if text.isdigit() else total


def _commit() -> str:
    """The commit of this checkout, marked where files are changed; empty outside of one."""
    command = ["git", "describe", "--always", "--dirty", "--abbrev=12"]
    done = subprocess.run(command, cwd=Path(__file__).parent, capture_output=True, text=True, check=False)
    return done.stdout.strip()
