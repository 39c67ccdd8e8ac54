"""Bodies that turn touch when interval arithmetic says so: nothing is missed or late, and nothing too early."""

from dataclasses import replace
from functools import cache, cached_property
from itertools import product

import numpy as np
import pytest
from flint import arb, arb_poly, ctx

import ccd_warp as ccd
from ccd_warp._rigid import motion_worlds
from laws.moving import Moves
from laws.near_paths import NearPaths
from laws.outputs import different, outputs_of, tois_of
from laws.scenes import drawn, motion_of
from laws.trajectories import BITS
from laws.truth import PLANE, UNITS, first_sides, halfway, plane_moves
from laws.turning import FAMILIES, KINDS, answers, hostile_pairs, prisms, random_pairs, step_of

pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")

SEEDS = range(24)
# Scenes by their seeds, and those whose bodies are beside their paths.
SCENES = [*product(SEEDS, [False]), *product(SEEDS[::2], [True]), (50002, True)]
LIMITS = [ccd.CCDStatus.ITERATION_LIMIT, ccd.CCDStatus.RESOLUTION_LIMIT, ccd.CCDStatus.ROUNDING_LIMIT]
MEDIAN_ERROR = {"float64": 1e-12, "float32": 1e-5}


# --- scenes ---


def beside(mesh, motion, rng, num_worlds=None):
    """How far bodies may be from their paths, some of which stand on them; static ones are where they are."""
    bodies = np.flatnonzero(mesh.rigid)
    shape = (len(bodies),) if num_worlds is None else (num_worlds, len(bodies))
    stands = rng.random(shape) < 0.3
    for name, rest in (("twist", np.zeros(6)), ("poses_t1", motion["poses_t0"])):
        if name in motion:
            motion[name] = np.where(stands[..., None], rest, motion[name])
    return ~mesh.static[bodies] * rng.choice([0.0, 1e-6, 1e-3, 0.01], shape) * np.ptp(mesh.vertices, axis=0).max()


class Scene:
    """A drawn scene of bodies that turn and deform, and what the calls say of it."""

    def __init__(self, seed: int, is_beside: bool = False) -> None:
        self.drawn, rng = drawn(seed, "arcs"), np.random.default_rng(seed)
        self.mesh, self.start, self.end = self.drawn.make()
        self.given, self.seed = motion_of(self.mesh, rng), seed
        self.within = beside(self.mesh, self.given, rng) if is_beside else None
        self.motion = ccd.RigidMotion(**self.given, within=0.0 if self.within is None else self.within)
        self.moves, self.on_paths = self.moved(), Moves(self.mesh, self.start, self.end, self.given)
        self.step = self.mesh, self.start, self.end
        self.kinds = self.drawn.options.get("pair_kinds") or [kind.name.lower() for kind in ccd.PairKind]

    def moved(self, end=None, shares=None):
        """How the bodies move, up to a share each."""
        given = self.mesh, self.start, self.end if end is None else end, self.given
        return Moves(*given, shares) if self.within is None else NearPaths(*given, self.within, self.seed, shares)

    def times(self, distance: float):
        """lo and hi of the pairs that are asked for."""
        found = self.moves.first_times(distance)
        return {key: row for key, row in found.items() if ccd.PairKind(key[0]).name.lower() in self.kinds}

    def options(self, **more):
        return {**self.drawn.options, "motion": self.motion, **more}

    @cache  # noqa: B019
    def result(self, precision: str):
        return ccd.mesh_ccd(*self.step, **self.options(precision=precision))

    @cached_property
    def of_copies(self):
        """Five worlds, each as a copy of the mesh: the mesh, the positions, options, the result and the free step."""
        rng = np.random.default_rng(1)
        given = motion_of(self.mesh, rng, 5)
        within = beside(self.mesh, given, rng, 5) if self.seed % 3 == 0 else 0.0
        motion = ccd.RigidMotion(**given, within=within)
        options, copies = {**self.drawn.options, "motion": motion}, self.mesh.replicate(5)
        step = copies, *(np.tile(x, (5, 1)) for x in self.step[1:])
        return options, copies, ccd.mesh_ccd(*step, **options), ccd.collision_free_step(*step, **options)


scene_of = cache(Scene)


def check_places(scene, contacts):
    """Points and velocities of contacts are those of their primitives on the paths."""
    contacts, step = contacts[:: 1 + len(contacts) // 20], 1e-9
    found = np.zeros((2, len(contacts), 4, 3))
    with ctx.workprec(BITS):
        for k, (vertices, is_first) in enumerate(zip(contacts.vertices, first_sides(contacts), strict=True)):
            time = arb_poly([arb(float(contacts.toi[k])), arb(step)])
            for side in (is_first, ~is_first)[: 1 + (contacts.kind[k] != PLANE)]:
                places = scene.on_paths.primitive(vertices[side])(time)
                found[:, k, side] = [[[float(arb_poly(x)[n]) for x in place] for place in places] for n in (0, 1)]
    places, moves = found[..., : scene.mesh.dimension]
    velocity = np.einsum("mk,mkd->md", contacts.weights, moves) / step
    velocity -= plane_moves(contacts, scene.mesh, scene.start, scene.end)
    lost = 1e-13 * scene.on_paths.size * (1 + scene.motion.turns.max(initial=0.0))
    apart = np.abs(halfway(contacts, scene.mesh, places) - contacts.points)[contacts.kind != PLANE]
    assert apart.max(initial=0.0) <= lost
    assert np.abs(velocity - contacts.relative_velocity).max(initial=0.0) <= 1e3 * lost


@pytest.mark.parametrize(("seed", "is_beside"), SCENES)
def test_contacts_of_a_step(seed, is_beside, precision):
    scene = scene_of(seed, is_beside)
    t_max = scene.drawn.options["t_max"]
    contacts = scene.result(precision).contacts
    found = tois_of(contacts)
    assert len(found) == len(contacts)
    for key, (_, hi) in scene.times(scene.drawn.distance).items():  # what touches in space touches in any norm
        assert hi > t_max or found.get(key, np.inf) <= hi, key
    near = scene.drawn.delta + 256 * UNITS[precision] * scene.moves.size
    near += 0.0 if scene.within is None else 2.0 * scene.within.max()
    factor = 1.0 if scene.drawn.is_euclidean else np.sqrt(3)
    early = scene.on_paths.first_times(scene.drawn.distance + near, factor, list(found))
    for key, toi, status in zip(found, contacts.toi.tolist(), contacts.status.tolist(), strict=True):
        assert toi <= t_max and (toi >= early[key][0] or status in LIMITS), key
    check_places(scene, contacts)


@pytest.mark.parametrize(("seed", "is_beside"), SCENES)
def test_steps_launches_and_candidates_say_what_the_list_of_contacts_does(seed, is_beside, precision):
    scene = scene_of(seed, is_beside)
    options, t_max = scene.options(precision=precision), scene.drawn.options["t_max"]
    result = scene.result(precision)
    others = {
        "num_threads": 4 - options["num_threads"],
        "broad_phase": "hash" if options["broad_phase"] == "tree" else "tree",
    }
    assert different(outputs_of(result), outputs_of(ccd.mesh_ccd(*scene.step, **options | others))) == []
    least, is_held = min(result.toi, t_max), options["start_gap_fraction"] == "hold"
    rough = options | {"length_scale": None, "tolerance": 0.01}  # by which a toi is as early as the scale is large
    held = {name: value for name, value in options.items() if name != "minimum_separation"}
    held |= {"minimum_distance": 0.3 * scene.drawn.size, "start_gap_fraction": "hold"}
    steps = [ccd.collision_free_step(*scene.step, **given) for given in (options, rough, held)]
    assert steps[0] == least or (is_held and steps[0] > least)
    assert ccd.is_step_collision_free(*scene.step, **options) == (result.toi == np.inf)
    with pytest.MonkeyPatch.context() as patch:  # of the parts that come near, as of a large mesh
        patch.setattr(motion_worlds, "_LARGE_ALONE", 0)
        patch.setattr(motion_worlds, "_FEW", np.inf)
        of_parts = ccd.mesh_ccd(*scene.step, **options)
        assert different(*(outputs_of(replace(each, counts=None)) for each in (of_parts, result))) == []
        assert [ccd.collision_free_step(*scene.step, **given) for given in (options, rough, held)] == steps
        assert ccd.is_step_collision_free(*scene.step, **options) == (result.toi == np.inf)
    motion = options.pop("motion")
    pipeline = ccd.CollisionPipeline(scene.mesh, **options)
    moving = scene.mesh.moving_vertices
    for shown in (motion, motion.shortened(0.5), motion):
        expected = pipeline.mesh_ccd(scene.start, scene.end, motion=shown)
        ours = pipeline.launch(scene.start, scene.end[moving], motion=shown).to_host()
        for name in ("toi", "vertex_toi", "body_toi"):
            assert np.array_equal(np.ravel(getattr(expected, name)), np.ravel(getattr(ours, name)))
        assert different(outputs_of(expected.contacts), outputs_of(ours.contacts)) == []
    candidates = pipeline.find_candidates(scene.start, scene.end, scene.drawn.distance, motion=motion)
    pairs = {(kind, *pair) for kind, of_kind in enumerate(vars(candidates).values()) for pair in of_kind.tolist()}
    assert pairs >= set(tois_of(result.contacts)) and len(pairs) == sum(map(len, vars(candidates).values()))


@pytest.mark.parametrize(("seed", "is_beside"), SCENES)
def test_what_a_line_search_leaves_is_free_and_a_launch_leaves_as_much(seed, is_beside, precision):
    """Pairs that come within their distance later than at the start do not on what is left of the paths."""
    scene = scene_of(seed, is_beside)
    mesh, per, distance = scene.mesh, ("body", "scene", "vertex")[seed % 3], scene.drawn.distance
    options = {**scene.drawn.without_end(), "precision": precision, "start_gap_fraction": None}
    pipeline = ccd.CollisionPipeline(mesh, **options)
    found = pipeline.line_search(scene.start, scene.end, per=per, motion=scene.motion)
    shares = np.append(found.vertex_fraction, 1.0)[mesh.body_vertex_range[:-1]]
    for body in np.flatnonzero(mesh.rigid):
        assert np.ptp(found.vertex_fraction[slice(*mesh.body_vertex_range[body : body + 2])]) == 0
    if is_beside or found.num_rounds <= 2:
        written, names = scene.end.copy(), {"per": per, "motion": scene.motion, "num_rounds": 4}
        launched = pipeline.launch_line_search(scene.start, written, **names).to_host()
    ends = [(found.vertices, shares, found.struck)]
    if is_beside:
        struck = launched.contacts if launched.flags & ccd.LaunchFlag.STRUCK else launched.contacts[:0]
        ends.append((written, launched.body_fraction, struck))
    for end, fractions, struck in ends:
        left = scene.moved(end, fractions)
        starts = {key for key, (lo, _) in left.first_times(1.01 * distance + 1e-9 * left.size).items() if lo == 0}
        for key, (_, hi) in left.first_times(0.99 * distance).items():
            is_asked = ccd.PairKind(key[0]).name.lower() in scene.kinds
            assert hi == np.inf or key in starts or key in tois_of(struck) or not is_asked, key
    if found.num_rounds <= 2:  # further ones differ: those on the device are fixed
        deforms = ~mesh.rigid[mesh.vertex_body]
        assert np.array_equal(written[deforms], found.vertices[deforms])
        assert np.array_equal(launched.motion.poses_t1, found.motion.poses_t1)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_common_motion_of_everything_is_none(seed, precision):
    """All bodies turn as one: what touches does so at the start, and all else goes all the way."""
    scene, rng = scene_of(seed), np.random.default_rng(seed)
    old, options = scene.mesh, {**scene.drawn.options, "precision": precision}
    options.pop("pair_kinds", None)  # all of them are looked at
    bodies = [(old.vertices[slice(*old.body_vertex_range[b : b + 2])], *of_body(old, b)) for b in range(old.num_bodies)]
    bodies = [body for body in bodies if len(body[0])]
    mesh = ccd.CollisionMesh.from_arrays(bodies, rigid=range(len(bodies)), self_collision=False)
    size = np.ptp(mesh.vertices, axis=0).max()
    pose = [*size * rng.standard_normal(3), *rng.standard_normal(4)]
    twist = [*size * rng.standard_normal(3), *rng.choice([0.1, 1.0, 9.0]) * rng.standard_normal(3)]
    motion = ccd.RigidMotion([pose] * len(bodies), twist=[twist] * len(bodies), path="screw")
    distance, factor = scene.drawn.distance, 1.0 if scene.drawn.is_euclidean else np.sqrt(3)
    x, pairs = mesh.vertices, Moves(mesh, mesh.vertices, mesh.vertices)
    beside = factor * (distance + scene.drawn.delta + size * (1e-3 if precision == "float32" else 1e-9))
    within, near = (pairs.first_times(d) for d in (distance, beside))
    found = tois_of(ccd.mesh_ccd(mesh, x, x, motion=motion, **options).contacts)
    assert all(found.get(key) == 0 for key, (_, hi) in within.items() if hi == 0)
    assert found.keys() <= {key for key, (lo, _) in near.items() if lo == 0}


def of_body(mesh, body):
    """Faces and edges of a body, by its own vertices."""
    begin = mesh.body_vertex_range[body]
    return mesh.faces[mesh.face_body == body] - begin, mesh.edges[mesh.edge_body == body] - begin


@pytest.mark.parametrize("primitives", [1 << 19, 100, 1])
def test_worlds_of_one_mesh_have_the_bits_of_copies(primitives, monkeypatch):
    """However many are searched at a time."""
    monkeypatch.setattr(motion_worlds, "_PRIMITIVES", primitives)
    num_hit = 0
    for seed in (seed for seed in SEEDS if scene_of(seed).mesh.num_worlds == 1):
        scene = scene_of(seed)
        options, copies, expected, step = scene.of_copies
        result = ccd.mesh_ccd(*scene.step, **options)
        assert np.array_equal(result.vertex_toi, expected.vertex_toi.reshape(5, -1))
        assert np.array_equal(result.world_toi, expected.world_toi) and result.toi == expected.toi
        first, other = in_order(result.contacts, scene.mesh), in_order(expected.contacts, copies)
        names = ("kind", "toi", "parameters", "normal", "status", "gap", "points", "relative_velocity", "world")
        assert [name for name in names if not np.array_equal(getattr(first, name), getattr(other, name))] == []
        assert np.array_equal(first.vertices, other.vertices % scene.mesh.num_vertices)
        assert ccd.collision_free_step(*scene.step, **options) == step
        num_hit += np.isfinite(result.toi)
    assert num_hit > 5


def in_order(contacts, mesh):
    """By world, kind and primitives, where half-spaces that stand are one of all copies."""
    keys = np.column_stack([contacts.world, contacts.kind, contacts.vertices % (mesh.num_vertices // mesh.num_worlds)])
    keys = np.column_stack([keys, np.where(contacts.kind == PLANE, contacts.normal[:, 0], 0.0), contacts.normal[:, 1]])
    return contacts[np.lexsort(keys.T[::-1])]


# --- pairs of hostile families, a world each ---


def checked(pairs, truth=None, in_plane=False, **options):
    """How much too early tois are of pairs of which none is missed or late, how many are false; and the result."""
    mesh, start, end, motion, of_pairs = step_of(pairs, in_plane)
    if mesh.rigid.all():
        result = ccd.rigid_ccd(mesh, **motion, **of_pairs, **options)
    else:
        result = ccd.mesh_ccd(mesh, start, end, motion=ccd.RigidMotion(**motion), **of_pairs, **options)
    lo, hi = answers(pairs if truth is None else truth)
    toi = result.world_toi
    assert (toi <= hi).all()
    touches = np.isfinite(hi)
    return np.maximum(lo[touches] - toi[touches], 0.0), (np.isinf(lo) & np.isfinite(toi)).sum(), result


@pytest.mark.parametrize("kind", KINDS)
def test_random_pairs(kind, precision):
    errors, ways = [], product(("linear", "screw"), ("turning", "at rest", "deformable"), (False, True))
    for k, (path, other, by_twist) in enumerate(ways):
        names = {"path": path, "other": other, "by_twist": by_twist}
        for distance in (None, 0.05):
            pairs = random_pairs(kind, np.random.default_rng([k, distance is None]), 4, distance=distance, **names)
            early, num_false, _ = checked(pairs, precision=precision)
            errors.append(early)
            assert num_false == 0
    errors = np.concatenate(errors)
    assert len(errors) > 40 and np.median(errors) < MEDIAN_ERROR[precision]


@pytest.mark.parametrize("family", FAMILIES)
def test_hostile_pairs(family):
    """Tois of turns that vanish, down to 1e-300, are those of straight motion but for rounding."""
    for k, (kind, *given) in enumerate([*((kind, 6) for kind in KINDS), ("edge-edge", 4, 0.03)]):
        precision = list(MEDIAN_ERROR)[k % 2]
        early, num_false, _ = checked(hostile_pairs(family, kind, *given), precision=precision)
        if "tiny" in family:
            assert num_false == 0 and early.max() < 100 * MEDIAN_ERROR[precision]


def test_a_common_spin_reaches_no_limit():
    """In the world the chords of both come closer by far more than the gap."""
    for kind in KINDS:
        early, _, result = checked(hostile_pairs("common spin", kind, 30), max_iterations=60)
        assert (result.contacts.status <= 2).all() and (len(early) == 0 or np.median(early) < 1e-4)


def test_iterations_that_are_spent_leave_what_was_proved():
    pairs = random_pairs("edge-edge", np.random.default_rng(8), 60)
    _, _, result = checked(pairs, max_iterations=1)
    assert (result.contacts.status == int(ccd.CCDStatus.ITERATION_LIMIT)).any()


@pytest.mark.parametrize(
    ("path", "other", "by_twist"), [*product(("linear", "screw"), ("turning", "deformable"), (False, True))]
)
def test_in_the_plane_bodies_meet_when_prisms_on_them_do(path, other, by_twist, precision):
    """Points are edges across the plane, so the truth in space is that in the plane."""
    for distance, far in product((0.0, 0.1), (0.0, 1e4)):
        names = {"path": path, "other": other, "by_twist": by_twist, "distance": distance, "in_plane": True}
        pairs = random_pairs("point-segment", np.random.default_rng(7), 8, **names)
        if far and other == "turning":
            shift = np.array([far, -0.7 * far, 0, 0, 0, 0, 0])
            pairs = replace(pairs, poses=pairs.poses + shift, ends=None if by_twist else pairs.ends + shift)
        early, num_false, _ = checked(pairs, prisms(pairs), in_plane=True, precision=precision)
        assert far or (len(early) > 2 and np.median(early) < MEDIAN_ERROR[precision] and num_false == 0)
        if distance:
            checked(
                random_pairs("point-point", np.random.default_rng(8), 8, **names), in_plane=True, precision=precision
            )
