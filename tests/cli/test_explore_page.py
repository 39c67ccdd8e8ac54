"""A person at the page of `ccd-warp explore`: mouse, keys, sliders, a telephone, a dark screen."""

import re

import pytest

HANDLES = {f"{name}-{end}" for name in "pab" for end in ("start", "end")}


@pytest.fixture
def page(explore_page):
    return explore_page


def test_sliders_of_the_bullet_change_what_the_tests_say(page):
    def verdicts() -> list[str]:
        return [
            page.evaluate(f"document.querySelector('#verdict-{name} .verdict').textContent")
            for name in ("ends", "samples", "ccd")
        ]

    assert verdicts() == ["miss", "miss", "hit"]
    before = page.number("bullet-toi")
    page.evaluate("byId('samples').focus()")
    page.press("ArrowRight")  # nine samples, one of them in the wall
    assert verdicts() == ["miss", "hit", "hit"]
    assert page.number("bullet-toi") == before
    page.evaluate("byId('thickness').focus()")
    page.press("Home")
    page.evaluate("byId('samples').focus()")
    page.press("ArrowRight")  # ten, and the thinnest wall is between two of them
    assert verdicts() == ["miss", "miss", "hit"]
    assert page.number("bullet-toi") > before  # the wall is thinner, so its front is farther
    page.evaluate("byId('travel').focus()")
    page.press("Home")
    assert verdicts() == ["miss", "miss", "miss"]
    assert "Certain" in page.evaluate("byId('verdict-ccd').textContent")
    assert page.evaluate("document.querySelectorAll('#lane-ccd .ring').length") == 0


def test_a_point_is_dragged_by_the_mouse_the_keys_and_its_coordinates(page):
    before = page.evaluate("state.pair"), page.number("bisection-toi"), page.number("clipping-toi")
    page.drag("p-end", -60, -120)
    after = page.evaluate("state.pair"), page.number("bisection-toi"), page.number("clipping-toi")
    assert after[0]["end"]["p"][0] < before[0]["end"]["p"][0] - 0.05  # to the left
    assert after[0]["end"]["p"][1] > before[0]["end"]["p"][1] + 0.1  # and up
    assert after[0]["start"] == before[0]["start"] and after[0]["end"]["a"] == before[0]["end"]["a"]
    assert after[1] != before[1] and after[2] != before[2]

    page.press("ArrowRight", count=3)  # the focus is where the mouse was
    assert page.evaluate("state.pair.end.p[0]") == pytest.approx(after[0]["end"]["p"][0] + 0.03, abs=1e-3)
    assert page.evaluate("byId('p-end').getAttribute('aria-valuetext')").startswith("x 0.")

    page.evaluate("byId('a-start-y').value = '0.95'; byId('a-start-y').dispatchEvent(new Event('input'))")
    assert page.evaluate("state.pair.start.a[1]") == 0.95
    page.evaluate("byId('a-start-y').value = ''; byId('a-start-y').dispatchEvent(new Event('input'))")
    assert page.evaluate("state.pair.start.a[1]") == 0.95  # no number is no place
    page.drag("b-end", 5000, 0)
    assert page.evaluate("state.pair.end.b[0]") == 1.0  # points stay in the picture


def test_the_subdivision_goes_step_by_step(page):
    last = int(page.number("step-count"))
    assert last == page.number("bisection-iterations") > 20
    bounds = page.evaluate("state.bisection.bounds")
    page.click("first")
    assert (page.number("step-count"), page.number("bound")) == (0, 0)
    seen = []
    for step in range(1, last + 1):
        page.evaluate("byId('forward').click()")
        assert (page.number("step-count"), page.number("bound")) == (step, bounds[step])
        counts = page.evaluate(
            "['free', 'open', 'contact', 'later'].map((k) => Number(byId(`count-${k}`).textContent))"
        )
        halved = page.evaluate(
            f"state.bisection.examined.slice(0, {step}).filter((box) => box.kind === 'split').length"
        )
        assert sum(counts) == halved + 1  # each halving adds a box, and none is lost
        seen.append(counts)
    assert seen[-1][1] == 0 and seen[-1][2] > 0  # nothing is open in the end
    assert bounds[last] == page.number("bisection-toi")
    assert bounds == sorted(bounds)

    page.click("back")
    assert page.number("step-count") == last - 1
    page.click("play")  # from where it is to the end
    page.evaluate("new Promise((done) => setInterval(() => state.timer === null && done(), 20))")
    assert page.number("step-count") == last
    page.evaluate("byId('step').focus()")
    page.press("Home")
    page.press("ArrowRight", count=2)
    assert page.number("step-count") == 2
    assert page.evaluate("byId('step-text').textContent").startswith("Box 2: ")


def test_the_clips_go_one_by_one_and_close_in_on_the_toi(page):
    last = int(page.number("clip-count"))
    times = page.evaluate("state.clipping.clips.map((clip) => clip.to)")
    assert len(times) == last >= 4 and times == sorted(times) and times[-1] <= page.number("clipping-toi")
    page.click("clip-back")
    assert page.number("clip-count") == last - 1
    assert page.evaluate("document.querySelectorAll('#pair .separator').length") == 1
    assert page.evaluate("document.querySelectorAll('#clip-rows .current').length") == 1
    page.click("clip-forward")
    assert page.evaluate("document.querySelectorAll('#pair .ring').length") == 1


def test_each_clip_names_its_direction_and_its_line_separates_p_from_the_segment(page):
    """The line is drawn at the time at which the clip begins, as is the pair."""
    names = {"closest": "the direction of the closest point", "normal": "the turning normal of the segment"}
    seen = set()
    for number, name in enumerate(page.evaluate("state.clipping.clips.map((clip) => clip.name)"), start=1):
        page.evaluate(f"setClip({number})")
        assert names[name] in page.evaluate("byId('clip-text').textContent")
        assert page.evaluate("document.querySelector('#clip-rows .current').lastChild.textContent") == name
        line, now = page.evaluate(
            f"""(() => {{
                const clip = state.clipping.clips[{number - 1}];
                const now = pairAt(state.pair, clip.from);
                const line = document.createElementNS("http://www.w3.org/2000/svg", "g");
                line.innerHTML = separatingLine(clip, now);
                const end = (k) => ["x", "y"].map((axis) => Number(line.firstChild.getAttribute(axis + k)));
                return [[end(1), end(2)], ["p", "a", "b"].map((point) => drawn(now[point]))];
            }})()"""
        )
        (x1, y1), (x2, y2) = line
        p, a, b = ((x2 - x1) * (y - y1) - (y2 - y1) * (x - x1) for x, y in now)
        assert a * b > 0.0 > p * a
        seen.add(name)
    assert seen == set(names)


def test_a_smaller_tolerance_needs_more_boxes_and_hardly_more_clips(page):
    page.evaluate("byId('example').value = 'sliding'; byId('example').dispatchEvent(new Event('change'))")
    boxes, steps = [], []
    page.evaluate("byId('delta').focus()")
    page.press("End")
    for _ in range(5):
        boxes.append(page.number("bisection-iterations"))
        steps.append(page.number("clipping-iterations"))
        page.press("ArrowLeft", count=4)  # a tenth
    assert page.number("delta-value") == pytest.approx(1e-6)
    assert boxes == sorted(boxes) and boxes[-1] > 50 * boxes[0]
    assert max(steps) <= 3


def _is_painted(page, canvas: str) -> bool:
    """Whether the middle row of a canvas is opaque within its axes."""
    return page.evaluate(
        f"""((c) => [...c.getContext('2d').getImageData(Math.round(0.3 * c.width), Math.round(0.3 * c.height),
        Math.round(0.6 * c.width), 1).data].every((value, i) => i % 4 < 3 || value === 255))(byId('{canvas}'))"""
    )


@pytest.mark.parametrize("theme", ["light", "dark"])
@pytest.mark.parametrize("width", [360, 1600])
def test_it_fits_a_telephone_and_a_wide_screen_by_day_and_night(page, width, theme):
    page.resize(width)
    page.set_theme(theme)
    page.wait_for_frame()
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    background = page.evaluate("getComputedStyle(document.body).backgroundColor")
    assert (sum(map(int, re.findall(r"\d+", background))) > 384) == (theme == "light")
    for canvas in ("boxes", "clips"):
        size, drawn = page.evaluate(f"[byId('{canvas}').getBoundingClientRect().width, byId('{canvas}').width]")
        assert size == pytest.approx(drawn, abs=1) and size >= 250
        assert _is_painted(page, canvas)
    for button in ("first", "back", "play", "forward", "last"):
        box = page.evaluate(f"(r => [r.width, r.height])(byId('{button}').getBoundingClientRect())")
        assert min(box) >= 24  # the least target that WCAG 2.2 asks for


def test_every_control_is_reached_by_tab_and_has_a_name(page):
    nodes = page.send("Accessibility.getFullAXTree")["nodes"]
    roles = ("slider", "button", "combobox", "spinbutton", "img", "image")
    controls = [node for node in nodes if not node.get("ignored") and node["role"]["value"] in roles]
    assert len(controls) > 30
    for node in controls:
        assert node["name"]["value"].strip(), node
    page.evaluate("document.activeElement.blur()")
    reached = set()
    for _ in range(60):
        page.press("Tab")
        reached.add(page.evaluate("document.activeElement.id"))
    assert HANDLES | {"travel", "thickness", "samples", "example", "delta", "step", "play", "clip"} <= reached
