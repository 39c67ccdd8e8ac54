"""Pairs in lanes: an answer depends on its pair alone, whatever the lane, the company and the width of the vectors."""

import hashlib
import os
import subprocess
import sys

import numpy as np
import pairs
import pytest
import warp as wp
from ccd_warp.benchmarks.hard_cases import FAMILIES
from pairs import FIELDS, results

import ccd_warp as ccd


def digest(precision):
    """A hash of all bits of these results."""
    found = hashlib.sha256()
    for *_, result in results(precision):
        for name in FIELDS:
            found.update(np.ascontiguousarray(getattr(result, name)).tobytes())
    return found.hexdigest()


def assert_equal_bits(found, expected, rows=slice(None)):
    for name in FIELDS:
        assert getattr(found, name).tobytes() == getattr(expected, name)[rows].tobytes(), name


def test_an_answer_depends_neither_on_its_lane_nor_on_its_neighbours(precision):
    rng = np.random.default_rng(1)
    for solve, points, options, together in results(precision):
        count = len(together.toi)
        for rows in (rng.permutation(count), np.repeat(rng.integers(0, count, 5), 7), np.arange(count - 3)):
            apart = solve(*(x[rows] for x in points), precision=precision, **options)
            assert_equal_bits(apart, together, rows)


def test_a_pair_alone_gets_the_answer_that_it_gets_among_many(precision):
    for solve, points, options, together in results(precision):
        for i in range(0, len(together.toi), 29):
            assert_equal_bits(solve(*(x[i : i + 1] for x in points), precision=precision, **options), together, [i])


# Plain numbers, and vectors of 256 bits compiled for a processor without AVX-512. The default of this machine is the
# other side of the comparison.
@pytest.mark.parametrize(("lanes", "flags"), [("1", None), ("4", "-target-cpu haswell")])
def test_answers_have_equal_bits_for_every_width(precision, lanes, flags):
    from ccd_warp._runtime.lanes import cpu_lanes

    if flags and cpu_lanes() < 4:
        pytest.skip("this processor has no AVX2")
    script = (
        f"import test_lane_width, warp\nwarp.config.cpu_compiler_flags = {flags!r}\n"
        if flags
        else ("import test_lane_width\n")
    )
    script += f"print(test_lane_width.digest({precision!r}))"
    folders = os.pathsep.join(os.path.dirname(file) for file in (__file__, pairs.__file__))
    environment = {**os.environ, "CCD_WARP_LANES": lanes, "PYTHONPATH": folders}
    done = subprocess.run([sys.executable, "-P", "-c", script], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split()[-1] == digest(precision)


def test_a_width_that_does_not_exist_is_refused():
    script = "import ccd_warp as ccd, numpy as np\nccd.vertex_face_ccd(np.zeros((1, 4, 3)), np.ones((1, 4, 3)))"
    environment = {**os.environ, "CCD_WARP_LANES": "3"}
    done = subprocess.run([sys.executable, "-P", "-c", script], env=environment, capture_output=True, text=True)
    assert done.returncode != 0
    assert "CCD_WARP_LANES must be 1, 4 or 8; found '3'" in done.stderr


def test_warp_arrays_and_numpy_arrays_get_equal_bits(precision):
    for solve, points, options, expected in results(precision, each=2):
        if points[0].shape[1] == 4:
            found = solve(*(wp.array(x, dtype=wp.vec3d, device="cpu") for x in points), precision=precision, **options)
            for name in FIELDS:
                assert getattr(found, name).numpy().tobytes() == getattr(expected, name).tobytes(), name


def test_a_pair_beside_one_in_a_plane_gets_the_answer_that_it_gets_among_its_like():
    """Only the pair in one plane needs the widest facet, which must not choose a point for the other."""
    names = [
        "touching_at_start",
        "double_root",
        "grazing_vertex",
        "one_ulp_neighbours",
        "lattice",
        "random_colliding",
        "one_plane",
        "slivers",
        "needle_against_needle",
    ]
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
