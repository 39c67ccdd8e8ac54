"""The public functions of pairs by the name of their kind, and the length that a pair's tolerance refers to."""

import numpy as np

import ccd_warp as ccd

SOLVE = {
    "vertex-face": ccd.vertex_face_ccd,
    "edge-edge": ccd.edge_edge_ccd,
    "point-segment": ccd.point_segment_ccd,
    "point-point": ccd.point_point_ccd,
}


def size_of_motion(points_t0: np.ndarray, points_t1: np.ndarray) -> np.ndarray:
    """Longest side of the box around each query's motion: its default length scale, shape [n]."""
    both = np.concatenate([points_t0, points_t1], axis=1)
    return (both.max(axis=1) - both.min(axis=1)).max(axis=1)
