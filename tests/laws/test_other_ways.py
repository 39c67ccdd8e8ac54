"""No result depends on how it is computed: drawn scenes and all calls, in every way that must change no bit.

The ways: threads, the broad phase, memory, what was called before, launches in place of calls on the host, graphs in
place of launches, the device, the width of lanes, the place of a pair among others. Ranks are in `tests/distributed`.
"""

import hashlib
import os
import pickle
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import trimesh
import warp as wp
from expected_warnings import OF_ROUNDING
from hard_cases import FAMILIES
from programs import begun
from scenes import crowd_of_three, pairs_in_worlds, sheet, single, squeezed, tube, with_static_at_rest

import ccd_warp as ccd
from ccd_warp._engine.boxes import near_bodies
from ccd_warp._runtime.every_module import every_module
from laws import calls
from laws.calls import CALLS, PRECISIONS, StepCase, on_device, pairs
from laws.outputs import assert_shared_bits, different, kept_outputs, outputs_of, rows_in_order, tois_of
from laws.scenes import drawn

pytestmark = [OF_ROUNDING, pytest.mark.filterwarnings("ignore:the distance|motion is None:RuntimeWarning")]


def sheets():
    """A wavy sheet that falls through another, which is static."""
    x, faces = sheet(7)
    x += [0.5, 0.5, 0.0]
    x[:, 2] = 0.05 * np.sin(9 * x[:, 0]) * np.cos(8 * x[:, 1])
    mesh = ccd.CollisionMesh.from_arrays([(x + [0.01, 0.02, 0.2], faces), (1.1 * x, faces)], static=[1])
    return mesh, mesh.vertices, mesh.vertices - [0.02, 0.01, 0.4] * (mesh.vertex_body == 0)[:, None]


def in_worlds():
    """Three worlds of these sheets, of which one falls farther than another."""
    mesh, start, end = sheets()
    ends = [start + share * (end - start) for share in (0.2, 1.0, 0.6)]
    return mesh.replicate(3), np.tile(start, (3, 1)), np.concatenate(ends)


def apart(num_together=1):
    """Bodies without self-collision of which few come near another, or so many are in one place and may meet."""
    rng, number = np.random.default_rng(25), np.arange(40) // num_together
    places = rng.uniform(-1.5, 1.5, (40, 3)) if num_together == 1 else np.zeros((40, 3))
    size = 0.2 if num_together == 1 else 1.0
    bodies = [(size * rng.random((9, 3)) + place, np.arange(9).reshape(-1, 3)) for place in places]
    pairs = None if num_together == 1 else number[:, None] == number
    mesh = ccd.CollisionMesh.from_arrays(bodies, self_collision=False, body_pairs=pairs)
    return mesh, mesh.vertices, mesh.vertices + rng.uniform(-0.5, 0.5, (40, 3))[mesh.vertex_body]


def parting():
    """A ball within its distance above another, which slides off it and rises."""
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.5)
    mesh = ccd.CollisionMesh.from_trimesh([ball, ball], static=[1], self_collision=False)
    start = mesh.vertices + [0, 0, 1.005] * (mesh.vertex_body == 0)[:, None]
    return mesh, start, start + [0.3, 0, 0.2] * (mesh.vertex_body == 0)[:, None]


def slender():
    """Needles around an axis, squeezed, whose pairs are searched in a frame of their own, as they are many."""
    mesh = single(*tube())
    return mesh, mesh.vertices, squeezed(mesh.vertices, 0.6)


def needles():
    """Needles that cross each other, each in a world of its own: many take more iterations than a first round has."""
    points = FAMILIES["needle_against_needle"]("edge-edge", 24, np.random.default_rng(0))
    return pairs_in_worlds("edge-edge", *points)


_LISTS = {
    "bodies": [(0, 2)],
    "vertices": [(0, 130), (7, 250), (3, 20)],
    "vertex_face": [(v, v % 20) for v in range(90)],
}
# Scenes so large that threads share them in many parts, batches are many and a device takes several turns.
LARGE = {
    "crowd": StepCase(lambda: crowd_of_three(1000, size=0.035, self_collision=[True, False, True]), {}, 60_000),
    "static": StepCase(
        lambda: crowd_of_three(300, 40, static=[1]), {"minimum_separation": 0.004, "start_gap_fraction": None}, 90_000
    ),
    "one place": StepCase(lambda: crowd_of_three(60, 30, dust=150, static=[0]), {}, 400_000),
}
# Those in which a GPU has what a warp, a block or a few threads must not lose.
ON_DEVICE = {
    "kinds": StepCase(
        lambda: crowd_of_three(40, 15, static=[1]), {"minimum_separation": 0.004, "start_gap_fraction": None}
    ),
    "hash": StepCase(lambda: crowd_of_three(40, 15, static=[1]), {"broad_phase": "hash"}),
    "lists": StepCase(lambda: crowd_of_three(40, 15, exclude_pairs=_LISTS), {"broad_phase": "hash"}),
    "tree lists": StepCase(lambda: crowd_of_three(40, 15, exclude_pairs=_LISTS)),
    "thick lists": StepCase(lambda: crowd_of_three(40, 15, exclude_pairs=_LISTS, radius=0.01), {"broad_phase": "hash"}),
    "radii": StepCase(
        lambda: crowd_of_three(40, 15, static=[1], radius=[0.02, 0.0, 0.01]), {"minimum_distance": 0.004}
    ),
    "thickness of 0": StepCase(lambda: crowd_of_three(40, 15, radius=0.0)),
    "sheet": StepCase(sheets),  # whose edges are more than its vertices
    "parting": StepCase(parting, {"minimum_distance": 0.02}),
    "needles": StepCase(needles, {"tolerance": 1e-15, "length_scale": 1.0, "max_work": 100_000}),
    "worlds": StepCase(in_worlds),
    "apart": StepCase(apart),
    "groups": StepCase(lambda: apart(2)),
    "bisection": StepCase(lambda: crowd_of_three(25), {"method": "bisection", "max_iterations": 300, "t_max": 0.4}),
    "bisection near": StepCase(
        lambda: crowd_of_three(25),
        {"method": "bisection", "max_iterations": 300, "t_max": 0.4, "minimum_distance": 0.004},
    ),
    "few iterations": StepCase(lambda: crowd_of_three(60), {"max_iterations": 3}),
    "levels": StepCase(lambda: crowd_of_three(900, size=0.02), {}, 90_000),
    "slender": StepCase(slender, {}, 90_000),
}
NAMES = [name for name in CALLS if name != "batches"]  # which has a law of its own
# Each seed with the call that has its turn, and each of the large scenes with some.
PLAN = [(NAMES[seed % len(NAMES)], seed) for seed in range(6 * len(NAMES))]
PLAN += [(call, name) for name in LARGE for call in ("steps", "searches")] + [("launches", "crowd")]
PLAN += [(call, f"arcs {k}") for k, call in enumerate(("steps", "launches", "line_searches", "searches") * 2)]
every = pytest.mark.parametrize(("call", "scene"), PLAN)


@cache
def case_of(scene):
    """The scene of a seed, one in which bodies turn, or a large one of a name."""
    if isinstance(scene, int):
        return drawn(scene)
    return (LARGE | ON_DEVICE).get(scene) or drawn(int(scene.removeprefix("arcs")), "arcs")


def precision_of(scene):
    """Both precisions, by turns."""
    return PRECISIONS[(scene // len(NAMES) if isinstance(scene, int) else len(scene)) % 2]


def asked(call, scene, change=lambda case: case, **options):
    """What a call returns of a scene that is changed, or passed with other options."""
    case = change(case_of(scene))
    return CALLS[call](replace(case, options=case.options | options), precision_of(scene))


@cache
def expected(call, scene):
    """What it returns on one thread."""
    return asked(call, scene, num_threads=1)


@every
def test_threads_and_the_broad_phase_and_earlier_calls_change_no_bit(call, scene):
    """Earlier calls have used the mesh in a step that goes elsewhere and back, and in the same one."""
    case = case_of(scene)
    other = "tree" if case.options.get("broad_phase") == "hash" else "hash"
    assert different(asked(call, scene, num_threads=5, broad_phase=other), expected(call, scene)) == []
    mesh, start, end = made = case.make()
    away = start + 0.3 * case.size * ~mesh.rigid[mesh.vertex_body][:, None]
    asked(call, scene, lambda case: replace(case, make=lambda: (mesh, away, with_static_at_rest(mesh, away, end))))
    assert different(asked(call, scene, lambda case: replace(case, make=lambda: made)), expected(call, scene)) == []


@pytest.mark.parametrize("scene", LARGE)
def test_threads_alone_change_no_bit(scene):
    assert different(asked("steps", scene, num_threads=8), expected("steps", scene)) == []


_REPEATED = [*range(40), "sheet", "worlds", "apart", "radii", "parting", "few iterations", "crowd"]


@pytest.mark.parametrize("scene", _REPEATED)
def test_steps_repeated_and_after_others_change_no_bit_nor_one_another(scene):
    """Of one pipeline, or mesh, whose steps leave each other what stays the same, and of new ones with a limit."""
    case = case_of(scene)
    mesh, start, end = case.make()
    given = case.options | {"precision": precision_of(scene)}
    away = 300.0 * case.size
    ends = [(start, end), (start, end), (end, start), (start + away, end + away), (start, start + 0.5 * (end - start))]
    flies = np.arange(len(end))[:, None] == mesh.moving_vertices[-1:]  # so far that rounding hides gaps
    ends.append((start, np.where(flies, 1e12 * case.size, end)))
    ends = [(x, with_static_at_rest(mesh, x, y)) for x, y in ends]
    used, found, truth = ccd.CollisionPipeline(mesh, **given), {}, {}
    searches, distance = ("find_candidates", "find_proximity"), 0.05 * case.size

    @cache
    def alone(name, k, **more):
        """The result of a step by a pipeline of its own, and what that counts."""
        pipeline = ccd.CollisionPipeline(mesh, **given | more, memory_limit=1 << 40)
        return calls.on_host(name, pipeline, *ends[k], distance), pipeline.counts

    in_turn = ("mesh_ccd",) * 6 + ("collision_free_step",) * 6 + ("mesh_ccd", *searches) * 2
    for k, name in enumerate((*in_turn, "collision_free_step", "is_step_collision_free", "mesh_ccd", "mesh_ccd")):
        n, shorter = k % len(ends), given | {"t_max": 0.7}
        found[k], truth[k] = (calls.on_host(name, used, *ends[n], distance), used.counts), alone(name, n)
        if name not in searches:  # of one mesh, which keeps the same for all of its calls
            once = [getattr(ccd, name)(mesh, *ends[n], **each) for each in (given, given, shorter, shorter, given)]
            whole, part = truth[k][0], alone(name, n, t_max=0.7)[0]
            found[k], truth[k] = (*found[k], *once), (*truth[k], whole, whole, part, part, whole)
    assert different(outputs_of(found), outputs_of(truth)) == []


@pytest.mark.parametrize("seed", range(6))
def test_motions_of_many_worlds_one_after_another_change_no_bit(seed):
    """Of each step other worlds come near, some none, and copies and trees stay from one to the next."""
    rng, count = np.random.default_rng([7, seed]), 40
    shape = trimesh.convex.convex_hull(rng.normal(size=(4 + 4 * (seed % 2), 3)))
    one = ccd.CollisionMesh.from_trimesh([shape] * 2, rigid=[0, 1], radius=[0.0, 0.02] if seed == 4 else None)
    mesh, axes = (one.replicate(count), (-1,)) if seed > 2 else (one, (count, 2))
    pipeline = ccd.CollisionPipeline(mesh, max_pairs=1 << 16, max_contacts=1 << 16)
    reach = np.repeat([0.4, 0.03], 3)  # all in one slice
    for k, call in enumerate((*["mesh_ccd"] * 5, *["collision_free_step"] * 3, "launch", "launch")):
        spread = np.append(np.full(3, (4.0, 3.0, 100.0, 2.0)[k % 4]), np.ones(4))
        poses, twist = rng.normal(size=(count, 2, 7)) * spread, rng.normal(size=(count, 2, 6)) * reach
        motion = ccd.RigidMotion(poses.reshape(*axes, 7), twist=twist.reshape(*axes, 6))
        alone = ccd.CollisionPipeline(pickle.loads(pickle.dumps(mesh)), max_pairs=1 << 16, max_contacts=1 << 16)
        found = [
            outputs_of(getattr(each, call)(mesh.vertices, mesh.vertices, motion=motion)) for each in (pipeline, alone)
        ]
        assert [name for name in different(*found) if "counts" not in name] == []


@pytest.mark.parametrize("scene", [*range(16), *LARGE])
def test_memory_changes_no_bit(scene):
    """Nor the order of candidates."""
    case, given = case_of(scene), (precision_of(scene),)
    limited, enough = (replace(case, options=case.options | {"num_threads": n}) for n in (3, 1))
    enough = calls.batches(enough, *given, is_limited=False, with_order=True)
    assert different(calls.batches(limited, *given, with_order=True), enough) == []


@pytest.mark.parametrize("scene", [*range(16), "kinds", "worlds", "needles"])
def test_a_graph_changes_no_bit(scene):
    """Replays with other positions give what launches give."""
    truth, found = (calls.replays(case_of(scene), precision_of(scene), is_captured=k) for k in (False, True))
    assert different(found, truth) == []


def check_columns(of_device, expected, *there):
    """What contacts on the device say, also of other positions, is what those on the host say."""
    found = {name: getattr(of_device, name) for name in ("points", "vertices", "weights", "bodies", "world")}
    pairs = [*((column, getattr(expected, name)) for name, column in found.items())]
    pairs.append((of_device.points_at(*there), of_device.to_host(*there).points))
    for column, of_host in pairs:  # of the plane points in space
        rows = column.numpy()[rows_in_order(of_device)]
        np.testing.assert_array_equal(rows[tuple(map(slice, of_host.shape))], of_host)


def launched_in_turn(pipeline, x, y, moves, motion):
    """Results of launches of a step in every form of its positions, which share their arrays, and how it is told.

    Before it static bodies were elsewhere.
    """
    moving, (t0, t1) = pipeline.mesh.moving_vertices, (on_device(each, x.dtype.name) for each in (x, y))
    aside = np.where(np.isin(np.arange(len(x)), moving)[:, None], 0, np.ptp(x))
    pipeline.launch(x + aside, y + aside, **motion)
    yield "to", pipeline.launch(x, y, **motion)
    yield "to", pipeline.launch(t0, t1, **motion)
    yield "to", pipeline.launch(x[moving], y[moving], **motion)
    if not motion:
        yield "by", pipeline.launch(t0, displacements=on_device(moves, x.dtype.name))


_PLATE = np.array([[-1.0, -1, -1], [4.5, -4.5, 0], [0, 1.5, -4.5]])
_LAUNCHED = [*range(24), 9031, *(scene for scene in ON_DEVICE if scene != "slender"), *(f"arcs {k}" for k in range(12))]


@pytest.mark.parametrize("scene", _LAUNCHED)
def test_a_launch_gives_the_bits_of_the_call_on_the_host(scene, monkeypatch):
    """Of positions of both types, and as displacements, which are added in float64; of few bodies as of many."""
    monkeypatch.setattr(near_bodies, "_FEWEST_BODIES", 2)
    case = case_of(scene)
    mesh, start, end = case.make()
    pipeline = case.pipeline(mesh, precision_of(scene), max_pairs=90_000, max_contacts=90_000)
    motion = case.motion()
    finder = ccd.CollisionPipeline(mesh, max_pairs=90_000, max_contacts=90_000)
    for dtype in PRECISIONS:
        x, moves = start.astype(dtype), (end - start).astype(dtype)
        y = (x.astype(float) + moves.astype(float)).astype(dtype)
        host = {
            name: ccd.mesh_ccd(mesh, x.astype(float), z, precision=precision_of(scene), **case.options, **motion)
            for name, z in (("to", y.astype(float)), ("by", x.astype(float) + moves.astype(float)))
        }
        for name, result in launched_in_turn(pipeline, x, y, moves, motion):
            of_device, result, expected = result.contacts, result.to_host(), host[name]
            tois, expected_tois = ([tois_of(part) for part in by_doubt(each)] for each in (result, expected))
            if tois[1].keys() == expected_tois[1].keys():
                assert_shared_bits(result, expected, ".toi", ".vertex_toi", ".body_toi", ".contacts.points")
                if not motion:  # of which a list may have a pair in several slices
                    check_columns(
                        of_device, expected.contacts, *(on_device(each + case.size, dtype) for each in (x, y))
                    )
            else:  # boxes in float32 decide which phantoms the solver sees that rounding hides from it
                assert tois[0] == expected_tois[0] and precision_of(scene) == "float32"
        distance = (0.05 if dtype == "float64" else 0.02) * case.size
        near = finder.launch_proximity(on_device(x, dtype), distance)
        assert_shared_bits(near.to_host(), ccd.find_proximity(mesh, x.astype(float), distance))
        bounds = finder.launch_displacement_bounds(on_device(x, dtype), distance).to_host()
        assert different({"": bounds}, {"": ccd.displacement_bounds(mesh, x.astype(float), distance)}) == []


@pytest.mark.parametrize("seed", range(8))
def test_a_launch_of_worlds_on_paths_gives_the_bits_of_the_call_on_the_host(seed):
    """Of bodies that are far from their paths, over a half-space or a face, for which launches look in another way."""
    rng, count = np.random.default_rng([8, seed]), 60
    normal, shape = rng.normal(size=3), trimesh.convex.convex_hull(rng.normal(size=(5, 3)))
    normal /= np.linalg.norm(normal)
    plate = 2.0 * (np.linalg.qr(np.column_stack([normal, rng.normal(size=(3, 2))]))[0] @ _PLATE).T
    ground = ccd.HalfSpace(-2.0 * normal, normal) if seed % 4 else (plate, [[0, 1, 2]])
    bodies = [(0.5 * shape.vertices, shape.faces)] * (1 + seed // 4)
    rigid = np.arange(len(bodies))
    mesh = ccd.CollisionMesh.from_arrays([*bodies, ground], rigid=rigid, static=[] if seed % 4 else [len(bodies)])
    poses, twist = (rng.normal(size=(count, len(bodies), n)) for n in (7, 6))
    poses[..., :3] *= 0.8
    twist *= [2.0] * 3 + [(0.3, 3.0, 20.0)[seed % 3]] * 3
    motion = ccd.RigidMotion(poses, twist=twist, within=0.3 * rng.integers(0, 2, (count, len(bodies))))
    pipeline = ccd.CollisionPipeline(mesh, max_pairs=90_000, max_contacts=80_000)
    for dtype in PRECISIONS[::-1]:
        x = mesh.vertices.astype(dtype)
        launched = pipeline.launch(on_device(x, dtype), on_device(x, dtype), motion=motion)
        assert len(launched.contacts.toi) == 80_000
        found, host = launched.to_host(), ccd.mesh_ccd(mesh, *2 * [x.astype(float)], motion=motion)
        np.testing.assert_array_equal(found.world_toi, host.world_toi)
        np.testing.assert_array_equal(np.sort(found.contacts.toi), np.sort(host.contacts.toi))
        assert not found.flags & ccd.LaunchFlag.PAIRS_OVERFLOW and host.toi < 1.0


def by_doubt(result):
    """The contacts of a result, and those of them that may be none, as rounding hides the gap at the start."""
    is_hidden = result.contacts.status == ccd.CCDStatus.ROUNDING_LIMIT
    return result.contacts[~is_hidden], result.contacts[is_hidden]


# --- another device: the emulated one where the run is on the CPU, which is asked in the place of a GPU ---

_SEARCHED = ("thickness of 0", "parting", "levels", "tree lists", "thick lists", "slender")
ON_OTHER = [(NAMES[seed % len(NAMES)], seed) for seed in range(2 * len(NAMES))]
ON_OTHER += [(call, scene) for scene in ON_DEVICE if scene not in _SEARCHED for call in ("launches", "steps")]
_MORE = {
    "searches": ["levels", "hash", "lists", "tree lists", "radii", "thick lists", 32],
    "at_one_time": ["kinds", "radii"],
    "gradients": ["kinds", "radii", 59],  # in the plane
    "launches": ["arcs 1", "arcs 3", 59],
    "launched_line_searches": ["radii", "arcs 2"],
    "few_pairs": ["kinds"],
    "replays": ["worlds"],
    "steps": [2, "arcs 0", "arcs 3"],  # with half-spaces
}
ON_OTHER += [(call, scene) for call, scenes in _MORE.items() for scene in scenes if (call, scene) not in ON_OTHER]


@pytest.fixture(scope="session")
def noted(tmp_path_factory):
    """Where the processes of a run note for each other what a case has given, and what was launched up to it."""
    folder = tmp_path_factory.getbasetemp()
    folder = (folder.parent if "PYTEST_XDIST_WORKER" in os.environ else folder) / "cases"
    folder.mkdir(exist_ok=True)
    return lambda case: folder / hashlib.sha256(repr(case).encode()).hexdigest()


def difference_here_and(other_device, noted, case, call):
    """What differs in a bit between this device and the other one, and the kernels that were launched."""
    from emulated.device import SHARED

    if not noted(case).exists():
        here = kept_outputs(case, call)
        with other_device():
            found = different(call(), here)
        own = noted(case).with_suffix(f".{os.getpid()}")
        own.write_bytes(pickle.dumps((found, [*SHARED.launches])))
        own.replace(noted(case))
    return pickle.loads(noted(case).read_bytes())


def difference_of_devices(case, *places):
    return difference_here_and(*places, case, lambda: asked(*case))


@pytest.mark.parametrize(("call", "scene"), [*ON_OTHER, pytest.param("launches", "slender", marks=pytest.mark.long)])
def test_the_device_changes_no_bit(call, scene, other_device, noted):
    assert difference_of_devices((call, scene), other_device, noted)[0] == []


# --- pairs ---

PAIR_OPTIONS = {
    "default": {},
    "separation": {"minimum_separation": 0.02, "start_gap_fraction": 0.5, "t_max": 0.6},
    "scale": {"length_scale": 2.0, "tolerance": 1e-3},
    "bisection": {"method": "bisection", "max_iterations": 500},
    "limit": {"max_iterations": 2},
    "distance": {"minimum_distance": 0.02, "t_max": 0.6},
    # limits within the later rounds, and within the solver for single pairs
    "later limit": {"max_iterations": 5},
    "last limit": {"max_iterations": 14},
}
KINDS = ["vertex-face 3", "edge-edge 3", "point-segment 2", "point-segment 3", "point-point 2", "point-point 3"]
_OF_KINDS = ("random", "random_colliding", "cloth_like", "static_partner", "lattice", "collinear")
OF_PAIRS = [
    (kind, name, precision)
    for k, kind in enumerate(KINDS)
    for n, name in enumerate(PAIR_OPTIONS)
    for precision in (PRECISIONS if n == 0 else PRECISIONS[(n + k) % 2 :][:1] if n < 5 else PRECISIONS[:1] * (k < 2))
]
every_pair = pytest.mark.parametrize(("kind", "options", "precision"), OF_PAIRS)


@cache
def points_of(kind, each, seed=0):
    """The function of a kind, and its points at both ends: of plain families and of all others."""
    kind, dimension = kind.split()
    families = FAMILIES if int(dimension) == 3 and "point" not in kind else _OF_KINDS
    rng = np.random.default_rng(seed)
    drawn_points = [FAMILIES[name](kind, each, rng, int(dimension)) for name in families]
    return kind.replace("-", "_"), *(np.concatenate(frames) for frames in zip(*drawn_points, strict=True))


@every_pair
def test_threads_and_graphs_and_arrays_of_warp_change_no_bit_of_pairs(kind, options, precision):
    name, *points = points_of(kind, 200)
    call, given = getattr(ccd, f"{name}_ccd"), {**PAIR_OPTIONS[options], "precision": precision}
    truth = outputs_of(call(*points, num_threads=1, **given))
    assert np.isfinite(truth[".toi"]).sum() > 20
    for num_threads in (2, 3):
        assert different(outputs_of(call(*points, num_threads=num_threads, **given)), truth) == []
    arrays = [on_device(x) for x in points_of(kind, 200, 1)[1:]]
    call(*arrays, **given)
    with wp.ScopedCapture() as capture:
        result = call(*arrays, num_threads=3, **given)
    for array, values in zip(arrays, points, strict=True):
        array.assign(values)
    wp.capture_launch(capture.graph)
    assert different(outputs_of(result), truth) == []
    assert different(outputs_of(call(*arrays, **given)), truth) == []


def difference_of_pairs(case, *places):
    kind, options, precision = case
    name, *points = points_of(kind, 16)
    return difference_here_and(*places, case, lambda: pairs(name, *points, precision, PAIR_OPTIONS[options]))


@every_pair
def test_the_device_changes_no_bit_of_pairs(kind, options, precision, other_device, noted):
    assert difference_of_pairs((kind, options, precision), other_device, noted)[0] == []


# Kernels of modules for CUDA that the CPU alone launches, each in place of another.
CPU_ALONE = "sort_range fill_grid fill_blocks apply_order unite_blocks unite_levels split_segments"
# Of modules for distances, ends of the names of those that are not run, as others run what is theirs: a precision, the
# norm of boxes, and of radii with lists of excluded pairs and without one search each.
_LIKE_OTHERS = ("float32 euclidean", "float32 arc_box", "float32 arc_ball", "own_box", "measure_pairs box")
_LIKE_OTHERS += ("near_contacts box", "search_trees boxes True thick", "search_trees cull True thick")
_LIKE_OTHERS += ("search_hashes boxes False thick", "search_hashes cull False thick")
# Bisections in float64 of mesh functions without a distance, which are run in float32, and of pairs with one.
_LIKE_OTHERS += tuple(f"{name} bisection float64" for name in ("solve_pairs", "pairs_bound"))
_LIKE_OTHERS += ("points_toi bisection float64 euclidean",)
# Of bodies with so many edges that their scene is marked long.
_LIKE_OTHERS += ("body_frames",)


@pytest.mark.emulated
def test_every_kernel_for_cuda_is_run(other_device, noted):
    """Otherwise a kernel would be missed above; cases that no process of the run has had yet are run now."""
    launched = {
        (module, key.split("__")[-1])
        for difference, cases in ((difference_of_devices, ON_OTHER), (difference_of_pairs, OF_PAIRS))
        for case in cases
        for module, key in difference(case, other_device, noted)[1]
    }
    missing = [
        f"{name}: {key}"
        for name, module in every_module(None).items()
        if not name.endswith(_LIKE_OTHERS)
        for key in (kernel.key.split("__")[-1] for kernel in module.kernels.values())
        if key not in CPU_ALONE.split() and (module.name, key) not in launched
    ]
    assert not missing, "\n".join(missing)


@every_pair
def test_the_lane_of_a_pair_and_its_neighbours_change_no_bit(kind, options, precision):
    name, *points = points_of(kind, 8)
    call, rng = getattr(ccd, f"{name}_ccd"), np.random.default_rng(1)
    together = outputs_of(call(*points, precision=precision, **PAIR_OPTIONS[options]))
    count = len(together[".toi"])
    for rows in (rng.permutation(count), np.repeat(rng.integers(0, count, 5), 7), *([i] for i in range(0, count, 29))):
        found = outputs_of(call(*(x[rows] for x in points), precision=precision, **PAIR_OPTIONS[options]))
        assert different(found, {field: values[rows] for field, values in together.items()}) == []


def digest_of_lanes():
    """A hash of the bits of pairs of all kinds, of steps, and of what is near."""
    found = hashlib.sha256()
    for precision in PRECISIONS:
        results = [CALLS["steps"](case_of(scene), precision) for scene in (*range(8), "kinds")]
        results += [CALLS["at_one_time"](case_of(scene), precision) for scene in range(4)]
        for kind in KINDS:
            name, *points = points_of(kind, 8)
            for options in ("default", "separation", "distance")[
                : 3 if precision == "float64" and "point" not in kind else 2
            ]:
                results.append(pairs(name, *points, precision, PAIR_OPTIONS[options]))
        for result in results:
            for name, array in sorted(result.items()):
                found.update(name.encode() + array.tobytes())
    return found.hexdigest()


# Plain numbers, and vectors of 256 bits compiled for a processor without AVX-512. The default of this machine is the
# other side of the comparison.
@pytest.mark.parametrize(
    ("lanes", "flags"), [("1", None), pytest.param("4", "-target-cpu haswell", marks=pytest.mark.long)]
)
def test_the_width_of_lanes_changes_no_bit(lanes, flags, tmp_path):
    from ccd_warp._runtime.lanes import cpu_lanes

    if wp.get_device().ordinal >= 0 or (flags and cpu_lanes() < 4):
        pytest.skip("lanes are those of a CPU, these of one with AVX2")
    script = "import conftest, warp; warp.set_device('cpu')\nfrom laws import test_other_ways\n"
    script += f"warp.config.cpu_compiler_flags = {flags!r}\n" if flags else ""
    script += "print(test_other_ways.digest_of_lanes())"
    status, shown, error = begun(tmp_path, "-P", "-c", script, CCD_WARP_LANES=lanes, PYTHONWARNINGS="ignore")
    assert status == 0, error
    assert shown.split()[-1] == digest_of_lanes()
