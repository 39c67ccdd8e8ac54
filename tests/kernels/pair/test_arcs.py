"""Pairs of primitives on arcs against their truth: nothing is missed or late, in both precisions."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from arc_hostile import FAMILIES, hostile_pairs
from arc_pairs import KINDS, PATHS, prisms, random_pairs, random_sets
from arc_worlds import result_of, step_of
from arcs import answers, check

import ccd_warp as ccd

MEDIAN_ERROR = {"float64": 1e-12, "float32": 1e-5}


def checked(pairs, truth=None, **options):
    """The verdict on what is found of pairs, of which none is missed or late."""
    result = result_of(pairs, **options)
    verdict = check(result.world_toi, answers(pairs if truth is None else truth))
    assert len(verdict.missed) == len(verdict.late) == 0
    return verdict, result


def errors_of(sets, precision):
    found = [checked(pairs, precision=precision)[0] for pairs in sets]
    return np.concatenate([verdict.errors for verdict in found]), sum(len(verdict.false) for verdict in found)


@pytest.mark.parametrize("precision", MEDIAN_ERROR)
def test_random_pairs(precision):
    errors, num_false = errors_of(random_sets(4).values(), precision)
    assert len(errors) > 60
    assert np.median(errors) < MEDIAN_ERROR[precision]
    assert num_false == 0


@pytest.mark.parametrize("family", FAMILIES)
def test_hostile_pairs(family):
    for k, kind in enumerate(KINDS):
        checked(hostile_pairs(family, kind, 6), precision=list(MEDIAN_ERROR)[k % 2])
    checked(hostile_pairs(family, "edge-edge", 4, 0.03))


@pytest.mark.parametrize("precision", MEDIAN_ERROR)
@pytest.mark.parametrize("distance", [0.0, 0.1])
@pytest.mark.parametrize(("path", "other", "by_twist"), [*product(PATHS, ("turning", "deformable"), (False, True))])
def test_bodies_that_turn_in_the_plane_meet_when_prisms_on_them_do(path, other, by_twist, distance, precision):
    """Points are edges across the plane, so the truth in space is that in the plane."""
    options = {"path": path, "other": other, "by_twist": by_twist, "distance": distance, "in_plane": True}
    pairs = random_pairs("point-segment", 7, 8, **options)
    verdict, _ = checked(pairs, prisms(pairs), in_plane=True, precision=precision)
    assert len(verdict.errors) > 3 and np.median(verdict.errors) < MEDIAN_ERROR[precision] and not len(verdict.false)
    places = [x.copy() for x in (pairs.poses_t0, pairs.poses_t1) if x is not None]
    for x in places:
        x[..., :2] += [1e4, -7e3]
    far = replace(pairs, poses_t0=places[0], poses_t1=None if by_twist else places[1])
    if other == "turning":
        checked(far, prisms(far), in_plane=True, precision=precision)
        if by_twist:  # as if both were one body
            spin = pairs.twist.copy()
            spin[:, 1, 3:] = spin[:, 0, 3:]
            pairs = replace(pairs, twist=spin)
            checked(pairs, prisms(pairs), in_plane=True, precision=precision)
        if distance:
            points = random_pairs("point-point", 8, 8, **options)
            checked(points, in_plane=True, precision=precision)


@pytest.mark.long
@pytest.mark.parametrize("precision", MEDIAN_ERROR)
def test_five_thousand_random_pairs_and_more_than_three_thousand_hostile_ones(precision):
    errors, _ = errors_of(random_sets(130).values(), precision)
    assert np.median(errors) < MEDIAN_ERROR[precision]
    for family in FAMILIES:
        for kind in KINDS:
            checked(hostile_pairs(family, kind, 50), precision=precision)


def test_a_common_spin_is_no_motion():
    """In the world the chords of both come closer by far more than the gap; no pair reaches a limit or is cut short."""
    for kind in KINDS:
        verdict, result = checked(hostile_pairs("common_spin", kind, 30), precision="float64", max_iterations=60)
        assert (result.contacts.status <= 2).all()
        assert len(verdict.errors) == 0 or np.median(verdict.errors) < 1e-4


def test_a_turn_by_nothing_is_straight_motion():
    """All poses are given, and none of the bodies turns; tois are those of straight motion, but for rounding."""
    pairs = random_pairs("edge-edge", 5, 40, by_twist=True)
    twist = pairs.twist.copy()
    twist[..., 3:] = 0.0
    pairs = type(pairs)(**{**vars(pairs), "twist": twist})
    mesh, start, end, motion, options = step_of(pairs)
    on_arcs = ccd.mesh_ccd(mesh, start, end, motion=motion, **options).world_toi
    paths = motion._body_paths
    ends = [paths.positions(mesh.vertices, mesh.vertex_body, t) for t in (0.0, 1.0)]
    straight = ccd.mesh_ccd(mesh, *ends, **options).world_toi
    assert np.isfinite(straight).sum() > 5
    assert (np.isfinite(straight) == np.isfinite(on_arcs)).all()
    touches = np.isfinite(straight)
    assert np.abs(straight[touches] - on_arcs[touches]).max() < 1e-10


def test_tois_are_continuous_where_a_turn_vanishes():
    pairs = random_pairs("vertex-face", 6, 40, by_twist=True)
    tois = []
    for share in (1e-3, 1e-6, 1e-9, 1e-300, 0.0):
        twist = pairs.twist.copy()
        twist[..., 3:] *= share
        tois.append(result_of(type(pairs)(**{**vars(pairs), "twist": twist})).world_toi)
    touches = np.isfinite(tois).all(axis=0)
    assert touches.sum() > 5
    for share, toi in zip((1e-3, 1e-6, 1e-9, 1e-300), tois, strict=False):
        assert np.quantile(np.abs(toi - tois[-1])[touches], 0.9) < 100 * share + 1e-11


def test_iterations_that_are_spent_leave_what_was_proved():
    """A limit of one iteration: nothing is late, and the status says so."""
    pairs = random_pairs("edge-edge", 8, 60)
    _, result = checked(pairs, max_iterations=1)
    assert (result.contacts.status == int(ccd.CCDStatus.ITERATION_LIMIT)).any()
