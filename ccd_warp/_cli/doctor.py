"""``ccd-warp doctor``: versions, and for each device whether kernels come with the package or are compiled, and why."""

import argparse
import os
import platform
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from ccd_warp._cli.process import start_quietly, teller
from ccd_warp._runtime import quiet
from ccd_warp._runtime.lanes import cpu_lanes
from ccd_warp._runtime.packaged import is_packaged, why_none
from ccd_warp._runtime.target import cpu_target, set_flags
from ccd_warp._runtime.version import __version__


def add_doctor(commands: Any) -> None:
    """Add the command to those of the parser."""
    text = "say whether kernels come with the package or are compiled, and where they are kept"
    commands.add_parser("doctor", help=text, description=f"{text[0].upper()}{text[1:]}.")


def run(_: argparse.Namespace) -> int:
    """Print a line for each device, and one for the cache."""
    start_quietly(None, needs_cache=False)
    tell = teller(None, is_quiet=False)
    versions = f"Warp {wp.config.version}, Python {platform.python_version()}, NumPy {np.__version__}"
    tell(f"ccd_warp {__version__}, {versions}, {platform.machine()}")
    for device in wp.get_devices():
        about = f"{cpu_target()}, {cpu_lanes()} lanes" if device.is_cpu else f"{device.name}, sm_{device.arch}"
        tell(f"{device} ({about}): {_source_of_kernels(device)}")
    if quiet.why_no_cache:
        tell(f"cache: none. {quiet.why_no_cache}")
        return 0
    folder = Path(str(wp.config.kernel_cache_dir))
    paths = [path for module in folder.glob("wp_ccd_warp.*") for path in module.iterdir()]
    writable = "can be written" if os.access(folder, os.W_OK) else "cannot be written"
    tell(f"cache: {folder} {writable}, {sum(path.stat().st_size for path in paths) / 2**20:.0f} MiB of ccd_warp")
    return 0


def _source_of_kernels(device: wp.Device) -> str:
    """Which of the two happens, and why."""
    if reason := why_none(device):
        return f"kernels are compiled when they are first needed, because {reason}"
    from ccd_warp._runtime.every_module import every_module  # defines all kernels that can be imported plainly

    modules = every_module(cpu_lanes() if device.is_cpu else None).values()
    count = 0
    for module in modules:
        set_flags(module, device)
        count += is_packaged(module, device, 1 if device.is_cpu else module.options["block_dim"])
    if count == len(modules):
        return f"all kernels come with the package, {count} modules"
    return (
        f"{count} of {len(modules)} modules come with the package; the others differ or are damaged, and are compiled"
    )
