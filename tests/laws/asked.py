"""Drawn scenes that several laws ask about, and which pairs of them come near by what a step asks for."""

from functools import cache

import numpy as np

import ccd_warp as ccd
from laws.scenes import drawn
from laws.truth import NAMES, Pairs, boxes_come_near, distances_at

SEEDS = [*range(160), 31008, 50086, 60385]


@cache
def scene_of(seed):
    """A drawn scene, its mesh and positions, and the pairs that may meet."""
    scene = drawn(seed)
    mesh, start, end = scene.make()
    return scene, mesh, start, end, Pairs(mesh)


def kinds_of(scene):
    """The kinds of pairs that a scene asks for."""
    names = scene.options.get("pair_kinds") or [kind.name.lower() for kind in ccd.PairKind]
    return [ccd.PairKind[name.upper()] for name in names]


def near_pairs(scene, start, end, pairs, keeps=None):
    """Kind, pairs, corners and distances of all pairs of two primitives that come near their distances.

    Distances are those of the scene; with a fraction of the gap at the start these are reduced to it; ``keeps`` tells
    the holds of vertices, as shares and lengths, of which the least reduce those of pairs as well.
    """
    fraction = scene.options["start_gap_fraction"]
    for kind, of_kind in enumerate(pairs.of_kinds):
        if ccd.PairKind(kind) not in kinds_of(scene):
            continue
        corners, distances = pairs.corners(kind, of_kind), scene.distance + pairs.radii(kind, of_kind)
        at = boxes_come_near(start[corners], end[corners], 2 if kind == 1 else 1, distances)
        of_kind, corners, distances = of_kind[at], corners[at], distances[at]
        if isinstance(fraction, float) and len(corners) and distances.any():
            gaps = distances_at(NAMES[kind], start[corners], end[corners], np.zeros(len(corners)), scene.is_euclidean)
            distances = np.minimum(distances, fraction * gaps)
        if keeps is not None:
            share, length = keeps[corners].min(axis=1, initial=np.inf).T
            distances = np.where(share < 1, np.maximum(share * distances, np.minimum(length, distances)), distances)
        yield kind, of_kind, corners, distances
