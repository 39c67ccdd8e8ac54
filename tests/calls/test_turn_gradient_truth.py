"""Gradients of tois by poses and twists of rigid bodies, against differences of exact tois in interval arithmetic."""

from dataclasses import replace

import arc_contacts
import arc_paths
import arc_search
import arcs
import numpy as np
import pytest
from arc_pairs import random_pairs
from arc_search import BITS, first_contact
from arc_worlds import step_of
from arcs import paths_of
from flint import ctx
from kept import kept

import ccd_warp as ccd

# The tois of both sides are known to 2e-22, so their difference to some 1e-13 of its size.
MOVE = 1e-9
DISTANCES = {"vertex-face": (0.0, 0.05), "edge-edge": (0.0, 0.05), "point-segment": (0.1,), "point-point": (0.1,)}
CASES = [(kind, distance) for kind, distances in DISTANCES.items() for distance in distances]
MOVED = ("points_b", "points_b_t1", "poses_t0", "poses_t1", "twist")


def _changes(late, early):
    """How much later each pair touches in the first set than in the second; nan where one of them is not certain to."""
    found = np.full(len(late), np.nan)
    for k in range(len(late)):
        with ctx.workprec(BITS):
            times = [first_contact(x.kind, paths_of(x, k), x.distance)[:2] for x in (late, early)]
            if all(hi is not None for _, hi in times):
                (low, by), (low_before, by_before) = times
                found[k] = float((low + by - low_before - by_before) / 2)
    return found


changes = kept(
    _changes, arc_paths, arc_contacts, arc_search, arcs, question_of=lambda *sets: [list(vars(x).items()) for x in sets]
)


def moved_to_both_sides(pairs, rng):
    """The pairs after random moves of all that they are given by, and after the opposite ones."""
    names = [name for name in MOVED if getattr(pairs, name) is not None]
    if pairs.points_b_t1 is None:
        names.remove("points_b")  # points in the frame of a body have no gradient
    moves = {name: MOVE * rng.standard_normal(getattr(pairs, name).shape) for name in names}
    moves["distance"] = MOVE * rng.standard_normal() if pairs.distance else 0.0
    return [replace(pairs, **{name: getattr(pairs, name) + s * dx for name, dx in moves.items()}) for s in (1, -1)]


def predicted(pairs, late, early):
    """The first-order change of each toi from the early to the late pairs; nan where it has no gradient."""
    mesh, start, end, motion, options = step_of(pairs)
    contacts = ccd.mesh_ccd(mesh, start, end, motion=motion, **options).contacts
    gradient = contacts.toi_gradient()
    of_poses = motion.gradient_by_poses(gradient) if pairs.twist is None else motion.gradient_by_twist(gradient)
    side = contacts.bodies % 2
    chosen = (contacts.world[:, None], side)

    def moves(name):
        return getattr(late, name) - getattr(early, name)  # exact, as both are nearly the same

    change = gradient.distance * (late.distance - early.distance)
    for of_body, name in zip(of_poses, ("poses_t0", "poses_t1" if pairs.twist is None else "twist"), strict=True):
        change += (of_body * moves(name)[chosen]).sum(axis=(1, 2))
    if pairs.points_b_t1 is not None:
        for of_points, name in ((gradient.start, "points_b"), (gradient.end, "points_b_t1")):
            moved = np.concatenate([np.zeros_like(pairs.points_a), moves(name)], axis=1).reshape(-1, 3)
            change += (of_points * moved[gradient.vertices]).sum(axis=(1, 2))
    found = np.full(len(pairs), np.nan)
    found[contacts.world[gradient.is_regular]] = change[gradient.is_regular]
    return found


def errors(kind, distance, count, *, other="turning", by_twist=False):
    """Relative errors of the changes of the tois of random pairs that are regular and touch."""
    pairs = random_pairs(kind, 5, count, other=other, by_twist=by_twist, distance=distance)
    late, early = moved_to_both_sides(pairs, np.random.default_rng(3))
    expected = predicted(pairs, late, early)
    regular = np.flatnonzero(np.isfinite(expected))
    found = changes(late[regular], early[regular])
    error = np.abs(expected[regular] / found - 1.0)[np.isfinite(found)]
    assert len(error) > 0.9 * len(regular) and len(regular) > 0.25 * count
    return error


@pytest.mark.parametrize(("kind", "distance"), CASES)
def test_gradients_by_poses_and_by_twists_agree_with_differences_of_the_exact_toi(kind, distance):
    for other, by_twist in (("turning", False), ("deformable", True)):
        found = errors(kind, distance, 8, other=other, by_twist=by_twist)
        assert np.median(found) < 1e-12 and found.max() < 1e-6


@pytest.mark.long
@pytest.mark.parametrize("by_twist", [False, True])
@pytest.mark.parametrize("other", ["turning", "deformable"])
@pytest.mark.parametrize(("kind", "distance"), CASES)
def test_many_gradients_agree_with_differences_of_the_exact_toi(kind, distance, other, by_twist):
    found = errors(kind, distance, 60, other=other, by_twist=by_twist)
    print(f"{len(found)} {kind} {distance} {other} twist={by_twist}: {np.median(found):.1e}, {np.sort(found)[-3:]}")
    # the worst are those whose directions cancel, or that nearly graze
    assert np.median(found) < 1e-12 and np.quantile(found, 0.9) < 1e-9
