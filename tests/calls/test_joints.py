"""Calls with links that joints move: a planar arm whose contacts are known, in worlds of their own."""

import numpy as np
import pytest
import trimesh

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


def arm_and_point(count, **options):
    """Two links of length 1, thin triangles, and a point beside them, in so many worlds."""
    bodies = [(BLADE, [[0, 1, 2]])] * 2 + [(OBSTACLE[None], NO_FACES)]
    mesh = ccd.CollisionMesh.from_arrays(
        bodies, rigid=[0, 1], static=[2], codimensional_points=True, body_pairs=NEIGHBOURS_APART, **options
    )
    return mesh if count == 1 else mesh.replicate(count)


def edges(count, seed=0):
    rng = np.random.default_rng(seed)
    q0 = rng.uniform(-0.5, 0.5, (count, 2))
    return q0, q0 + rng.uniform(-2, 2, (count, 2))


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


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_arm_that_sweeps_a_point(truth, precision):
    motion = ccd.JointMotion(ARM, *edges(24), links=LINKS)
    mesh = arm_and_point(24)
    result = ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices, motion=motion, precision=precision, device="cpu")
    touches = np.isfinite(truth)
    assert 5 < touches.sum() < 20
    assert (np.isfinite(result.world_toi) == touches).all()
    early = truth[touches] - result.world_toi[touches]
    assert early.min() > -1e-14  # the bisection's own error
    assert np.median(early) < 1e-12
    assert result.toi == result.world_toi.min()
    assert (result.contacts.toi >= result.world_toi[result.contacts.world]).all()
    assert np.abs(result.contacts.points - OBSTACLE).max() < 1e-9
    for world in np.flatnonzero(touches):
        assert result.contacts.world[result.world_contact[world]] == world
    assert (result.world_contact[~touches] == -1).all()


def test_one_arm_alone_has_the_toi_that_it_has_among_others(truth):
    q0, q1 = edges(24)
    k = int(np.flatnonzero(np.isfinite(truth))[0])
    mesh = arm_and_point(1)
    motion = ccd.JointMotion(ARM, q0[k], q1[k], links=LINKS)
    arguments = (mesh, mesh.vertices, mesh.vertices)
    toi = ccd.collision_free_step(*arguments, motion=motion, device="cpu")
    assert toi == pytest.approx(truth[k], abs=1e-11)
    assert toi <= truth[k] + 1e-14
    assert not ccd.is_step_collision_free(*arguments, motion=motion, device="cpu")
    assert ccd.is_step_collision_free(*arguments, motion=motion.shortened(0.999 * toi), device="cpu")
    assert ccd.is_step_collision_free(*arguments, motion=motion, t_max=0.999 * toi, device="cpu")


def test_distance_is_kept_on_the_way(truth):
    motion = ccd.JointMotion(ARM, *edges(24), links=LINKS)
    mesh = arm_and_point(24)
    options = {"motion": motion, "minimum_distance": 0.01, "device": "cpu"}
    result = ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices, **options)
    touches = np.isfinite(truth)
    assert (result.world_toi[touches] < truth[touches]).all()
    assert (result.contacts.gap < 1e-9).all()


def test_links_of_one_arm_do_not_collide_where_their_joint_is():
    """They touch at the elbow all the time; the mesh says that they are neighbours."""
    mesh = arm_and_point(1)
    motion = ccd.JointMotion(ARM, [0.0, -1.0], [0.2, -0.5], links=LINKS)
    assert ccd.is_step_collision_free(mesh, mesh.vertices, mesh.vertices, motion=motion, device="cpu")


def test_bad_joints_are_refused_by_name():
    mesh = arm_and_point(2)
    arguments = (mesh, mesh.vertices, mesh.vertices)
    motion = ccd.JointMotion(ARM, [0.0, 0.0], [1.0, 1.0], links=LINKS)
    with pytest.raises(ValueError, match="1 worlds; expected 2 like the mesh"):
        ccd.mesh_ccd(*arguments, motion=motion, device="cpu")
    with pytest.raises(ValueError, match="method is 'bisection'"):
        ccd.mesh_ccd(*arguments, motion=motion, method="bisection", device="cpu")
    three = ccd.JointMotion(ARM, *edges(2))
    with pytest.raises(ValueError, match="6 rows for 4 rigid bodies"):
        ccd.mesh_ccd(*arguments, motion=three, device="cpu")


@pytest.mark.parametrize("per", ["world", "scene"])
def test_arms_in_worlds_stop_before_the_point_in_their_way(truth, per):
    mesh, motion = arm_and_point(24), ccd.JointMotion(ARM, *edges(24), links=LINKS)
    arguments = (mesh, mesh.vertices, mesh.vertices)
    found = ccd.line_search(*arguments, per=per, motion=motion, device="cpu")
    expected = np.where(np.isfinite(truth), 0.9 * truth, 1.0)
    expected = expected if per == "world" else np.full(24, expected.min())
    is_link = mesh.rigid[mesh.vertex_body]
    fraction = found.vertex_fraction[is_link].reshape(24, -1)
    assert (np.ptp(fraction, axis=1) == 0.0).all()
    assert fraction[:, 0] == pytest.approx(expected, abs=1e-11)
    assert (found.motion.poses_t1 == motion.at(fraction[:, 0])).all()
    assert found.motion.configuration(1.0) == pytest.approx(motion.configuration(fraction[:, 0]), abs=1e-15)
    angles = np.cumsum(found.motion.configuration(1.0), axis=1)
    ends = np.cumsum(np.stack([np.cos(angles), np.sin(angles)], axis=2), axis=1)
    assert found.vertices[is_link].reshape(24, 2, 3, 3)[:, :, 1, :2] == pytest.approx(ends, abs=1e-12)
    assert ccd.is_step_collision_free(*arguments, motion=found.motion, device="cpu")


def test_arm_pushes_no_cloth_that_hangs_in_its_way():
    """What is deformable shares the fraction of its world."""
    cloth = np.array([[0.6, 1.0, -0.1], [0.9, 1.3, -0.1], [0.75, 1.15, 0.1]])
    bodies = [(BLADE, [[0, 1, 2]])] * 2 + [(cloth, [[0, 1, 2]])]
    mesh = ccd.CollisionMesh.from_arrays(bodies, rigid=[0, 1], body_pairs=NEIGHBOURS_APART).replicate(2)
    end = mesh.vertices.copy()
    moves = np.flatnonzero(mesh.vertex_body % 3 == 2)
    end[moves] += [0.0, -0.6, 0.0]
    motion = ccd.JointMotion(ARM, np.zeros((2, 2)), [[1.5, 0.2], [0.1, -0.1]], links=LINKS)
    found = ccd.line_search(mesh, mesh.vertices, end, per="world", motion=motion, device="cpu")
    fraction = found.vertex_fraction.reshape(2, -1)
    toi = ccd.mesh_ccd(mesh, mesh.vertices, end, motion=motion, device="cpu").world_toi
    assert 0.2 < toi[0] < 0.9 and toi[1] == np.inf and found.num_rounds == 2
    assert (np.ptp(fraction, axis=1) == 0.0).all() and fraction[:, 0].tolist() == [0.9 * toi[0], 1.0]
    moved = mesh.vertices + found.vertex_fraction[:, None] * (end - mesh.vertices)
    assert found.vertices[moves] == pytest.approx(moved[moves], abs=1e-15)
    shortened = np.where(mesh.rigid[mesh.vertex_body][:, None], mesh.vertices, found.vertices)
    assert ccd.is_step_collision_free(mesh, mesh.vertices, shortened, motion=found.motion, device="cpu")


def test_arm_that_touches_at_the_start_stays_and_the_others_go():
    mesh = arm_and_point(2)
    bend = np.arccos(0.5 * np.hypot(*OBSTACLE[:2]))  # of two links of length 1 whose tip is at the point
    q0 = np.array([[np.arctan2(0.9, 1.3) + bend, -2 * bend], [0.0, 0.0]])
    motion = ccd.JointMotion(ARM, q0, q0 + [[0.3, 0.1], [0.1, 0.0]], links=LINKS)
    options = {"minimum_distance": 0.01, "device": "cpu"}
    found = ccd.line_search(mesh, mesh.vertices, mesh.vertices, per="world", motion=motion, **options)
    assert found.vertex_fraction[mesh.rigid[mesh.vertex_body]].tolist() == [0.0] * 6 + [1.0] * 6
    assert (found.motion.configuration(1.0)[0] == q0[0]).all()
    assert found.touching.world.tolist() == [0] * len(found.touching) != []
    of_scene = ccd.line_search(mesh, mesh.vertices, mesh.vertices, motion=motion, **options)
    assert (of_scene.vertex_fraction[mesh.rigid[mesh.vertex_body]] == 0.0).all()
    assert (of_scene.motion.poses_t1 == motion.poses_t0).all()


def test_candidates_of_an_arm_are_all_pairs_that_come_near_on_the_way():
    count = 24
    q0, q1 = edges(count)
    motion, mesh = ccd.JointMotion(ARM, q0, q1, links=LINKS), arm_and_point(count)
    near = 0.02
    found = {}
    for broad_phase in ("tree", "hash"):
        options = {"motion": motion, "broad_phase": broad_phase, "device": "cpu"}
        candidates = ccd.find_candidates(mesh, mesh.vertices, mesh.vertices, near, **options)
        found[broad_phase] = {tuple(pair) for pair in candidates.vertex_face.tolist()}
        assert len(found[broad_phase]) == len(candidates.vertex_face)
    assert found["tree"] == found["hash"]
    swept = set()
    for t in np.linspace(0, 1, 200):
        for link in (0, 1):
            side, is_along = side_of_point(motion.configuration(t), link)
            for world in np.flatnonzero((abs(side) <= near) & is_along).tolist():
                swept.add((int(mesh.body_vertex_range[3 * world + 2]), 2 * world + link))
    assert len(swept) > 3
    assert swept <= found["tree"]
    assert len(found["tree"]) < 1.5 * len(swept)  # boxes of the whole step hold the point for most links


@pytest.mark.parametrize("place", [0.2, 0.99])
def test_slider_that_is_back_at_the_end_meets_what_is_where_it_was_between(place):
    """Its poses at both ends are the same."""
    slide = ccd.Joint("slide", "base", "tool", "prismatic", axis=[1, 0, 0])
    motion = ccd.JointMotion.from_cubics([slide], [[0.0], [4.0], [-4.0], [0.0]], links=["tool"])
    face, point = [[0.0, -1, -1], [0, 1, -1], [0, 0, 1]], [[place, 0, 0]]
    bodies = [(face, [[0, 1, 2]]), (point, NO_FACES)]
    mesh = ccd.CollisionMesh.from_arrays(bodies, rigid=[0], static=[1], codimensional_points=True)
    arguments = (mesh, mesh.vertices, mesh.vertices)
    assert ccd.find_candidates(*arguments, motion=motion, device="cpu").vertex_face.tolist() == [[3, 0]]
    found = ccd.line_search(*arguments, motion=motion, device="cpu")
    assert found.fraction == pytest.approx(0.45 * (1.0 - np.sqrt(1.0 - place)), abs=1e-8)


def test_line_searches_that_joints_do_not_have_are_refused():
    mesh, motion = arm_and_point(1), ccd.JointMotion(ARM, [0.0, 0.0], [1.0, 1.0], links=LINKS)
    with pytest.raises(ValueError, match="per is 'body'; expected 'scene' or 'world'"):
        ccd.line_search(mesh, mesh.vertices, mesh.vertices, per="body", motion=motion, device="cpu")
    bodies = [(BLADE, [[0, 1, 2]])] * 2 + [(OBSTACLE[None], NO_FACES)]
    moving = ccd.CollisionMesh.from_arrays(bodies, rigid=[0, 1], kinematic=[2], codimensional_points=True)
    with pytest.raises(ValueError, match="body 2 is kinematic; expected no such body"):
        ccd.line_search(moving, moving.vertices, moving.vertices, motion=motion, device="cpu")


@pytest.fixture(scope="module")
def blocks():
    """An arm whose links are divided blocks, among a divided ball, a cable and a point, and 12 edges of it."""
    block = trimesh.creation.box([1, 0.1, 0.1]).subdivide().subdivide().apply_translation([0.5, 0, 0])
    ball = trimesh.creation.icosphere(2, 0.2)
    bodies = [
        (block.vertices, block.faces),
        (block.vertices, block.faces),
        (ball.vertices + [1.2, 1.0, 0.05], ball.faces),
        (np.array([[-0.8, 0.9, -0.5], [-0.8, 0.9, 0.5]]), NO_FACES, [[0, 1]]),
        (np.array([[0.2, -1.4, 0.01]]), NO_FACES),
    ]
    may = np.ones((5, 5), dtype=bool)
    may[0, 1] = may[1, 0] = False
    mesh = ccd.CollisionMesh.from_arrays(
        bodies, rigid=[0, 1], static=[2, 3, 4], codimensional_points=True, body_pairs=may
    )
    rng = np.random.default_rng(1)
    q0 = rng.uniform(-3, 3, (12, 2))
    return mesh, (q0, q0 + rng.uniform(-2, 2, (12, 2)))


@pytest.mark.parametrize(
    "options", [{}, {"minimum_distance": 0.05}, {"t_max": 0.7}], ids=["plain", "distance", "t_max"]
)
def test_parts_alone_touch_as_whole_bodies_do(blocks, options, monkeypatch):
    one, ends = blocks
    mesh, motion = one.replicate(12), ccd.JointMotion(ARM, *ends, links=LINKS)
    if not options:  # in several meshes of parts
        for name, few in (("_MOST_ROWS", 1000), ("_MOST_WINDOWS", 4), ("_FEW_WORLDS", 1), ("_SLICES", 1)):
            monkeypatch.setattr(near_search, name, few)
    results = []
    for near_parts in (ccd.CollisionPipeline._near_parts, lambda *_: None):
        monkeypatch.setattr(ccd.CollisionPipeline, "_near_parts", near_parts)
        results.append(ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices, motion=motion, device="cpu", **options))
    of_parts, of_bodies = results
    touches = np.isfinite(of_bodies.world_toi)
    assert 3 < touches.sum() < 12 and "near parts" in of_parts.timings and "near parts" not in of_bodies.timings
    assert (np.isfinite(of_parts.world_toi) == touches).all()
    np.testing.assert_allclose(of_parts.world_toi[touches], of_bodies.world_toi[touches], atol=1e-12)
    np.testing.assert_array_equal(of_parts.body_toi < np.inf, of_bodies.body_toi < np.inf)
    # of each world the first contact; others differ with the last window
    for world in np.flatnonzero(touches).tolist():
        first = [r.contacts[int(r.world_contact[world])] for r in results]
        assert first[0].world == first[1].world == world
        assert (first[0].bodies % 5 == first[1].bodies % 5).all() and (first[0].bodies // 5 == world).all()
        # of several at once, as of two edges that are parallel, it is one of them
        own = of_bodies.contacts[of_bodies.contacts.world == world]
        own = own[own.toi < of_bodies.world_toi[world] + 1e-9]
        same = own[int(np.linalg.norm(own.points - first[0].point, axis=1).argmin())]
        np.testing.assert_allclose(first[0].point, same.point, atol=1e-6)
        np.testing.assert_allclose(first[0].relative_velocity, same.relative_velocity, atol=1e-3)
    assert len({*of_parts.contacts.kind.tolist()}) > 1


def test_relative_velocity_of_contacts_is_that_in_the_whole_step(blocks):
    one, ends = blocks
    mesh, motion = one.replicate(12), ccd.JointMotion(ARM, *ends, links=LINKS)
    contacts = ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices, motion=motion, device="cpu").contacts
    assert len(contacts)
    for contact in contacts[:20]:
        link, sign = (0, 1.0) if mesh.rigid[contact.bodies[0]] else (1, -1.0)
        row = int(contact.bodies[link]) % 5
        poses = [motion.at(min(max(contact.toi + d, 0), 1))[contact.world, row] for d in (-1e-6, 1e-6)]
        turns = [trimesh.transformations.quaternion_matrix(p[[6, 3, 4, 5]])[:3, :3] for p in poses]
        local = turns[0].T @ (contact.point - poses[0][:3])
        velocity = sum(k * (turn @ local + p[:3]) for k, turn, p in zip((-1, 1), turns, poses, strict=True)) / 2e-6
        np.testing.assert_allclose(contact.relative_velocity, sign * velocity, atol=1e-3)


def test_a_link_that_stands_is_where_its_joint_has_it(truth):
    """The obstacle is a link on a fixed joint, whose vertex is the origin of its own frame."""
    mesh = ccd.CollisionMesh.from_arrays(
        [(BLADE, [[0, 1, 2]]), (BLADE, [[0, 1, 2]]), (np.zeros((1, 3)), NO_FACES)],
        rigid=[0, 1, 2],
        static=[2],
        codimensional_points=True,
        body_pairs=NEIGHBOURS_APART,
    ).replicate(24)
    joints = [*ARM, ccd.Joint("mount", "base", "post", "fixed", origin=[*OBSTACLE, 0, 0, 0, 1])]
    motion = ccd.JointMotion(joints, *edges(24), links=[*LINKS, "post"])
    result = ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices.copy(), motion=motion, device="cpu")
    assert "near parts" in result.timings
    assert (np.isfinite(result.world_toi) == np.isfinite(truth)).all()
    touches = np.isfinite(truth)
    np.testing.assert_allclose(result.world_toi[touches], truth[touches], atol=1e-11)


def test_worlds_that_differ_are_searched_as_a_whole():
    """Links of other sizes in the second world, and an obstacle elsewhere."""
    far = ccd.CollisionMesh.from_arrays(
        [(BLADE, [[0, 1, 2]]), (BLADE, [[0, 1, 2]]), (OBSTACLE[None], NO_FACES)]
        + [(BLADE, [[0, 1, 2]]), (2 * BLADE, [[0, 1, 2]]), (OBSTACLE[None] * [1.5, 1.5, 1], NO_FACES)],
        rigid=[0, 1, 3, 4],
        static=[2, 5],
        codimensional_points=True,
        body_pairs=np.kron(np.eye(2, dtype=bool), np.ones((3, 3), dtype=bool))
        & ~np.kron(np.eye(2, dtype=bool), np.array([[0, 1, 0], [1, 0, 0], [0, 0, 0]], dtype=bool)),
        vertex_world=np.repeat([0, 1], 7),
    )
    motion = ccd.JointMotion(ARM, [[-0.2, 0.0]] * 2, [[1.4, 0.5]] * 2, links=LINKS)
    tois = ccd.mesh_ccd(far, far.vertices, far.vertices, motion=motion, device="cpu").world_toi
    assert tois[0] < 1 and tois[1] < 1 and tois[0] != tois[1]


def test_rigid_bodies_that_are_not_in_the_order_of_worlds_are_refused():
    mesh = ccd.CollisionMesh.from_arrays(
        4 * [(BLADE, [[0, 1, 2]])], rigid=range(4), vertex_world=np.repeat([0, 1, 0, 1], 3)
    )
    motion = ccd.JointMotion(ARM, *edges(2), links=LINKS)
    with pytest.raises(ValueError, match="rigid bodies are in the order of their worlds"):
        ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices, motion=motion, device="cpu")


def test_slides_as_short_as_squares_that_vanish_do_not_lose_a_face():
    """A point at the end of six slides of 1.4e-162 each, whose squares are 0, comes to a face after nine tenths."""
    count, size = 6, 1.4e-162
    slides = [ccd.Joint(f"s{k}", f"l{k}", f"l{k + 1}", "prismatic", axis=[1, 0, 0]) for k in range(count)]
    face = size * (np.array([[0.0, -1, -1], [0, 1, -1], [0, 0, 1]]) + [0.9 * count, 0, 0])
    bodies = [(np.zeros((1, 3)), np.zeros((0, 3), dtype=int)), (face, [[0, 1, 2]])]
    mesh = ccd.CollisionMesh.from_arrays(bodies, rigid=[0], static=[1], codimensional_points=True)
    motion = ccd.JointMotion(slides, np.zeros(count), np.full(count, size), links=[f"l{count}"])
    toi = ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices, motion=motion).toi
    assert toi == pytest.approx(0.9, abs=1e-6) and toi <= 0.9
