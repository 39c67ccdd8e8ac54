"""Read and write the public sample data of continuous collision detection: queries, truth, boxes and frames.

The formats are those of the Sample-Queries ("handcrafted") and the Sample-Scalable-CCD-Data ("simulation"):

    SCENE/{edge-edge,vertex-face}/*.csv      handcrafted queries with their truth, 7 columns
    SCENE/queries/STEM{ee,vf}.csv            queries of a simulation, 6 columns
    SCENE/mma_bool/STEM{ee,vf}_mma_bool.json their truth
    SCENE/boxes/STEM{ee,vf}.json             their primitives
    SCENE/frames/*.ply                       the mesh at both ends of the step

References:
    Wang et al., "A Large-scale Benchmark and an Inclusion-based Algorithm for Continuous Collision Detection", 2021.
    Belgrod et al., "Time of Impact Dataset for Continuous Collision Detection and a Scalable Conservative Algorithm",
    2023.
"""

from ccd_warp.datasets._frames import SimulationStep, find_steps, read_step, write_step
from ccd_warp.datasets._json import edges_by_max, read_boxes, read_truth, write_boxes, write_truth
from ccd_warp.datasets._queries import Queries, find_queries, read_queries, write_queries

__all__ = [
    "Queries",
    "SimulationStep",
    "edges_by_max",
    "find_queries",
    "find_steps",
    "read_boxes",
    "read_queries",
    "read_step",
    "read_truth",
    "write_boxes",
    "write_queries",
    "write_step",
    "write_truth",
]
