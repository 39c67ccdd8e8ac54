"""The cull: one answer in every width, lane and company, and never free for a pair that touches."""

import numpy as np
import pytest
from ccd_warp.kernels.template import specialised
from cull_probe import KINDS, WIDTHS, culled
from exact import exact_tois
from hard_cases import FAMILIES
from laws.outputs import different, outputs_of
from scenes import crowd, sheet_over_floor

import ccd_warp as ccd
from ccd_warp._runtime import lanes

# Powers of two by which the axes are scaled: exact, but products of such lengths underflow and overflow.
SCALES = (0, 0, 0), (-900, -900, -900), (-1060, -1060, -1060), (1000, 1000, 1000), (700, -537, -530)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("flags", ["", "-target-cpu haswell"], ids=["of this machine", "without AVX-512"])
def test_every_width_gives_one_answer(flags, kind):
    if flags and lanes.cpu_lanes() < 4:
        pytest.skip("this processor has no AVX2")
    rng, found = np.random.default_rng(51), []
    for separation, t_end in ((0.0, 1.0), (2.0**-10, 1.0), (0.0, 0.3), (2.0**-10, 0.3)):
        for family in FAMILIES.values():
            drawn = family(kind, 101, rng)
            for scale in SCALES:
                with np.errstate(over="ignore", under="ignore"):
                    points, options = np.ldexp(drawn, scale), {"separation": separation, "t_end": t_end}
                found.append(culled(kind, *points, 1, **options))
                for width in WIDTHS:
                    wide = culled(kind, *points, width, flags=flags, **options)
                    assert np.array_equal(wide, found[-1]), (family.name, scale, width)
    assert 0.01 < np.mean(found) < 0.99


@pytest.mark.parametrize("width", [4, 8])
def test_what_an_item_collects_is_as_long_as_its_array(width):
    collected = specialised("search.collected", width=width)
    assert collected.number_at + 1 == collected.num_collected == 6 * collected.capacity + 1


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("width", WIDTHS)
def test_answer_depends_neither_on_the_lane_nor_on_the_neighbours(width, kind):
    rng = np.random.default_rng(52)
    points = np.concatenate([family(kind, 60, rng) for family in FAMILIES.values()], axis=1)
    for p in points:  # some with numbers that spoil whatever they meet
        p[rng.integers(len(p), size=40), rng.integers(4, size=40), rng.integers(3, size=40)] = np.nan
    first = culled(kind, *points, width)
    assert 0 < first.sum() < len(first)
    for order in (rng.permutation(len(first)) for _ in range(3)):
        assert np.array_equal(culled(kind, *points[:, order], width), first[order])


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("family", FAMILIES)
def test_no_pair_in_contact_is_free(family, kind):
    rng = np.random.default_rng(53)
    points = FAMILIES[family](kind, 40, rng)
    for separation, t_end in ((0.0, 1.0), (2.0**-6, 0.6)):
        exact = exact_tois(kind, *points, separation, t_end)
        for width in WIDTHS:
            free = culled(kind, *points, width, separation=separation, t_end=t_end)
            assert not any(truth.hit for truth, is_free in zip(exact, free, strict=True) if is_free)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("number", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("width", WIDTHS)
def test_pair_with_a_number_that_is_not_finite_stays_open(width, number, kind):
    rng = np.random.default_rng(54)
    far = rng.random((2, 96, 4, 3))
    far[:, :, 2 if kind == "edge-edge" else 1 :, 0] += 9.0
    assert culled(kind, *far, width).mean() > 0.9
    spoiled = far.reshape(2, 96, 12).copy()
    for k in range(96):  # each coordinate at one end, at the other, and at both
        spoiled[[0, 1] if k % 24 < 12 and k > 48 else k // 12 % 2, k, k % 12] = number
    for test in ("volume", "sides", "both"):
        assert not culled(kind, *spoiled.reshape(far.shape), width, test=test).any()


@pytest.mark.parametrize("make", [sheet_over_floor, lambda: crowd(np.random.default_rng(58))], ids=["sheet", "crowd"])
def test_every_width_gives_a_mesh_one_answer_and_counts_pairs_beyond_the_capacity(make, monkeypatch):
    mesh, *frames = make()
    answers = []
    for width in WIDTHS:
        monkeypatch.setattr(lanes, "cpu_lanes", lambda w=width: w)
        result = ccd.mesh_ccd(mesh, *frames)
        pipeline = ccd.CollisionPipeline(mesh, num_threads=1, max_pairs=4096, max_contacts=4096)
        whole = outputs_of(pipeline.launch(*frames))
        answers.append(
            outputs_of({"host": result.contacts, "counts": result.counts})
            | {key: whole[key] for key in (".num_pairs", ".vertex_toi")}
        )
        pipeline.reserve(max_pairs=7, max_contacts=4096)
        short = outputs_of(pipeline.launch(*frames))
        num_pairs = whole[".num_pairs"]
        assert np.array_equal(short[".num_pairs"], num_pairs) and num_pairs.max() > 7
        assert short[".flags"] == ccd.LaunchFlag.PAIRS_OVERFLOW and (short[".vertex_toi"] <= whole[".vertex_toi"]).all()
        # no more than what was beyond the capacity is marked: two edges or a vertex and a face for each pair
        assert 0 < np.sum(short[".vertex_toi"] == 0) <= 4 * np.maximum(num_pairs - 7, 0).sum()
    assert len(result.contacts) and not any(different(answer, answers[0]) for answer in answers[1:])
