"""Every Warp module with kernels that a CUDA device may be asked to run, by a name that a reader knows."""

from __future__ import annotations

import importlib
from functools import cache
from itertools import product
from typing import Any

import warp as wp

# Modules that are files; explicit, so that `tests/kernels/test_cuda.py` fails for a file with kernels that is not here.
_FILES = [
    *("boxes.boxes", "boxes.box_tree", "boxes.rest_order", "boxes.body_boxes", "boxes.body_frames"),
    *("boxes.half_warp_tree", "boxes.box_groups", "boxes.hash_grid", "boxes.thickness", "narrow_phase.meet_planes"),
    *("step.contacts", "step.device_step", "step.contact_place", "rigid.place_bodies", "rigid.shorten_paths"),
    *("gradients.toi_slope", "gradients.attained", "gradients.toi_adjoint", "gradients.ordered_sums"),
    *("gradients.regularity", "rigid.part_overlap"),
    *("at_one_time.intersections", "at_one_time.near_planes", "at_one_time.proximity"),
    *("at_one_time.device_start_distances", "at_one_time.start_distances"),
]


@cache
def cuda_modules(with_distances: bool = False, reals: tuple[type, ...] = (wp.float64, wp.float32)) -> dict[str, Any]:
    """The modules of the files, and those of templates for a precision, a dimension or an end of the search.

    With ``with_distances`` also those that only scenes with a ``minimum_distance`` launch, or with radii or bodies that
    turn, or line searches in which something starts within its distance; of the latter the narrow phase in one
    precision, as there is no other.
    """
    from ccd_warp.kernels.narrow_phase.queued_pairs import STAGES
    from ccd_warp.kernels.pair.norm import ARC_BALL_NORM, ARC_BOX_NORM, EUCLIDEAN_NORM, MAXIMUM_NORM, OWN_BOX_NORM
    from ccd_warp.kernels.search.search_types import BOXES, CULL, LIST
    from ccd_warp.kernels.template import specialised

    modules = {}
    for name in _FILES:
        module = importlib.import_module(f"ccd_warp.kernels.{name}")
        modules[name.partition(".")[2]] = wp.get_module(module.__name__)
    for real in reals:
        for dimension in (2, 3):
            name = f"{real.__name__} {dimension}"
            parameters = {"real": real, "dimension": dimension}
            modules[f"input_rows {name}"] = specialised("step.input_rows", **parameters).read_moving.module
            of_rows = specialised("gradients.toi_adjoint_rows", **parameters).add_rows
            of_shortened = specialised("gradients.shorten_adjoint", **parameters).shorten_back
            modules |= {f"toi_adjoint_rows {name}": of_rows.module, f"shorten_adjoint {name}": of_shortened.module}
            modules[f"contact_points {name}"] = specialised("step.contact_points", **parameters).fill_points.module
        norms = [MAXIMUM_NORM]
        if with_distances:
            norms += [EUCLIDEAN_NORM, OWN_BOX_NORM] if real is wp.float64 else [EUCLIDEAN_NORM]
            norms += [ARC_BOX_NORM, ARC_BALL_NORM]
        for norm in norms:
            of_norm = "" if norm == MAXIMUM_NORM else f" {norm}"
            queued = specialised("narrow_phase.queued_pairs", real=real, norm=norm)
            for name in ("points_toi", "solve_pairs", "pairs_bound"):
                kernels = getattr(queued, name)
                for stage, kernel in zip(STAGES if kernels else (), kernels, strict=True):
                    modules[f"queued_pairs {name} {stage} {real.__name__}{of_norm}"] = kernel.module
    shapes = {"ball": EUCLIDEAN_NORM} | ({"box": MAXIMUM_NORM} if with_distances else {})
    for shape, norm in shapes.items():
        modules[f"measure_pairs {shape}"] = specialised("at_one_time.measure_pairs", norm=norm).measure_pairs.module
    for dimension in (2, 3):
        points = specialised("gradients.toi_adjoint_points", dimension=dimension)
        modules[f"toi_adjoint_points {dimension}"] = points.add_points.module
    modules["candidate_cull"] = specialised("search.candidate_cull").cull_candidates.module
    if with_distances:
        modules["candidate_cull thick"] = specialised("search.candidate_cull", is_thick=True).cull_candidates.module
        for shape, norm in shapes.items():
            of_start = specialised("at_one_time.start_distances", norm=norm)
            modules[f"near_contacts {shape}"] = of_start.note_near_contacts.module
    for end, with_lists, is_thick in product((BOXES, LIST, CULL), (False, True), (False, with_distances)):
        if is_thick and end == LIST:
            continue  # lists candidates with radii as it does without
        name = f"{end} {with_lists}{' thick' if is_thick else ''}"
        parameters = {"end": end, "with_lists": with_lists, "is_thick": is_thick}
        for walk in ("search_trees", "search_hashes"):
            of_walk = specialised(f"search.{walk}", **parameters, in_warps=True)
            modules[f"{walk} {name}"] = getattr(of_walk, walk).module
    return {name: module for name, module in modules.items() if module.kernels}
