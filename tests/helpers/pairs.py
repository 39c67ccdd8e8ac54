"""Pairs of all kinds, many of them hard, and their results with several options."""

import numpy as np
from hard_cases import FAMILIES

import ccd_warp as ccd

SOLVE = {"vertex-face": ccd.vertex_face_ccd, "edge-edge": ccd.edge_edge_ccd}
OPTIONS = [{}, {"minimum_separation": 1e-3}, {"minimum_separation": 1e-2, "start_gap_fraction": 0.3}, {"t_max": 0.6}]
FIELDS = ["toi", "status", "parameters", "gap", "width", "iterations"]


def hard_pairs(kind, each):
    """A few pairs of every family of hard cases."""
    points = [family(kind, each, np.random.default_rng(5)) for family in FAMILIES.values()]
    return [np.concatenate(frames) for frames in zip(*points, strict=True)]


def hanging_points(num_points, count):
    """Points and segments in space, so close to each other that a separation brings them into contact."""
    rng = np.random.default_rng(3)
    start = rng.standard_normal((count, num_points, 3))
    return start, rng.standard_normal((count, num_points, 3)) * 0.1 - start


def results(precision, each=8):
    """The results of pairs of all kinds, with several options."""
    sets = [(SOLVE[kind], hard_pairs(kind, each)) for kind in SOLVE]
    sets += [(ccd.point_segment_ccd, hanging_points(3, 300)), (ccd.point_point_ccd, hanging_points(2, 300))]
    for solve, points in sets:
        for options in OPTIONS:
            yield solve, points, options, solve(*points, precision=precision, **options)
