"""What the set-up of the tests promises of a run: what hangs or dies is named, the others run, Ctrl-C is one."""

import signal

from programs import begun

TESTS = """
import os, signal, time
import warp as wp
from ccd_warp._runtime import launch
from ccd_warp._runtime.progress import Progress

def test_dies():
    os._exit(3)

def test_hangs():
    time.sleep(60)

def test_compiles_longer_than_a_test_may_take():
    launch.build_side_by_side([lambda: time.sleep(4.0)], Progress())

def test_runs_on_the_device():
    assert wp.get_device().is_cpu and signal.getsignal(signal.SIGINT) is signal.default_int_handler
"""


def _run(folder, *options, **environment):
    (folder / "test_it.py").write_text(TESTS)
    return begun(folder, *"-m pytest test_it.py -p conftest --device cpu".split(), *options, **environment)


def test_what_dies_or_hangs_is_named_and_the_others_run(tmp_path):
    """In the background of a script, where SIGINT is ignored."""
    options = ["-n", "1", "-o", "faulthandler_timeout=3", "-o", "faulthandler_exit_on_timeout=true"]
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        status, shown, error = _run(tmp_path, *options, "--junitxml=it.xml")
    finally:
        signal.signal(signal.SIGINT, before)
    assert status == 1 and "2 failed, 2 passed" in shown, shown + error
    for name in ("test_dies", "test_hangs"):
        assert f"crashed while running 'test_it.py::{name}'" in shown
        assert f'name="{name}"' in (tmp_path / "it.xml").read_text("utf-8")


def test_a_cache_that_cannot_be_written_is_a_sentence(tmp_path):
    """As where HOME cannot be written, and WARP_CACHE_PATH names no other place."""
    status, shown, error = _run(tmp_path, WARP_CACHE_PATH=str(tmp_path / "test_it.py" / "cache"))
    assert status == 4 and "INTERNALERROR" not in shown + error
    assert "ERROR: Warp's kernel cache cannot be written in" in error and "WARP_CACHE_PATH" in error
