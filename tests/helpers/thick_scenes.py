"""Scenes whose vertices have radii, and the exact times at which their pairs come within their distances."""

import numpy as np
from exact import exact_distance_tois, exact_tois
from oracles import brute_force, corners_of
from scenes import NO_FACES

import ccd_warp as ccd

KIND_NAMES = ("vertex-face", "edge-edge", "point-segment", "point-point")
# A lattice on which sums of radii and distances are exact.
STEP = 2.0**-24


def on_lattice(radius):
    """Radii, rounded so that their sums are exact."""
    return np.round(np.asarray(radius) / STEP) * STEP


def crowd(seed, count=20, motion=0.08, largest=0.04, spread=0.7, **options):
    """Small faces, edges and points at random places with random radii, some 0, or none: mesh, start and end."""
    rng = np.random.default_rng(seed)
    parts = [
        (spread * rng.random((n, 1, 3)) + 0.06 * rng.normal(size=(n, corners, 3))).reshape(-1, 3)
        for n, corners in ((count, 3), (count // 2, 2), (count // 2, 1))
    ]
    faces, edges = np.arange(3 * count).reshape(-1, 3), np.arange(2 * (count // 2)).reshape(-1, 2)
    bodies = [(parts[0], faces), (parts[1], NO_FACES, edges), (parts[2], NO_FACES)]
    start = np.concatenate(parts)
    if largest is not None:
        options["radius"] = on_lattice(largest * rng.random(len(start)) * rng.integers(0, 2, len(start)))
    mesh = ccd.CollisionMesh.from_arrays(bodies, codimensional_points=True, **options)
    return mesh, start, start + motion * rng.normal(size=start.shape)


def crowd_in_plane(seed, count=24, motion=0.05, largest=0.05, **options):
    """Segments and points in the plane with random radii: mesh, start and end."""
    rng = np.random.default_rng(seed)
    segments = (rng.random((count, 1, 2)) + 0.06 * rng.normal(size=(count, 2, 2))).reshape(-1, 2)
    bodies = [
        (segments, np.arange(2 * count).reshape(-1, 2)),
        (0.5 * rng.random((count, 2)), np.zeros((0, 2), dtype=int)),
    ]
    start = np.concatenate([vertices for vertices, _ in bodies])
    radius = on_lattice(largest * rng.random(len(start)) * rng.integers(0, 2, len(start)))
    mesh = ccd.CollisionMesh.from_arrays(bodies, radius=radius, **options)
    return mesh, start, start + motion * rng.normal(size=start.shape)


def distances_of(mesh, kind, pairs, minimum_distance=0.0, radius=None):
    """The distance of each pair: the minimum distance and the largest radius of either primitive."""
    corners, radius = corners_of(mesh, kind, pairs), mesh.radius if radius is None else radius
    split = 2 if kind == ccd.PairKind.EDGE_EDGE else 1
    with np.errstate(over="ignore"):
        return minimum_distance + radius[corners[:, :split]].max(axis=1) + radius[corners[:, split:]].max(axis=1)


def exact_contacts(mesh, start, end, minimum_distance=0.0, radius=None, more=0.0):
    """All pairs that come within their distances and ``more``, by exact arithmetic: (kind, *pair) to the time."""
    end = np.where(mesh.static[mesh.vertex_body][:, None], start, end)
    found = {}
    for kind, pairs in zip(ccd.PairKind, brute_force(mesh, 0 * start, 0 * start), strict=True):
        if not pairs:
            continue
        corners = corners_of(mesh, kind, pairs)
        distances = distances_of(mesh, kind, pairs, minimum_distance, radius) + more
        for is_zero in (True, False):
            at = np.flatnonzero((distances == 0) == is_zero)
            if len(at):
                args = (KIND_NAMES[kind], start[corners[at]], end[corners[at]])
                exact = exact_tois(*args) if is_zero else exact_distance_tois(*args, distances[at])
                found |= {(int(kind), *pairs[i]): e for i, e in zip(at, exact, strict=True) if e.hit}
    return found


def found_contacts(contacts):
    """The toi of each pair that was found, in the same form."""
    return {
        (int(kind), *map(int, pair)): toi
        for kind, pair, toi in zip(contacts.kind, contacts.primitives, contacts.toi.tolist(), strict=True)
    }


def check_contacts(mesh, contacts, exact, beyond):
    """None of the exact contacts is missed or late, and others lie within those ``beyond`` the distances."""
    found = found_contacts(contacts)
    assert exact.keys() <= found.keys()
    assert not any(truth.late(found[key]) for key, truth in exact.items())
    assert found.keys() <= beyond.keys()
