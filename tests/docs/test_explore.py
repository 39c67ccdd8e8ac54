"""The page to play with the method: it opens from the disk, and shows in a browser what the library says."""

import html
import json
import os
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from exact import exact_tois

import ccd_warp as ccd

FOLDER = Path(__file__).resolve().parents[2] / "docs" / "explore"
NUM_CASES = 50  # for each tolerance
TOLERANCES = np.repeat((1e-1, 1e-2, 1e-3, 1e-4), NUM_CASES)


def test_the_page_names_nothing_but_the_files_beside_it():
    text = {path.name: path.read_text(encoding="utf-8") for path in FOLDER.iterdir()}
    page = text["index.html"]
    assert {*re.findall(r'\b(?:src|href)="([^"]*)"', page)} == text.keys() - {"index.html"} | {"data:,"}
    identifiers = re.findall(r'\bid="([^"]*)"', page)
    assert len(set(identifiers)) == len(identifiers) > 40 and "default-src 'none'" in page
    for part in text.values():
        assert not re.search(r"\b(https?|ftp|wss?):|file:/", part)
        assert not re.search(r"@import|\bfetch\(|XMLHttpRequest|\bimport\b[^;]*\bfrom\b|url\(", part)


# Any of these will do: `apt-get install chromium` has the first.
BROWSERS = "chromium chromium-browser chromium-headless-shell google-chrome google-chrome-stable"
# Without a sandbox, as it cannot run as root otherwise, which it does in most containers; the page is our own.
HEADLESS = (
    "--headless --no-sandbox --disable-gpu --disable-dev-shm-usage --no-first-run --enable-logging=stderr --dump-dom"
)


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


WORDS = "[describeEnds(shoot({0}, {1}, {2})), describeSamples(shoot({0}, {1}, {2}), {0}, {1})]"
CASES, SHOTS = _cases(), [(8.6, 0.2, 8), (9.2, 0.02, 40), (4.2, 1.0, 3), (3.0, 0.5, 12), (5.0, 2.0, 5), (4.0, 0.2, 8)]


@pytest.fixture(scope="module")
def shown(tmp_path_factory):
    """What the page shows of all cases and shots, and how wide it is on a telephone; it must complain of nothing."""
    names = os.environ.get("CCD_WARP_BROWSER", BROWSERS).split()
    browser, folder = next(filter(None, map(shutil.which, names)), None), tmp_path_factory.mktemp("page")
    if browser is None:
        pytest.skip("no Chromium found: apt-get install chromium, or set CCD_WARP_BROWSER to its path")
    shutil.copytree(FOLDER, folder, dirs_exist_ok=True)
    cases = json.dumps([*zip(CASES.tolist(), TOLERANCES.tolist(), strict=True)])
    of_cases = f"""{cases}.map(([points, tolerance]) => {{
        const [start, end] = points.map(([p, a, b]) => ({{ p, a, b }}));
        showPair({{ start, end }}, tolerance);
        return ["bisection", "clipping"].map((method) => [
            ...["toi", "status", "iterations"].map((each) => document.getElementById(`${{method}}-${{each}}`).value),
            state[method].bounds, state[method].u]);
    }})"""
    of_shots = [f"[shoot({x}, {y}, {n}), bulletPairs({x}, {y}), {WORDS.format(x, y, n)}]" for x, y, n in SHOTS]
    asked = f"{of_cases}, [{', '.join(of_shots)}], document.documentElement.scrollWidth"
    (folder / "asked.js").write_text(f"parent.postMessage(JSON.stringify([{asked}]), '*')", encoding="utf-8")
    with (folder / "index.html").open("a", encoding="utf-8") as page:
        page.write('<script src="asked.js"></script>')
    note = "<script>addEventListener('message', (event) => { document.body.dataset.answer = event.data; })</script>"
    telephone = '<!DOCTYPE html><body><iframe width="360" height="900" src="index.html"></iframe>'
    (folder / "telephone.html").write_text(f"{telephone}{note}", encoding="utf-8")
    page = (folder / "telephone.html").as_uri()
    command = [browser, *HEADLESS.split(), f"--user-data-dir={folder}/profile", page]
    done = subprocess.run(command, capture_output=True, text=True, env=os.environ | {"HOME": str(folder)}, timeout=300)
    answers = re.findall('data-answer="([^"]*)"', done.stdout)
    assert answers and "CONSOLE" not in done.stderr, done.stderr
    return json.loads(html.unescape(answers[0]))


def _solved(cases, method, **options):
    """The library's toi, status and iterations of every case."""
    results = []
    for (start, end), tolerance in zip(cases, TOLERANCES, strict=True):
        result = ccd.point_segment_ccd(start[None], end[None], tolerance=tolerance, method=method, **options)
        results.append([result.toi[0], result.status[0], result.iterations[0]])
    return [np.array(column) for column in zip(*results, strict=True)]


def test_the_page_shows_the_toi_the_status_and_every_bound_of_the_library(shown):
    """The page's operations are those of the kernels in their order, so in float64 there is nothing to tolerate."""
    cases = CASES
    in_space = np.concatenate([cases, np.zeros((*cases.shape[:3], 1))], axis=3)
    exact = exact_tois("point-segment", in_space[:, 0], in_space[:, 1])
    for method, of_method in zip(("bisection", "clipping"), zip(*shown[0], strict=True), strict=True):
        tois, names, counts, bounds, places = zip(*of_method, strict=True)
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


def test_the_bullet_meets_the_wall_when_the_library_says_and_the_page_is_no_wider_than_a_telephone(shown):
    for (travel, thickness, _), (shot, pairs, words) in zip(SHOTS, shown[1], strict=True):
        start, end = (np.array([[pair[time][name] for name in "pab"] for pair in pairs]) for time in ("start", "end"))
        toi = float(np.asarray(ccd.point_segment_ccd(start, end, device="cpu").toi).min())
        assert (np.inf if shot["toi"] is None else shot["toi"]) == toi
        way_behind = round(travel - 4.7 - 0.5 * thickness, 9)  # of its rear; at 0 it still touches the wall
        assert ("went through" in words[0]) == (way_behind > 0) and (way_behind > 0 or "passes between" not in words[1])
        is_at_end = round(travel - 4.1 + 0.5 * thickness, 9) == 0
        assert ("just at the end" in words[0]) == ("just when" in words[1]) == is_at_end
    assert shown[2] <= 360
