"""Every Warp module that a public call may launch, by a name that a reader knows: what is compiled beforehand."""

import importlib
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import warp as wp

from ccd_warp import kernels
from ccd_warp.kernels.later import define_kernels
from ccd_warp.kernels.pair.norm import Norm
from ccd_warp.kernels.search.search_types import BOXES, CULL, LIST
from ccd_warp.kernels.template import specialised

_REALS: tuple[Any, ...] = (wp.float64, wp.float32)
_NORMS = tuple(Norm)
_OF_CUDA = "half_warp_tree"  # a file with kernels that the CPU never launches
_OPTIONS = ("end", "with_lists", "is_thick")


@cache
def every_module(width: int | None) -> dict[str, Any]:
    """The modules of the files, and those of templates for what they depend on.

    Args:
        width: Lanes of float64 on the CPU, or None for CUDA.
    """
    modules: dict[str, Any] = {}
    for path in sorted(Path(kernels.__path__[0]).glob("*/*.py")):
        if "@wp.kernel" in path.read_text(encoding="utf-8"):
            name = f"{kernels.__name__}.{path.parent.name}.{path.stem}"
            module = wp.get_module(importlib.import_module(name).__name__)
            define_kernels(name)
            if module.kernels and not (width and path.stem == _OF_CUDA):
                modules[path.stem] = module
    for dimension in (2, 3):
        points = specialised("gradients.toi_adjoint_points", dimension=dimension)
        modules[f"toi_adjoint_points {dimension}"] = points.add_points.module
        for real in _REALS:
            for name, kernel in (
                ("step.input_rows", "read_moving"),
                ("step.contact_points", "fill_points"),
                ("gradients.toi_adjoint_rows", "add_rows"),
                ("gradients.shorten_adjoint", "shorten_back"),
            ):
                of_rows = getattr(specialised(name, real=real, dimension=dimension), kernel)
                modules[f"{name.partition('.')[2]} {real.__name__} {dimension}"] = of_rows.module
    for norm in dict.fromkeys(norm.shape for norm in _NORMS):
        shape, lanes = ("ball", width or 1) if norm.is_ball else ("box", 1)
        measured = specialised("at_one_time.measure_pairs", norm=norm, width=lanes)
        modules[f"measure_pairs {shape}"] = measured.measure_pairs.module
        of_start = specialised("at_one_time.near_contacts", norm=norm)
        modules[f"near_contacts {shape}"] = of_start.note_near_contacts.module
    for real, norm in product(_REALS, _NORMS):
        modules |= _of_solver(real, norm, width)
    return modules | _of_searches(width)


def _of_solver(real: type, norm: Norm, width: int | None) -> dict[str, Any]:
    of_norm = norm.suffix.replace(".", " ")
    if width:
        lanes = width if width == 1 or real is wp.float64 else 2 * width
        narrow_phase = specialised("narrow_phase.narrow_phase", real=real, width=lanes, norm=norm)
        return {f"narrow_phase {real.__name__}{of_norm}": narrow_phase.solve_pairs.module}
    queued = specialised("narrow_phase.queued_pairs", real=real, norm=norm)
    return {
        f"queued_pairs {name} {stage} {real.__name__}{of_norm}": kernel.module
        for name in ("points_toi", "solve_pairs", "pairs_bound")
        for stage, kernel in getattr(queued, name).items()
    }


def _of_searches(width: int | None) -> dict[str, Any]:
    modules = {}
    ends = (BOXES, CULL) if width else (BOXES, LIST, CULL)
    for options in product(ends, (False, True), (False, True)):
        end, with_lists, is_thick = options
        lanes = {"in_warps": True} if width is None else {"width": 1 if end == BOXES else width}
        if end == LIST and is_thick:
            continue  # lists candidates with radii as it does without
        for walk in ("search_trees", "search_hashes"):
            of_walk = specialised(f"search.{walk}", **dict(zip(_OPTIONS, options, strict=True)), **lanes)
            modules[f"{walk} {end} {with_lists}{' thick' if is_thick else ''}"] = getattr(of_walk, walk).module
    for is_thick in (False, True) if width is None else ():
        culled = specialised("search.candidate_cull", is_thick=is_thick)
        modules[f"candidate_cull{' thick' if is_thick else ''}"] = culled.cull_candidates.module
    return modules
