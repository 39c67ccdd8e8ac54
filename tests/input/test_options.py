"""Options: what a misspelled and a foreign one lead to, their one table, and that no call sees those of another."""

import copy
import inspect
import re
import threading
import typing
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields

import numpy as np
import pytest
import warp as wp
from every_call import EVERY_CALL, run
from scenes import random_pairs

import ccd_warp as ccd
from ccd_warp._scene.input.option_types import BroadPhase, Method, PairKindName, Precision
from ccd_warp._scene.input.options import Options

MESH_ONLY = {"max_work", "broad_phase", "pair_kinds", "memory_limit"}
# Every call with options.
NAMES = [
    name for name, (function, arguments) in EVERY_CALL.items() if name in ccd.__all__ and "num_threads" in arguments
]


def call(name, **options):
    """Call a public function by its name, with no option but these."""
    function, arguments = EVERY_CALL[name]
    names = inspect.signature(function).parameters
    return run(function, {key: value for key, value in arguments.items() if key in names}, options)


@pytest.mark.parametrize("name", NAMES)
def test_a_misspelled_option_is_told_with_the_right_name(name):
    options = {"num_thread": "did you mean 'num_threads'", "abacus": "expected one of .*device"}
    others = {"saftey": "safety", "max_round": "max_rounds", "max_pair": "max_pairs", "inflaton": "inflation"}
    taken = EVERY_CALL[name][1]
    options |= {wrong: f".* '{right}'" for wrong, right in others.items() if right in taken}
    for option, words in options.items():
        with pytest.raises(TypeError, match=rf"^{name}\(\) got an unexpected option '{option}'; {words}"):
            call(name, **{option: 1})
    for option in ccd.MeshOptions.__optional_keys__ - set(taken):
        with pytest.raises(TypeError, match=rf"^{name}\(\) does not take the option '{option}'; mesh_ccd\(\) does$"):
            call(name, **{option: None})
    for option, right in {"radius": "radius", "thickness": "radius", "static": "static"}.items():
        with pytest.raises(TypeError, match=rf"'{option}'; a mesh does: CollisionMesh.from_arrays\(…, {right}=…\)$"):
            call(name, **{option: None})


def test_a_flag_is_no_number_even_after_that_number_was_taken():
    """1.0, 1 and True are one key of a dictionary."""
    for number in (1.0, 1):
        call("vertex_face_ccd", t_max=number)
    call("vertex_face_ccd", max_iterations=1)
    for option, value in (("t_max", True), ("max_iterations", True), ("max_iterations", 1.0)):
        with pytest.raises(ValueError, match=f"{option} is {value}"):
            call("vertex_face_ccd", **{option: value})


def test_an_iterator_over_kinds_is_read_once():
    kinds = iter([ccd.PairKind.VERTEX_FACE, "edge_edge"])
    result, expected = call("mesh_ccd", pair_kinds=kinds), call("mesh_ccd", pair_kinds=["vertex_face", "edge_edge"])
    assert np.array_equal(result.contacts.primitives, expected.contacts.primitives)
    with pytest.raises(ValueError, match=r"^mesh_ccd: pair_kinds is"):
        call("mesh_ccd", pair_kinds=kinds)


def test_every_option_is_documented_once_with_its_default():
    table = inspect.getdoc(ccd.MeshOptions)
    found = re.findall(r"^    (\w+): .*?Default:\s+``(\S+)``\.$", table, re.S | re.M)
    defaults = {field.name: field.default for field in fields(Options)}
    assert {name: eval(default) for name, default in found} == defaults and len(found) == len(defaults)
    assert defaults.keys() == ccd.MeshOptions.__optional_keys__
    whole = typing.get_type_hints(ccd.MeshOptions)
    for kind in (ccd.PairOptions, ccd.LineSearchOptions, ccd.CandidateOptions):
        part = typing.get_type_hints(kind)
        assert part == {name: whole[name] for name in part} and not kind.__required_keys__
    assert set(whole) - ccd.LineSearchOptions.__optional_keys__ == {"t_max"}
    assert set(whole) - ccd.PairOptions.__optional_keys__ == MESH_ONLY
    assert set(re.findall(r"``(\w+)``", inspect.getdoc(ccd.PairOptions))) == ccd.PairOptions.__optional_keys__


def test_the_words_that_a_type_checker_knows_are_those_that_are_taken():
    for option, words in {"precision": Precision, "method": Method, "broad_phase": BroadPhase}.items():
        for word in typing.get_args(words):
            call("mesh_ccd", **{option: word})
    assert typing.get_args(PairKindName) == tuple(kind.name.lower() for kind in ccd.PairKind)


# ---- Few pairs, whose launch is kept ---------------------------------------------------------------------------------


def is_same(result, expected, rows=slice(None)):
    return all(np.array_equal(getattr(result, name), value[rows]) for name, value in vars(expected).items())


def test_few_arrays_of_warp_have_results_of_their_own():
    points = random_pairs("vertex_face", 5)
    results = [ccd.vertex_face_ccd(*(wp.array(x, dtype=wp.vec3d, device="cpu") for x in points)) for _ in range(2)]
    expected = ccd.vertex_face_ccd(*points)
    for name, array in vars(results[0]).items():
        array.zero_()
        assert np.array_equal(getattr(results[1], name).numpy(), getattr(expected, name))
        assert getattr(results[1], name).dtype == array.dtype and array.device.is_cpu


def test_calls_one_after_another_and_of_many_threads_do_not_see_each_other():
    queries = [random_pairs("vertex_face", 20, seed) for seed in range(8)]
    expected = [ccd.vertex_face_ccd(*query) for query in queries]
    kept = copy.deepcopy(expected[0])
    assert (ccd.vertex_face_ccd(*queries[0], minimum_separation=0.2).toi < kept.toi).any()
    assert is_same(ccd.vertex_face_ccd(*queries[0]), kept) and is_same(expected[0], kept)
    for value in vars(expected[0]).values():
        assert value.flags.writeable and value.flags.c_contiguous
        assert not any(np.shares_memory(value, array) for array in vars(expected[1]).values())
    barrier = threading.Barrier(len(queries))

    def work(k):
        barrier.wait()
        return all([is_same(ccd.vertex_face_ccd(*queries[k]), expected[k]) for _ in range(200)])

    with ThreadPoolExecutor(len(queries)) as threads:
        assert all(threads.map(work, range(len(queries))))
