"""Options: what a misspelled, a foreign and a bad one lead to, and that no call sees those of another."""

import inspect
import re
import typing
from dataclasses import fields

import numpy as np
import pytest
import warp as wp

import ccd_warp as ccd
from ccd_warp._option_types import Method, PairKindName, Precision
from ccd_warp._options import Options

FACES = np.array([[0, 1, 2], [3, 4, 5]])
START = np.array([[0.0, 0, 1], [1, 0, 1], [0, 1, 1], [0, 0, 0], [1, 0, 0], [0, 1, 0]])
END = START * [1, 1, -1]
MESH = ccd.CollisionMesh.from_arrays([(START[:3], FACES[:1]), (START[3:], FACES[:1])])
PAIR_FUNCTIONS = {
    ccd.vertex_face_ccd: 4,
    ccd.edge_edge_ccd: 4,
    ccd.point_segment_ccd: 3,
    ccd.point_point_ccd: 2,
}
MESH_FUNCTIONS = (ccd.mesh_ccd, ccd.collision_free_step, ccd.line_search, ccd.find_candidates)
NAMES = ["CollisionPipeline", *(f.__name__ for f in (*PAIR_FUNCTIONS, *MESH_FUNCTIONS))]


def call(name, **options):
    """Call a public function by its name, on the CPU unless something else is asked for."""
    function = getattr(ccd, name)
    if function in PAIR_FUNCTIONS:
        points = np.random.default_rng(0).uniform(size=(2, 1, PAIR_FUNCTIONS[function], 3))
        return function(*points, **options)
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
        *((f.__name__, option) for f in PAIR_FUNCTIONS for option in ("max_work", "pair_kinds", "memory_limit")),
        ("line_search", "t_max"),
        ("find_candidates", "tolerance"),
    ],
)
def test_an_option_of_another_function_is_told_from_a_misspelled_one(name, option):
    with pytest.raises(TypeError, match=rf"^{name}\(\) does not take the option '{option}'; mesh_ccd\(\) does$"):
        call(name, **{option: None})


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(("option", "value"), [("num_threads", 0), ("device", "abacus")])
def test_a_bad_value_is_told_with_the_function_that_got_it(name, option, value):
    with pytest.raises(ValueError, match=rf"^{name}: {option} is {value!r}; expected"):
        call(name, **{option: value})


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("line_search", {"safety": 2}),
        ("line_search", {"max_rounds": 2}),
        ("find_candidates", {"inflation": -1}),
        ("CollisionPipeline", {"max_pairs": 0}),
    ],
)
def test_a_bad_argument_beside_the_options_is_told_with_the_function(name, options):
    ((argument, value),) = options.items()
    with pytest.raises(ValueError, match=rf"^{name}: {argument} is {value}; expected"):
        call(name, **options)


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
    assert set(whole) - set(typing.get_type_hints(ccd.PairOptions)) == {"max_work", "memory_limit", "pair_kinds"}
    names = set(re.findall(r"``(\w+)``", inspect.getdoc(ccd.PairOptions)))
    assert names == ccd.PairOptions.__optional_keys__


def test_the_words_that_a_type_checker_knows_are_those_that_are_taken():
    for precision in typing.get_args(Precision):
        call("vertex_face_ccd", precision=precision)
    for method in typing.get_args(Method):
        call("vertex_face_ccd", method=method)
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
