"""Pairs in lanes: an answer depends on its pair alone, whatever the lane, the company and the width of the vectors."""

import numpy as np
import pytest
from hard_cases import FAMILIES
from pairs import FIELDS

import ccd_warp as ccd


def assert_equal_bits(found, expected, rows=slice(None)):
    for name in FIELDS:
        assert getattr(found, name).tobytes() == getattr(expected, name)[rows].tobytes(), name


def test_a_pair_beside_one_in_a_plane_gets_the_answer_that_it_gets_among_its_like():
    """Only the pair in one plane needs the widest facet, which must not choose a point for the other."""
    names = ["touching_at_start", "double_root", "grazing_vertex", "one_ulp_neighbours", "lattice"]
    names += ["random_colliding", "one_plane", "slivers", "needle_against_needle"]
    rng = np.random.default_rng(0)
    # a separation of the size of the rounding error: then pairs in space do without facets
    options = {"precision": "float32", "minimum_separation": 3e-6}
    for seed in (17, 29, 100):
        families = [FAMILIES[name]("vertex-face", 30, np.random.default_rng(seed)) for name in names]
        like = [np.concatenate(frames) for frames in zip(*families, strict=True)]
        rows = rng.permutation(len(like[0]))
        among_its_like = ccd.vertex_face_ccd(*like, **options)
        assert_equal_bits(ccd.vertex_face_ccd(*(x[rows] for x in like), **options), among_its_like, rows)


def test_the_parameters_of_a_contact_in_one_plane_are_those_of_the_point_that_touches():
    """Everything moves on one line, up to rounding; the point claimed lies where the parameters say."""
    start = [
        [-0.6388516524392863, 0.08148762364207655, 0.2996502385100188],
        [-5.2522414168966804, 0.6699406177846453, 2.463538108729795],
        [6.281232994246804, -0.8011918675717764, -2.9461815668196465],
        [13.380664300267673, -1.7067476120954232, -6.276135045116664],
    ]
    end = [
        [11.999530110510184, -1.5305794174392684, -5.628320818407084],
        [10.521515742135986, -1.3420538371616775, -4.935065419322945],
        [6.281232994246804, -0.8011918675717764, -2.9461815668196465],
        [-6.633375606654168, 0.8461088124407997, 3.111352335439374],
    ]
    for limit in (3, 4, 12, 10_000):
        result = ccd.vertex_face_ccd([start], [end], precision="float32", t_max=0.5, max_iterations=limit)
        toi, (u, v) = result.toi[0], result.parameters[0]
        p, a, b, c = (1 - toi) * np.array(start) + toi * np.array(end)
        assert np.abs(p - (1 - u - v) * a - u * b - v * c).max() <= result.gap[0] + 1e-12


@pytest.mark.parametrize("length_scale", [1e10, 1e12, 1e300])
def test_a_tolerance_far_larger_than_the_pair_leaves_the_parameters_finite(length_scale, precision):
    start = np.array([[[0.2, 0.2, 0.5], [0, 0, 0], [1, 0, 0], [0, 1, 0]]])
    end = start - [[[0, 0, 1.0], [0, 0, 0], [0, 0, 0], [0, 0, 0]]]
    result = ccd.vertex_face_ccd(start, end, precision=precision, tolerance=0.01, length_scale=length_scale)
    assert result.hit.all() and np.isfinite(result.parameters).all() and np.isfinite(result.gap).all()
    assert (result.parameters >= 0).all() and result.parameters.sum() <= 1


def test_kernels_are_compiled_anew_when_an_operator_changes(monkeypatch):
    """Warp does not look for operators in a function, so the names of the modules tell."""
    from ccd_warp.kernels.pair import simd
    from ccd_warp.kernels.search import search_types
    from ccd_warp.kernels.template import specialised

    modules = [
        specialised("narrow_phase.narrow_phase").solve_pairs.module.name,
        specialised("search.search_trees", end=search_types.CULL).search_trees.module.name,
    ]
    assert all(simd.fingerprint() in name for name in modules)
    before = simd.fingerprint()
    source = simd.inspect.getsource
    monkeypatch.setattr(simd.inspect, "getsource", lambda module: source(module).replace("lanes(a) +", "lanes(a) -"))
    assert simd.fingerprint() != before
