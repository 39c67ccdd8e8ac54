"""Batched, conservative continuous collision detection (CCD) for deforming triangle meshes, on NVIDIA Warp.

During a step every vertex moves on a straight line; CCD computes the earliest time of impact (toi) in [0, t_max]. A
collision is never missed and never reported late. All functions share the options of :class:`MeshOptions`, which are
passed by keyword.

Guarantee: if the exact trajectories of a pair first touch (or come within the minimum separation, or distance) at
τ ≤ t_max, every reported toi that covers the pair is ≤ τ. ``inf`` is certain. A finite toi without a collision is
possible only where the gap, L∞ (Euclidean with a distance), falls below separation + δ + ε, with δ the tolerance and ε
the bound on the rounding errors, or where a limit was reached, which the status says. It holds in floating point, in
both precisions, for every finite input.
"""

import importlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

if not Path(__file__).with_name("kernels").exists():  # a checkout, in which the kernels have a folder next to this one
    __path__.append(str(Path(__file__).parents[1]))

from ccd_warp._calls.one_shot import (
    collision_free_step,
    displacement_bounds,
    find_candidates,
    find_intersections,
    find_proximity,
    is_step_collision_free,
    line_search,
    mesh_ccd,
    rigid_ccd,
)
from ccd_warp._calls.pair_ccd import PairResult, edge_edge_ccd, point_point_ccd, point_segment_ccd, vertex_face_ccd
from ccd_warp._calls.pipeline import CollisionPipeline
from ccd_warp._engine.host.candidates import Candidates
from ccd_warp._results.device_pairs import DeviceContacts
from ccd_warp._results.device_results import DeviceDisplacements, DeviceProximities, LaunchResult
from ccd_warp._results.intersections import Intersections
from ccd_warp._results.line_search_result import LineSearchResult
from ccd_warp._results.proximities import Proximities
from ccd_warp._results.results import Contact, Contacts, Counts, HostLaunchResult, MeshResult
from ccd_warp._results.toi_gradient import ToiGradient
from ccd_warp._rigid.motion import RigidMotion
from ccd_warp._runtime.status import CCDStatus, IntersectionKind, LaunchFlag, PairKind
from ccd_warp._runtime.version import __version__
from ccd_warp._scene.half_space import HalfSpace, Planes
from ccd_warp._scene.input.body_options import BodyOptions
from ccd_warp._scene.input.option_types import (
    CandidateOptions,
    DisplacementOptions,
    IntersectionOptions,
    LineSearchOptions,
    MeshOptions,
    PairOptions,
    ProximityOptions,
)
from ccd_warp._scene.mesh import CollisionMesh

__all__ = [
    "BodyOptions",
    "CCDStatus",
    "CandidateOptions",
    "Candidates",
    "CollisionMesh",
    "CollisionPipeline",
    "Contact",
    "Contacts",
    "Counts",
    "DeviceContacts",
    "DeviceDisplacements",
    "DeviceProximities",
    "DisplacementOptions",
    "FrameSequence",
    "Frames",
    "HalfSpace",
    "HostLaunchResult",
    "IntersectionKind",
    "IntersectionOptions",
    "Intersections",
    "LaunchFlag",
    "LaunchResult",
    "LineSearchOptions",
    "LineSearchResult",
    "MeshOptions",
    "MeshResult",
    "PairKind",
    "PairOptions",
    "PairResult",
    "Planes",
    "Proximities",
    "ProximityOptions",
    "RigidMotion",
    "ToiGradient",
    "__version__",
    "collision_free_step",
    "displacement_bounds",
    "edge_edge_ccd",
    "find_candidates",
    "find_intersections",
    "find_proximity",
    "is_step_collision_free",
    "line_search",
    "mesh_ccd",
    "point_point_ccd",
    "point_segment_ccd",
    "read_frames",
    "read_sequence",
    "rigid_ccd",
    "vertex_face_ccd",
    "viz",
]

if TYPE_CHECKING:
    from ccd_warp import viz
    from ccd_warp._files.sequence import Frames, FrameSequence, read_frames, read_sequence

# Modules that are loaded when one of their names is first asked for, or they themselves.
_PARTS = {
    "viz": (),
    "_files.sequence": ("FrameSequence", "Frames", "read_frames", "read_sequence"),
}


def __getattr__(name: str) -> Any:
    """A name whose module is loaded when it is used."""
    for part, names in _PARTS.items():
        if name == part or name in names:
            module = importlib.import_module(f"{__name__}.{part}")
            return getattr(module, name) if names else module
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    """The public names, those of parts that are not loaded included, and nothing that this file imports for itself."""
    return sorted({*__all__, *(name for name in globals() if name.startswith("__"))})
