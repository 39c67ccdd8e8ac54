"""What the fields of a result mean, and which examples, pages and benchmarks rely on it.

A field that changes its meaning fails here, and the failure names those who read it, who need not fail by themselves:
when the sign of weights turned, the cloth of an example still passed through nothing, and tore.
"""

import ast
import functools
import re
from dataclasses import fields, is_dataclass
from pathlib import Path

import numpy as np
import pytest
import warp as wp
from scenes import FACE, NO_FACES, TRIANGLE

import ccd_warp as ccd
from ccd_warp._runtime.lazy import lazy_property

ROOT = Path(__file__).resolve().parents[2]
RESULTS = (
    *(ccd.Contacts, ccd.Contact, ccd.Proximities, ccd.Intersections, ccd.Candidates, ccd.MeshResult, ccd.PairResult),
    *(ccd.LineSearchResult, ccd.LaunchResult, ccd.HostLaunchResult, ccd.DeviceContacts, ccd.DeviceProximities),
    *(ccd.DeviceDisplacements, ccd.ToiGradient),
)
# Fields with a sign, a side, an order or a unit of their own; each has a test of its meaning below.
MEANT = {
    *("bodies", "body_contact", "body_fraction", "bounds", "direction", "distance", "edge_parameter", "features"),
    *("fraction", "gap"),
    *("is_crossing", "normal", "parameters", "point", "points", "primitives", "relative_velocity", "touching"),
    *("struck", "vertex_contact", "vertex_fraction", "weights", "world_contact"),
}
# Fields whose name says all, or that so many things have that a search for them would tell nothing.
PLAIN = {
    *("body_names", "body_toi", "contacts", "count", "counts", "edge_edge", "end", "first", "flags", "hit", "index"),
    *(
        "is_limited",
        "is_regular",
        "iterations",
        "kind",
        "mesh",
        "motion",
        "num_contacts",
        "num_crossing",
        "num_pairs",
        "num_rounds",
    ),
    *(
        "hidden_gaps",
        "num_touching",
        "pairs_at_start",
        "point_point",
        "point_segment",
        "positions",
        "radius",
        "start",
        "status",
    ),
    *(
        "timings",
        "toi",
        "vertex_face",
        "vertex_plane",
        "vertex_toi",
        "vertices",
        "width",
        "world",
        "world_flags",
        "world_toi",
    ),
}
# Which of the former each program and page reads. Before a name is added here, the reader is compared with the test of
# its meaning. Names are all that is searched for, so some of these belong to other things.
READ = {
    "docs/at_one_time.md": "bodies direction distance edge_parameter features is_crossing normal parameters points "
    "primitives weights",
    "docs/bodies.md": "bodies distance normal point primitives struck",
    "docs/calls.md": "gap parameters",
    "docs/choosing.md": "distance touching",
    "docs/coming_from_ipc_toolkit.md": "direction distance gap is_crossing parameters weights",
    "docs/command_line.md": "bodies gap primitives",
    "docs/distributed.md": "bodies primitives",
    "docs/gradients.md": "bodies body_contact distance vertex_contact weights",
    "docs/make_pictures.py": "bodies",
    "docs/method.md": "gap",
    "docs/on_device.md": "bodies body_contact gap normal parameters point points primitives vertex_contact weights "
    "world_contact",
    "docs/rigid.md": "body_fraction",
    "docs/solver.md": "bodies body_contact distance normal point points touching vertex_contact world_contact",
    "examples/barrier_solver.py": "direction distance weights",
    "examples/bullet_2d.py": "gap parameters",
    "examples/cloth_drop.py": "direction normal weights",
    "examples/dice.py": "bodies direction distance points",
    "examples/fsi_membrane.py": "normal parameters",
    "examples/mesh_against_mesh.py": "normal point primitives",
    "examples/newton_cloth.py": "bodies normal weights",
    "examples/rotor.py": "direction distance normal primitives relative_velocity",
    "examples/two_layers.py": "direction distance weights",
    "examples/valve.py": "direction weights",
}
DISTANCE = 0.1
TESTED: set[str] = set()


def read_in(path: Path) -> dict[str, list[int]]:
    """The attributes that a program or a page reads, with their lines; of a page also what stands in code spans."""
    text = path.read_text(encoding="utf-8")
    programs, found = [(0, text)], []
    if path.suffix == ".md":
        blocks = list(re.finditer(r"^```python\n(.*?)^```$", text, re.DOTALL | re.M))
        programs = [(text.count("\n", 0, block.start(1)), block[1]) for block in blocks]
        prose = re.sub(r"^```.*?^```$", lambda block: "\n" * block[0].count("\n"), text, flags=re.DOTALL | re.M)
        spans = re.finditer(r"`(?:[\w.]*\.)?(\w+)`", prose)
        found = [(span[1], prose.count("\n", 0, span.start()) + 1) for span in spans]
    for first, program in programs:
        tree = ast.parse(program)
        called = {id(node.func) for node in ast.walk(tree) if isinstance(node, ast.Call)}
        for node in ast.walk(tree):
            if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Load) and id(node) not in called:
                found.append((node.attr, first + node.lineno))
    lines: dict[str, list[int]] = {}
    for name, line in found:
        lines.setdefault(name, []).append(line)
    return lines


@functools.cache
def readers() -> dict[str, dict[str, list[int]]]:
    """The programs and pages that read such fields, with the lines of each."""
    paths = [ROOT / "README.md", *(ROOT / "docs").glob("*.md")]
    paths += [path for folder in ("examples", "docs", "benchmarks") for path in (ROOT / folder).rglob("*.py")]
    found = {}
    for path in sorted(paths):
        if read := {name: sorted({*lines}) for name, lines in read_in(path).items() if name in MEANT}:
            found[path.relative_to(ROOT).as_posix()] = read
    return found


def meaning_of(*names: str):
    """A test of what fields mean, whose failure names those who rely on it."""
    TESTED.update(names)

    def with_readers(test):
        @functools.wraps(test)
        def checked(**arguments):
            try:
                test(**arguments)
            except AssertionError as error:
                uses = [(path, read) for path, read in readers().items() if read.keys() & {*names}]
                places = [
                    f"{path}: {name}, lines {read[name]}" for path, read in uses for name in names if name in read
                ]
                raise AssertionError("\n".join([f"{error}", "Look at those who rely on it:", *places])) from error

        return checked

    return with_readers


def test_every_field_of_a_result_is_in_one_of_the_lists():
    found = set()
    for result in RESULTS:
        found |= {field.name for field in fields(result)} if is_dataclass(result) else {*result.__slots__}
        members = [member for base in result.__mro__ for member in vars(base).items()]
        found |= {name for name, value in members if isinstance(value, (property, lazy_property))}
    assert {name for name in found if not name.startswith("_")} == MEANT | PLAIN
    assert not MEANT & PLAIN and TESTED == MEANT


def test_who_reads_a_field_has_been_compared_with_its_meaning():
    assert {path: " ".join(sorted(read)) for path, read in readers().items()} == READ


# --- what they mean ---


@pytest.fixture(scope="module")
def step():
    """Two bodies, the upper one (1) comes within the distance of the lower one (0), and that of the ground (2)."""
    lower = np.array(
        [*TRIANGLE, [-2.0, 0, 0], [-1.5, 0.4, 0.02], [2.0, 0.1, 0.01], [-1.75, 0.2, 0.01], [5.0, 5.0, 0.02]]
    )
    upper = lower * [0.98, 1.04, 1.0] + [0.02, 0.01, 0.5] + 0.02 * np.random.default_rng(0).random(lower.shape)
    bodies = [*((x, FACE, [[3, 4]]) for x in (lower, upper)), ccd.HalfSpace([0, 0, -0.35], [0, 0, 2.0])]
    mesh = ccd.CollisionMesh.from_arrays(bodies, codimensional_points=True, self_collision=False)
    end = mesh.vertices - np.where(mesh.vertex_body == 1, 0.75, 0.3)[:, None] * [0, 0, 1]
    pipeline = ccd.CollisionPipeline(mesh, minimum_distance=DISTANCE, device="cpu")
    return pipeline, mesh.vertices, end, pipeline.mesh_ccd(mesh.vertices, end)


def at_toi(step, contact):
    """Positions at the toi of a contact."""
    _, start, end, _ = step
    return (1 - contact.toi) * start + contact.toi * end


def row_of(pairs, kind, primitives):
    """The row of a pair."""
    return int(np.flatnonzero((pairs.kind == kind) & (pairs.primitives == primitives).all(axis=1))[0])


def one_of_each_kind(pairs):
    """A row of every kind of pair."""
    return [int(np.flatnonzero(pairs.kind == kind)[0]) for kind in ccd.PairKind]


@meaning_of("primitives", "bodies")
def test_the_first_primitive_and_its_body_come_first(step):
    pipeline, _, end, result = step
    mesh = pipeline.mesh
    tables = {"vertex": np.arange(mesh.num_vertices)[:, None], "edge": mesh.edges, "face": mesh.faces}
    tables |= {"point": tables["vertex"], "segment": mesh.edges, "plane": np.empty((1, 0), dtype=int)}
    for pairs in (result.contacts, pipeline.find_proximity(end, DISTANCE)):
        for k in one_of_each_kind(pairs):
            names, (a, b) = ccd.PairKind(int(pairs.kind[k])).name.lower().split("_"), pairs.primitives[k].tolist()
            first, second = tables[names[0]][a].tolist(), tables[names[1]][b].tolist()
            assert list(dict.fromkeys(pairs.vertices[k].tolist())) == first + second
            body = mesh.vertex_body[second[0]] if second else mesh.planes.bodies[b]
            assert pairs.bodies[k].tolist() == [mesh.vertex_body[first[0]], body]


@meaning_of("normal", "direction")
def test_normals_point_from_the_second_primitive_to_the_first(step):
    pipeline, _, end, result = step
    near = pipeline.find_proximity(end, DISTANCE)
    for bodies, normal in ((result.contacts.bodies, result.contacts.normal), (near.bodies, near.direction)):
        is_first_above = (bodies[:, 0] == 1) | (bodies[:, 1] == 2)
        assert 5 < is_first_above.sum() < len(bodies)
        assert np.array_equal(normal[:, 2] > 0, is_first_above)
        assert np.allclose(np.linalg.norm(normal, axis=1), 1.0)


@meaning_of("weights", "normal", "direction", "distance")
def test_a_push_by_the_weights_along_the_normal_parts_the_two(step):
    pipeline, _, _, result = step
    push = 1e-3
    for k in one_of_each_kind(result.contacts):
        contact, weights = result.contacts[k], result.contacts.weights[k]
        of_plane = contact.kind == ccd.PairKind.VERTEX_PLANE
        assert weights.sum() == pytest.approx(1.0 if of_plane else 0.0, abs=1e-15) and np.abs(weights).sum() > 0.99
        before = at_toi(step, contact)
        near = pipeline.find_proximity(before, 2 * DISTANCE)
        row = row_of(near, contact.kind, contact.primitives)
        assert near.distance[row] == pytest.approx(DISTANCE, abs=1e-6)
        assert np.allclose(near.direction[row], contact.normal, atol=1e-5) and np.allclose(
            near.weights[row], weights, atol=1e-5
        )
        after = before.copy()
        np.add.at(after, result.contacts.vertices[k], push * weights[:, None] * contact.normal)
        parted = pipeline.find_proximity(after, 2 * DISTANCE)
        grown = parted.distance[row_of(parted, contact.kind, contact.primitives)] - near.distance[row]
        assert grown == pytest.approx(push * (weights**2).sum(), rel=0.05)


@meaning_of("parameters", "point", "points")
def test_points_and_parameters_are_those_of_the_closest_points(step):
    pipeline, _, end, result = step
    near = pipeline.find_proximity(end, DISTANCE)
    for k in one_of_each_kind(result.contacts):
        contact = result.contacts[k]
        ends, (u, v) = at_toi(step, contact)[result.contacts.vertices[k]], contact.parameters
        p, q = {
            "VERTEX_FACE": lambda x, u=u, v=v: (x[0], x[1] + u * (x[2] - x[1]) + v * (x[3] - x[1])),
            "EDGE_EDGE": lambda x, u=u, v=v: (x[0] + u * (x[1] - x[0]), x[2] + v * (x[3] - x[2])),
            "POINT_SEGMENT": lambda x, u=u: (x[0], x[2] + u * (x[3] - x[2])),
            "POINT_POINT": lambda x: (x[0], x[2]),
            "VERTEX_PLANE": lambda x: (x[0], [*x[0, :2], -0.35]),
        }[contact.kind.name](ends)
        assert np.allclose(p - q, DISTANCE * contact.normal, atol=1e-5)
        assert np.allclose(contact.point, (p + q) / 2, atol=1e-12)
        assert np.array_equal(contact.point, result.contacts.points[k])
    assert np.allclose(near.points[:, 0] - near.points[:, 1], near.distance[:, None] * near.direction, atol=1e-12)


@meaning_of("relative_velocity", "normal")
def test_the_relative_velocity_is_that_of_the_first_primitive_less_that_of_the_second(step):
    contacts = step[3].contacts
    velocity = np.array([[0, 0, -0.3], [0, 0, -0.75], [0, 0, 0]])[contacts.bodies]
    assert np.allclose(contacts.relative_velocity, velocity[:, 0] - velocity[:, 1], rtol=0, atol=1e-14)
    approach = (contacts.relative_velocity * contacts.normal).sum(axis=1)
    assert (approach < -0.1).all() and {*contacts.kind.tolist()} == {*ccd.PairKind}
    assert all(
        np.array_equal(contact.relative_velocity, contacts.relative_velocity[contact.index]) for contact in contacts
    )


@meaning_of("gap")
def test_the_gap_is_beyond_the_distance_and_no_less_than_the_true_one(step):
    contacts = step[3].contacts
    for contact in contacts:
        gap = contacts.weights[contact.index] @ at_toi(step, contact)[contacts.vertices[contact.index]]
        if contact.kind != ccd.PairKind.VERTEX_PLANE:
            assert np.linalg.norm(gap) - DISTANCE <= contact.gap + 1e-15
        assert 0 <= contact.gap < 1e-4


@meaning_of("vertex_contact", "body_contact", "world_contact")
def test_rows_of_contacts_are_those_that_give_the_toi(step):
    result = step[3]
    contacts = result.contacts
    of_vertices = result.vertex_contact, result.vertex_toi, contacts.vertices
    of_bodies = result.body_contact, result.body_toi, contacts.bodies
    of_worlds = result.world_contact, result.world_toi, contacts.world[:, None]
    for rows, toi, members in (of_vertices, of_bodies, of_worlds):
        is_hit = np.isfinite(toi)
        assert is_hit.any() and (rows[~is_hit] == -1).all()
        for k in np.flatnonzero(is_hit):
            row = rows[k]
            assert contacts.toi[row] == toi[k] and k in members[row]
            assert not (contacts.toi[:row][(members[:row] == k).any(axis=1)] <= toi[k]).any()


@meaning_of("features")
def test_features_have_a_bit_for_each_vertex_of_the_closest_points(step):
    pipeline, _, end, _ = step
    near = pipeline.find_proximity(end, DISTANCE)
    near = near[near.kind <= int(ccd.PairKind.EDGE_EDGE)]
    bits = near.features[:, None] >> np.arange(4) & 1
    assert np.array_equal(bits == 1, near.weights != 0) and len({*near.features.tolist()}) > 1


@meaning_of("touching", "fraction", "vertex_fraction")
def test_a_line_search_says_how_far_each_vertex_goes_and_what_keeps_it():
    standing = np.array([[0.1, 0.2, 0.0], [0.2, 0.2, 1.0], [0.1, 0.3, 1.0]])  # on one vertex
    falling = TRIANGLE + [5.0, 0.0, 1.0]
    mesh = ccd.CollisionMesh.from_arrays([(x, FACE) for x in (TRIANGLE, standing, falling)], static=[0])
    end = mesh.vertices - [0, 0, 0.5] * (mesh.vertex_body > 0)[:, None]
    found = ccd.line_search(mesh, mesh.vertices, end, per="vertex", device="cpu")
    assert found.vertex_fraction.tolist() == [1, 1, 1, 0, 1, 1, 1, 1, 1] and found.fraction == 0.0
    moved = mesh.vertices + found.vertex_fraction[:, None] * (end - mesh.vertices)
    assert np.allclose(found.vertices, moved, atol=1e-15)
    assert len(found.touching) and (found.touching.vertices == 3).any(axis=1).all()


@meaning_of("body_fraction")
def test_the_fraction_of_a_body_is_that_of_its_turn():
    """A blade turns by a quarter, to a point that it would meet halfway."""
    blade, point = [[0.5, 0, 0], [2, 0, 0], [2, 0, 0.5]], [[np.sqrt(0.5), np.sqrt(0.5), 0.1]]
    mesh = ccd.CollisionMesh.from_arrays(
        [(point, NO_FACES), (blade, FACE)], codimensional_points=True, static=[0], rigid=[1]
    )
    motion = ccd.RigidMotion([[0, 0, 0, 0, 0, 0, 1]], twist=[[0, 0, 0, 0, 0, np.pi / 2]])
    pipeline = ccd.CollisionPipeline(mesh, device="cpu")
    found = pipeline.launch_line_search(mesh.vertices, mesh.vertices.copy(), safety=0.5, motion=motion)
    fraction = found.to_host().body_fraction
    assert np.allclose(fraction, [1.0, 0.25], atol=1e-12) and (found.body_fraction.numpy() == fraction).all()
    assert np.allclose(found.motion.poses_t1, motion.at(fraction[1]), atol=1e-15)


@meaning_of("struck")
def test_struck_is_what_a_kinematic_body_meets_that_stays():
    wall = 0.5 * TRIANGLE[:, [2, 0, 1]] - [1.0, 0.0, 0.0]
    mesh = ccd.CollisionMesh.from_arrays([(TRIANGLE, FACE), (wall, FACE)], kinematic=[1])
    end = mesh.vertices + [2.0, 0.0, 0.0] * (mesh.vertex_body == 1)[:, None]
    found = ccd.line_search(mesh, mesh.vertices, end, per="vertex", device="cpu")
    assert found.vertex_fraction.tolist() == [1.0] * 6 and np.array_equal(found.vertices, end)
    assert len(found.struck) and (found.struck.toi < 0.5).any() and not len(found.touching)
    assert ({*found.struck.bodies.ravel().tolist()} == {0, 1}) and np.isfinite(found.struck.toi).all()


@meaning_of("edge_parameter", "is_crossing", "parameters", "points")
def test_an_edge_through_a_face_is_where_its_parameters_say():
    mesh = ccd.CollisionMesh.from_arrays([(TRIANGLE, FACE), ([[0.1, 0.2, -1.0], [0.1, 0.2, 3.0]], NO_FACES, [[0, 1]])])
    found = ccd.find_intersections(mesh, mesh.vertices)
    assert found.is_crossing.tolist() == [True] and found.vertices.tolist() == [[3, 4, 0, 1, 2]]
    assert np.allclose(found.points, [[0.1, 0.2, 0.0]]) and np.allclose(found.edge_parameter, [0.25])
    (u, v), (f0, f1, f2) = found.parameters[0], TRIANGLE
    assert np.allclose(f0 + u * (f1 - f0) + v * (f2 - f0), found.points[0], atol=1e-6)


@meaning_of("bounds")
def test_bounds_of_two_that_may_both_move_are_half_of_what_is_between_them():
    mesh = ccd.CollisionMesh.from_arrays([([[0.0, 0, 0], [0.5, 0, 0]], NO_FACES)], codimensional_points=True)
    x = wp.array(mesh.vertices, dtype=wp.vec3d, device="cpu")
    bounds = ccd.CollisionPipeline(mesh, device="cpu").launch_displacement_bounds(x, 1.0).bounds.numpy()
    assert np.allclose(bounds, 0.25, rtol=1e-12) and (bounds <= 0.25).all()


@meaning_of("normal", "parameters", "primitives", "gap", "direction", "distance", "features")
def test_launches_say_what_the_calls_say(step):
    pipeline, start, end, result = step
    x, y = (wp.array(values, dtype=wp.vec3d, device="cpu") for values in (start, end))
    found, expected = pipeline.launch(x, y).contacts.to_host(), result.contacts
    near, expected_near = pipeline.launch_proximity(y, DISTANCE).to_host(), pipeline.find_proximity(end, DISTANCE)
    of_pairs = found, expected, vars(expected)
    of_near = near, expected_near, ("direction", "distance", "features")
    for ours, theirs, names in (of_pairs, of_near):
        for name in (*names, "kind", "primitives", "parameters", "weights", "vertices", "bodies"):
            np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name), err_msg=name)
