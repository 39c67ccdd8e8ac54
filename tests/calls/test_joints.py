"""Calls with links that joints move: a planar arm whose contacts are known, in worlds of their own."""

from itertools import product

import numpy as np
import pytest
import trimesh
from laws.turning import turned

import ccd_warp as ccd
from ccd_warp._engine.host import near_search

NO_FACES = np.zeros((0, 3), dtype=int)
BLADE = np.array([[0.0, 0, -0.1], [1, 0, -0.1], [1, 0, 0.1]])
OBSTACLE = np.array([1.3, 0.9, 0.0])
ARM = [
    ccd.Joint("shoulder", "base", "upper", "revolute", axis=[0, 0, 1]),
    ccd.Joint("elbow", "upper", "lower", "revolute", axis=[0, 0, 1], origin=[1, 0, 0, 0, 0, 0, 1]),
]
LINKS = ["upper", "lower"]
NEIGHBOURS_APART = ~np.array([[0, 1, 0], [1, 0, 0], [0, 0, 0]], dtype=bool)
TWO_BLADES = [(BLADE, [[0, 1, 2]])] * 2


def arm_mesh(*others, **options):
    """Two links of length 1, thin triangles, and other bodies."""
    options = {"rigid": [0, 1], "codimensional_points": True, "body_pairs": NEIGHBOURS_APART} | options
    return ccd.CollisionMesh.from_arrays([*TWO_BLADES, *others], **options)


def arm_and_point(count, **options):
    """The arm and a point beside it, in so many worlds."""
    mesh = arm_mesh((OBSTACLE[None], NO_FACES), **{"static": [2]} | options)
    return mesh if count == 1 else mesh.replicate(count)


def moved(mesh, motion, call=ccd.mesh_ccd, end=None, **options):
    """A call with a motion of joints, where nothing else moves by default."""
    return call(mesh, mesh.vertices, mesh.vertices if end is None else end, motion=motion, **options)


def edges(count, seed=0, around=0.5):
    rng = np.random.default_rng(seed)
    q0 = rng.uniform(-around, around, (count, 2))
    return q0, q0 + rng.uniform(-2, 2, (count, 2))


def arms(count=24):
    return ccd.JointMotion(ARM, *edges(count), links=LINKS)


def side_of_point(q, link):
    """By how much the obstacle is beside the line of a link, and whether it is along it, for [..., 2] angles."""
    angle = q[..., 0] if link == 0 else q[..., 0] + q[..., 1]
    d = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    z = OBSTACLE[:2] - link * np.stack([np.cos(q[..., 0]), np.sin(q[..., 0])], axis=-1)
    along = (z * d).sum(axis=-1)
    return z[..., 0] * d[..., 1] - z[..., 1] * d[..., 0], (along >= 0) & (along <= 1)


def first_contact(q0, q1, samples=20_000):
    """When the first link sweeps the point, by samples and bisection; inf if none does."""
    first, t = np.inf, np.linspace(0, 1, samples)
    for link in (0, 1):
        side, is_along = side_of_point(q0 + t[:, None] * (q1 - q0), link)
        for k in np.flatnonzero((side[:-1] * side[1:] <= 0) & is_along[1:])[:1]:
            low, high = t[k], t[k + 1]
            for _ in range(60):
                middle = 0.5 * (low + high)
                at_middle = side_of_point(q0 + middle * (q1 - q0), link)[0]
                low, high = (middle, high) if at_middle * side[k] > 0 else (low, middle)
            first = min(first, high)
    return first


@pytest.fixture(scope="module")
def truth():
    return np.array([first_contact(a, b) for a, b in zip(*edges(24), strict=True)])


def test_arm_that_sweeps_a_point(truth, precision):
    result = moved(arm_and_point(24), arms(), precision=precision)
    touches, contacts = np.isfinite(truth), result.contacts
    assert 5 < touches.sum() < 20 and (np.isfinite(result.world_toi) == touches).all()
    early = truth[touches] - result.world_toi[touches]
    assert early.min() > -1e-14 and np.median(early) < 1e-12  # the bisection's own error
    assert result.toi == result.world_toi.min() and (contacts.toi >= result.world_toi[contacts.world]).all()
    assert np.abs(contacts.points - OBSTACLE).max() < 1e-9
    assert (contacts.world[result.world_contact[touches]] == np.flatnonzero(touches)).all()
    assert (result.world_contact[~touches] == -1).all()
    within = moved(arm_and_point(24), arms(), precision=precision, minimum_distance=0.01)
    assert (within.world_toi[touches] < truth[touches]).all()
    assert (within.contacts.gap < (1e-9 if precision == "float64" else 1e-6)).all()
    # one alone has its toi; its links touch at the elbow all the time, and the mesh says that they are neighbours
    k, mesh, is_free = int(np.flatnonzero(touches)[0]), arm_and_point(1), ccd.is_step_collision_free
    motion = ccd.JointMotion(ARM, *(q[k] for q in edges(24)), links=LINKS)
    toi = moved(mesh, motion, ccd.collision_free_step, precision=precision)
    assert toi == result.world_toi[k] and not moved(mesh, motion, is_free)
    assert moved(mesh, motion.shortened(0.999 * toi), is_free) and moved(mesh, motion, is_free, t_max=0.999 * toi)


def test_what_joints_do_not_move_is_refused_by_name():
    mesh, one = arm_and_point(2), ccd.JointMotion(ARM, [0.0, 0.0], [1.0, 1.0], links=LINKS)
    kinematic = arm_and_point(1, static=[], kinematic=[2])
    mixed = ccd.CollisionMesh.from_arrays(2 * TWO_BLADES, rigid=range(4), vertex_world=np.repeat([0, 1, 0, 1], 3))
    for arguments, options, message in (
        ((mesh, one), {}, "1 worlds; expected 2 like the mesh"),
        ((mesh, one), {"method": "bisection"}, "method is 'bisection'"),
        ((mesh, ccd.JointMotion(ARM, *edges(2))), {}, "6 rows for 4 rigid bodies"),
        ((mixed, arms(2)), {}, "rigid bodies are in the order of their worlds"),
        ((arm_and_point(1), one, ccd.line_search), {"per": "body"}, "per is 'body'; expected 'scene' or 'world'"),
        ((kinematic, one, ccd.line_search), {}, "body 2 is kinematic; expected no such body"),
    ):
        with pytest.raises(ValueError, match=message):
            moved(*arguments, **options)


@pytest.mark.parametrize("per", ["world", "scene"])
def test_arms_in_worlds_stop_before_the_point_in_their_way(truth, per):
    mesh, motion = arm_and_point(24), arms()
    found = moved(mesh, motion, ccd.line_search, per=per)
    expected = np.where(np.isfinite(truth), 0.9 * truth, 1.0)
    expected = expected if per == "world" else np.full(24, expected.min())
    is_link = mesh.rigid[mesh.vertex_body]
    fraction = found.vertex_fraction[is_link].reshape(24, -1)
    assert (np.ptp(fraction, axis=1) == 0.0).all() and fraction[:, 0] == pytest.approx(expected, abs=1e-11)
    assert (found.motion.poses_t1 == motion.at(fraction[:, 0])).all()
    angles = np.cumsum(motion.configuration(fraction[:, 0]), axis=1)
    ends = np.cumsum(np.stack([np.cos(angles), np.sin(angles)], axis=2), axis=1)
    assert found.vertices[is_link].reshape(24, 2, 3, 3)[:, :, 1, :2] == pytest.approx(ends, abs=1e-12)
    assert moved(mesh, found.motion, ccd.is_step_collision_free)


def test_arm_pushes_no_cloth_that_hangs_in_its_way():
    """What is deformable shares the fraction of its world."""
    mesh = arm_mesh((np.array([[0.6, 1.0, -0.1], [0.9, 1.3, -0.1], [0.75, 1.15, 0.1]]), [[0, 1, 2]])).replicate(2)
    moves = mesh.vertex_body % 3 == 2
    end = mesh.vertices + moves[:, None] * [0.0, -0.6, 0.0]
    motion = ccd.JointMotion(ARM, np.zeros((2, 2)), [[1.5, 0.2], [0.1, -0.1]], links=LINKS)
    found = moved(mesh, motion, ccd.line_search, end, per="world")
    fraction, toi = found.vertex_fraction.reshape(2, -1), moved(mesh, motion, end=end).world_toi
    assert 0.2 < toi[0] < 0.9 and toi[1] == np.inf and found.num_rounds == 2
    assert (np.ptp(fraction, axis=1) == 0.0).all() and fraction[:, 0].tolist() == [0.9 * toi[0], 1.0]
    expected = mesh.vertices + found.vertex_fraction[:, None] * (end - mesh.vertices)
    assert found.vertices[moves] == pytest.approx(expected[moves], abs=1e-15)
    shortened = np.where(moves[:, None], found.vertices, mesh.vertices)
    assert moved(mesh, found.motion, ccd.is_step_collision_free, shortened)


def test_arm_that_touches_at_the_start_stays_and_the_others_go():
    mesh = arm_and_point(2)
    bend = np.arccos(0.5 * np.hypot(*OBSTACLE[:2]))  # of two links of length 1 whose tip is at the point
    q0 = np.array([[np.arctan2(0.9, 1.3) + bend, -2 * bend], [0.0, 0.0]])
    motion = ccd.JointMotion(ARM, q0, q0 + [[0.3, 0.1], [0.1, 0.0]], links=LINKS)
    is_link = mesh.rigid[mesh.vertex_body]
    for per, fractions in (("world", [0.0] * 6 + [1.0] * 6), ("scene", [0.0] * 12)):
        found = moved(mesh, motion, ccd.line_search, per=per, minimum_distance=0.01)
        assert found.vertex_fraction[is_link].tolist() == fractions
        assert (found.motion.configuration(1.0)[0] == q0[0]).all()
        assert found.touching.world.tolist() == [0] * len(found.touching) != []
    assert (found.motion.poses_t1 == motion.poses_t0).all()


def test_candidates_of_an_arm_are_all_pairs_that_come_near_on_the_way():
    motion, mesh, near, swept = arms(), arm_and_point(24), 0.02, set()
    find = lambda *ends, **options: ccd.find_candidates(*ends, near, **options)  # noqa: E731
    tree, grid = (moved(mesh, motion, find, broad_phase=name).vertex_face.tolist() for name in ("tree", "hash"))
    found = {*map(tuple, tree)}
    assert found == {*map(tuple, grid)} and len(found) == len(tree) == len(grid)
    for t, link in product(np.linspace(0, 1, 200), (0, 1)):
        side, is_along = side_of_point(motion.configuration(t), link)
        for world in np.flatnonzero((abs(side) <= near) & is_along).tolist():
            swept.add((int(mesh.body_vertex_range[3 * world + 2]), 2 * world + link))
    # boxes of the whole step hold the point for most links
    assert swept <= found and 3 < len(swept) <= len(found) < 1.5 * len(swept)


@pytest.mark.parametrize("place", [0.2, 0.99])
def test_slider_that_is_back_at_the_end_meets_what_is_where_it_was_between(place):
    """Its poses at both ends are the same."""
    slide = ccd.Joint("slide", "base", "tool", "prismatic", axis=[1, 0, 0])
    motion = ccd.JointMotion.from_cubics([slide], [[0.0], [4.0], [-4.0], [0.0]], links=["tool"])
    bodies = [([[0.0, -1, -1], [0, 1, -1], [0, 0, 1]], [[0, 1, 2]]), ([[place, 0, 0]], NO_FACES)]
    mesh = ccd.CollisionMesh.from_arrays(bodies, rigid=[0], static=[1], codimensional_points=True)
    assert moved(mesh, motion, ccd.find_candidates).vertex_face.tolist() == [[3, 0]]
    fraction = moved(mesh, motion, ccd.line_search).fraction
    assert fraction == pytest.approx(0.45 * (1.0 - np.sqrt(1.0 - place)), abs=1e-8)


@pytest.fixture(scope="module")
def blocks():
    """An arm whose links are divided blocks, among a divided ball, a cable and a point, with 12 motions of it."""
    block = trimesh.creation.box([1, 0.1, 0.1]).subdivide().subdivide().apply_translation([0.5, 0, 0])
    ball = trimesh.creation.icosphere(2, 0.2)
    cable = np.array([[-0.8, 0.9, -0.5], [-0.8, 0.9, 0.5]]), NO_FACES, [[0, 1]]
    bodies = [*[(block.vertices, block.faces)] * 2, (ball.vertices + [1.2, 1.0, 0.05], ball.faces), cable]
    bodies.append((np.array([[0.2, -1.4, 0.01]]), NO_FACES))
    may = np.ones((5, 5), dtype=bool)
    may[0, 1] = may[1, 0] = False
    options = {"rigid": [0, 1], "static": [2, 3, 4], "codimensional_points": True, "body_pairs": may}
    mesh = ccd.CollisionMesh.from_arrays(bodies, **options).replicate(12)
    return mesh, ccd.JointMotion(ARM, *edges(12, seed=1, around=3), links=LINKS)


@pytest.mark.parametrize("options", [{}, {"minimum_distance": 0.05}, {"t_max": 0.7}])
def test_parts_alone_touch_as_whole_bodies_do(blocks, options, monkeypatch):
    (mesh, motion), results = blocks, []
    if not options:  # in several meshes of parts
        for name, few in (("_MOST_ROWS", 1000), ("_MOST_WINDOWS", 4), ("_FEW_WORLDS", 1), ("_SLICES", 1)):
            monkeypatch.setattr(near_search, name, few)
    for near_parts in (ccd.CollisionPipeline._near_parts, lambda *_: None):
        monkeypatch.setattr(ccd.CollisionPipeline, "_near_parts", near_parts)
        results.append(moved(mesh, motion, **options))
    of_parts, of_bodies = results
    touches = np.isfinite(of_bodies.world_toi)
    assert 3 < touches.sum() < 12 and "near parts" in of_parts.timings and "near parts" not in of_bodies.timings
    np.testing.assert_allclose(of_parts.world_toi, of_bodies.world_toi, atol=1e-12)
    np.testing.assert_array_equal(of_parts.body_toi < np.inf, of_bodies.body_toi < np.inf)
    # of each world the first contact; others differ with the last window
    for world in np.flatnonzero(touches).tolist():
        first, other = (r.contacts[int(r.world_contact[world])] for r in results)
        assert first.world == other.world == world
        assert (first.bodies % 5 == other.bodies % 5).all() and (first.bodies // 5 == world).all()
        # of several at once, as of two edges that are parallel, it is one of them
        own = of_bodies.contacts[of_bodies.contacts.world == world]
        own = own[own.toi < of_bodies.world_toi[world] + 1e-9]
        same = own[int(np.linalg.norm(own.points - first.point, axis=1).argmin())]
        np.testing.assert_allclose(first.point, same.point, atol=1e-6)
        np.testing.assert_allclose(first.relative_velocity, same.relative_velocity, atol=1e-3)
    assert len({*of_parts.contacts.kind.tolist()}) > 1


def test_relative_velocity_of_contacts_is_that_in_the_whole_step(blocks):
    mesh, motion = blocks
    contacts = moved(mesh, motion).contacts
    assert len(contacts)
    for contact in contacts[:20]:
        link, sign = (0, 1.0) if mesh.rigid[contact.bodies[0]] else (1, -1.0)
        row = int(contact.bodies[link]) % 5
        times = (min(max(contact.toi + d, 0), 1) for d in (-1e-6, 1e-6))
        first, last = (motion.at(t)[contact.world, row] for t in times)
        local = turned(first[3:] * [-1, -1, -1, 1], contact.point - first[:3])
        velocity = (turned(last[3:], local) + last[:3] - contact.point) / 2e-6
        np.testing.assert_allclose(contact.relative_velocity, sign * velocity, atol=1e-3)


def test_a_link_that_stands_is_where_its_joint_has_it(truth):
    """The obstacle is a link on a fixed joint, whose vertex is the origin of its own frame."""
    mesh = arm_mesh((np.zeros((1, 3)), NO_FACES), rigid=[0, 1, 2], static=[2]).replicate(24)
    joints = [*ARM, ccd.Joint("mount", "base", "post", "fixed", origin=[*OBSTACLE, 0, 0, 0, 1])]
    result = moved(mesh, ccd.JointMotion(joints, *edges(24), links=[*LINKS, "post"]))
    assert "near parts" in result.timings
    np.testing.assert_allclose(result.world_toi, truth, atol=1e-11)


def test_worlds_that_differ_are_searched_as_a_whole():
    """Links of other sizes in the second world, and an obstacle elsewhere."""
    bodies = [(OBSTACLE[None], NO_FACES), TWO_BLADES[0], (2 * BLADE, [[0, 1, 2]])]
    bodies += [(OBSTACLE[None] * [1.5, 1.5, 1], NO_FACES)]
    apart = np.kron(np.eye(2, dtype=bool), NEIGHBOURS_APART)
    options = {"rigid": [0, 1, 3, 4], "static": [2, 5], "vertex_world": np.repeat([0, 1], 7)}
    motion = ccd.JointMotion(ARM, [[-0.2, 0.0]] * 2, [[1.4, 0.5]] * 2, links=LINKS)
    tois = moved(arm_mesh(*bodies, body_pairs=apart, **options), motion).world_toi
    assert tois.max() < 1 and tois[0] != tois[1]


def test_slides_as_short_as_squares_that_vanish_do_not_lose_a_face():
    """A point at the end of six slides of 1.4e-162 each, whose squares are 0, comes to a face after nine tenths."""
    count, size = 6, 1.4e-162
    slides = [ccd.Joint(f"s{k}", f"l{k}", f"l{k + 1}", "prismatic", axis=[1, 0, 0]) for k in range(count)]
    face = size * (np.array([[0.0, -1, -1], [0, 1, -1], [0, 0, 1]]) + [0.9 * count, 0, 0])
    bodies = [(np.zeros((1, 3)), NO_FACES), (face, [[0, 1, 2]])]
    mesh = ccd.CollisionMesh.from_arrays(bodies, rigid=[0], static=[1], codimensional_points=True)
    motion = ccd.JointMotion(slides, np.zeros(count), np.full(count, size), links=[f"l{count}"])
    toi = moved(mesh, motion).toi
    assert toi == pytest.approx(0.9, abs=1e-6) and toi <= 0.9
