"""Pairs of primitives on arcs as a mesh, each in a world of its own, for one call."""

import numpy as np
from arc_pairs import ArcPairs

import ccd_warp as ccd

_BODIES = {
    1: lambda x: (x, np.zeros((0, 3), dtype=int)),
    2: lambda x: (x, np.zeros((0, 3), dtype=int), [[0, 1]]),
    3: lambda x: (x, [[0, 1, 2]]),
}
_BODIES_IN_PLANE = {
    count: lambda x, edges=[[0, 1]][: count - 1]: (x[:, :2], np.reshape(edges, (-1, 2))) for count in (1, 2)
}


def step_of(
    pairs: ArcPairs, *, in_plane: bool = False
) -> tuple[ccd.CollisionMesh, np.ndarray, np.ndarray, ccd.RigidMotion, dict]:
    """Mesh, positions at both ends, motion and options of a call for pairs of one kind; a mesh in the plane z = 0."""
    n, is_deformable = len(pairs), pairs.points_b_t1 is not None
    sides = [pairs.points_a, pairs.points_b]
    body_of = _BODIES_IN_PLANE if in_plane else _BODIES
    bodies = [body_of[side.shape[1]](side[k]) for k in range(n) for side in sides]
    mesh = ccd.CollisionMesh.from_arrays(
        bodies,
        rigid=range(0, 2 * n, 2) if is_deformable else range(2 * n),
        codimensional_points=not in_plane,
        vertex_world=np.repeat(np.arange(n), sum(side.shape[1] for side in sides)),
    )
    end = mesh.vertices
    if is_deformable:
        end = np.concatenate([pairs.points_a, pairs.points_b_t1], axis=1).reshape(-1, 3)[:, : mesh.dimension]
    chosen = slice(0, 1) if is_deformable else slice(0, 2)

    def rows(values):
        return None if values is None else values[:, chosen].reshape(-1, values.shape[2])

    pivot = rows(pairs.pivot) if pairs.path == "linear" else None
    twist = rows(pairs.twist)
    motion = ccd.RigidMotion(rows(pairs.poses_t0), rows(pairs.poses_t1), path=pairs.path, pivot=pivot, twist=twist)
    options = {"pair_kinds": [pairs.kind.replace("-", "_")], "device": "cpu"}
    if pairs.distance > 0:
        options["minimum_distance"] = pairs.distance
    return mesh, mesh.vertices, end, motion, options


def result_of(pairs: ArcPairs, *, in_plane: bool = False, **further) -> ccd.MeshResult:
    """What `mesh_ccd` finds; ``world_toi`` is the toi of each pair."""
    mesh, start, end, motion, options = step_of(pairs, in_plane=in_plane)
    return ccd.mesh_ccd(mesh, start, end, motion=motion, **options, **further)
