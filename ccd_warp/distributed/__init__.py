"""Collision detection on a mesh whose parts lie on the ranks of MPI; needs the extra ``mpi``.

Each rank hands in its own part of the mesh, and gets results for it that have the bits of one process with the whole
mesh. All calls are collective. See docs/distributed.md.
"""

from ccd_warp.distributed._intersections import DistributedIntersections
from ccd_warp.distributed._mesh import DistributedMesh
from ccd_warp.distributed._pipeline import DistributedPipeline
from ccd_warp.distributed._results import (
    DistributedCandidates,
    DistributedContacts,
    DistributedLineSearch,
    DistributedProximities,
    DistributedResult,
    RankWork,
)

__all__ = [
    "DistributedCandidates",
    "DistributedContacts",
    "DistributedIntersections",
    "DistributedLineSearch",
    "DistributedMesh",
    "DistributedPipeline",
    "DistributedProximities",
    "DistributedResult",
    "RankWork",
]
