"""What a check is of: the code, and the GPU. Records and answers of another are not taken for its own."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import ccd_warp.benchmarks.gpu_check
import ccd_warp.kernels
import warp as wp
from ccd_warp.benchmarks.machine import processor

import ccd_warp


def fingerprint() -> str:
    """Hash of every source file of the package, its kernels and this check, wherever each of them lies."""
    digest = hashlib.sha256()
    for package in (ccd_warp, ccd_warp.kernels, ccd_warp.benchmarks.gpu_check):
        folder = Path(package.__path__[0])
        files = {path.relative_to(folder).as_posix(): path for path in folder.rglob("*.py")}
        for name, path in sorted(files.items()):
            if package is not ccd_warp or not name.startswith(("kernels/", "benchmarks/")):
                digest.update(f"{package.__name__} {name}\n".encode() + path.read_bytes())
    return digest.hexdigest()[:16]


def identity(device: Any) -> dict[str, str]:
    """What tells a device from others of its name: two GPUs are both ``cuda:0``, each on a machine of its own."""
    device = wp.get_device(device)
    if device.is_cpu:
        return {"name": processor()["cpu"]}
    driver = ".".join(map(str, device.runtime.driver_version or ()))
    return {"name": device.name, "uuid": str(device.uuid), "driver": driver}
