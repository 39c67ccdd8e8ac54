"""Gradients of tois are differences of exact ones: of pairs, contacts, tapes, motions, and line searches."""

import sys
from dataclasses import replace

import numpy as np
import pytest
import warp as wp
from distance_oracle import exact_distance_tois
from flint import ctx
from kept import kept
from oracle import exact_tois
from toi_scenes import array, taped

import ccd_warp as ccd
from ccd_warp._engine.device.input import SAFETY, LineSearch
from ccd_warp._engine.device.line_search import passes_of
from laws import moving, trajectories, turning
from laws.calls import EVERY_PER
from laws.moving import Moves
from laws.scenes import drawn, motion_of
from laws.trajectories import BITS
from laws.truth import Pairs
from laws.turning import KINDS, random_pairs, step_of

pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")

MOVE = 1e-9  # of the size: exact tois are known to 2e-22, so their difference to some 1e-13 of its size
LEAST_TOI = 1e-6  # of contacts that are moved: no later one comes to be that at the start
SOLVE = {kind: getattr(ccd, f"{kind.replace('-', '_')}_ccd") for kind in KINDS}


def options_of(distance, is_euclidean):
    return {"minimum_distance": distance} if is_euclidean else {"minimum_separation": distance, "length_scale": 1.0}


# --- pairs ---


def exact_times(kind, start, end, distance, is_euclidean):
    """Exact tois of pairs, as numbers of 77 digits; None where there is none."""
    if is_euclidean and distance > 0:
        found = exact_distance_tois(kind, start, end, distance)
    else:
        found = exact_tois(kind, start, end, separation=distance)
    return [x.refine(240)[0] if x.hit else None for x in found]


def errors_of(kind, ends, gradient, distance, is_euclidean, move, rng, sides=(1, -1)):
    """How far the first-order change of each toi is from the exact one, as a share of its terms; nan without one."""
    size = np.ptp(np.concatenate(ends, axis=1), axis=1).max(axis=1)[:, None, None]
    moves = [move * size * rng.standard_normal(x.shape) for x in ends]
    of_distance = move * rng.standard_normal() if distance else 0.0
    late, early = (
        [*(x + s * dx for x, dx in zip(ends, moves, strict=True)), distance + s * of_distance] for s in sides
    )
    terms = [gradient.start * (late[0] - early[0]), gradient.end * (late[1] - early[1])]
    of_distance = gradient.distance * (late[2] - early[2])
    change = sum(x.sum(axis=(1, 2)) for x in terms) + of_distance
    scale = sum(np.abs(x).sum(axis=(1, 2)) for x in terms) + np.abs(of_distance)
    times = [exact_times(kind, *x, is_euclidean) for x in (late, early)]
    exact = [np.nan if None in pair else float(pair[0] - pair[1]) for pair in zip(*times, strict=True)]
    return np.abs(change - exact) / np.maximum(scale, 1e-300)


def rows_of(gradient, chosen):
    return replace(gradient, **{name: x[chosen] for name, x in vars(gradient).items() if x is not None})


PAIRS = [
    *((kind, 3, *d) for kind in ("vertex-face", "edge-edge") for d in ((0.0, False), (0.05, True), (0.05, False))),
    *(("point-segment", 2, *d) for d in ((0.0, False), (0.1, True), (0.1, False))),
    *((kind, 3, 0.3, e) for kind in ("point-segment", "point-point") for e in (True, False)),
    *(("point-point", 2, 0.1, e) for e in (True, False)),
]


def random_regular(kind, dimension, distance, is_euclidean, count=8, **more):
    """Random pairs that touch, and their gradients, all of which are regular; those of others are not."""
    rng, points = np.random.default_rng(1), {"v": 4, "e": 4}.get(kind[0], 3 if kind == "point-segment" else 2)
    ends = rng.standard_normal((2, 64 * count, points, dimension))
    result = SOLVE[kind](*ends, **options_of(distance, is_euclidean), **more)
    touches, gradient = np.flatnonzero(result.hit & (result.toi > 0))[:count], result.toi_gradient(*ends)
    assert gradient.is_regular[touches].all() and not gradient.is_regular[~result.hit].any() and len(touches) == count
    return ends[:, touches], rows_of(gradient, touches)


@pytest.mark.parametrize("case", PAIRS)
def test_random_pairs(case):
    kind, _, distance, is_euclidean = case
    for more in ({}, {"precision": "float32"}, {"tolerance": 1e-3}):  # tois that are early have the exact gradients
        ends, gradient = random_regular(*case, **more)
        found = errors_of(kind, ends, gradient, distance, is_euclidean, 1e-10, np.random.default_rng(2))
        assert np.median(found) < 1e-13 and found.max() < 1e-9  # that of a difference is some 1e-20 of its size


def test_gradients_scale_with_the_unit_of_length_and_stay_where_all_is_far():
    for case in PAIRS[:6]:
        kind, _, distance, is_euclidean = case
        ends, gradient = random_regular(*case)
        for scale in (1e-100, 1e100):
            options = options_of(distance * scale, True) if is_euclidean else options_of(distance, False)
            options |= {} if is_euclidean else {"length_scale": scale}
            found = SOLVE[kind](*(ends * scale), **options).toi_gradient(*(ends * scale))
            for name in ("start", "end", "distance"):
                np.testing.assert_allclose(getattr(found, name) * scale, getattr(gradient, name), rtol=1e-9, atol=1e-12)
        near = np.round(ends * 2**20) / 2**20  # exact at both places
        both = [SOLVE[kind](*x, **options_of(distance, is_euclidean)).toi_gradient(*x) for x in (near, near + 2.0**20)]
        np.testing.assert_allclose(both[1].start, both[0].start, rtol=1e-9, atol=1e-12)


FACE = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
AHEAD, SEGMENT, EDGE = [0.2, 0.2, 1.0], [[0, 0, 0], [0, 1, 0]], [[0, 0, 0], [1, 0, 0]]
WITHOUT = [  # kind, points at both ends, options, and whether the toi is finite
    ("vertex-face", [[0.2, 0.2, 0], *FACE], [[0.2, 0.2, -1], *FACE], {}, 0.0),  # touches at the start
    ("vertex-face", [AHEAD, *FACE], [[0.2, 0.2, 0], *FACE], {}, 1.0),  # at the end
    ("vertex-face", [AHEAD, *FACE], [[0.2, 0.2, -1], *FACE], {"t_max": 0.5}, 0.5),
    ("vertex-face", [AHEAD, *FACE], [[0.2, 0.2, 0.5], *FACE], {}, np.inf),
    ("point-point", [[0, 0, 0.05], [0, 0, 0]], [[0, 0, -1], [0, 0, 0]], {"minimum_distance": 0.1}, 0.0),
    # passes by another at exactly the distance
    ("point-point", [[-1, 0.25, 0], [0, 0, 0]], [[1, 0.25, 0], [0, 0, 0]], {"minimum_distance": 0.25}, 0.5),
    # a toi that jumps: moves beside it miss
    ("point-point", [[-1.0, 0], [0, 0]], [[1.0, 0], [0, 0]], {}, 0.5),
    ("point-segment", [[-1, 0.5, 0], *SEGMENT], [[1, 0.5, 0], *SEGMENT], {}, 0.5),
    ("vertex-face", [[-1, 0.2, 0], *FACE], [[1, 0.2, 0], *FACE], {}, 0.5),
    ("edge-edge", [[-1, 0, 0], [-1, 1, 0], *EDGE], [[2, 0, 0], [2, 1, 0], *EDGE], {}, 1 / 3),
]


@pytest.mark.parametrize("case", WITHOUT)
def test_pairs_without_a_gradient(case):
    kind, start, end, options, latest = case
    ends = np.array([[start], [end]], dtype=float)
    result = SOLVE[kind](*ends, **options)
    gradient = result.toi_gradient(*ends)
    assert (result.toi[0] == np.inf) == (latest == np.inf) and result.toi[0] <= latest
    assert not gradient.is_regular.any() and len(gradient) == 1
    assert not any(np.any(x) for x in (gradient.start, gradient.end, gradient.distance))


def test_pairs_that_pass_by_within_their_tolerance_or_reach_a_limit_have_no_gradient():
    start, end = np.random.default_rng(4).standard_normal((2, 400, 4, 3))
    result = ccd.vertex_face_ccd(start, end, tolerance=0.1, length_scale=1.0, method="bisection")
    passes = result.hit & np.array([time is None for time in exact_times("vertex-face", start, end, 0.0, False)])
    assert passes.any() and not result.toi_gradient(start, end).is_regular[passes].any()
    result = ccd.edge_edge_ccd(start, end, method="bisection", max_iterations=20, tolerance=1e-9)
    limited = result.status == ccd.CCDStatus.ITERATION_LIMIT
    assert limited.any() and not result.toi_gradient(start, end).is_regular[limited].any()


@pytest.mark.parametrize("is_euclidean", [True, False])
def test_borders_of_primitives_have_the_derivative_to_one_side(is_euclidean):
    """A vertex over an edge of a face, and parallel edges: some moves agree, as those into the face do."""
    over_edge = [[0.5, 0.0, 1.0], *FACE], [[0.5, 0.0, -1.0], *FACE]
    below = [[0.3, 0.0, 0.0], [1.4, 0.0, 0.0]]
    parallel = [[0.0, 0.02, 1], [1, 0.02, 1], *below], [[0.0, 0.02, -1], [1, 0.02, -1], *below]
    for kind, pair, distance in (("vertex-face", over_edge, 0.0), ("edge-edge", parallel, 0.1)):
        ends, rng = np.array(pair, dtype=float)[:, None], np.random.default_rng(3)
        is_ball = is_euclidean and distance > 0
        gradient = SOLVE[kind](*ends, **options_of(distance, is_ball)).toi_gradient(*ends)
        assert gradient.is_regular.all()
        tried = [errors_of(kind, ends, gradient, distance, is_ball, s * 1e-9, rng, (1, 0)) for s in (1, -1) * 8]
        assert np.nanmin(tried) < 1e-5


# --- scenes: straight, and with bodies that turn ---


class Step:
    """A step with a Euclidean distance, which can be moved as a whole, as a sum of named arrays."""

    def __init__(self, mesh, start, end, motion, options) -> None:
        self.mesh, self.given, self.options = mesh, {"start": start, "end": end}, dict(options)
        self.path = {} if motion is None else {name: motion[name] for name in ("path", "pivot") if name in motion}
        self.given |= {} if motion is None else {k: x for k, x in motion.items() if k not in self.path}
        self.given["distance"] = np.array(self.options.pop("minimum_distance", 0.0))
        if mesh.radius is not None:
            self.given["radius"] = mesh.radius

    def moves(self, rng, size):
        """Moves of everything that has a gradient; what is static stays, and a radius of 0 does."""
        found = {name: MOVE * size * rng.standard_normal(x.shape) for name, x in self.given.items()}
        is_rigid, is_static = (flag[self.mesh.vertex_body] for flag in (self.mesh.rigid, self.mesh.static))
        for name in ("start", "end"):
            found[name][is_rigid & ("twist" in found or "poses_t1" in found)] = 0.0
        found["end"][is_static] = found["start"][is_static]
        if self.mesh.dimension == 2:
            for name in {"poses_t0", "poses_t1", "twist"} & found.keys():
                found[name][..., 2:5] = 0.0
        for name in ("distance", "radius"):
            if name in found:
                found[name] = np.where(self.given[name] == 0, 0.0, found[name])
        return found

    def motion(self, given):
        named = {name: x for name, x in given.items() if name in ("poses_t0", "poses_t1", "twist")}
        return {**self.path, **named} if named else None

    def calls(self, **more):
        """The contacts of the step, and the motion."""
        motion = self.motion(self.given)
        motion = {} if motion is None else {"motion": ccd.RigidMotion(**motion)}
        options = {**self.options, "minimum_distance": float(self.given["distance"]), **more}
        return ccd.mesh_ccd(self.mesh, self.given["start"], self.given["end"], **motion, **options), motion.get(
            "motion"
        )

    def exact_changes(self, contacts, late, early):
        """How much later each pair touches in one moved step than in the other, exactly; nan without both."""
        kinds, primitives = contacts.kind.tolist(), contacts.primitives.tolist()
        pairs, mesh, planes = Moves(self.mesh, late["start"], late["end"]).pairs, self.mesh, vars(self.mesh.planes)
        corners = [pairs.corners(kind, np.array([pair])) for kind, pair in zip(kinds, primitives, strict=True)]
        given = [mesh.vertices, mesh.vertex_body, mesh.rigid, planes, corners, self.path]
        return _changes(self, kinds, primitives, late, early, given=given)

    def predicted(self, contacts, motion, late, early):
        """The first-order changes of contacts, the sum of the magnitudes of their terms, and which are regular."""
        gradient, made = contacts.toi_gradient(), {name: late[name] - early[name] for name in late}
        terms = [gradient.start * made["start"][gradient.vertices], gradient.end * made["end"][gradient.vertices]]
        of_distance = gradient.distance * (made["distance"] + self.radii(contacts, late) - self.radii(contacts, early))
        if motion is not None:
            by_twist = "twist" in late
            of_bodies = (motion.gradient_by_twist if by_twist else motion.gradient_by_poses)(gradient)
            row, turns = np.cumsum(self.mesh.rigid) - 1, self.mesh.rigid[contacts.bodies][..., None]
            for values, name in zip(of_bodies, ("poses_t0", "twist" if by_twist else "poses_t1"), strict=True):
                terms.append(values * np.where(turns, made[name][row[contacts.bodies]], 0.0))
        change = sum(x.sum(axis=(1, 2)) for x in terms) + of_distance
        return change, sum(np.abs(x).sum(axis=(1, 2)) for x in terms) + np.abs(of_distance), gradient

    def radii(self, contacts, given):
        pairs, kinds = Moves(self.mesh, given["start"], given["end"]).pairs, contacts.kind.tolist()
        rows = zip(kinds, contacts.primitives, strict=True)
        return np.array([pairs.radii(kind, pair[None], given.get("radius"))[0] for kind, pair in rows])


def _solve(step, kinds, primitives, late, early, given):
    found, times = np.full(len(kinds), np.nan), []
    for ends in (late, early):
        moves = Moves(step.mesh, ends["start"], ends["end"], step.motion(ends))
        radius, rows = ends.get("radius"), []
        for kind, pair in zip(kinds, primitives, strict=True):
            own = moves.pairs.radii(kind, np.array([pair]), radius)[0]
            rows.append(moves.exact_time(kind, pair, float(ends["distance"] + own)))
        times.append(rows)
    with ctx.workprec(BITS):
        for k, (a, b) in enumerate(zip(*times, strict=True)):
            if a.hi is not None and b.hi is not None:
                found[k] = float((a.lo + a.hi - b.lo - b.hi) / 2)
    return found


_oracle = trajectories, turning, moving, sys.modules[__name__]
_changes = kept(_solve, *_oracle, question_of=lambda _, *arguments, given: [arguments, given])


def both_sides(given, moves):
    return [{name: x + s * moves[name] for name, x in given.items()} for s in (1, -1)]


def straight_step(seed):
    """A drawn scene of no grid, in which what touches does so at different times."""
    return _step_of(drawn(seed, ("dust", "close", "far", "slivers", "worlds")[seed % 5]), lambda mesh: None)


def turning_step(seed):
    """One with bodies that turn; poses are of unit length, by which gradients are."""

    def motion(mesh):
        motion = {**motion_of(mesh, np.random.default_rng(seed)), "path": "linear"}
        made = ccd.RigidMotion(**motion)
        return motion | {name: getattr(made, name) for name in ("poses_t0", "poses_t1") if name in motion}

    return _step_of(drawn(seed, "arcs"), motion)


def _step_of(scene, motion):
    mesh, start, end = scene.make()
    left_out = ("minimum_separation", "start_gap_fraction", "pair_kinds", "t_max")
    options = {name: x for name, x in scene.options.items() if name not in left_out}
    return Step(mesh, start, end, motion(mesh), options)


def step_of_pairs(kind, in_plane=False, **names):
    pairs = random_pairs(kind, np.random.default_rng(5), 12, in_plane=in_plane, **names)
    return Step(*step_of(pairs, in_plane))


def check_contacts(step, rng, **options):
    """Relative errors of the contacts that are regular, and how many of them there are."""
    result, motion = step.calls(**options)
    contacts = result.contacts
    late, early = both_sides(step.given, step.moves(rng, np.ptp(step.given["start"], axis=0).max()))
    change, scale, gradient = step.predicted(contacts, motion, late, early)
    regular = np.flatnonzero(gradient.is_regular & (contacts.toi > LEAST_TOI))
    regular = regular[:: 1 + len(regular) // 24]  # of many some
    exact = step.exact_changes(contacts[regular], late, early)
    return (np.abs(change[regular] - exact) / scale[regular])[np.isfinite(exact)], contacts, gradient


@pytest.mark.parametrize(("make", "kinds"), [(straight_step, {0, 1, 3, 4}), (turning_step, {0, 1, 2, 3, 4})])
def test_contacts_of_drawn_scenes(make, kinds):
    found, regular = [], []
    for step in map(make, range(48)):
        errors, contacts, gradient = check_contacts(step, np.random.default_rng(0))
        found.append(errors)
        regular += contacts.kind[gradient.is_regular][:: 1 + gradient.is_regular.sum() // 24].tolist()
    found = np.concatenate(found)
    assert len(found) > 0.95 * len(regular) > 80 and {*regular} >= kinds
    assert np.median(found) < 1e-13 and found.max() < 1e-7


@pytest.mark.parametrize("kind", KINDS)
def test_pairs_of_bodies_that_turn(kind, precision):
    """In space and in the plane; tois that are early have the gradients of the exact ones."""
    for other, by_twist in (("turning", False), ("turning", True), ("deformable", True)):
        is_point = kind.startswith("point")
        for distance, in_plane in ((0.1, False), (0.1, True)) if is_point else ((0.0, False), (0.05, False)):
            step = step_of_pairs(kind, in_plane, distance=distance, other=other, by_twist=by_twist)
            errors, _, gradient = check_contacts(step, np.random.default_rng(3), precision=precision)
            assert len(errors) > 0.8 * gradient.is_regular.sum() > 2
            assert np.median(errors) < 1e-12 and errors.max() < 1e-6


# --- on a tape ---


TOIS = ("toi", "world_toi", "body_toi", "vertex_toi")
ROUNDS = 3


def backward(tape, result, weights):
    """Run a tape backwards from a sum over tois with these weights, by name."""
    tape.zero()
    for values in {id(x): x for x in (getattr(result, name) for name in TOIS)}.values():
        # the toi of a single world is that of the scene
        of = sum(weights[name] for name in TOIS if getattr(result, name) is values and name in weights)
        values.grad.assign(np.broadcast_to(of, values.shape))
    tape.backward()


def test_tapes_of_drawn_scenes():
    """Sums over regular tois of vertices, bodies, worlds and the scene change as those of their first contacts do."""
    found = []
    for step in map(straight_step, range(48)):
        contacts, rng = step.calls()[0].contacts, np.random.default_rng(0)
        pipeline = ccd.CollisionPipeline(step.mesh, minimum_distance=float(step.given["distance"]), **step.options)
        dtype = wp.vec3d if step.mesh.dimension == 3 else wp.vec2d
        given = {name: array(step.given[name], dtype) for name in ("start", "end")}
        if pipeline.radius is not None:
            given["radius"] = pipeline.radius
            pipeline.radius.requires_grad = True
        tape, result = taped(lambda: pipeline.launch(given["start"], given["end"]))  # noqa: B023
        firsts, weights = first_contacts(Pairs(step.mesh), contacts), {}
        of_contact = np.append(contacts.toi_gradient().is_regular, False)  # the last one is none
        for name in TOIS:
            regular = np.atleast_1d(result.is_regular(name.removesuffix("_toi").replace("toi", "scene")).numpy())
            assert np.array_equal(regular, of_contact[firsts[name]])
            regular &= np.atleast_1d(getattr(result, name).numpy()) > LEAST_TOI
            weights[name] = np.where(regular, rng.standard_normal(len(regular)), 0.0)
        moves = step.moves(rng, np.ptp(step.given["start"], axis=0).max()) | {"distance": np.zeros(())}
        late, early = both_sides(step.given, moves)
        chosen = np.unique(np.concatenate([firsts[name][weights[name] != 0] for name in TOIS]))
        exact = np.zeros(len(contacts) + 1)
        exact[chosen] = step.exact_changes(contacts[chosen], late, early)
        expected = sum((weights[name] * exact[firsts[name]]).sum() for name in TOIS)
        if len(chosen) and np.isfinite(expected):
            backward(tape, result, weights)
            terms = [(x.grad.numpy() * (late[name] - early[name])).ravel() for name, x in given.items()]
            found.append(abs(sum(x.sum() for x in terms) - expected) / sum(np.abs(x).sum() for x in terms))
    assert len(found) > 8 and np.median(found) < 1e-12 and max(found) < 1e-7


NONE, STAYS, CHANGES = 0, 1, 2  # the derivative of a position: none, that of a start where it stays, or any


def searched_by_launches(step, per, **options):
    """What a line search makes of the end positions, and of their derivatives, by a launch for each of its passes.

    A vertex that a pass shortens depends on those of the contact that does so, and has no derivative where one of them
    or the contact has none. One that a pass stops stays at its start, for all moves if the contact is regular.
    """
    mesh, start, x, safety = step.mesh, step.given["start"], step.given["end"].copy(), 0.9
    dtype, rating = wp.vec3d if mesh.dimension == 3 else wp.vec2d, np.full(mesh.num_vertices, CHANGES)
    own = {"world": mesh.vertex_world, "body": mesh.vertex_body, "vertex": np.arange(mesh.num_vertices)}
    free = np.flatnonzero(~(mesh.static | mesh.kinematic)[mesh.vertex_body])
    pairs, least_toi, pipeline = Pairs(mesh), np.inf, ccd.CollisionPipeline(mesh, **options)
    for number, (of, share) in enumerate(passes_of(LineSearch.of(per, ROUNDS))):
        name = TOIS[EVERY_PER.index(of)]
        _, result = taped(lambda: pipeline.launch(array(start, dtype), array(x, dtype)))
        contacts, before = result.to_host().contacts, rating.copy()
        tois, firsts, is_regular = (
            np.atleast_1d(values)
            for values in (
                getattr(result, name).numpy(),
                first_contacts(pairs, contacts)[name],
                result.is_regular(of).numpy(),
            )
        )
        least_toi = min(least_toi, tois.min()) if number == 0 else least_toi
        for v in free.tolist():
            g = own[of][v] if of in own else 0
            if np.isfinite(tois[g]):
                kind, primitives = contacts.kind[firsts[g]], contacts.primitives[firsts[g]]
                corners = pairs.corners(kind, primitives)[0].tolist()
                if kind == ccd.PairKind.VERTEX_PLANE and mesh.planes.vertices[primitives[1]] >= 0:
                    corners.append(mesh.planes.vertices[primitives[1]])
                of_contact = min(before[corners]) if is_regular[g] else NONE
                fraction = (safety if share is SAFETY else share) * tois[g]
                rating[v] = min(rating[v], of_contact) if fraction > 0 else max(STAYS, of_contact)
                x[v] = (1 - fraction) * start[v] + fraction * x[v]
    return x, rating == CHANGES, least_toi


@pytest.mark.parametrize("per", EVERY_PER)
def test_positions_of_line_searches_have_derivatives_by_the_contacts_of_their_passes(per):
    num_compared, seen = 0, set()
    for step in (_step_of(drawn(seed), lambda mesh: None) for seed in range(96)):
        options = {"minimum_distance": float(step.given["distance"]), "start_gap_fraction": None, **step.options}
        end, is_regular, least_toi = searched_by_launches(step, per, **options)
        if least_toi < 1e-11:  # a gap that rounding hides, or nearly, lets the first pass move by a share of it
            continue
        dtype = wp.vec3d if step.mesh.dimension == 3 else wp.vec2d
        given, pipeline = (
            [array(step.given[name], dtype) for name in ("start", "end")],
            ccd.CollisionPipeline(step.mesh, **options),
        )
        _, result = taped(lambda: pipeline.launch_line_search(*given, per=per, num_rounds=ROUNDS))  # noqa: B023
        np.testing.assert_allclose(given[1].numpy(), end, rtol=0, atol=1e-9 * np.ptp(end))
        assert np.array_equal(result.is_regular().numpy(), is_regular)
        stays = (end == step.given["start"]).all(axis=1) & (end != step.given["end"]).any(axis=1)
        num_compared += 1
        seen |= {*zip(stays.tolist(), is_regular.tolist(), strict=True)}
    assert num_compared > 20 and seen >= {(False, True), (True, True), (False, False)}


def first_contacts(pairs, contacts):
    """The first contact of the scene and of each world, body and vertex; -1 for none."""
    mesh, order = pairs.mesh, np.argsort(contacts.toi, kind="stable")
    result = {"toi": np.full(1, -1), "world_toi": np.full(mesh.num_worlds, -1)}
    result |= {"body_toi": np.full(mesh.num_bodies, -1), "vertex_toi": np.full(mesh.num_vertices, -1)}
    for k in order[::-1].tolist():
        corners = pairs.corners(contacts.kind[k], contacts.primitives[k])[0]
        bodies = contacts.bodies[k]
        for name, rows in (("toi", 0), ("world_toi", contacts.world[k]), ("body_toi", bodies), ("vertex_toi", corners)):
            result[name][rows] = k
    return result
