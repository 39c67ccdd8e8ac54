"""How many numbers of float64 a device works on at once: the width of the lanes for which kernels are built.

The width decides which version of a kernel is compiled, and with it the speed; the answers have equal bits for every
width. It is found without compiling anything, from what NumPy says of the processor.
"""

import os
from collections.abc import Collection
from functools import cache
from types import ModuleType
from typing import Any

import numpy as np
import warp as wp

from ccd_warp.kernels.pair.norm import Norm
from ccd_warp.kernels.search.search_types import BOXES, LIST
from ccd_warp.kernels.template import specialised

# Names of the features in NumPy, which has renamed its groups.
_WIDTHS = {8: ("AVX512F", "X86_V4"), 4: ("AVX2", "X86_V3")}


def lanes_of(device: wp.Device) -> int:
    """Lanes of float64: 8 with AVX-512, 4 with AVX2, 1 with any other processor and on CUDA.

    Args:
        device: Warp device.
    """
    return 1 if device.is_cuda else cpu_lanes()


def narrow_phase_on(device: wp.Device, real: type, norm: Norm) -> ModuleType:
    """The kernels of the narrow phase for a device and a precision, with twice as many lanes of float32.

    Args:
        device: Warp device.
        real: Floating-point type of the iteration, a Warp dtype.
        norm: That of the separation (``kernels.pair.norm``).
    """
    width = lanes_of(device)
    width = width if width == 1 or real is wp.float64 else 2 * width
    return specialised("narrow_phase.narrow_phase", real=real, width=width, norm=norm)


def queued_kernels(real: type, norm: Norm, sink: int, *, is_clipping: bool) -> dict[str, Any]:
    """The kernels of the narrow phase on CUDA by their stages, in the order of their launches.

    Args:
        real: Floating-point type of the iteration, a Warp dtype.
        norm: That of the separation (``kernels.pair.norm``).
        sink: Where the outcomes go (``kernels.narrow_phase.sinks``).
        is_clipping: Whether pairs are solved by clips of time, not by bisection.
    """
    left_out = "bisection" if is_clipping else "last"
    stages = specialised("narrow_phase.queued_pairs", real=real, norm=norm).by_sink[sink]
    return {stage: kernel for stage, kernel in stages.items() if stage != left_out}


def search_on(
    device: wp.Device, walk: str, end: str, with_lists: bool, *, is_cuda: bool, is_thick: bool = False
) -> Any:
    """The kernel of a search that ends at a stage (``kernels.search.search_types``), with lanes for its cull.

    Args:
        device: Warp device.
        walk: What is searched: ``"search_trees"`` or ``"search_hashes"``, the name of the kernel and of its file.
        end: The stage.
        with_lists: Whether there are lists of excluded pairs.
        is_cuda: Whether warps take the queries, as on CUDA.
        is_thick: Whether pairs have distances of their own; a search that lists candidates is the same without.
    """
    parameters = {"end": end, "with_lists": with_lists, "is_thick": is_thick and end != LIST}
    if is_cuda:
        parameters["in_warps"] = True
    elif end != BOXES:
        parameters["width"] = lanes_of(device)
    return getattr(specialised(f"search.{walk}", **parameters), walk)


@cache
def cpu_lanes() -> int:
    """The lanes of this processor, or as many as the environment variable ``CCD_WARP_LANES`` says.

    Raises:
        ValueError: If the variable is none of 1, 4 and 8.
    """
    asked = os.environ.get("CCD_WARP_LANES", "")
    if asked and asked not in ("1", "4", "8"):
        raise ValueError(f"the environment variable CCD_WARP_LANES must be 1, 4 or 8; found {asked!r}")
    return int(asked) if asked else lanes_with(cpu_features())


def lanes_with(features: Collection[str]) -> int:
    """The lanes of a processor with the given features, in the names of NumPy."""
    return next((width for width, names in _WIDTHS.items() if any(name in features for name in names)), 1)


def cpu_features() -> set[str]:
    """The features of this processor, in the names of NumPy; none where it does not tell."""
    try:
        found = np.show_config(mode="dicts")["SIMD Extensions"]  # type: ignore[index]
    except (KeyError, TypeError):  # NumPy 1 built by setuptools
        return set()
    return {*found.get("baseline", ()), *found.get("found", ())}
