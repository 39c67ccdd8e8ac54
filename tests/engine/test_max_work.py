"""The budget of a step: what hard pairs get is theirs by number alone, and what is cut is early and marked."""

from functools import cache

import numpy as np
import pytest
import trimesh
from exact import exact_tois
from expected_warnings import OF_ROUNDING
from hard_cases import FAMILIES
from scenes import FACE, pairs_in_worlds

import ccd_warp as ccd

pytestmark = OF_ROUNDING

KINDS = ["vertex_face", "edge_edge"]
OPTIONS = {"tolerance": 1e-15, "length_scale": 1.0}
_FIRST = 256  # iterations of a first round, after which a pair waits for its share of the work


def solved(kind, start, end, **options):
    """Each pair alone."""
    return getattr(ccd, f"{kind}_ccd")(start, end, **OPTIONS, **options)


@cache
def needles(kind):
    """Needles that cross each other, each pair of which takes more than the iterations of a first round."""
    start, end = FAMILIES["needle_against_needle"](kind.replace("_", "-"), 3000, np.random.default_rng(0))
    is_hard = solved(kind, start, end).iterations > _FIRST
    assert is_hard.sum() > 30
    return start[is_hard], end[is_hard]


def scene_of(kind, count):
    """Hard pairs one after the other, mirrored in turn, each in a world of its own."""
    mirror = np.random.default_rng(1).choice([-1.0, 1.0], (count, 1, 3))
    return pairs_in_worlds(kind, *(mirror * x[np.arange(count) % len(x)] for x in needles(kind)))


@pytest.mark.parametrize("kind", KINDS)
def test_first_step_of_a_mesh_loses_no_hard_pair_where_several_threads_find_one_at_once(kind):
    mesh, start, end = scene_of(kind, 800)
    options = OPTIONS | {"max_iterations": _FIRST + 4}
    toi = ccd.mesh_ccd(mesh, start, end, **options).toi
    body = mesh.vertices, mesh.faces, mesh.edges[mesh.codimensional_edges]
    for _ in range(4):
        new = ccd.CollisionMesh.from_arrays([body], vertex_world=mesh.vertex_world, codimensional_points=True)
        assert ccd.collision_free_step(new, start, end, num_threads=4, **options) == toi


@pytest.mark.parametrize("kind", KINDS)
def test_pairs_that_come_after_a_closed_one_take_no_share_of_the_work(kind):
    """Of many hard pairs one is open before the time at which a face meets another: all of the work is its."""
    start, end = needles(kind)
    exact, cut = solved(kind, start, end), solved(kind, start, end, max_iterations=_FIRST)
    first = np.argmin(exact.toi)
    later = np.flatnonzero(cut.toi > 1.1 * exact.toi[first])
    assert len(later) > 10 and cut.toi[first] < exact.toi[first]
    bound, chosen = 0.5 * (exact.toi[first] + cut.toi[later].min()), np.append(first, later)
    hard, *ends = pairs_in_worlds(kind, start[chosen], end[chosen])
    faces = [np.array([[0.0, 0, z], [1, 0, z], [0, 1, z]]) for z in (0.0, bound)]
    bodies = [(hard.vertices, hard.faces, hard.edges[hard.codimensional_edges]), *((face, FACE) for face in faces)]
    worlds = np.append(hard.vertex_world, np.full(6, len(chosen)))
    mesh = ccd.CollisionMesh.from_arrays(bodies, vertex_world=worlds, codimensional_points=True)
    positions = mesh.vertices, np.concatenate([ends[1], faces[0] + [0, 0, 1.0], faces[1]])
    enough = int(exact.iterations[first]) + 1
    assert ccd.collision_free_step(mesh, *positions, max_work=enough, **OPTIONS) == exact.toi[first]


@pytest.mark.parametrize("kind", KINDS)
def test_hopeless_pairs_get_equal_shares_of_the_work_and_not_an_iteration_more(kind):
    frames = scene_of(kind, 200)
    by_work = ccd.mesh_ccd(*frames, max_work=200 * 300 + 199, max_iterations=10**6, **OPTIONS).contacts
    by_pair = ccd.mesh_ccd(*frames, max_iterations=300, **OPTIONS).contacts
    assert (by_work.status == ccd.CCDStatus.ITERATION_LIMIT).any()
    for name, values in vars(by_pair).items():
        np.testing.assert_array_equal(getattr(by_work, name), values)


def test_thousands_of_hopeless_pairs_end():
    # many of them would go on for all of these iterations
    frames, options = scene_of("vertex_face", 2000), OPTIONS | {"max_work": 1, "max_iterations": 10**6}
    result = ccd.mesh_ccd(*frames, **options)
    assert (result.contacts.status == ccd.CCDStatus.ITERATION_LIMIT).sum() > 1000
    assert ccd.collision_free_step(*frames, **options) >= result.toi


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("max_work", [1, 3000, 10_000_000])
def test_cut_pairs_are_early_and_marked_and_never_late(kind, max_work):
    count = len(needles(kind)[0])
    mesh, start, end = scene_of(kind, count)
    pairs = [x.reshape(-1, 4, 3) for x in (start, end)]
    result = ccd.mesh_ccd(mesh, start, end, max_work=max_work, **OPTIONS)
    step = ccd.collision_free_step(mesh, start, end, max_work=max_work, **OPTIONS)
    is_cut = np.zeros(count, dtype=bool)
    is_cut[result.contacts.world[result.contacts.status == ccd.CCDStatus.ITERATION_LIMIT]] = True
    assert is_cut.any() or max_work == 10_000_000
    alone = solved(kind, *pairs).toi
    np.testing.assert_array_equal(result.world_toi[~is_cut], alone[~is_cut])
    assert (result.world_toi <= alone).all()
    truth = exact_tois(kind.replace("_", "-"), *pairs)
    assert not any(exact.late(toi) or exact.late(step) for exact, toi in zip(truth, result.world_toi, strict=True))


def test_scene_without_hard_pairs_never_touches_the_budget(precision):
    ball = trimesh.creation.icosphere(subdivisions=2)
    mesh = ccd.CollisionMesh.from_trimesh([ball, ball])
    start = mesh.vertices + [2.5, 0.1, 0.2] * (mesh.vertex_body == 1)[:, None]
    end, found = start - [2.0, 0, 0] * (mesh.vertex_body == 1)[:, None], []
    for max_work in (1, 2**63 - 1):
        options = {"max_work": max_work, "precision": precision, "minimum_separation": 1e-3}
        result = ccd.mesh_ccd(mesh, start, end, **options)
        found.append([*vars(result.contacts).values(), result.vertex_toi, result.body_toi])
        assert ccd.collision_free_step(mesh, start, end, **options) == result.toi < 1
    assert all(map(np.array_equal, *found))
