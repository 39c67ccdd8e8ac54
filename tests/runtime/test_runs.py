"""What the set-up of the tests promises of a run: what hangs or dies is named, the others run, Ctrl-C is one."""

import os
import signal
import subprocess
import sys
from pathlib import Path

TESTS = """
import os, signal, time
import warp as wp

def test_dies():
    os._exit(3)

def test_hangs():
    time.sleep(60)

def test_runs_on_the_device():
    assert wp.get_device().is_cpu and signal.getsignal(signal.SIGINT) is signal.default_int_handler
"""


def test_what_dies_or_hangs_is_named_and_the_others_run(tmp_path):
    """In the background of a script, where SIGINT is ignored."""
    (tmp_path / "test_it.py").write_text(TESTS)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).parents[1]), *sys.path])}
    options = ["-p", "conftest", "--device", "cpu", "-n", "1", "-o", "faulthandler_timeout=3"]
    options += ["-o", "faulthandler_exit_on_timeout=true", "--junitxml=it.xml"]
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        command = [sys.executable, "-m", "pytest", "test_it.py", *options]
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=300)
    finally:
        signal.signal(signal.SIGINT, before)
    assert done.returncode == 1 and "2 failed, 1 passed" in done.stdout, done.stdout + done.stderr
    for name in ("test_dies", "test_hangs"):
        assert f"crashed while running 'test_it.py::{name}'" in done.stdout
        assert f'name="{name}"' in (tmp_path / "it.xml").read_text()
