"""What the page of `ccd-warp explore` shows in a browser is what the library says."""

import json

import numpy as np
import pytest
from exact import exact_tois

import ccd_warp as ccd

METHODS = ("bisection", "clipping")
TOLERANCES = (1e-1, 1e-2, 1e-3, 1e-4)
NUM_CASES = 50  # for each tolerance
NAMES = ("p", "a", "b")


@pytest.fixture
def page(explore_page):
    return explore_page


def _cases() -> np.ndarray:
    """Pairs [n, 2, 3, 2]: of random places, of few places, that slide along each other, turn, or meet at an end."""
    random = np.random.default_rng(14)
    cases = random.uniform(size=(len(TOLERANCES) * NUM_CASES, 2, 3, 2))
    for i, (start, end) in enumerate(cases):
        match i % 5:
            case 1:
                cases[i] = np.round(4.0 * cases[i]) / 4.0
            case 2:  # p flies beside a stationary segment
                end[1:] = start[1:]
                side = start[2] - start[1]
                start[0] = start[1] + 0.1 * side + random.uniform(-0.01, 0.01, 2)
                end[0] = start[2] - 0.1 * side + random.uniform(-0.01, 0.01, 2)
            case 3:  # the segment turns about its middle
                angle = random.uniform(1.5, 3.0)
                turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
                middle = start[1:].mean(axis=0)
                end[1:] = (start[1:] - middle) @ turn.T + middle
            case 4:  # p flies through an end of the segment
                end[0] = 2.0 * (0.5 * (start[1] + end[1])) - start[0]
    return cases


@pytest.fixture(scope="module")
def answers(browser, explore_file):
    """For each case its points, its tolerance, and what the page shows of both methods."""
    browser.open(explore_file)
    cases = _cases()
    tolerances = np.repeat(TOLERANCES, NUM_CASES)
    values = ["toi", "status", "iterations"]
    names = [f"{method}-{value}" for method in METHODS for value in values]
    script = f"""{json.dumps([*zip(cases.tolist(), tolerances.tolist(), strict=True)])}.map(([points, tolerance]) => {{
        const [start, end] = points.map(([p, a, b]) => ({{ p, a, b }}));
        showPair({{ start, end }}, tolerance);
        const texts = {json.dumps(names)}.map((name) => document.getElementById(name).value);
        const [{{ bounds, u }}, clipping] = [state.bisection, state.clipping];
        return [texts, [bounds, clipping.bounds], [u, clipping.u]];
    }})"""
    return cases, tolerances, browser.evaluate(script)


def _solved(cases, tolerances, method, **options):
    """The library's toi, status and iterations of every case."""
    results = []
    for tolerance in TOLERANCES:
        mine = cases[tolerances == tolerance]
        result = ccd.point_segment_ccd(
            mine[:, 0].copy(), mine[:, 1].copy(), tolerance=tolerance, method=method, device="cpu", **options
        )
        results.append([np.asarray(result.toi), np.asarray(result.status), np.asarray(result.iterations)])
    return (np.concatenate(column) for column in zip(*results, strict=True))


@pytest.mark.parametrize("method", METHODS)
def test_the_page_shows_the_toi_status_and_work_of_the_library(answers, method):
    """The page's operations are those of the kernels in their order, so in float64 there is nothing to tolerate.

    Kernels are compiled without fused multiply-add.
    """
    cases, tolerances, pages = answers
    first = 3 * METHODS.index(method)
    toi, status, iterations = _solved(cases, tolerances, method)
    texts = [texts[first : first + 3] for texts, _, _ in pages]
    assert len(texts) == 200
    assert [float(text[0] or "inf") for text in texts] == toi.tolist()
    assert [text[1] for text in texts] == [ccd.CCDStatus(number).name for number in status.tolist()]
    assert [int(text[2]) for text in texts] == iterations.tolist()
    # the cases are worth comparing: contacts and none, at the start and later
    assert {"NO_COLLISION", "COLLISION", "INITIAL_CONTACT"} <= {text[1] for text in texts}
    assert 40 <= np.isfinite(toi).sum() <= 160


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("limit", [1, 2, 3, 7, 20])
def test_the_bound_after_some_steps_is_that_of_the_library_stopped_there(answers, method, limit):
    cases, tolerances, pages = answers
    toi, status, _ = _solved(cases, tolerances, method, max_iterations=limit)
    is_cut = status == ccd.CCDStatus.ITERATION_LIMIT
    assert is_cut.any() or (method, limit) in (("clipping", 7), ("clipping", 20))
    bounds = [of_methods[METHODS.index(method)] for _, of_methods, _ in pages]
    assert [bounds[i][limit] for i in np.flatnonzero(is_cut)] == toi[is_cut].tolist()


def test_a_pair_that_is_open_after_all_rounds_ends_as_in_the_library(page):
    """The segment turns by half a turn about p, which hardly moves: the rounds are too few, and no half is needed."""
    case = np.array(
        [
            [0.3331147663257309, 0.8313288750391993],
            [0.5831523495726287, 0.9007403526920825],
            [0.0716327615082264, 0.7584174533840269],
            [0.3331147663241234, 0.8313288742555534],
            [0.07113985207490622, 0.7585790241097565],
            [0.5829006627560593, 0.9009780704549049],
        ]
    ).reshape(2, 1, 3, 2)
    start, end = ({name: x for name, x in zip(NAMES, points[0], strict=True)} for points in case.tolist())
    pair = json.dumps({"start": start, "end": end})
    assert page.evaluate(f"runRounds(normalise({pair}, 1e-4), 10000).outcome") is None
    shown = page.evaluate(f"clipPair({pair}, 1e-4)")
    result = ccd.point_segment_ccd(case[0], case[1], tolerance=1e-4, device="cpu")
    assert shown["status"] == ccd.CCDStatus(int(result.status[0])).name == "COLLISION"
    assert (shown["toi"], shown["gap"]) == (result.toi[0], result.gap[0])
    assert shown["iterations"] == result.iterations[0] > 10
    for limit in range(1, shown["iterations"]):
        cut = ccd.point_segment_ccd(case[0], case[1], tolerance=1e-4, max_iterations=limit, device="cpu")
        assert cut.status[0] == ccd.CCDStatus.ITERATION_LIMIT
        assert shown["bounds"][limit] == cut.toi[0]


def test_no_toi_on_the_page_is_late_and_every_contact_is_within_the_tolerance(answers):
    cases, tolerances, pages = answers
    in_space = np.concatenate([cases, np.zeros((*cases.shape[:3], 1))], axis=3)
    exact = exact_tois("point-segment", in_space[:, 0], in_space[:, 1])
    num_contacts = 0
    for case, tolerance, truth, (texts, _, places) in zip(cases, tolerances, exact, pages, strict=True):
        length = np.ptp(case.reshape(-1, 2), axis=0).max()
        for k, u in enumerate(places):
            toi = float(texts[3 * k] or "inf")
            assert not truth.late(toi)
            if np.isfinite(toi):
                p, a, b = (1.0 - toi) * case[0] + toi * case[1]
                # delta, and some tens of units in the last place of coordinates up to 2
                assert np.abs(p - (a + u * (b - a))).max() <= tolerance * length + 64 * 2.0**-53
                num_contacts += 1
    assert num_contacts > 100


def test_a_search_that_is_cut_says_up_to_when_the_pair_is_free(page):
    case = np.array([[[0.1, 0.2000001], [0.0, 0.1], [0.8, 0.9]], [[0.7, 0.8000001], [0.0, 0.1], [0.8, 0.9]]])
    start, end = ({name: x for name, x in zip(NAMES, points, strict=True)} for points in case.tolist())
    page.evaluate(f"showPair({json.dumps({'start': start, 'end': end})}, 1e-8)")
    result = ccd.point_segment_ccd(case[:1], case[1:], tolerance=1e-8, method="bisection", device="cpu")
    assert result.status[0] == ccd.CCDStatus.ITERATION_LIMIT
    assert page.number("bisection-toi") == result.toi[0]
    assert page.number("bisection-iterations") == 10_000
    text = page.evaluate("document.getElementById('bisection-status').textContent")
    assert text == "stopped after 10,000: free up to here, no more is known (ITERATION_LIMIT)"
    assert page.evaluate("byId('clipping-status').value") == "NO_COLLISION"


def test_the_bullet_meets_the_wall_when_the_library_says(page):
    for travel, thickness, samples in [(8.6, 0.2, 8), (9.2, 0.02, 40), (4.2, 1.0, 3), (3.0, 0.5, 12), (5.0, 2.0, 5)]:
        shot = page.evaluate(f"shoot({travel}, {thickness}, {samples})")
        pairs = page.evaluate(f"bulletPairs({travel}, {thickness})")
        start, end = (np.array([[pair[time][name] for name in NAMES] for pair in pairs]) for time in ("start", "end"))
        toi = float(np.asarray(ccd.point_segment_ccd(start, end, device="cpu").toi).min())
        assert (np.inf if shot["toi"] is None else shot["toi"]) == toi
        nose = 0.6 + 0.3
        reach = (5.0 - 0.5 * thickness - nose) / travel
        if reach > 1.0:
            assert toi == np.inf
        else:  # but for the roundings of the positions and of `reach`
            assert reach - 1e-14 <= toi <= reach + 1e-15
        # tests at an instant see an overlap only
        behind = nose - 0.6 + travel * np.linspace(0.0, 1.0, samples) > 5.0 + 0.5 * thickness
        inside = (nose + travel * np.linspace(0.0, 1.0, samples) >= 5.0 - 0.5 * thickness) & ~behind
        assert [test["isHit"] for test in shot["samples"]] == inside.tolist()
        assert [test["isHit"] for test in shot["ends"]] == [inside[0], inside[-1]]
