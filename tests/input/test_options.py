"""Options: what a misspelled, a foreign and a bad one lead to, and that no call sees those of another."""

import inspect
import re
import threading
import typing
from dataclasses import fields

import numpy as np
import pytest
import warp as wp

import ccd_warp as ccd
from ccd_warp import _small_batch
from ccd_warp._input.option_types import BroadPhase, Method, PairKindName, Precision
from ccd_warp._input.options import Options

FACES = np.array([[0, 1, 2], [3, 4, 5]])
START = np.array([[0.0, 0, 1], [1, 0, 1], [0, 1, 1], [0, 0, 0], [1, 0, 0], [0, 1, 0]])
END = START * [1, 1, -1]
MESH = ccd.CollisionMesh.from_arrays([(START[:3], FACES[:1]), (START[3:], FACES[:1])])
MESH_ONLY = {"max_work", "broad_phase", "pair_kinds", "memory_limit"}
PAIR_FUNCTIONS = {
    ccd.vertex_face_ccd: 4,
    ccd.edge_edge_ccd: 4,
    ccd.point_segment_ccd: 3,
    ccd.point_point_ccd: 2,
}
MESH_FUNCTIONS = (
    ccd.mesh_ccd,
    ccd.collision_free_step,
    ccd.is_step_collision_free,
    ccd.line_search,
    ccd.find_candidates,
    ccd.find_intersections,
    ccd.find_proximity,
    ccd.displacement_bounds,
)
NAMES = ["CollisionPipeline", *(f.__name__ for f in (*PAIR_FUNCTIONS, *MESH_FUNCTIONS))]


def call(name, **options):
    """Call a public function by its name, on the CPU unless something else is asked for."""
    function = getattr(ccd, name)
    if function in PAIR_FUNCTIONS:
        points = np.random.default_rng(0).uniform(size=(2, 1, PAIR_FUNCTIONS[function], 3))
        return function(*points, **options)
    if function is ccd.find_intersections:
        return function(MESH, START, **options)
    if function in (ccd.find_proximity, ccd.displacement_bounds):
        return function(MESH, START, 0.1, **options)
    return function(MESH, **options) if name == "CollisionPipeline" else function(MESH, START, END, **options)


@pytest.mark.parametrize("name", NAMES)
def test_a_misspelled_option_is_told_with_the_right_name(name):
    with pytest.raises(TypeError, match=rf"^{name}\(\) got an unexpected option 'num_thread'; did you mean '\w+s'"):
        call(name, num_thread=1)
    with pytest.raises(TypeError, match=rf"^{name}\(\) got an unexpected option 'abacus'; expected one of .*device"):
        call(name, abacus=1)


@pytest.mark.parametrize(
    ("name", "misspelled", "meant"),
    [
        ("line_search", "saftey", "safety"),
        ("line_search", "max_round", "max_rounds"),
        ("CollisionPipeline", "max_pair", "max_pairs"),
        ("find_candidates", "inflaton", "inflation"),
    ],
)
def test_a_misspelled_argument_beside_the_options_is_told_too(name, misspelled, meant):
    with pytest.raises(TypeError, match=rf"^{name}\(\) got an unexpected option '{misspelled}'; .* '{meant}'"):
        call(name, **{misspelled: 1})


@pytest.mark.parametrize(
    ("name", "option"),
    [
        *((f.__name__, option) for f in PAIR_FUNCTIONS for option in sorted(MESH_ONLY)),
        ("line_search", "t_max"),
        ("find_candidates", "tolerance"),
        ("find_intersections", "pair_kinds"),
        ("find_proximity", "minimum_distance"),
        ("displacement_bounds", "minimum_separation"),
    ],
)
def test_an_option_of_another_function_is_told_from_a_misspelled_one(name, option):
    with pytest.raises(TypeError, match=rf"^{name}\(\) does not take the option '{option}'; mesh_ccd\(\) does$"):
        call(name, **{option: None})


def test_points_on_another_device_are_told_with_the_function():
    points = wp.zeros((1, 4), dtype=wp.vec3d, device="cpu")
    with pytest.raises(ValueError, match=r"^vertex_face_ccd: device is 'abacus'; expected"):
        ccd.vertex_face_ccd(points, points, device="abacus")


def test_a_flag_is_no_number_even_after_that_number_was_taken():
    """1.0, 1 and True are one key of a dictionary."""
    for number in (1.0, 1):
        call("vertex_face_ccd", t_max=number)
        call("vertex_face_ccd", max_iterations=1)
    for option in ("t_max", "max_iterations"):
        with pytest.raises(ValueError, match=f"{option} is True"):
            call("vertex_face_ccd", **{option: True})
    with pytest.raises(ValueError, match=r"max_iterations is 1\.0"):
        call("vertex_face_ccd", max_iterations=1.0)


def test_an_iterator_over_kinds_is_read_once():
    kinds = iter(["edge_edge"])
    call("mesh_ccd", pair_kinds=kinds)
    with pytest.raises(ValueError, match=r"^mesh_ccd: pair_kinds is"):
        call("mesh_ccd", pair_kinds=kinds)


# ---- One table -------------------------------------------------------------------------------------------------------


def test_every_option_is_documented_once_with_its_default():
    table = inspect.getdoc(ccd.MeshOptions)
    found = re.findall(r"^    (\w+): .*?Default:\s+``(\S+)``\.$", table, re.S | re.M)
    defaults = {field.name: field.default for field in fields(Options)}
    assert {name: eval(default) for name, default in found} == defaults
    assert len(found) == len(defaults)
    assert defaults.keys() == ccd.MeshOptions.__optional_keys__


def test_what_functions_take_is_among_what_mesh_ccd_takes():
    whole = typing.get_type_hints(ccd.MeshOptions)
    for kind in (ccd.PairOptions, ccd.LineSearchOptions, ccd.CandidateOptions):
        part = typing.get_type_hints(kind)
        assert part == {name: whole[name] for name in part}
        assert not kind.__required_keys__
    assert set(whole) - set(typing.get_type_hints(ccd.LineSearchOptions)) == {"t_max"}
    assert set(whole) - set(typing.get_type_hints(ccd.PairOptions)) == MESH_ONLY
    names = set(re.findall(r"``(\w+)``", inspect.getdoc(ccd.PairOptions)))
    assert names == ccd.PairOptions.__optional_keys__


def test_the_words_that_a_type_checker_knows_are_those_that_are_taken():
    for precision in typing.get_args(Precision):
        call("vertex_face_ccd", precision=precision)
    for method in typing.get_args(Method):
        call("vertex_face_ccd", method=method)
    for broad_phase in typing.get_args(BroadPhase):
        call("mesh_ccd", broad_phase=broad_phase)
    assert typing.get_args(PairKindName) == tuple(kind.name.lower() for kind in ccd.PairKind)


@pytest.mark.parametrize("name", NAMES)
def test_the_help_names_the_options_in_a_line(name):
    function = getattr(ccd, name)
    text = function.__init__.__doc__ if isinstance(function, type) else function.__doc__
    (kind,) = re.findall(r"\*\*options: Options of :class:`ccd_warp\.(\w+)`", text)
    hints = typing.get_type_hints(function.__init__ if isinstance(function, type) else function)
    assert typing.get_args(hints["options"]) == (getattr(ccd, kind),)


def test_the_help_of_mesh_ccd_fits_on_a_screen():
    assert len(inspect.getdoc(ccd.mesh_ccd).splitlines()) <= 30
    assert len(str(inspect.signature(ccd.mesh_ccd))) <= 200


# ---- Few pairs, whose launch is kept ---------------------------------------------------------------------------------


def random_pairs(count, seed=0):
    points_t0, points_t1 = np.random.default_rng(seed).uniform(-1, 1, (2, count, 4, 3))
    return points_t0, points_t1


def assert_same(result, expected):
    for name, value in vars(expected).items():
        np.testing.assert_array_equal(getattr(result, name), value, err_msg=name)


@pytest.mark.parametrize("count", [0, 1, 2, _small_batch.CAPACITY, _small_batch.CAPACITY + 1])
@pytest.mark.parametrize("function", PAIR_FUNCTIONS)
def test_few_pairs_have_the_results_that_they_have_among_many(function, count, precision):
    points_t0, points_t1 = (x[:, : PAIR_FUNCTIONS[function]] for x in random_pairs(300))
    options = {"precision": precision, "minimum_separation": 0.1, "device": "cpu"}
    whole = function(points_t0, points_t1, **options)
    few = function(points_t0[:count], points_t1[:count], **options)
    assert_same(few, ccd.PairResult(*(value[:count] for value in vars(whole).values())))


def test_points_of_the_plane_do_not_see_the_third_coordinate_of_the_call_before():
    points_t0, points_t1 = (x[:, :3] for x in random_pairs(8))
    flat = [np.ascontiguousarray(x[:, :, :2]) for x in (points_t0, points_t1)]
    expected = ccd.point_segment_ccd(*(np.tile(x, (20, 1, 1)) for x in flat), device="cpu")
    ccd.point_segment_ccd(points_t0, points_t1, device="cpu")
    few = ccd.point_segment_ccd(*flat, device="cpu")
    assert_same(few, ccd.PairResult(*(value[:8] for value in vars(expected).values())))


def test_hard_pairs_among_few_are_solved_to_the_end():
    """Edges that cross in their common plane, which the bisection does not settle before its limit."""
    points_t0, points_t1 = random_pairs(5)
    points_t0[1:3] = [[0.0, 0, 0], [1, 0.3, 0], [0.1, 0.5, 0], [1.1, 0.1, 0]]
    points_t1[1:3] = points_t0[1:3] + [[0.0, 0, 0], [0, 0, 0], [0.3, -0.5, 0], [0.3, -0.5, 0]]
    options = {"method": "bisection", "tolerance": 1e-9, "device": "cpu"}
    few = ccd.edge_edge_ccd(points_t0, points_t1, **options)
    assert (few.iterations == 10_000).tolist() == [False, True, True, False, False]
    many = ccd.edge_edge_ccd(*(np.tile(x, (20, 1, 1)) for x in (points_t0, points_t1)), **options)
    assert_same(few, ccd.PairResult(*(value[:5] for value in vars(many).values())))


def test_options_of_one_call_do_not_hold_in_the_next():
    points_t0, points_t1 = random_pairs(20)
    plain = ccd.vertex_face_ccd(points_t0, points_t1, device="cpu")
    wide = ccd.vertex_face_ccd(points_t0, points_t1, minimum_separation=0.2, device="cpu")
    assert (wide.toi < plain.toi).any()
    assert_same(ccd.vertex_face_ccd(points_t0, points_t1, device="cpu"), plain)


def test_a_result_stays_as_it_is_when_the_next_call_is_made():
    first = ccd.vertex_face_ccd(*random_pairs(20), device="cpu")
    kept = ccd.PairResult(*(value.copy() for value in vars(first).values()))
    other = ccd.vertex_face_ccd(*random_pairs(20, seed=1), device="cpu")
    assert_same(first, kept)
    for value in vars(first).values():
        assert value.flags.writeable and value.flags.c_contiguous
        assert not any(np.shares_memory(value, array) for array in vars(other).values())


def test_calls_of_many_threads_do_not_see_each_other():
    queries = [random_pairs(5, seed) for seed in range(8)]
    expected = [ccd.vertex_face_ccd(*query, device="cpu") for query in queries]
    wrong, barrier = [], threading.Barrier(len(queries))

    def work(k):
        barrier.wait()
        for _ in range(200):
            result = ccd.vertex_face_ccd(*queries[k], device="cpu")
            if not all(np.array_equal(getattr(result, name), value) for name, value in vars(expected[k]).items()):
                wrong.append(k)

    threads = [threading.Thread(target=work, args=(k,)) for k in range(len(queries))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong


def test_a_call_that_failed_gives_nothing_back(monkeypatch):
    query = random_pairs(5)
    expected = ccd.vertex_face_ccd(*query, device="cpu")
    solve, used = _small_batch.SmallBatch.solve, []

    def interrupted(batch, *arguments):
        used.append(batch)
        solve(batch, *arguments)
        raise KeyboardInterrupt

    monkeypatch.setattr(_small_batch.SmallBatch, "solve", interrupted)
    with pytest.raises(KeyboardInterrupt):
        ccd.vertex_face_ccd(*query, device="cpu")
    monkeypatch.undo()
    assert_same(ccd.vertex_face_ccd(*query, device="cpu"), expected)
    assert used[0] not in [batch for idle in _small_batch._idle.values() for batch in idle]
