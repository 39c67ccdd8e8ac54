"""Batched, conservative continuous collision detection (CCD) for deforming triangle meshes, on NVIDIA Warp.

CCD here means: every vertex moves on a straight line over a step, and the question is the earliest time of impact (toi)
in [0, t_max]. A collision is never missed and never reported late.
"""

from ccd_warp import datasets
from ccd_warp._candidates import Candidates
from ccd_warp._line_search import LineSearchResult
from ccd_warp._mesh import CollisionMesh
from ccd_warp._narrow_phase import PairResult, edge_edge_ccd, point_point_ccd, point_segment_ccd, vertex_face_ccd
from ccd_warp._one_shot import collision_free_step, find_candidates, line_search, mesh_ccd
from ccd_warp._pipeline import CollisionPipeline
from ccd_warp._results import Contacts, Counts, DeviceContacts, LaunchResult, MeshResult
from ccd_warp._status import CCDStatus, LaunchFlag, PairKind

__version__ = "0.1.0"

__all__ = [
    "CCDStatus",
    "Candidates",
    "CollisionMesh",
    "CollisionPipeline",
    "Contacts",
    "Counts",
    "DeviceContacts",
    "LaunchFlag",
    "LaunchResult",
    "LineSearchResult",
    "MeshResult",
    "PairKind",
    "PairResult",
    "__version__",
    "collision_free_step",
    "datasets",
    "edge_edge_ccd",
    "find_candidates",
    "line_search",
    "mesh_ccd",
    "point_point_ccd",
    "point_segment_ccd",
    "vertex_face_ccd",
]
