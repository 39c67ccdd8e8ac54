"""Thickness: a radius for each body or vertex, and distances that grow by it."""

import math
from fractions import Fraction

import numpy as np
import pytest
import warp as wp
from ccd_warp.kernels.boxes.thickness import add_rounded_up
from exact import exact_contacts
from expected_warnings import OF_DISTANCES, OF_ROUNDING
from laws.outputs import tois_of
from laws.truth import Pairs
from scenes import FACE, NO_FACES, TRIANGLE, crowd_of_all_kinds

import ccd_warp as ccd

pytestmark = [OF_DISTANCES, OF_ROUNDING]


@wp.kernel(enable_backward=False)
def add_lengths(
    a: wp.array[wp.float64],
    b: wp.array[wp.float64],
    c: wp.array[wp.float64],
    # out
    s: wp.array[wp.float64],
):
    k = wp.tid()
    s[k] = add_rounded_up(a[k], add_rounded_up(b[k], c[k]))


def sheet_and_bead(radius=None, **options):
    bodies = [(TRIANGLE, FACE), (np.array([[0.2, 0.2, 1.0]]), NO_FACES)]
    return ccd.CollisionMesh.from_arrays(bodies, codimensional_points=True, radius=radius, **options)


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        *((given, [0.1, 0.1, 0.1, 0.2]) for given in ([0.1, 0.2], np.array([0.1, 0.1, 0.1, 0.2]))),
        *((given, [0.1] * 4) for given in (0.1, np.float64(0.1), np.array(0.1))),
        (np.array([1, 2], dtype=np.float32), [1.0, 1.0, 1.0, 2.0]),
    ],
)
def test_a_radius_is_one_for_all_or_one_for_each_body_or_vertex_and_stays_with_the_mesh(given, expected):
    mesh = sheet_and_bead(given)
    for copied in (mesh, mesh.excluding({"bodies": [[0, 1]]})):
        assert copied.radius.tolist() == expected and copied.radius.dtype == np.float64
        assert copied.replicate(2).radius.tolist() == expected * 2 and not copied.radius.flags.writeable
    lowest, highest = min(expected), max(expected)
    assert repr(mesh).endswith(f"radius {lowest:g})" if lowest == highest else f"radius {lowest:g} to {highest:g})")
    point, pair, empty = ((np.zeros((n, 3)), NO_FACES) for n in (1, 2, 0))
    for bodies, radius in (([point, point], [0.1, 0.2]), ([empty, pair], [0.1, 0.1])):  # as many bodies as vertices
        assert ccd.CollisionMesh.from_arrays(bodies, radius=radius).radius.tolist() == radius


def test_sum_of_a_distance_and_two_radii_is_rounded_up_and_exact_where_it_can_be():
    def summed_up(a, b):
        exact = Fraction(a) + Fraction(b)
        return float(exact) if Fraction(float(exact)) >= exact else math.nextafter(float(exact), math.inf)

    rng = np.random.default_rng(93)
    lengths = rng.random((3, 400)) * 10.0 ** rng.integers(-30, 3, (3, 400))
    lengths = np.hstack([lengths, [[0, 5e-324, 0.1, 1e300, 0], [0, 5e-324, 0.2, 1, 0.3], [0, 0, 0.3, 1e-300, 0]]])
    lengths = np.hstack([lengths, 10.0 ** rng.integers(-320, 300, (3, 200))])
    sums = wp.empty(lengths.shape[1], dtype=wp.float64)
    wp.launch(add_lengths, len(sums), inputs=[wp.array(x, dtype=wp.float64) for x in lengths], outputs=[sums])
    assert sums.numpy().tolist() == [summed_up(a, summed_up(b, c)) for a, b, c in lengths.T.tolist()]


def test_boxes_that_touch_overlap_though_they_grow_by_a_radius_and_an_inflation_that_rounding_would_drop():
    """Rounded to nearest, neither reaches half way to the other: each half of a last bit is lost twice."""
    half = 2.0**-53
    places = np.array([[1.0, 0, 0], [1.0 + 4 * half, 0, 0]])
    mesh = ccd.CollisionMesh.from_arrays([(places, NO_FACES)], codimensional_points=True, radius=half)
    for broad_phase in ("tree", "hash"):
        found = ccd.find_candidates(mesh, places, places, half, broad_phase=broad_phase)
        assert found.point_point.tolist() == [[0, 1]]


@pytest.mark.parametrize("largest", [5e-324, 1e-300, 1e-160, 1e150, 1.7e308])
@pytest.mark.filterwarnings("error:overflow:RuntimeWarning")
def test_tiny_and_huge_radii_are_never_late_and_nothing_is_said_of_overflow(largest, precision):
    radius = largest * np.random.default_rng(0).integers(0, 2, 3 * 18)
    mesh, start, end = crowd_of_all_kinds(np.random.default_rng(98), count=2, radius=radius)
    found, pairs = tois_of(ccd.mesh_ccd(mesh, start, end, precision=precision).contacts), Pairs(mesh)
    if largest < 1:
        assert not any(time.late(found[key]) for key, time in exact_contacts(mesh, start, end).items())
        return
    for kind, of_kind in enumerate(pairs.of_kinds):  # all that are thick are in contact
        with np.errstate(over="ignore"):
            is_thick = pairs.radii(kind, of_kind) > 0
        assert all(found[kind, *pair] == 0.0 for pair in of_kind[is_thick].tolist())


def test_radius_counts_where_a_difference_of_coordinates_is_beyond_the_largest_number():
    reach, radius, start, end = 1.2e308, 1e301, 1e303, 1e300
    below = np.array([[-reach, 0.0, 0.0], [reach, 0.0, 0.0]])
    above = np.array([[-reach, -1e307, end], [reach, 1e307, end]])  # crosses it far below twice the radius
    mesh = ccd.CollisionMesh.from_arrays([(x, NO_FACES, [[0, 1]]) for x in (below, above)], radius=radius)
    vertices_t0 = mesh.vertices.copy()
    vertices_t0[2:, 2] = start
    exact = (start - 2.0 * radius) / (start - end)
    toi = ccd.mesh_ccd(mesh, vertices_t0, mesh.vertices).toi
    assert 0.99 * exact < toi <= exact  # the tolerance is a share of the length of the edges


def test_radii_of_a_pipeline_are_its_own_and_are_kept_as_more_is_reserved():
    mesh = sheet_and_bead([0.1, 0.2])
    pipeline, end = ccd.CollisionPipeline(mesh), mesh.vertices - [0, 0, 2.0] * (mesh.vertex_body == 1)[:, None]
    assert pipeline.radius.numpy().tolist() == mesh.radius.tolist() and pipeline.radius.dtype is wp.float64
    pipeline.radius.fill_(0.25)
    pipeline.reserve(max_pairs=1 << 13)
    assert pipeline.launch(mesh.vertices, end).toi.numpy()[0] == pytest.approx(0.25)
    assert mesh.radius.max() == 0.2 and pipeline.mesh_ccd(mesh.vertices, end).toi == pytest.approx(0.35)
    with pytest.raises(ValueError, match=r"minimum_separation is 0.01 and the mesh has a radius of up to 0"):
        ccd.CollisionPipeline(sheet_and_bead(0.0), minimum_separation=0.01)  # whose radii the device may change
