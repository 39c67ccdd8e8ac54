"""The oracle of trajectories that turn, against times known by analysis and against dense samples."""

import math
from itertools import product

import arc_samples
import numpy as np
import pytest
from arc_contacts import Feature
from arc_hostile import FAMILIES, hostile_pairs
from arc_pairs import KINDS, PATHS, ArcPairs, quaternion, random_pairs
from arc_paths import Basis, StraightPath, short
from arc_samples import first_contact_seen, gaps, least_gap
from arc_search import Parts, Search, first_contact
from arcs import Answers, answers, check, paths_of, solve
from flint import arb, arb_poly, ctx
from kept import kept


def _question(pairs, *arguments):
    return vars(pairs), arguments


seen_first = kept(first_contact_seen, arc_samples, question_of=_question)
least_gap_of = kept(least_gap, arc_samples, question_of=_question)
AT_REST = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
WALL = [[0.0, -9.0, -9.0], [0.0, 9.0, -9.0], [0.0, 0.0, 9.0]]  # in the plane x = 0


def one(kind, a, b, *, end=None, start=AT_REST, twist=None, path="linear", pivot=(0, 0, 0), distance=0.0, end_b=None):
    """A pair whose second body is at rest, or deformable with an end."""
    points = [np.array(side, dtype=float).reshape(1, -1, 3) for side in (a, b)]
    poses_t0 = np.array([[start, AT_REST]], dtype=float)
    poses_t1 = None if end is None else np.array([[end, AT_REST]], dtype=float)
    twists = None if twist is None else np.array([[twist, [0.0] * 6]], dtype=float)
    pivots = np.array([[pivot, (0, 0, 0)]], dtype=float)
    ends = None if end_b is None else np.array([end_b], dtype=float)
    return ArcPairs(kind, *points, poses_t0, poses_t1, pivots, path, twists, ends, distance)


def touches_at(pair, expected):
    answer = solve(pair)
    assert answer.touches.all() and (answer.width <= 1e-20).all()
    assert abs(answer.lo[0] - expected) <= 2e-16  # the rounding of what is expected, and of the answer
    assert answer.lo[0] <= answer.hi[0]


def test_a_clock_hand_meets_a_wall():
    """From the direction x to the plane x = 0 are 90 degrees."""
    for turn in (2.0, 3.0, 6.5, 100.0):
        touches_at(one("vertex-face", [2, 0, 1], WALL, twist=[0, 0, 0, 0, 0, turn]), math.pi / 2 / turn)
    assert solve(one("vertex-face", [2, 0, 1], WALL, twist=[0, 0, 0, 0, 0, 1.5])).free.all()
    assert solve(one("vertex-face", [2, 0, 50], WALL, twist=[0, 0, 0, 0, 0, 50.0])).free.all()


def test_a_clock_hand_turns_the_short_way_between_two_poses():
    for sign in (1, -1):
        end = [0, 0, 0, *(sign * quaternion(np.array([0.0, 0.0, 2.5])))]
        touches_at(one("vertex-face", [2, 0, 1], WALL, end=end), math.pi / 2 / 2.5)
    # 5 rad are 1.28 rad the other way, which do not reach the wall
    assert solve(one("vertex-face", [2, 0, 1], WALL, end=[0, 0, 0, *quaternion(np.array([0, 0, 5.0]))])).free.all()


def test_a_hand_turns_about_its_pivot():
    """The tip is 3 from the pivot at (3, 0, 0), and at x = 0.5 where the cosine is −2.5/3."""
    wall = [[0.5, *p[1:]] for p in WALL]
    pair = one("vertex-face", [4, 0, 0], wall, pivot=(1, 0, 0), twist=[0, 0, 0, 0, 0, 3.0], start=[2, 0, 0, 0, 0, 0, 1])
    touches_at(pair, math.acos(-2.5 / 3) / 3.0)


def test_two_clock_hands_cross():
    """An edge that turns meets one that rises with constant speed, and is where it is at a known angle."""
    hand, bar = [[0.5, 0, 0], [2, 0, 0]], [[0, 1, -1], [0, 1, 1]]
    touches_at(one("edge-edge", hand, bar, twist=[0, 0, 0, 0, 0, 2.0]), math.pi / 4)
    rising = one("edge-edge", hand, np.array(bar) - [0, 0, 3], twist=[0, 0, 0, 0, 0, 2.0], end_b=np.array(bar))
    touches_at(rising, math.pi / 4)  # the bar has risen by 2.4, so that it reaches from -1.6 to 0.4
    assert solve(one("edge-edge", hand, np.array(bar) + [0, 0, 1.5], twist=[0, 0, 0, 0, 0, 2.0])).free.all()


def test_a_wheel_rolls():
    """A point of the rim, at the top, comes down to half the radius after a third of a turn, wherever it has rolled."""
    ground = [[-99.0, -99.0, 0.5], [99.0, -99.0, 0.5], [0.0, 99.0, 0.5]]
    pair = one("vertex-face", [0, 0, 1], ground, start=[0, 0, 1, 0, 0, 0, 1], twist=[0, 5.0, 0, -5.0, 0, 0])
    touches_at(pair, 2 * math.pi / 3 / 5)


def test_a_nut_is_screwed_down_to_a_plate():
    """A screw turns by 2 rad and sinks by 1: its lower face, 0.75 above the plate, gets there after 3/4."""
    plate = [[-9.0, -9.0, -0.75], [9.0, -9.0, -0.75], [0.0, 9.0, -0.75]]
    end = [math.cos(2.0), math.sin(2.0), -1.0, *quaternion(np.array([0.0, 0.0, 2.0]))]
    touches_at(one("vertex-face", [0, 1, 0], plate, start=[1, 0, 0, 0, 0, 0, 1], end=end, path="screw"), 0.75)


def test_a_screw_leads_its_origin_along_an_arc():
    """The axis is that of the poses, z, one from the body's origin, which reaches x = 0 after 90 degrees; a chord
    would be there earlier."""
    end = [math.cos(2.0), math.sin(2.0), 0, *quaternion(np.array([0.0, 0.0, 2.0]))]
    pair = one("vertex-face", [0, 0, 0], WALL, start=[1, 0, 0, 0, 0, 0, 1], end=end, path="screw")
    assert abs(solve(pair).lo[0] - math.pi / 4) < 1e-15  # the end pose is rounded
    twist = one("vertex-face", [0, 0, 0], WALL, start=[1, 0, 0, 0, 0, 0, 1], twist=[0, 2, 0, 0, 0, 2], path="screw")
    touches_at(twist, math.pi / 4)


def test_points_meet_within_a_distance():
    """On a circle of radius 1, a chord of 0.5 from (−1, 0) has an angle of 2 asin(1/4)."""
    for turn in (3.2, 30.0):
        pair = one("point-point", [1, 0, 0], [-1, 0, 0], twist=[0, 0, 0, 0, 0, turn], distance=0.5)
        touches_at(pair, (math.pi - 2 * math.asin(0.25)) / turn)
        across = one("point-segment", [1, 0, 0], [[-1, 0, 2], [-1, 0, -3]], twist=[0, 0, 0, 0, 0, turn], distance=0.5)
        touches_at(across, (math.pi - 2 * math.asin(0.25)) / turn)
    assert solve(one("point-point", [1, 0, 0], [-1, 0, 0.6], twist=[0, 0, 0, 0, 0, 4.0], distance=0.5)).free.all()


def test_faces_and_edges_meet_within_a_distance():
    touches_at(one("vertex-face", [2, 0, 1], WALL, twist=[0, 0, 0, 0, 0, 2.0], distance=1.0), math.acos(0.5) / 2)
    hand, bar = [[0.5, 0, 0], [2, 0, 0]], [[0, 1, -1], [0, 1, 1]]
    # the line of the hand passes (0, 1) at the distance |cos|
    expected = (math.pi / 2 - math.asin(0.25)) / 2
    touches_at(one("edge-edge", hand, bar, twist=[0, 0, 0, 0, 0, 2.0], distance=0.25), expected)


@pytest.mark.parametrize("margin", [1e-3, 1e-9, 1e-15, -1e-15, -1e-9, -1e-3])
def test_a_grazing_circle(margin):
    """The circle of radius 1 + margin about z and the plane x = 1, the direction x coming in the middle of the step."""
    wall = [[1.0, *p[1:]] for p in WALL]
    start = [0, 0, 0, *quaternion(np.array([0.0, 0.0, -1.0]))]
    answer = solve(one("vertex-face", [1 + margin, 0, 0], wall, start=start, twist=[0, 0, 0, 0, 0, 2.0]))
    assert answer.touches.all() == (margin > 0) and answer.free.all() == (margin < 0)
    if margin > 0:
        assert abs(answer.lo[0] - 0.5 * (1 - math.acos(1 / (1 + margin)))) < 1e-8


def test_what_touches_in_one_time_is_undecided():
    """A circle touches a plane exactly at t = 1/2, since the poses are symmetric; their quaternions are not unit."""
    wall = [[1.0, *p[1:]] for p in WALL]
    answer = solve(one("vertex-face", [1, 0, 0], wall, start=[0, 0, 0, 0, 0, -1, 2], end=[0, 0, 0, 0, 0, 1, 2]))
    assert answer.undecided.all() and 0.5 - 1e-12 < answer.lo[0] <= 0.5


def test_what_comes_after_a_doubt_is_found():
    """A function that touches zero at 1/3, which no interval tells from missing it, and is positive after 3/4."""
    with ctx.workprec(256):
        feature = Feature((), (lambda at: (at.time - arb(1) / 3) * (at.time - arb(1) / 3) * (at.time - arb(0.75)),))
        at_rest = StraightPath(WALL, WALL)
        found = Search(feature, (at_rest, at_rest), "vertex-face", arb(0), arb(1))
        assert 0.333 < found.lo < arb(1) / 3 and 0.75 <= found.hi and found.hi - 0.75 < 1e-20


def test_a_contact_at_the_start_is_at_zero():
    for twist in ([0, 0, 0, 0, 0, 3.0], [1.0, 0, 0, 0, 2.0, 0]):
        answer = solve(one("vertex-face", [0, 0, 1], WALL, twist=twist))
        assert answer.lo[0] == answer.hi[0] == 0.0


def test_edges_on_one_line_prove_no_contact():
    """All conditions of a crossing hold where the normal vanishes; they meet at t = 1/2, or never."""
    edge = np.array([[-1.0, 0, 0], [1, 0, 0]])
    assert solve(one("edge-edge", edge, edge + [5, 0, 0], twist=[0] * 6, end_b=edge + [3, 0, 0])).free.all()
    answer = solve(one("edge-edge", edge, edge + [3, 0, 0], twist=[0] * 6, end_b=edge + [1, 0, 0]))
    assert answer.undecided.all() and 0.5 - 1e-12 < answer.lo[0] <= 0.5


@pytest.mark.parametrize("gap", [1e-3, 1e-9])
def test_parallel_edges_spin_together(gap):
    """Nothing but a direction that turns with them tells in few intervals that they do not meet."""
    edge, twist = np.array([[-1.0, 1, 0], [1, 1, 0]]), [0, 0, 0, 1.0, 2.0, 5.0]
    pair = one("edge-edge", edge, edge + [0.25, 0, gap], twist=twist)
    pair.twist[:, 1] = twist
    with ctx.workprec(256):
        lo, hi, looks = first_contact("edge-edge", paths_of(pair, 0))
    assert lo is None and hi is None and looks < 40


def test_a_turn_in_the_plane_of_the_face():
    """The vertex never leaves the plane z = 0, and comes in across the side x = 0."""
    face = [[0.0, 0.5, 0.0], [0.0, 3.0, 0.0], [-3.0, 1.0, 0.0]]
    touches_at(one("vertex-face", [1, 0, 0], face, twist=[0, 0, 0, 0, 0, 2.0]), math.pi / 4)


@pytest.mark.parametrize("turn", [1e-300, 1e-160, 1e-12, 1e-8, 3e-8, 1e-7])
def test_a_tiny_turn_is_nearly_none(turn):
    """A point that falls by 1, and by `turn` times its arm of 1 to first order."""
    ground = [[-9.0, -9.0, -0.5], [9.0, -9.0, -0.5], [0.0, 9.0, -0.5]]
    pair = one("vertex-face", [1, 0, 0], ground, twist=[0, 0, -1, 0, turn, 0])
    assert abs(solve(pair).lo[0] - 0.5 / (1 + turn)) < 2e-15


def test_samples_of_random_pairs_say_the_same():
    """Where samples see a contact first, and that they see none where the oracle says that there is none."""
    kinds = [*product(KINDS, (None,)), ("vertex-face", 0.3), ("edge-edge", 0.3)]
    for seed, ((kind, distance), path, other) in enumerate(product(kinds, PATHS, ("turning", "deformable"))):
        options = {"path": path, "other": other, "by_twist": seed % 2 == 0, "distance": distance}
        pairs = random_pairs(kind, seed, 8, **options)
        answer, seen = answers(pairs), seen_first(pairs, 150)
        assert not answer.undecided.any() and answer.touches.sum() >= 2
        np.testing.assert_array_equal(answer.touches, np.isfinite(seen))
        hit = answer.touches
        np.testing.assert_allclose(answer.lo[hit], seen[hit].astype(float), rtol=0, atol=1e-9)
        assert (answer.width[hit] < 1e-20).all()


def test_each_feature_is_met():
    """A point or an edge that comes straight to a face or an edge from beyond each of their sides and ends."""
    face, far = np.array([[0.0, 0, 0], [4, 0, 0], [0, 3, 0]]), 5.0
    for place, way in (
        ([0, 0], [-1, -1]),
        ([4, 0], [1, -0.2]),
        ([0, 3], [-0.2, 1]),
        ([2, 0], [0, -1]),
        ([0, 1], [-1, 0]),
    ):
        way = np.array([*way, 0]) / np.linalg.norm(way)
        start = np.array([*place, 0]) + (far + 0.5) * way
        pair = one(
            "vertex-face", [0, 0, 0], face, start=[*start, *AT_REST[3:]], twist=[*(-10 * way), 0, 0, 0], distance=0.5
        )
        assert abs(solve(pair).lo[0] - 0.5) < 1e-15
    edge, across, askew = [[-1, 0, 0], [1, 0, 0]], [[0, 0, 0], [0, 2, 0]], [[0, 0, 0], [2, 0.5, 0.3]]
    for a, b, way in (
        (edge, across, [0, 1, 0]),  # an end of B comes to the inside of A
        (across, edge, [0, -1, 0]),
        (edge, np.array(askew) + [1, 0, 0], [1, 0, 0]),  # two ends
        (np.array(edge) + [1, 0, 0], np.array(edge) - [1, 0, 0], [-1, 0, 0]),
    ):
        end = np.array(b) + 0.5 * np.array(way)
        start = end + 5 * np.array(way)
        pair = one("edge-edge", a, start, twist=[0] * 6, end_b=end - 5 * np.array(way), distance=0.5)
        assert abs(solve(pair).lo[0] - 0.5) < 1e-15


@pytest.mark.parametrize("name", FAMILIES)
def test_samples_of_hostile_pairs_do_not_contradict(name):
    """No contact is claimed where there is a gap, and no gap is seen to vanish before."""
    for kind in KINDS:
        pairs = hostile_pairs(name, kind, 2)
        answer = answers(pairs)
        # of the roundings of positions in extended precision, and of the time in float64
        points = [np.abs(x).max(axis=(1, 2)) for x in (pairs.points_a, pairs.points_b, pairs.poses_t0)]
        speed = 1 if pairs.twist is None else 1 + np.abs(pairs.twist).max(axis=(1, 2))
        error = 1e-17 * np.max(points, axis=0) + 1e-15 * speed
        assert (least_gap_of(pairs[answer.free], None, 100) > -error[answer.free]).all()
        hit = answer.touches & (answer.lo > 0)
        at = gaps(pairs[hit], answer.lo[hit][:, None])[:, 0]
        assert (np.abs(at) <= 50 * error[hit]).all()
        assert (least_gap_of(pairs[hit], answer.lo[hit], 100) >= -50 * error[hit]).all()


@pytest.mark.parametrize("theta", [0.0, 1e-300, 3e-8, 1e-7, 0.3, 3.0, 300.0])
def test_a_basis_encloses_sine_and_cosine(theta):
    """At all times of the interval, of which half a turn by 1.5 rad is the longest."""
    exact, middle = arb(theta), arb(0.5)
    half = arb(min(0.5, 1.5 / max(theta, 1.0)))
    with ctx.workprec(256):
        basis = Basis(exact, middle, half)
    with ctx.workprec(2600):  # 1 − cos θ has 600 digits less for θ = 1e-300
        for s in np.linspace(-1, 1, 9):
            t = middle + half * float(s)
            sine, cosine = (exact * t).sin_cos()
            first, second = (t, t * t / 2) if theta == 0.0 else (sine / exact, (1 - cosine) / (exact * exact))
            for polynomial, value in ((basis.t, t), (basis.sigma1, first), (basis.sigma2, second)):
                found = polynomial(arb(float(s)))
                assert found.contains(value.mid()) and found.rad() < 1e-8


def test_parts_of_an_interval_are_where_a_function_holds():
    """Random polynomials, at whose samples the conditions are known."""
    rng = np.random.default_rng(0)
    samples = np.linspace(-1, 1, 41).tolist()
    counts = [0, 0]
    for _ in range(300):
        values = rng.standard_normal(6) * 0.4 ** np.arange(6)
        p = arb_poly([arb(float(value)) for value in values])
        parts, zero = Parts(), Parts()
        parts.not_negative(p)
        zero.zero(p)
        signs = [(s, p(arb(s))) for s in samples]
        assert all(short(p * p * p)(arb(s)).overlaps(value**3) for s, value in signs)
        assert all(parts.may[0] <= s <= parts.may[1] for s, value in signs if value >= 0)
        assert all(value >= 0 for s, value in signs if parts.does[0] <= s <= parts.does[1])
        outside = (
            [value > 0 for s, value in signs if s < zero.may[0]],
            [value > 0 for s, value in signs if s > zero.may[1]],
        )
        assert all(len({*side}) <= 1 for side in outside)
        if zero.root is not None:
            assert (p(zero.root[0]) > 0) != (p(zero.root[1]) > 0)
            counts[0] += 1
        counts[1] += parts.contact() is not None
    assert min(counts) > 20


def test_a_check_counts_what_is_missed_and_late():
    truth = Answers(
        *(np.array(x) for x in ([0.5, 0.5, 0.5, 0.5, 0.2, np.inf, np.inf], [0.5] * 4 + [np.inf] * 3, 7 * [0]))
    )
    found = check(np.array([0.5, 0.25, np.inf, np.nextafter(0.5, 1), np.inf, np.inf, 0.5]), truth)
    assert found.missed.tolist() == [2] and found.late.tolist() == [3] and found.false.tolist() == [6]
    np.testing.assert_array_equal(found.errors, [0.0, 0.25, 0.0])
    with pytest.raises(ValueError, match="nan"):
        check(np.full(7, np.nan), truth)
