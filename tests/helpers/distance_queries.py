"""Queries against the exact oracles, in the norm and with the options of the call: what is missed, late or too early.

A query fails if it is

- missed: the exact trajectories come within the distance, and toi is inf;
- late: toi is after the exact time;
- phantom: at a finite toi, no limit reached, the exact distance is above distance + tolerance + 100 u · size, with the
  unit roundoff u; the kernel accepts at ten rounding bounds of at most 8.25 u each on every axis
  (kernels/pair/rounding.py);
- gap: the reported bound of the gap is below the exact one.
"""

import numpy as np
from distance_oracle import exact_distance
from exact import exact_distance_tois, exact_tois
from oracle import exact_gap

import ccd_warp as ccd

SOLVE = {"vertex-face": ccd.vertex_face_ccd, "edge-edge": ccd.edge_edge_ccd}
SOLVE |= {"point-segment": ccd.point_segment_ccd, "point-point": ccd.point_point_ccd}
UNIT_ROUNDOFF = {"float64": 2.0**-53, "float32": 2.0**-24}
# Kinds, and the dimensions in which they are defined.
KINDS = (("vertex-face", 3), ("edge-edge", 3))
KINDS += tuple((kind, dimension) for kind in ("point-segment", "point-point") for dimension in (2, 3))
LIMITS = (ccd.CCDStatus.ITERATION_LIMIT, ccd.CCDStatus.RESOLUTION_LIMIT)


def size_of(points_t0, points_t1):
    """Longest side of the box around each query's motion: its default length scale."""
    both = np.concatenate([points_t0, points_t1], axis=1)
    return (both.max(axis=1) - both.min(axis=1)).max(axis=1)


def named_vector(kind, points_t0, points_t1, result):
    """The vector between the points that the parameters name, at toi."""
    t = np.minimum(result.toi, 1.0)[:, None, None]
    x = ((1 - t) * points_t0 + t * points_t1).transpose(1, 0, 2)
    u, v = result.parameters.T[..., None]
    if kind == "vertex-face":
        return x[0] - ((1 - u - v) * x[1] + u * x[2] + v * x[3])
    if kind == "edge-edge":
        return (1 - u) * x[0] + u * x[1] - ((1 - v) * x[2] + v * x[3])
    return x[0] - ((1 - u) * x[1] + u * x[2] if kind == "point-segment" else x[1])


def failures(kind, points_t0, points_t1, *, checks_gap=False, **options):
    """Failures as (query, what, numbers) of one call; its result, and the exact times."""
    result = SOLVE[kind](points_t0, points_t1, **options)
    size, t_max = size_of(points_t0, points_t1), options.get("t_max", 1.0)
    length = np.full(len(size), options["length_scale"]) if "length_scale" in options else size
    if options.get("minimum_distance"):
        distance, gap_at, norm = np.full(len(size), options["minimum_distance"]), exact_distance, np.linalg.norm
        exact = exact_distance_tois(kind, points_t0, points_t1, options["minimum_distance"], t_max)
    else:
        separation = options.get("minimum_separation", 0.0)
        distance, gap_at = separation * length, exact_gap
        if "length_scale" not in options and separation:
            raise ValueError("a minimum_separation has a length_scale here")
        exact = exact_tois(kind, points_t0, points_t1, separation * options.get("length_scale", 1.0), t_max)

        def norm(vectors, axis):
            return np.abs(vectors).max(axis=axis)

    unit = UNIT_ROUNDOFF[options.get("precision", "float64")]
    bound = distance + options.get("tolerance", 1e-6) * length + 100 * unit * (size + distance)
    # what the kernel reports as a gap is formed from a distance that it has rounded up by 16 u
    reported = (distance + result.gap) * (1 + 32 * unit) + 5e-324
    with np.errstate(all="ignore"):  # no pair is farther apart than two of its points
        near = norm(named_vector(kind, points_t0, points_t1, result), axis=1)
        near += 2.0**-46 * np.abs([points_t0, points_t1]).max(axis=(0, 2, 3))
        is_inside = (result.parameters >= 0).all(axis=1) & (result.parameters.max(axis=1) <= 1)
        is_inside &= (kind != "vertex-face") | (result.parameters.sum(axis=1) <= 1)
        is_certain = is_inside & (near <= bound) & (not checks_gap)
    found = []
    for i, (truth, toi) in enumerate(zip(exact, result.toi.tolist(), strict=True)):
        if truth.hit and toi == np.inf:
            found.append((i, "missed", truth))
        elif truth.late(toi):
            found.append((i, "late", toi, -truth.early_by(toi)))
        if toi == np.inf or is_certain[i]:
            continue
        gap = gap_at(kind, points_t0[i], points_t1[i], toi)
        if result.status[i] not in LIMITS and gap > bound[i]:
            found.append((i, "phantom", toi, gap, bound[i]))
        if checks_gap and gap > reported[i] and result.width[i] == 0.0:
            found.append((i, "gap", toi, gap, reported[i]))
    return found, result, exact
