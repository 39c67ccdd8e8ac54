"""The numbers of docs/how_it_is_tested.md are those of the tests, of the benchmark's raw file, and of the fuzz run."""

import importlib.util
import inspect
import json
import re
from pathlib import Path

import arc_hostile
import arc_pairs
import pytest
from emulated.comparison import PAIRS, PLAN
from hard_cases import FAMILIES
from planted import of_gpu, of_host

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "how_it_is_tested.md"
TESTS = ROOT / "tests"


def loaded(file):
    """A module of tests under a name of its own."""
    spec = importlib.util.spec_from_file_location(f"counted_{Path(file).stem}", TESTS / file)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def text():
    return " ".join(PAGE.read_text(encoding="utf-8").split())


def row_of(text, command):
    """The number of the row of the cases with a command."""
    (number,) = re.findall(rf"\| ([\d,]+)[^|]* \| `{re.escape(command)}` \|", text)
    return int(number.replace(",", ""))


def test_planted_faults(text):
    more, gpu, host = map(int, re.findall(r"more than (\d+): some (\d+) of the kind .*? and some (\d+) in", text)[0])
    assert len(of_gpu.PLANTED) >= gpu and len(of_host.PLANTED) >= host
    assert 0 < len(of_gpu.PLANTED) + len(of_host.PLANTED) - more < 20


def test_fuzz_run(text):
    run = json.loads((ROOT / "benchmarks" / "results" / "fuzz.json").read_text(encoding="utf-8"))
    assert run["failures"] == {}
    assert row_of(text, "python -m ccd_warp.benchmarks.fuzz") == run["queries"]
    assert f"of which {run['collisions']:,} touch; {run['in_meshes']:,} of them in meshes as well" in text


def test_sets_of_the_benchmark(text):
    sets = json.loads((ROOT / "benchmarks" / "results" / "bench.json").read_text(encoding="utf-8"))["sets"]
    published = sum(row["queries"] for row in sets if row["truth_disagreements"] is not None)
    assert all(row["queries"] == row["of"] and not row["truth_disagreements"] for row in sets)
    command = "pytest tests/kernels/narrow_phase/test_narrow_phase.py -k published"
    assert row_of(text, command) == published
    assert row_of(text, "ccd-warp bench") == sum(row["queries"] for row in sets)


def test_families(text):
    numbers = {int(number) for number in re.findall(r"(\d+) families", text)}
    assert numbers == {len(FAMILIES), len(arc_hostile.FAMILIES)}


def test_pairs_that_turn(text):
    source = (TESTS / "kernels" / "pair" / "test_arcs.py").read_text(encoding="utf-8")
    long = source.partition("@pytest.mark.long")[2].partition("\n\n\n")[0]
    assert "random_sets(130)" in long and "hostile_pairs(family, kind, 50)" in long
    assert row_of(text, "pytest -m long tests/kernels/pair/test_arcs.py") == sum(
        map(len, arc_pairs.random_sets(130).values())
    )
    assert f"| {len(arc_hostile.FAMILIES) * len(arc_pairs.KINDS) * 50:,} | the same |" in text


def test_distances(text):
    source = (TESTS / "kernels" / "pair" / "test_minimum_distance.py").read_text(encoding="utf-8")
    assert "pytest.param(6, marks=pytest.mark.long)" in source
    (random, hostile) = re.findall(r"num_random=(\d+) \* num_parts, num_hostile=(\d+) \* num_parts", source)[0]
    command = "pytest -m long tests/kernels/pair/test_minimum_distance.py"
    assert row_of(text, command) == 6 * (int(random) + int(hostile))


def test_gradients(text):
    module = loaded("calls/test_toi_gradient.py")
    many = inspect.getsource(module.test_many_random_pairs_agree_with_differences_of_the_exact_toi)
    assert "is_euclidean, 3000, move)" in many
    assert f"{len(module.CASES)} kinds and norms, two sizes of the move" in text
    assert row_of(text, "pytest -m long tests/calls/test_toi_gradient.py") == 2 * 3000 * len(module.CASES)


def test_links_of_an_arm(text):
    source = (TESTS / "input" / "test_joint_slices.py").read_text(encoding="utf-8")
    long = source.partition("@pytest.mark.long")[2].partition("\n\n\n")[0]
    assert "for k in range(500):" in long and "for row in range(1, 8):" in long
    assert row_of(text, "pytest -m long tests/input/test_joint_slices.py") == 500 * 7


def test_damaged_files(text):
    source = (ROOT / "benchmarks" / "fuzz_files.py").read_text(encoding="utf-8")
    (default,) = re.findall(r'"--cases", type=int, default=([\d_]+)', source)
    assert row_of(text, "python -m ccd_warp.benchmarks.fuzz_files") == int(default)


def test_scenarios_of_calls_that_fail(text):
    assert f"{len(loaded('calls/test_faults.py').SCENARIOS)} scenarios" in text


def test_calls_on_the_emulated_device(text):
    assert f"{len(PLAN)} calls on steps and {len(PAIRS)} on pairs have to return the bits of the CPU" in text


def test_files_that_the_page_names(text):
    for name in re.findall(r"`((?:tests|benchmarks)/[\w/.]+)`", text):
        assert (ROOT / name).exists(), name
    for file in re.findall(r"`pytest [^`]*?(tests/[\w/.]+)", text):
        assert (ROOT / file).exists(), file
