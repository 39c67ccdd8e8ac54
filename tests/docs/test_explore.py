"""The page to play with the method: it opens from the disk, and shows in a browser what the library says."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from exact import exact_tois

import ccd_warp as ccd

PAGE = Path(__file__).resolve().parents[2] / "docs" / "explore" / "index.html"
NUM_CASES = 50  # for each tolerance
TOLERANCES = np.repeat((1e-1, 1e-2, 1e-3, 1e-4), NUM_CASES)


@pytest.fixture(scope="module")
def page(browser):
    """The page in a headless Chromium, from the disk; it must have asked for its own files alone and not complained."""
    browser.messages.clear()
    browser.requests.clear()
    browser.resize(360)  # a telephone
    browser.open(PAGE)
    yield browser
    assert browser.messages == [] and {*browser.requests} == {path.as_uri() for path in PAGE.parent.iterdir()}


def test_the_page_names_nothing_but_the_files_beside_it():
    html = PAGE.read_text(encoding="utf-8")
    files = {path.name for path in PAGE.parent.iterdir()}
    assert {*re.findall(r'\b(?:src|href)="([^"]*)"', html)} == files - {"index.html"} | {"data:,"}
    identifiers = re.findall(r'\bid="([^"]*)"', html)
    assert len(set(identifiers)) == len(identifiers) > 40 and "default-src 'none'" in html
    text = "".join(path.read_text(encoding="utf-8") for path in PAGE.parent.iterdir())
    assert not re.search(r"\b(https?|ftp|wss?):|file:/", text)
    assert not re.search(r"@import|\bfetch\(|XMLHttpRequest|\bimport\b[^;]*\bfrom\b|url\(", text)


def _cases() -> np.ndarray:
    """Pairs [n, 2, 3, 2]: of random places, of few places, that slide along each other, or meet at an end."""
    random = np.random.default_rng(14)
    cases = random.uniform(size=(len(TOLERANCES), 2, 3, 2))
    cases[1::4] = np.round(4.0 * cases[1::4]) / 4.0
    for start, end in cases[2::4]:  # p flies beside a stationary segment
        end[1:] = start[1:]
        start[0], end[0] = ([[0.9, 0.1], [0.1, 0.9]] @ start[1:]) + random.uniform(-0.01, 0.01, (2, 2))
    for start, end in cases[3::4]:  # p flies through an end of the segment
        end[0] = start[2] + end[2] - start[0]
    return cases


def _solved(cases, method, **options):
    """The library's toi, status and iterations of every case."""
    results = []
    for (start, end), tolerance in zip(cases, TOLERANCES, strict=True):
        result = ccd.point_segment_ccd(start[None], end[None], tolerance=tolerance, method=method, **options)
        results.append([result.toi[0], result.status[0], result.iterations[0]])
    return [np.array(column) for column in zip(*results, strict=True)]


def test_the_page_shows_the_toi_the_status_and_every_bound_of_the_library(page):
    """The page's operations are those of the kernels in their order, so in float64 there is nothing to tolerate."""
    cases = _cases()
    script = f"""{json.dumps([*zip(cases.tolist(), TOLERANCES.tolist(), strict=True)])}.map(([points, tolerance]) => {{
        const [start, end] = points.map(([p, a, b]) => ({{ p, a, b }}));
        showPair({{ start, end }}, tolerance);
        return ["bisection", "clipping"].map((method) => [
            ...["toi", "status", "iterations"].map((each) => document.getElementById(`${{method}}-${{each}}`).value),
            state[method].bounds, state[method].u]);
    }})"""
    in_space = np.concatenate([cases, np.zeros((*cases.shape[:3], 1))], axis=3)
    exact = exact_tois("point-segment", in_space[:, 0], in_space[:, 1])
    for method, shown in zip(("bisection", "clipping"), zip(*page.evaluate(script), strict=True), strict=True):
        tois, names, counts, bounds, places = zip(*shown, strict=True)
        toi, status, iterations = _solved(cases, method)
        assert [float(text or "inf") for text in tois] == toi.tolist()
        assert [*names] == [ccd.CCDStatus(number).name for number in status.tolist()]
        assert [int(text) for text in counts] == iterations.tolist()
        # the cases are worth comparing: contacts and none, at the start and later
        assert {"NO_COLLISION", "COLLISION", "INITIAL_CONTACT"} <= {*names} and 40 <= np.isfinite(toi).sum() <= 160
        for limit in (1, 2, 3, 7, 20):
            cut, status, _ = _solved(cases, method, max_iterations=limit)
            is_cut = np.flatnonzero(status == ccd.CCDStatus.ITERATION_LIMIT)
            assert len(is_cut) or (method == "clipping" and limit > 3)
            assert [bounds[i][limit] for i in is_cut] == cut[is_cut].tolist()
        for case, tolerance, truth, t, u in zip(cases, TOLERANCES, exact, toi, places, strict=True):
            assert not truth.late(t)
            if np.isfinite(t):
                p, a, b = (1.0 - t) * case[0] + t * case[1]
                # delta, and some tens of units in the last place of coordinates up to 2
                width = tolerance * np.ptp(case.reshape(-1, 2), axis=0).max() + 64 * 2.0**-53
                assert np.abs(p - (a + u * (b - a))).max() <= width


def test_the_bullet_meets_the_wall_when_the_library_says(page):
    for travel, thickness, samples in [(8.6, 0.2, 8), (9.2, 0.02, 40), (4.2, 1.0, 3), (3.0, 0.5, 12), (5.0, 2.0, 5)]:
        shot, pairs = page.evaluate(f"[shoot({travel}, {thickness}, {samples}), bulletPairs({travel}, {thickness})]")
        start, end = (np.array([[pair[time][name] for name in "pab"] for pair in pairs]) for time in ("start", "end"))
        toi = float(np.asarray(ccd.point_segment_ccd(start, end, device="cpu").toi).min())
        assert (np.inf if shot["toi"] is None else shot["toi"]) == toi
        assert page.evaluate("document.documentElement.scrollWidth") <= 360
