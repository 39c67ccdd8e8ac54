"""How the benchmarks count missed and late answers: exactly as the oracle decides."""

import math
import sys
from pathlib import Path

import numpy as np
import pytest
from exact import exact_tois
from hard_cases import FAMILIES

sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks"))

from accuracy import ExactTimes, judged


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
            # one rounding each of the rest, the difference and the sum; the oracle refines τ to 80 bits
            assert times.early_by(answer) == pytest.approx(e.early_by(toi), rel=4 * 2**-53, abs=2**-79)


def test_missed_late_and_phantom_are_counted_apart():
    times = ExactTimes(np.array([0.5, 0.5, 0.5, np.inf, np.inf]), np.zeros(5))
    found = judged(times, np.array([np.inf, 0.75, 0.25, 0.1, np.inf]))
    assert [found[name] for name in ("contacts", "missed", "late", "phantom")] == [3, 1, 1, 1]
    assert found["error"]["least_signed"] == -0.25 and found["error"]["max"] == 0.25
