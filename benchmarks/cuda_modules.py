"""Every Warp module with kernels that a CUDA device may be asked to run, by a name that a reader knows."""

from __future__ import annotations

import importlib
from itertools import product
from typing import Any

import warp as wp

# Modules that are files; explicit, so that `tests/test_cuda.py` fails for a file with kernels that has no place here.
_FILES = ["contacts", "boxes", "box_tree", "device_step", "rest_order", "body_boxes", "contact_place"]
_FILES += ["half_warp_tree", "hash_grid", "intersections", "meet_planes", "near_planes", "proximity"]
_FILES += ["thickness", "device_hold", "start_holds"]


def cuda_modules(with_distances: bool = False) -> dict[str, Any]:
    """The modules of the files, and those that a factory makes for a precision, a dimension or an end of the search.

    With ``with_distances`` also those that only scenes with a ``minimum_distance`` launch, or with radii, or line
    searches in which something starts within its distance; of these the narrow phase in one precision, as nothing else
    distinguishes the two from those without radii, or as there is no other.
    """
    from ccd_warp.kernels.candidate_cull import make_candidate_cull
    from ccd_warp.kernels.contact_place import make_contact_points
    from ccd_warp.kernels.device_step import make_input
    from ccd_warp.kernels.half_warp_grid_search import make_half_warp_grid_search
    from ccd_warp.kernels.half_warp_search import make_half_warp_search
    from ccd_warp.kernels.norm import EUCLIDEAN_NORM, MAXIMUM_NORM, OWN_BOX_NORM, THICK_NORM
    from ccd_warp.kernels.queued_pairs import STAGES, make_queued_pairs
    from ccd_warp.kernels.search_types import BOXES, CULL, LIST
    from ccd_warp.kernels.start_holds import make_holds

    modules = {}
    for name in _FILES:
        module = importlib.import_module(f"ccd_warp.kernels.{name}")
        modules[name] = wp.get_module(module.__name__)
    for real in (wp.float64, wp.float32):
        for dimension in (2, 3):
            name = f"{real.__name__} {dimension}"
            modules[f"device_step input {name}"] = make_input(real, dimension).read_moving.module
            modules[f"contact_place points {name}"] = make_contact_points(real, dimension).fill_points.module
        norms = [MAXIMUM_NORM]
        if with_distances:
            norms += [EUCLIDEAN_NORM, THICK_NORM, OWN_BOX_NORM] if real is wp.float64 else [EUCLIDEAN_NORM]
        for norm in norms:
            of_norm = "" if norm == MAXIMUM_NORM else f" {norm}"
            for name, kernels in vars(make_queued_pairs(real, norm)).items():
                for stage, kernel in zip(STAGES if kernels else (), kernels, strict=True):
                    modules[f"queued_pairs {name} {stage} {real.__name__}{of_norm}"] = kernel.module
    modules["candidate_cull"] = make_candidate_cull(False).cull_candidates.module
    if with_distances:
        modules["candidate_cull thick"] = make_candidate_cull(True).cull_candidates.module
        for is_euclidean in (True, False):
            modules[f"holds {'ball' if is_euclidean else 'box'}"] = make_holds(is_euclidean).lower_holds.module
    for end, with_lists, is_thick in product((BOXES, LIST, CULL), (False, True), (False, with_distances)):
        if is_thick and end == LIST:
            continue  # lists candidates with radii as it does without
        name = f"{end} {with_lists}{' thick' if is_thick else ''}"
        modules[f"half_warp_search {name}"] = make_half_warp_search(end, with_lists, is_thick).search_queries.module
        modules[f"half_warp_grid_search {name}"] = make_half_warp_grid_search(end, with_lists, is_thick).module
    return {name: module for name, module in modules.items() if module.kernels}
