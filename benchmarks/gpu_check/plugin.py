"""The plugin with which pytest runs the cases of a stage within its time, and keeps a line for each in the journal."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import pytest
from ccd_warp.benchmarks.gpu_check import pytest_cubins, stages
from ccd_warp.benchmarks.gpu_check.journal import BEGUN, FAILED, NO_TIME, PASSED, SKIPPED, Journal
from ccd_warp.benchmarks.gpu_check.record import Record
from ccd_warp.benchmarks.gpu_check.stages import Stage
from ccd_warp.benchmarks.gpu_check.target import Target

# Nothing of the checkout or of the user changes what is run, and all that is said is what the cases say.
_ALONE = (
    "-c",
    os.devnull,
    "--noconftest",
    "-p",
    "no:python",
    "-p",
    "no:xdist",
    "-p",
    "no:unraisableexception",
    "--capture=no",
)
_QUIET = ("-p", "no:cacheprovider", "-p", "no:terminal", "--continue-on-collection-errors")
_MOST_SAID = 2000  # characters of an error in the journal
_ENDED = (pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED, pytest.ExitCode.NO_TESTS_COLLECTED)


class _Case(pytest.Item):
    """A case of a stage."""

    call: Callable[[Record], None]
    plugin: Plugin

    def runtest(self) -> None:
        """Call it, on the device that is checked."""
        record = Record(self.plugin.left, self.plugin.say)
        self.user_properties.append(("rows", record.rows))
        stage, target = self.plugin.stage, self.plugin.target
        with nullcontext() if stage.has_reference else target.checked():
            self.call(record)

    def repr_failure(self, excinfo: Any, style: Any = None) -> str:
        """The error; of one that a case has found itself, the words alone."""
        if excinfo.errisinstance(pytest.fail.Exception):
            return str(excinfo.value)
        return str(excinfo.getrepr(style="short"))


class _Cases(pytest.File):
    """The cases of a stage."""

    plugin: Plugin

    def collect(self) -> Iterator[_Case]:
        """All of them."""
        plugin = self.plugin
        for name, call in plugin.stage.cases(plugin.target, **plugin.folders).items():
            case = _Case.from_parent(self, name=name)
            case.call, case.plugin = call, plugin
            yield case


class Plugin:
    """What pytest is told of a stage.

    Attributes:
        stage: The stage.
        target: What is checked.
        folders: What the stage is told beside it.
        journal: Where the lines go.
        say: Called with each line for people.
    """

    def __init__(
        self,
        stage: Stage,
        target: Target,
        folders: dict[str, Path | None],
        journal: Journal,
        seconds: float,
        say: Callable[[str], None],
    ) -> None:
        self.stage, self.target, self.folders, self.journal, self.say = stage, target, folders, journal, say
        self.error = ""
        self._end = time.perf_counter() + seconds
        self._reasons: set[str] = set()  # that have been said of what is left out
        self._over = journal.stage(stage.name).over

    def run(self) -> str | None:
        """Run the cases that are not over; None where pytest came to its end, else what it says."""
        if self.stage.arguments is None:
            # any file of this package: what is collected of it are the cases of the stage
            chosen = [stages.__file__, f"--rootdir={Path(stages.__file__).parent}", *_ALONE]
        else:
            chosen = [*self.stage.arguments(**self.folders), "-p", pytest_cubins.__name__]
        status = pytest.main([*chosen, *_QUIET], plugins=[self])
        if status == pytest.ExitCode.INTERRUPTED:
            raise KeyboardInterrupt
        return None if status in _ENDED else self.error or f"pytest ended with status {int(status)}"

    def left(self) -> float:
        """Seconds that are left."""
        return self._end - time.perf_counter()

    # --- what pytest calls ---

    def pytest_collect_file(self, file_path: Path, parent: pytest.Collector) -> pytest.Collector | None:
        """The cases of a stage of this package; files of tests are pytest's own matter."""
        if self.stage.arguments is not None:
            return None
        cases = _Cases.from_parent(parent, path=file_path)
        cases.plugin = self
        return cases

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Leave out what is over."""
        items[:] = [item for item in items if self._name(item.nodeid) not in self._over]

    def pytest_runtest_setup(self) -> None:
        """Begin nothing for which there is no time."""
        if self.left() <= self.stage.least * (0.2 if self.target.is_short else 1.0):
            pytest.skip(NO_TIME)

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        """A case begins."""
        self._add(nodeid, BEGUN)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """A case, or what precedes or follows it, is over; nothing more runs in this process if the device is lost."""
        if report.failed or report.skipped or report.when == "call":
            self._keep(report, dict(report.user_properties).get("rows", []))
        if report.failed and self.target.is_lost():
            sys.stdout.flush()
            os._exit(1)

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        """A file cannot be imported, or a stage does not know its cases."""
        if report.failed:
            self._keep(report, [])

    def pytest_internalerror(self, excrepr: Any) -> None:
        """Keep what pytest would print."""
        self.error = str(excrepr)

    def _keep(self, report: pytest.TestReport | pytest.CollectReport, rows: list[dict]) -> None:
        name = self._name(report.nodeid)
        if report.failed:
            why = report.longreprtext
            self.say(f"FAILED {name}: {why.strip().splitlines()[-1] if why.strip() else ''}"[:600])
            self._add(report.nodeid, FAILED, rows=rows, why=why[-_MOST_SAID:])
        elif report.skipped:
            why = str(report.longrepr[2] if isinstance(report.longrepr, tuple) else report.longrepr)
            self._add(report.nodeid, SKIPPED, why=why.removeprefix("Skipped: "))
            if self.stage.arguments is None and why not in self._reasons:
                self.say(f"left out: {name}: {why.removeprefix('Skipped: ')}")
                self._reasons.add(why)
        else:
            self._add(report.nodeid, PASSED, rows=rows)

    def _add(self, nodeid: str, outcome: str, **more: Any) -> None:
        self.journal.add(stage=self.stage.name, case=self._name(nodeid), outcome=outcome, **more)

    def _name(self, nodeid: str) -> str:
        """The name of a case; that of a test has its file."""
        return nodeid if self.stage.arguments is not None else nodeid.partition("::")[2] or self.stage.name
