"""Collision detection on a mesh whose parts lie on the ranks of MPI; needs the extra ``mpi``.

Each rank hands in its own part of the mesh, and gets results for it that are those of one process with the whole mesh.
All calls are collective. See docs/distributed.md.
"""

from ccd_warp.distributed._mesh import DistributedMesh
from ccd_warp.distributed._pipeline import DistributedPipeline
from ccd_warp.distributed._ranks import Sent
from ccd_warp.distributed._results import DistributedLineSearch, DistributedPairs, DistributedResult, RankWork

__all__ = [
    "DistributedLineSearch",
    "DistributedMesh",
    "DistributedPairs",
    "DistributedPipeline",
    "DistributedResult",
    "RankWork",
    "Sent",
]
