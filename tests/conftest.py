"""Set-up of the test suite: the installed package, a quiet Warp, and the fixtures every module shares."""

import gc
import importlib.util
import sys
from contextlib import contextmanager
from pathlib import Path

sys.path += [str(Path(__file__).resolve().parent / folder) for folder in ("helpers", "")]

import pytest
import warp as wp
from browser import find_browser, opened_browser

from ccd_warp._cli.explore import write_page

wp.config.log_level = wp.LOG_WARNING
# Files with seconds to minutes of work in few tests.
_LONGEST = [
    "test_emulated",
    "test_distributed",
    "test_cuda",
    "test_faults",
    "test_invariance",
    "test_gpu_check",
    "test_docs",
    "test_hold",
    "test_cli_progress",
    "test_sequence",
    "test_package",
    "test_typing",
    "test_queued_pairs",
    "test_step",
    "test_rounding",
    "test_closest_point",
    "test_line_search",
    "test_broad_phase",
    "test_narrow_phase",
    "test_minimum_distance",
    "test_damaged_files",
    "test_interrupts",
    "test_distance_oracle",
    "test_bench",
]
# What processes of `pytest -n` ran on the emulated device.
_TOLD: list[str | None] = []


@contextmanager
def loaded_example(name: str):
    """An example as a module; Warp looks up the source of its kernels among the modules."""
    spec = importlib.util.spec_from_file_location(name, Path(__file__).resolve().parents[1] / "examples" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    yield module
    del sys.modules[name]


@pytest.hookimpl(tryfirst=True)
def pytest_cmdline_main(config):
    """Files are what `pytest -n` shares among processes, as the fixtures and kernels of a file are made once."""
    if getattr(config.option, "numprocesses", None) and config.option.dist == "no":
        config.option.dist, config.option.loadscopereorder = "loadfile", False


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items):
    """What takes longest comes first, so that at the end no process waits for another."""
    items.sort(key=lambda item: _LONGEST.index(item.path.stem) if item.path.stem in _LONGEST else len(_LONGEST))


def pytest_collection_finish():
    """What was imported stays to the end: the collector need not go through it at each of its full passes."""
    gc.collect()
    gc.freeze()


def _emulated() -> str | None:
    """What this process ran on the emulated device."""
    if "emulated.comparison" in sys.modules:
        from emulated.comparison import shared, summary

        if shared().num_kernels:
            return summary(shared())
    return None


def pytest_sessionfinish(session):
    """A process of `pytest -n` tells the one that writes the summary."""
    if hasattr(session.config, "workeroutput"):
        session.config.workeroutput["emulated"] = _emulated()


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node):
    """Take what a process of `pytest -n` tells."""
    _TOLD.append(getattr(node, "workeroutput", {}).get("emulated"))


def pytest_terminal_summary(terminalreporter):
    """Say what ran on the emulated device."""
    for line in filter(None, [*_TOLD, _emulated()]):
        terminalreporter.write_line(line)


def _devices() -> list[str]:
    return ["cpu", *(["cuda:0"] if wp.is_cuda_available() else [])]


@pytest.fixture(scope="session", params=_devices())
def device(request) -> str:
    """Each kind of device of this machine: the CPU, and the first CUDA device where there is one."""
    return request.param


@pytest.fixture(scope="session", params=["float64", "float32"])
def precision(request) -> str:
    """Both precisions of the kernels."""
    return request.param


@pytest.fixture(scope="session")
def browser():
    """A page of a headless Chromium; what needs it is skipped where there is none."""
    path = find_browser()
    if path is None:
        pytest.skip("no Chromium found: apt-get install chromium, or set CCD_WARP_BROWSER to its path")
    with opened_browser(path) as page:
        yield page


@pytest.fixture(scope="session")
def explore_file(tmp_path_factory) -> Path:
    """The page of `ccd-warp explore`."""
    return write_page(tmp_path_factory.mktemp("page") / "explore.html")


@pytest.fixture
def explore_page(browser, explore_file):
    """That page, newly opened; in the end it must have asked for nothing else and complained of nothing."""
    browser.messages.clear()
    browser.requests.clear()
    browser.resize(1280)
    browser.set_theme("light")
    browser.open(explore_file)
    yield browser
    assert browser.messages == []
    assert browser.requests == [explore_file.as_uri()]
