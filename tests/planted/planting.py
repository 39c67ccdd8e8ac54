"""Plant faults in a copy of the project, and say which tests find them."""

import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]
# Signals by which a process ends of itself; one that another process has ended says nothing of a fault.
_CRASHES = {signal.SIGSEGV, signal.SIGABRT, signal.SIGBUS, signal.SIGFPE, signal.SIGILL}


class Fault(NamedTuple):
    """A text of a file, once in it, and what stands in its place.

    `finders` are keys of `FINDERS`, or files or single tests in the folder of the tests.
    """

    name: str
    file: str
    text: str
    planted: str
    finders: tuple[str, ...]


def fault_in(fault: Fault, source: str) -> str:
    """The source with a fault in it.

    Raises:
        LookupError: If the text of the fault is not in the source, once.
    """
    if (count := source.count(fault.text)) != 1:
        raise LookupError(f"fault {fault.name!r}: its text is {count} times in {fault.file}; expected once")
    return source.replace(fault.text, fault.planted)


class Copy:
    """A copy of the project, installed in a folder of its own."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.is_planted = folder, False
        (folder / "answers").mkdir()
        unneeded = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / "ccd_warp", folder / "package" / "ccd_warp", ignore=unneeded)
        shutil.copytree(ROOT / "kernels", folder / "package" / "ccd_warp" / "kernels", ignore=unneeded)
        shutil.copytree(ROOT / "tests", folder / "tests", ignore=unneeded)
        figures = shutil.ignore_patterns("figures")
        shutil.copytree(ROOT / "docs", folder / "docs", ignore=figures)  # tests run the programs of pages

    def path_of(self, file: str) -> Path:
        """Where a file of the project lies in the copy."""
        return self.folder / "package" / (file if file.startswith("ccd_warp/") else f"ccd_warp/{file}")

    def failing_test(self, tests: list[str], marks: str = "not long", most_seconds: float | None = None) -> str | None:
        """The first of the tests that fails, or how the process ended; None if they pass.

        Raises:
            subprocess.TimeoutExpired: If they are not done in time; what they have started is ended, too.
            RuntimeError: If they could not be run.
        """
        environment = {**os.environ, "PYTHONPATH": str(self.folder / "package")}
        # with the seed Warp writes the functions of a module in one order, and few modules are compiled again
        environment |= {"CCD_WARP_KEPT_ANSWERS": str(self.folder / "answers"), "PYTHONHASHSEED": "0"}
        if self.is_planted:  # no later process may find what it has compiled
            environment["PYTHONDONTWRITEBYTECODE"] = "1"
        command = [sys.executable, "-P", "-m", "pytest", "-x", "-q", "-rfE", "--tb=line", "-p", "no:cacheprovider"]
        command += ["-m", marks]  # the tests of every run have to find it
        command += [str(self.folder / "tests" / test) for test in tests]
        streams = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True, "errors": "replace"}
        with subprocess.Popen(command, cwd=self.folder, env=environment, start_new_session=True, **streams) as process:
            try:
                output, _ = process.communicate(timeout=most_seconds)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                raise
        if process.returncode == 0:
            return None
        if process.returncode == 1 and (found := re.search(r"^(?:FAILED|ERROR) \S*?(test_\w+\.py\b.*)$", output, re.M)):
            return found[1]
        if -process.returncode in _CRASHES:
            return f"signal {-process.returncode}"
        raise RuntimeError(f"pytest ended with {process.returncode}:\n{output[-5000:]}")
