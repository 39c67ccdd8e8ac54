"""The machine on which the figures were measured."""

from __future__ import annotations

import datetime
import importlib.metadata
import os
import platform
import subprocess
from pathlib import Path

import warp as wp

# Whose changes make figures stale.
_MEASURED = ("ccd_warp", "kernels")
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
        "code": commit(),
        "load": round(os.getloadavg()[0], 1),
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
    text = limit.read_text("utf-8").strip() if limit.exists() else ""
    return min(total, int(text)) if text.isdigit() else total


def commit() -> str:
    """The commit of this checkout, marked where files but those of results are changed; empty outside of one."""
    is_changed = _git("status", "--porcelain", "--untracked-files=no", "--", ".", ":!benchmarks/results")
    return _git("rev-parse", "--short=12", "HEAD") + ("-dirty" if is_changed else "")


def why_refused(code: str) -> str:
    """Why figures of a commit cannot be traced to code: it is not of the history of this checkout; empty if it is."""
    if not code or code.endswith("-dirty"):
        return "of code that was not committed"
    known = _git("rev-parse", "--verify", f"{code}^{{commit}}")
    return "" if known and _git("merge-base", known, "HEAD") == known else f"of {code}, which is not in the history"


def why_stale(code: str) -> str:
    """Why figures of a commit may not be those of this checkout; empty if they are."""
    if why := why_refused(code):
        return why
    changed = _git("diff", "--name-only", code, "--", *_MEASURED).splitlines()
    return f"of {code}, since which {len(changed)} files have changed" if changed else ""


def has_history() -> bool:
    """Whether this is a checkout with all of its history, which tells commits that are in it from others."""
    return _git("rev-parse", "--is-shallow-repository") == "false"


def _git(*command: str) -> str:
    folder = Path(__file__).resolve().parents[1]
    done = subprocess.run(["git", *command], cwd=folder, capture_output=True, text=True, check=False)
    return done.stdout.strip()
