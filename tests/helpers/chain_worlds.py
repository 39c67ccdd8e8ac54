"""Pairs of primitives on the links of an arm as a mesh, each in a world of its own, for one call."""

import numpy as np
from chain_pairs import ChainPairs
from laws.turning import SPACE

import ccd_warp as ccd


def motion_of(pairs: ChainPairs) -> ccd.JointMotion:
    """The motion of the two links, with a world a pair."""
    arm = zip(pairs.joints, pairs.axes, pairs.origins, strict=True)
    joints = [ccd.Joint(f"joint {k}", f"link {k}", f"link {k + 1}", *rest) for k, rest in enumerate(arm)]
    return ccd.JointMotion(joints, pairs.q0, pairs.q1, links=[f"link {pairs.link_a}", f"link {pairs.link_b}"])


def step_of(pairs: ChainPairs) -> tuple[ccd.CollisionMesh, ccd.JointMotion, dict]:
    """Mesh, motion and options of a call for pairs of one kind; ``world_toi`` is the toi of each pair."""
    n, sides = len(pairs), [pairs.points_a, pairs.points_b]
    mesh = ccd.CollisionMesh.from_arrays(
        [SPACE[side.shape[1]](side[k]) for k in range(n) for side in sides],
        rigid=range(2 * n),
        codimensional_points=True,
        vertex_world=np.repeat(np.arange(n), sum(side.shape[1] for side in sides)),
    )
    options = {"pair_kinds": [pairs.kind.replace("-", "_")], "device": "cpu"}
    if pairs.distance > 0:
        options["minimum_distance"] = pairs.distance
    return mesh, motion_of(pairs), options
