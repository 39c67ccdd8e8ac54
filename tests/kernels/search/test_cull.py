"""The cull: one answer in every width, lane and company, and never free for a pair that touches."""

import numpy as np
import pytest
from cull_probe import KINDS, WIDTHS, culled
from exact import exact_tois
from hard_cases import FAMILIES
from laws.outputs import different, outputs_of
from scenes import crowd, sheet_over_floor

import ccd_warp as ccd
from ccd_warp._runtime import lanes

# Powers of two by which the axes are scaled: exact, but products of such lengths underflow and overflow.
_SCALES = {
    "as_drawn": (0, 0, 0),
    "small": (-900, -900, -900),
    "subnormal": (-1060, -1060, -1060),
    "large": (1000, 1000, 1000),
    "mixed": (700, -537, -530),
}
HASWELL = "-target-cpu haswell"


def scaled(points, scale):
    with np.errstate(over="ignore", under="ignore"):
        return [np.ldexp(p, _SCALES[scale]) for p in points]


@pytest.fixture(params=["of this machine", "without AVX-512"])
def flags(request):
    """Flags of the compiler: for this processor, and for one with AVX2."""
    if request.param == "of this machine":
        return ""
    if lanes.cpu_lanes() < 4:
        pytest.skip("this processor has no AVX2")
    return HASWELL


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("separation", "t_end"), [(0.0, 1.0), (2.0**-10, 1.0), (0.0, 0.3), (2.0**-10, 0.3)])
def test_every_width_gives_one_answer(separation, t_end, kind, flags):
    rng = np.random.default_rng(51)
    free = count = 0
    for family in FAMILIES:
        drawn = FAMILIES[family](kind, 101, rng)
        for scale in _SCALES:
            points = scaled(drawn, scale)
            options = {"separation": separation, "t_end": t_end}
            narrow = culled(kind, *points, 1, **options)
            for width in WIDTHS:
                wide = culled(kind, *points, width, flags=flags, **options)
                assert np.array_equal(wide, narrow), (family, scale, width)
            free += narrow.sum()
            count += len(narrow)
    assert 0.01 * count < free < 0.99 * count


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("width", WIDTHS)
def test_answer_depends_neither_on_the_lane_nor_on_the_neighbours(width, kind):
    rng = np.random.default_rng(52)
    drawn = [FAMILIES[name](kind, 60, rng) for name in FAMILIES]
    points = [np.concatenate([pair[end] for pair in drawn]) for end in (0, 1)]
    # some with numbers that spoil whatever they meet
    for p in points:
        p[rng.integers(len(p), size=40), rng.integers(4, size=40), rng.integers(3, size=40)] = np.nan
    first = culled(kind, *points, width)
    assert 0 < first.sum() < len(first)
    for _ in range(3):
        order = rng.permutation(len(first))
        assert np.array_equal(culled(kind, *(p[order] for p in points), width), first[order])


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
        counts = {k: np.array([*getattr(result.counts, k).values()]) for k in ("num_candidates", "num_after_cull")}
        pipeline = ccd.CollisionPipeline(mesh, num_threads=1, max_pairs=4096, max_contacts=4096)
        whole = pipeline.launch(*frames)
        num_pairs, toi = whole.num_pairs.numpy().copy(), whole.vertex_toi.numpy().copy()
        pipeline.reserve(max_pairs=7, max_contacts=4096)
        short = pipeline.launch(*frames)
        assert np.array_equal(short.num_pairs.numpy(), num_pairs) and num_pairs.max() > 7
        assert short.flags.numpy()[0] == ccd.LaunchFlag.PAIRS_OVERFLOW and (short.vertex_toi.numpy() <= toi).all()
        # no more than what was beyond the capacity is marked: two edges or a vertex and a face for each pair
        assert 0 < np.count_nonzero(short.vertex_toi.numpy() == 0) <= 4 * np.maximum(num_pairs - 7, 0).sum()
        answers.append(outputs_of(result.contacts, "contacts") | counts | {"launched": toi, "pairs": num_pairs})
    assert len(result.contacts) and not any(different(answer, answers[0]) for answer in answers[1:])
