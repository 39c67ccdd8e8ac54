"""The check for a first GPU: rehearsed from beginning to end, and when a stage fails, hangs or is resumed."""

import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp
from ccd_warp.benchmarks.gpu_check import __main__ as command
from ccd_warp.benchmarks.gpu_check import (
    bits,
    cases,
    fingerprint,
    pack,
    precompile,
    runner,
    sanitizer,
    small_scene,
    stages,
    summary,
    unpack,
    variants,
)
from ccd_warp.benchmarks.gpu_check.emulation import emulated_device, require_emulation
from ccd_warp.benchmarks.gpu_check.journal import (
    DONE,
    FAILED,
    LEFT_OUT,
    NO_TIME,
    STOPPED,
    Journal,
    StageRecord,
)
from ccd_warp.benchmarks.gpu_check.plugin import Plugin
from ccd_warp.benchmarks.gpu_check.runner import run_all
from ccd_warp.benchmarks.gpu_check.target import CPU, CUDA, Target, launched_with
from laws.outputs import different
from warp._src import context

TESTS = Path(__file__).resolve().parents[1]
NEEDS_GPU = {"tests", "sanitizer"}


def records(folder):
    """The stages of the only run that the file of a folder has."""
    first = json.loads((folder / "gpu_check.jsonl").read_text().splitlines()[0])
    return Journal(folder, first["settings"]).stages()


def rehearse(folder, *more):
    """Run the command as a user does, in this process, and return its status."""
    return command.main(["--output", str(folder), *more])


def require_emulation_here():
    """Skip where the tests have no emulation, or there is no compiler for it."""
    try:
        require_emulation(TESTS)
    except ValueError as error:
        pytest.skip(str(error))


# --- from beginning to end ---


def check_whole(folder, kind):
    """Every stage has said something, nothing has failed, and no bit is different."""
    found = records(folder)
    assert list(found) == list(stages.NAMES)
    assert {name for name, stage in found.items() if stage.status == LEFT_OUT} == NEEDS_GPU
    assert {stage.status for stage in found.values()} == {DONE, LEFT_OUT}
    assert not any(stage.failed for stage in found.values())
    for name in NEEDS_GPU:
        assert found[name].left_out == [f"not on the {kind}"]
    assert len(found["bits"].rows) >= 8
    assert {row["kind"] for row in found["graphs"].rows} >= {"launch"}
    for name in ("kernels", "queries", "against", "broad phases", "reserve", "static body"):
        assert found[name].rows, name
    touching = {row["what"]: row["share_touching"] for row in found["queries"].rows}
    assert touching == {"colliding": 1.0, "culled": 0.0}
    text = (folder / "gpu_check.md").read_text()
    assert "This is a rehearsal" in text and "0 calls differ" in text
    # no goal is judged by times of a CPU, or by some of the cases
    assert text.count("| not known |") == 4 and "| missed |" not in text


@pytest.mark.filterwarnings("ignore")
def test_rehearsal_on_the_cpu(tmp_path, capsys):
    assert rehearse(tmp_path, "--device", "cpu") == 0
    check_whole(tmp_path, "CPU")
    said = capsys.readouterr().out
    assert "== bits: done in" in said and "## Goals" in said


@pytest.mark.long  # the rehearsal on the CPU is in each run
def test_emulated_from_beginning_to_end(tmp_path, capsys, monkeypatch):
    require_emulation_here()
    entered, checked = [], Target.checked
    monkeypatch.setattr(Target, "checked", lambda target: entered.append(target.kind) or checked(target))
    assert rehearse(tmp_path, "--emulated", "--tests", str(TESTS)) == 0, capsys.readouterr().out[-3000:]
    check_whole(tmp_path, "emulation")
    found = records(tmp_path)
    of_reference = [each.name for each in stages.STAGES if each.has_reference]
    assert len(entered) >= sum(len(found[name].cases) for name in stages.NAMES if name not in of_reference) > 80


# --- what goes wrong ---


def stage(chosen, name="newton", **options):
    return stages.Stage(name, "what it does", lambda target, **_: chosen, 1.0, **options)


def run_in(folder, chosen, monkeypatch, *, anew=(), settings=None, kind=CPU, seconds=20.0, is_apart=False):
    """Run stages, of which none is known by name elsewhere; what was said, what was known before, and the journal."""
    monkeypatch.setattr(runner, "STAGES", tuple(chosen))
    said = []
    journal = Journal(folder, {"kind": kind, **(settings or {"code": "1"})})
    note = journal.begin(list(anew))
    target = Target("cpu", kind, is_short=True)
    run_all(target, {}, journal, [each.name for each in chosen], seconds, said.append, is_apart)
    return said, note, journal


def add_one(record):
    record.add("one", number=1)


def raise_error(record):
    record.add("before", number=1)
    raise RuntimeError("illegal address")


def test_case_that_raises_keeps_its_rows_and_the_next_ones_run(tmp_path, monkeypatch):
    chosen = [stage({"a": raise_error, "b": add_one}, "bits"), stage({"c": add_one}, "queries")]
    said, _, journal = run_in(tmp_path, chosen, monkeypatch)
    found = records(tmp_path)
    assert found["bits"].status == found["queries"].status == DONE
    assert found["bits"].rows == [{"number": 1}] * 2 and found["bits"].over == {"a", "b"}
    assert "RuntimeError: illegal address" in found["bits"].failed["a"] and found["queries"].rows == [{"number": 1}]
    assert "FAILED a: E   RuntimeError: illegal address" in said
    assert summary.complaints(journal.stages()) == ["bits: a: E   RuntimeError: illegal address"]


def test_stage_that_does_not_know_its_cases_is_told_and_repeated(tmp_path, monkeypatch):
    def cases_of(target, **_):
        raise ValueError("answers is none")

    run_in(tmp_path, [stages.Stage("bits", "what it does", cases_of, 1.0)], monkeypatch)
    assert "ValueError: answers is none" in records(tmp_path)["bits"].failed["bits"]


def test_second_run_keeps_what_is_over_and_goes_on_with_what_there_was_no_time_for(tmp_path, monkeypatch):
    calls = []
    two = {"a": lambda record: calls.append("a"), "b": lambda record: calls.append("b")}
    said, _, _ = run_in(tmp_path, [stage(two, "queries", least=1e3)], monkeypatch)
    assert calls == [] and records(tmp_path)["queries"].left_out == [f"a and 1 more: {NO_TIME}"]
    assert said.count(f"left out: a: {NO_TIME}") == 1
    run_in(tmp_path, [stage({"a": two["a"]}, "queries")], monkeypatch)
    assert calls == ["a"] and not records(tmp_path)["queries"].is_whole
    _, note, _ = run_in(tmp_path, [stage(two, "queries")], monkeypatch)
    assert calls == ["a", "b"] and records(tmp_path)["queries"].is_whole
    _, note, _ = run_in(tmp_path, [stage(two, "queries")], monkeypatch)
    assert calls == ["a", "b"] and "1 stages are kept" in note
    run_in(tmp_path, [stage(two, "queries")], monkeypatch, anew=["queries"])
    assert calls == ["a", "b", "a", "b"]


def test_two_gpus_and_two_versions_of_the_code_are_kept_apart_and_each_goes_on_with_its_own(tmp_path, monkeypatch):
    """The first of two GPUs of one name is checked, then the second, then the first again."""
    calls = []
    for gpu, code, names in (("a", "1", ["bits"]), ("b", "1", ["queries"]), ("a", "2", ["bits"]), ("a", "1", ["bits"])):
        case = {"one": lambda record, gpu=gpu: calls.append(gpu)}
        settings = {"device": "cuda:0", "code": code, "gpu": {"name": "NVIDIA H200", "uuid": gpu}}
        _, note, journal = run_in(tmp_path, [stage(case, name) for name in names], monkeypatch, settings=settings)
        assert list(journal.stages()) == names
    assert calls == ["a", "b", "a"] and "1 stages are kept" in note


# A program in the place of that of a stage: it begins a case, starts a process, and never ends.
_HANGS = """
import json, subprocess, sys, time
from pathlib import Path
stage, folder = json.loads(sys.argv[1])["stage"], Path(sys.argv[2])
run = json.loads((folder / "gpu_check.jsonl").read_text().splitlines()[0])["run"]
def add(**line):
    with (folder / "gpu_check.jsonl").open("a") as file:
        print(json.dumps({"run": run, "stage": stage, **line}), file=file)
add(case="first", outcome="passed", rows=[{"n": 1}])
child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
(folder / "child").write_text(str(child.pid))
add(case="second", outcome="begun")
time.sleep(600)
"""
# The check, in which this is the program of every stage.
_CHECK = """
import subprocess, sys
from ccd_warp.benchmarks.gpu_check import __main__ as command, runner
popen = subprocess.Popen
def start(given, **options):
    if "--stage" in given:
        given = [sys.executable, "-P", "-c", {program!r}, given[-3], given[-1]]
    return popen(given, **options)
runner.subprocess.Popen = start
command.main(sys.argv[1:])
"""


def is_running(pid):
    """Whether there is such a process that has not ended."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False


def wait_until(condition, seconds=300.0):
    """Wait until something is so; whether it is."""
    end = time.perf_counter() + seconds
    while not condition() and time.perf_counter() < end:
        time.sleep(0.02)
    return condition()


def test_stage_whose_process_hangs_is_ended_with_its_children_and_keeps_its_rows(tmp_path, monkeypatch):
    file = tmp_path / "gpu_check.jsonl"

    class Started(subprocess.Popen):
        """A process; its time begins when it hangs, however long a busy machine takes to start it."""

        def __init__(self, command, **options):
            if "--stage" in command:
                self.begun = file.read_text().count('"begun"')
                command = [sys.executable, "-P", "-c", _HANGS, command[-3], command[-1]]
            super().__init__(command, **options)

        def wait(self, timeout=None):
            if timeout is not None:
                assert wait_until(lambda: file.read_text().count('"begun"') > self.begun)
            return super().wait(timeout)

    monkeypatch.setattr(runner.subprocess, "Popen", Started)
    monkeypatch.setattr(runner, "_GRACE", 0.1)
    chosen = [stage({}, "queries")]
    run_in(tmp_path, chosen, monkeypatch, kind=CUDA, seconds=1.0, is_apart=True)
    found = records(tmp_path)["queries"]
    assert found.status == STOPPED and found.rows == [{"n": 1}] and found.over == {"first"}
    assert found.why == "it took more than 1 s, and was ended in second" and found.late == {"second"}
    assert wait_until(lambda: not is_running((tmp_path / "child").read_text()))
    assert "was ended in second" in (tmp_path / "gpu_check.md").read_text()
    # the case has another try, and no third one
    run_in(tmp_path, chosen, monkeypatch, kind=CUDA, seconds=1.0, is_apart=True)
    found = records(tmp_path)["queries"]
    assert found.over == {"first", "second"} and list(found.failed) == ["second"]


def test_check_that_is_killed_takes_its_children_with_it_and_goes_on_in_the_case_it_was_in(tmp_path, monkeypatch):
    arguments = ["--output", str(tmp_path), "--device", "cpu", "--apart", "--only", "queries"]
    command = [sys.executable, "-P", "-c", _CHECK.format(program=_HANGS), *arguments]
    check = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    file = tmp_path / "gpu_check.jsonl"
    assert wait_until(lambda: file.exists() and '"second"' in file.read_text())
    child = (tmp_path / "child").read_text()
    check.kill()
    check.wait()
    assert wait_until(lambda: not is_running(child))

    begun = []
    case = {name: lambda record, name=name: begun.append(name) for name in ("first", "second", "third")}
    settings = json.loads(file.read_text().splitlines()[0])["settings"]
    _, note, _ = run_in(tmp_path, [stage(case, "queries")], monkeypatch, settings=settings)
    assert "queries: the check ended in second" in note
    assert begun == ["second", "third"] and records(tmp_path)["queries"].rows == [{"n": 1}]


# A program in which the second case of a stage ends its process, and after the third the device is lost.
_ENDS = """
import os, sys
from pathlib import Path
from ccd_warp.benchmarks.gpu_check import runner, stages
from ccd_warp.benchmarks.gpu_check.target import Target

def fail(record):
    Target.is_lost = lambda target: True
    cases["d"] = None
    raise RuntimeError("illegal address")

cases = {"a": lambda record: record.add(n=1), "b": lambda record: os._exit(9), "c": fail}
cases["d"] = lambda record: record.add(n=2 if cases["d"] else 3)
runner.STAGES = (stages.Stage("queries", "what it does", lambda target, **_: cases, 1.0),)
sys.exit(runner.run_ordered(sys.argv[1], Path(sys.argv[2])))
"""


def test_stage_goes_on_after_a_case_that_ends_its_process_and_after_the_device_is_lost(tmp_path, monkeypatch):
    popen = subprocess.Popen

    def start(command, **options):
        if "--stage" in command:
            command = [sys.executable, "-P", "-c", _ENDS, command[-3], command[-1]]
        return popen(command, **options)

    monkeypatch.setattr(runner.subprocess, "Popen", start)
    run_in(tmp_path, [stage({}, "queries")], monkeypatch, seconds=300.0, is_apart=True)
    found = records(tmp_path)["queries"]
    assert found.status == DONE and found.rows == [{"n": 1}, {"n": 2}]
    assert list(found.failed) == ["b", "c"] and "illegal address" in found.failed["c"]
    assert found.failed["b"] == "its process ended with status 9 in b"


def test_tests_of_a_folder_are_cases_and_those_for_other_devices_are_left_out(tmp_path, monkeypatch):
    monkeypatch.setattr(stages, "_PROCESSES", 1)
    (tmp_path / "tests").mkdir()
    (tmp_path / "tests" / "test_some.py").write_text(
        "import pytest\n"
        "@pytest.mark.parametrize('device', ['cpu', 'cuda:0'])\n"
        "@pytest.mark.parametrize('k', range(3))\n"
        "def test_one(device, k):\n"
        "    assert k != 1\n"
        "    if k == 2:\n"
        "        pytest.skip('not here')\n"
        "def test_emulated_cuda():\n"
        "    raise ValueError\n"
    )
    (tmp_path / "tests" / "test_broken.py").write_text("import no_such_module\n")
    suite = next(each for each in stages.STAGES if each.name == "tests")
    journal = Journal(tmp_path, {"kind": CUDA})
    plugin = Plugin(suite, Target("cpu", CPU), {"tests": tmp_path / "tests"}, journal, 60.0, print)
    assert plugin.run() is None
    found = journal.stage("tests")
    outcomes = {name.rpartition("::")[2] or name: line["outcome"] for name, line in found.cases.items()}
    one = {"test_one[0-cuda:0]": "passed", "test_one[1-cuda:0]": "failed", "test_one[2-cuda:0]": "skipped"}
    assert {name: outcome for name, outcome in outcomes.items() if "broken" not in name} == one
    broken = next(why for name, why in found.failed.items() if "test_broken.py" in name)
    assert "No module named 'no_such_module'" in broken


def test_line_that_was_cut_off_costs_no_other(tmp_path):
    journal = Journal(tmp_path, {"kind": CPU})
    for name in ("a", "b"):
        journal.add(stage="bits", case=name, outcome="passed", rows=[{"n": 1}])
        with journal.path.open("a") as cut:
            cut.write('{"run": "')
    assert journal.stage("bits").over == {"a", "b"}


def test_goal_is_not_judged_where_nothing_was_compared():
    found = {"bits": StageRecord(cases={"a": {"outcome": "skipped", "why": NO_TIME}}, status=DONE)}
    line = "| bits as on the CPU | all | 0 arrays of 0 calls, 0 calls differ or fail | not known |"
    assert line in summary.goal_table(found, True)


def some_cases(is_short):
    """Two calls of each of three kinds."""
    wanted = ("point_point in 2D, defaults", "edge_edge in 3D, few", "searches, polygons")
    return [case for case in cases.all_cases(True) if case.name.startswith(wanted)]


@pytest.fixture
def answers(tmp_path, monkeypatch):
    """The file of the CPU's answers to a few cases, which are now all cases."""
    chosen = some_cases(True)
    monkeypatch.setattr(bits, "all_cases", lambda is_short: list(chosen))
    bits.write_answers(tmp_path / "answers.json")
    monkeypatch.setattr(Target, "stride", 1)
    return tmp_path / "answers.json"


def compared(answers, folder, monkeypatch):
    """Compare with answers; the record of the stage, and on which devices which case was asked for."""
    asked = []

    class Asked(cases.Case):
        def __getattribute__(self, name):
            if name != "call":
                return super().__getattribute__(name)
            return lambda device: asked.append((self.name, device)) or self.answer(device)

        def answer(self, device):
            found = super().__getattribute__("call")("cpu")
            if device == "somewhere" and self.name.startswith("edge_edge in 3D, few iterations, float64"):
                found["many.toi"] = np.nextafter(found["many.toi"], 1)
            return found

    with monkeypatch.context() as patched:
        patched.setattr(bits, "all_cases", lambda _: [Asked(c.name, c.call, c.make_inputs) for c in some_cases(True)])
        journal = Journal(folder, {"kind": CPU})
        chosen = next(each for each in stages.STAGES if each.name == "bits")
        target = Target("somewhere", CPU, is_short=True)
        assert Plugin(chosen, target, {"answers": answers}, journal, 60.0, lambda line: None).run() is None
    return journal.stage("bits"), asked


def test_carried_answers_are_in_place_of_the_cpu_where_code_and_input_are_the_same(answers, tmp_path, monkeypatch):
    found, asked = compared(answers, tmp_path / "same", monkeypatch)
    assert len(found.cases) == len(some_cases(True)) == bits.totals(found.rows)["carried"]
    assert [name for name, device in asked if device == "cpu"] == ["edge_edge in 3D, few iterations, float64"]
    ((name, why),) = found.failed.items()
    assert name == "edge_edge in 3D, few iterations, float64" and why.startswith("many.toi: 120 of 120 rows: [0] ")

    # other input: what another version of NumPy may make of it; the CPU is asked here
    raw = json.loads(answers.read_text())
    raw["short"] = {name: ["0" * 16, answer] for name, (_, answer) in raw["short"].items()}
    other = answers.with_name("other.json")
    other.write_text(json.dumps(raw))
    found, asked = compared(other, tmp_path / "other", monkeypatch)
    assert len(asked) == 2 * len(found.rows) and bits.totals(found.rows)["carried"] == 0


def test_answers_of_other_code_are_refused(answers):
    raw = json.loads(answers.read_text())
    answers.with_name("old.json").write_text(json.dumps(raw | {"code": "0123"}))
    with pytest.raises(ValueError, match=r"made with code 0123; expected those of code [0-9a-f]{16}"):
        bits.read_answers(answers.with_name("old.json"))
    with pytest.raises(ValueError, match="expected a file that pack has written"):
        bits.read_answers(answers.with_name("none.json"))


def test_few_cases_are_of_all_kinds():
    """Names are unlike, and every kind is among the first ones, as is each scene among the first of a kind."""
    ordered = bits.in_turn(cases.all_cases(True))
    names = [case.name for case in ordered]
    assert len(set(names)) == len(names) == len(list(cases.all_cases(True)))
    kinds = [name.partition(", ")[0] for name in names]
    num_kinds = len(set(kinds))
    assert len(set(kinds[:num_kinds])) == num_kinds
    launches = [name.split(", ")[1] for name in names if name.startswith("launches, ")]
    num_scenes = len(set(launches))
    assert len(set(launches[:num_scenes])) == num_scenes


def test_difference_in_one_bit_is_found_and_described():
    expected = {"toi": np.array([0.5, np.inf, np.nan]), "status": np.arange(3), "only": np.zeros(1)}
    found = {"toi": np.array([np.nextafter(0.5, 1), np.inf, np.nan]), "status": np.arange(3)}
    only, toi = different(found, expected)
    assert only == "only: only one has it" and toi.startswith("toi: 1 of 3 rows: [0] 0.5")
    assert different({"a": np.zeros(1)}, {"a": np.zeros(2)}) == ["a: float64 (1,), expected float64 (2,)"]
    assert different({"a": np.array([0.0])}, {"a": np.array([-0.0])})  # equal numbers, other bits


def test_what_is_wrong_is_told_and_is_the_exit_status():
    good = StageRecord(cases={"a": {"outcome": "passed", "rows": [{"n": 1}]}}, status=DONE)
    assert summary.complaints({"graphs": good, "tests": StageRecord(status=LEFT_OUT, why="not on the CPU")}) == []
    bad = StageRecord(cases={"b": {"outcome": FAILED, "why": "here\n3 of 100 replays differ"}}, status=DONE)
    ended = StageRecord(status=STOPPED, why="Traceback\nRuntimeError: no memory\n")
    assert summary.complaints({"graphs": bad, "queries": ended}) == [
        "graphs: b: 3 of 100 replays differ",
        "queries: stopped, RuntimeError: no memory",
    ]


# --- times on a device, which is not there ---


@pytest.fixture
def fake_gpu(monkeypatch):
    """A device whose stream notes what is recorded, and whose events are 2 ms apart."""
    noted = []
    device = SimpleNamespace(stream=SimpleNamespace(record_event=lambda event: noted.append("event")))
    monkeypatch.setattr(wp, "get_device", lambda name: device)
    monkeypatch.setattr(wp, "Event", lambda device, enable_timing: SimpleNamespace(enable_timing=enable_timing))
    monkeypatch.setattr(wp, "synchronize_device", lambda name: noted.append("wait"))
    monkeypatch.setattr(wp, "get_event_elapsed_time", lambda begin, end: 2.0)
    return noted


def test_calls_on_a_device_are_timed_between_events_without_waiting(fake_gpu):
    seconds = Target("cuda:0", CUDA).seconds_on_device(lambda: fake_gpu.append("call"), 2)
    assert seconds == [0.002, 0.002]
    assert fake_gpu == ["call", "wait", *["event", "call", "event"] * 2, "wait"]


def test_times_of_a_kernel_are_added_up(monkeypatch):
    results = [("forward kernel solve", 1.0), ("memset", 0.25), ("forward kernel solve", 2.0)]
    monkeypatch.setattr(wp, "timing_begin", lambda cuda_filter: None)
    monkeypatch.setattr(wp, "timing_end", lambda: [SimpleNamespace(name=n, elapsed=t) for n, t in results])
    assert Target("cuda:0", CUDA).kernel_seconds(lambda: None) == {"solve": 0.003, "memset": 0.00025}
    assert Target("cpu", CPU).kernel_seconds(lambda: None) == {}


# --- what other programs say ---


def test_summary_of_the_sanitizer():
    assert sanitizer.summary_of("========= x\n========= ERROR SUMMARY: 0 errors\n") == "ERROR SUMMARY: 0 errors"
    assert "not come to an end" in sanitizer.summary_of("killed")


def test_threads_a_block_are_set_for_every_launch_within(monkeypatch):
    asked = []
    monkeypatch.setattr(wp, "launch", lambda *_, **options: asked.append(options.get("block_dim")))
    with launched_with(None):
        wp.launch("kernel", dim=1)
    with launched_with(64):
        wp.launch("kernel", dim=1)
        wp.launch("kernel", dim=1, block_dim=128)
    wp.launch("kernel", dim=1)
    assert asked == [None, 64, 64, None]


@pytest.mark.parametrize(
    "arguments, error",
    [
        ([], "output is not given"),
        (["--output", "x", "--minutes", "0"], "minutes is 0.0; expected a positive number"),
        (["--output", "x", "--only", "bit"], "only holds 'bit'; expected some of machine"),
        (["--output", "x", "--emulated", "--device", "cuda:0"], "emulated is given with device 'cuda:0'"),
        (["--output", "x", "--tests", "nowhere"], "tests is nowhere; expected a folder"),
        (["--output", "x", "--device", "cuda:9"], "device is 'cuda:9'; expected one of cpu"),
        (["--output", "x", "--precompiled", "nowhere"], "precompiled is nowhere; expected a folder that --precompile"),
    ],
)
def test_bad_arguments_are_named_in_a_line(arguments, error, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert command.main(arguments) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"error: {error}") and said.count("\n") == 1


# --- which modules are loaded ---


def modules_launched(monkeypatch, device):
    """Names of the modules that a small scene loads, but for those that Warp makes for itself."""
    loaded = set()
    load = context.Module.load

    def watched(module, *arguments, **options):
        loaded.add(module.name)
        return load(module, *arguments, **options)

    with monkeypatch.context() as patched:
        patched.setattr(context.Module, "load", watched)
        small_scene.run_small_scene(device)
    return {name for name in loaded if "ccd_warp" in name}


def test_every_module_of_the_cpu_is_loaded_before_it_is_needed(monkeypatch):
    assert modules_launched(monkeypatch, "cpu") <= {module.name for module in variants.cpu_modules()}


def test_every_module_of_cuda_is_loaded_before_it_is_needed(monkeypatch):
    require_emulation_here()
    with emulated_device():
        launched = modules_launched(monkeypatch, "cpu")
    assert len(launched) > 10
    assert launched <= {module.name for _, module, _ in variants.variants()}


# --- cubins made without a GPU ---

_LOAD = """
import sys
from pathlib import Path
from types import SimpleNamespace
from unittest import mock
import warp as wp
from warp._src import build, context
from ccd_warp.benchmarks.gpu_check import precompile, variants

folder, wanted = Path(sys.argv[1]), sys.argv[2]
wp.config.log_level = wp.LOG_ERROR
print(precompile.check_folder(folder))
precompile.use_in_all_processes(folder)
wp.init()


def refuse(*arguments, **options):
    raise AssertionError("something was compiled")


class Gpu(context.Device):
    '''A GPU of a compute capability as far as loading a module asks for one.'''

    def __init__(self, arch):
        self.ordinal, self.arch, self.runtime, self._context = 0, arch, context.runtime, arch
        self.is_cubin_supported, self.alias, self.name = True, "cuda:0", "none"

    is_cpu, is_cuda, context = False, True, property(lambda self: self.arch)


gpus = [Gpu(int(arch)) for arch in sys.argv[3:]]
context.runtime.driver_version = (99, 0)  # new enough that Warp would choose PTX
loaded = []
with (
    mock.patch.object(build, "build_cuda", refuse),
    mock.patch.object(build, "load_cuda", lambda path, device: loaded.append(Path(path).name) or 1),
    mock.patch.object(context.runtime, "get_device", lambda device=None: device if device in gpus else gpus[0]),
):
    ((module, block_dim),) = [found[1:] for found in variants.variants() if found[0] == wanted]
    for gpu in gpus:
        assert variants.is_compiled(Path(wp.config.kernel_cache_dir), module, gpu, block_dim)
        module.load(gpu, block_dim=block_dim)
print(*loaded)
"""


@pytest.mark.long  # processes that make every module of CUDA
def test_cubins_made_without_a_gpu_are_what_warp_loads_on_one(tmp_path):
    """Warp's own `Module.load` on a stand-in for a GPU finds the file, and compiles nothing."""
    name = "contact_points float32 2"
    folder = tmp_path / "cubins"
    make = ["--precompile", str(folder), "--arch", "80", "90", "120", "--modules", name]
    program = [sys.executable, "-P", "-m", "ccd_warp.benchmarks.gpu_check"]
    made = subprocess.run([*program, *make], capture_output=True, text=True)
    assert made.returncode == 0, made.stderr
    assert "3 cubins" in made.stdout
    files = json.loads((folder / precompile.MANIFEST).read_text())["files"]
    assert all((folder / file).stat().st_size > 1000 for file in files)
    done = subprocess.run(
        [sys.executable, "-P", "-c", _LOAD, str(folder), name, "80", "90", "120"], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    loaded = [Path(each).name for arch in (80, 90, 120) for each in files if f".sm{arch}." in each]
    assert done.stdout.splitlines() == [f"1 modules for sm_80, sm_90, sm_120 in {folder}", " ".join(loaded)]
    assert len(loaded) == 3


def test_cubins_of_another_version_of_warp_are_refused(tmp_path):
    (tmp_path / precompile.MANIFEST).write_text(json.dumps({"warp": "1.0", "archs": [90], "modules": 1}))
    with pytest.raises(ValueError, match=r"made with Warp 1.0; expected cubins of Warp 1\."):
        precompile.check_folder(tmp_path)


# --- what is carried to a machine without Warp and without a network ---


@pytest.fixture(scope="module")
def packed(tmp_path_factory):
    """A folder of parts, made as the command does, of small packages."""
    folder = tmp_path_factory.mktemp("packed")
    (folder / "cubins").mkdir()
    (folder / "cubins" / precompile.MANIFEST).write_text(
        json.dumps({"files": [], "warp": wp.config.version, "modules": 0, "archs": [90]})
    )
    answers = {"code": fingerprint.fingerprint(), "warp": wp.config.version, "cases": {}, "short": {}}
    (folder / "answers.json").write_text(json.dumps(answers))
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(pack, "_PRESET", 0)
        pack.pack(folder, 1 << 19, ["trimesh", *pack.PYTEST], TESTS, None)
    return folder / "parts"


def unpacked(arguments, capsys):
    """Run the program that lies beside the parts; its status, and what it says."""
    status = unpack.main(list(map(str, arguments)))
    said = capsys.readouterr()
    return status, said.out + said.err


@pytest.mark.long  # each run has parts that are missing or damaged, and a rehearsal
def test_parts_that_come_one_by_one_are_put_together_and_run(packed, tmp_path, capsys):
    parts = sorted(path for path in packed.iterdir() if path.suffix.removeprefix(".").isdigit())
    assert {path.stem for path in parts} == {"packages", "check"} and len(parts) > 3
    assert all(path.stat().st_size <= 1 << 19 for path in parts)
    into = tmp_path / "there"
    for path in parts:
        carried = tmp_path / path.name
        carried.mkdir()
        for each in (path, packed / "parts.json"):
            shutil.copy(each, carried)
        status, said = unpacked([carried, "--into", into, "--collect"], capsys)
        assert status == 0
    assert f"unpacked; sh {into / 'gpu_check.sh'}" in said
    for name in ("ccd_warp/__init__.py", "ccd_warp/kernels/step/minima.py", "ccd_warp/benchmarks/gpu_check/unpack.py"):
        assert (into / "site" / name).is_file()
    assert (into / "site" / "trimesh" / "__init__.py").is_file()
    assert (into / "tests" / Path(__file__).relative_to(TESTS)).read_bytes() == Path(__file__).read_bytes()
    assert not list((into / "parts").iterdir())  # they are not kept twice
    assert unpacked([packed, "--into", into], capsys)[0] == 0  # nothing is done again

    # a machine with Warp and NumPy alone, which are not of the parts here, and without a network, where that can be had
    site = tmp_path / "site"
    site.mkdir()
    for package in (wp, np):
        (site / package.__name__).symlink_to(Path(package.__file__).parent)
    libraries = Path(np.__file__).parents[1] / "numpy.libs"
    if libraries.exists():
        (site / libraries.name).symlink_to(libraries)
    (tmp_path / "python").write_text(f'#!/bin/sh\nexec "{sys.executable}" -S "$@"\n')
    (tmp_path / "python").chmod(0o755)
    alone = (
        ["unshare", "-rn"] if subprocess.run(["unshare", "-rn", "true"], capture_output=True).returncode == 0 else []
    )
    environment = os.environ | {"PYTHONPATH": str(site), "PYTHON": str(tmp_path / "python")}
    arguments = ["--output", str(tmp_path / "out"), "--device", "cpu", "--only", "machine"]
    run = [*alone, "sh", str(into / "gpu_check.sh"), *arguments]
    done = subprocess.run(run, capture_output=True, text=True, cwd=tmp_path, env=environment)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "0 answers of the CPU are carried along" in done.stdout  # the code is taken for the same
    assert "== machine: done" in done.stdout and "## Goals" in done.stdout


def test_parts_that_are_missing_or_damaged_are_named(packed, tmp_path, capsys):
    copies = tmp_path / "copies"
    shutil.copytree(packed, copies)
    first, second = copies / "packages.00", copies / "packages.01"
    data = bytearray(first.read_bytes())
    data[1000] ^= 1
    first.write_bytes(data)
    second.unlink()
    status, said = unpacked([copies, "--into", tmp_path / "there"], capsys)
    assert status == 2
    assert "error: part 1 of " in said and "packages.00, is damaged" in said
    assert "error: part 2 of " in said and f"packages.01, is missing; expected it in {copies}" in said
    assert not (tmp_path / "there" / "site" / "trimesh").exists()
    assert unpacked([tmp_path, "--into", tmp_path / "x"], capsys)[0] == 2
    manifest = json.loads((copies / "parts.json").read_text())
    for change, word in (
        ({"machine": "pdp11"}, "expected pdp11"),
        ({"needs": ["no_such"]}, "no_such is not installed"),
    ):
        (copies / "parts.json").write_text(json.dumps(manifest | change))
        shutil.copy(packed / "packages.00", copies)
        shutil.copy(packed / "packages.01", copies)
        status, said = unpacked([copies, "--into", tmp_path / "there"], capsys)
        assert status == 2 and word in said


@pytest.mark.parametrize(
    "arguments, error",
    [
        (["--limit", "12"], "limit is '12'; expected a number of bytes of at least 65536, as 56M"),
        (["--limit", "many"], "limit is 'many'; expected"),
        (["--packages", "no-such"], "packages holds 'no-such', which is not installed; expected a package that is"),
    ],
)
def test_bad_arguments_of_pack_are_named_in_a_line(arguments, error, tmp_path, capsys):
    assert command.main(["pack", "--out", str(tmp_path), *arguments]) == 2
    assert capsys.readouterr().err.startswith(f"error: {error}")
