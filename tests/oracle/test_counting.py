"""How the benchmarks count missed and late answers: exactly as the oracle decides."""

import math
import sys
from pathlib import Path

import numpy as np
import pytest
from exact import exact_tois
from hard_cases import FAMILIES

import ccd_warp as ccd

sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks"))

from accuracy import ExactTimes, corners_of, first_contact, judged


@pytest.mark.parametrize("family", ["random_colliding", "touching_at_start", "lattice", "one_ulp_neighbours"])
def test_exact_times_decide_late_as_the_oracle_does(family):
    exact = exact_tois("edge-edge", *FAMILIES[family]("edge-edge", 60, np.random.default_rng(3)))
    times = ExactTimes.from_oracle(exact)
    assert times.hit.tolist() == [e.hit for e in exact]
    for i, e in ((i, e) for i, e in enumerate(exact) if e.hit):
        below = float(times.below[i])
        for toi in (below, math.nextafter(below, -1), math.nextafter(below, 2), 0.0, 1.0):
            answer = np.full(len(exact), np.inf)
            answer[i] = toi
            assert times.faults(answer)["late"] == int(e.late(toi))
            # one rounding each of the rest, the difference and the sum
            assert times.early_by(answer) == pytest.approx(e.early_by(toi), rel=4 * 2**-53, abs=2**-79)


def test_missed_late_and_phantom_are_counted_apart():
    times = ExactTimes(np.array([0.5, 0.5, 0.5, np.inf, np.inf]), np.zeros(5))
    found = judged(times, np.array([np.inf, 0.75, 0.25, 0.1, np.inf]))
    assert [found[name] for name in ("contacts", "missed", "late", "phantom")] == [3, 1, 1, 1]
    assert found["error"]["least_signed"] == -0.25 and found["error"]["max"] == 0.25


@pytest.mark.parametrize("seed", range(4))
def test_the_first_contact_of_a_step_is_the_least_exact_toi_of_its_pairs(seed):
    """Whichever pair is named as likely to be first, also one that is last, and none."""
    rng = np.random.default_rng(seed)
    bodies = [(rng.standard_normal((3, 3)) + 3 * rng.standard_normal(3), [[0, 1, 2]]) for _ in range(24)]
    mesh = ccd.CollisionMesh.from_arrays(bodies)
    start = mesh.vertices
    end = start + np.repeat(3 * rng.standard_normal((24, 3)), 3, axis=0) + 0.1 * rng.standard_normal(start.shape)
    found = ccd.find_candidates(mesh, start, end)
    of_kinds = {"vertex-face": found.vertex_face, "edge-edge": found.edge_edge}
    corners = {kind: corners_of(mesh, kind, pairs) for kind, pairs in of_kinds.items()}
    all_tois = [ExactTimes.from_oracle(exact_tois(kind, start[c], end[c])) for kind, c in corners.items()]
    contacts, none = ccd.mesh_ccd(mesh, start, end).contacts, np.zeros((0, 2), int)
    likely = [None, contacts[int(np.argmin(contacts.toi))], contacts[int(np.argmax(contacts.toi))]]
    for chosen, tried in (((0, 1), likely), ((0,), [None]), ((1,), [None])):
        least = min(pair for k in chosen for pair in zip(all_tois[k].below, all_tois[k].remainder, strict=True))
        pairs = [of_kind if k in chosen else none for k, of_kind in enumerate(of_kinds.values())]
        for contact in tried:
            times = first_contact(mesh, start, end, tuple(pairs), contact)
            assert (times.below[0], times.remainder[0]) == least
    assert sum(times.hit.sum() for times in all_tois) > 5
    free = [pairs[np.isinf(times.below)] for pairs, times in zip(of_kinds.values(), all_tois, strict=True)]
    assert not first_contact(mesh, start, end, tuple(free), None).hit[0] and min(map(len, free)) > 10
