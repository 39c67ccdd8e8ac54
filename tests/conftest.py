"""Set-up of the test suite: the installed package, a quiet Warp, its device, and the fixtures every module shares."""

import gc
import os
import signal
import sys
from pathlib import Path

sys.path += [str(Path(__file__).resolve().parent / folder) for folder in ("helpers", "")]

import pytest
import warp as wp
from _pytest.faulthandler import fault_handler_stderr_fd_key
from helpers import clock
from programs import programs
from uploads import upload_to_launches

from ccd_warp._engine.boxes import trees
from ccd_warp._runtime import kernel_cache, launch
from ccd_warp._runtime.quiet import start_warp

wp.config.log_level = wp.LOG_WARNING
kernel_cache._is_said = True  # what a test captures does not depend on what has been compiled
# calls make many objects, few of them in circles: at the default the collector takes a sixth of the time
gc.set_threshold(20_000, 10, 10)
if folder := os.environ.get("CCD_WARP_CUBINS"):  # of benchmarks/gpu_pack.py
    wp.config.kernel_cache_dir, wp.config.cuda_output = folder, "cubin"
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:  # as of a command in the background of a script
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_addoption(parser):
    parser.addoption("--device", default="cpu", help="Warp's device in all tests: cpu, emulated or cuda:0")


@pytest.hookimpl(tryfirst=True)
def pytest_cmdline_main(config):
    """`pytest -n` gives each process a stretch of the tests, as a file's fixtures are made once, and lets it steal."""
    if getattr(config.option, "numprocesses", None) and config.option.dist == "no":
        config.option.dist = "worksteal"


def pytest_sessionstart(session):
    """Let Warp take the device of the option where a test names none."""
    config = session.config
    seconds, is_end = (config.getini(f"faulthandler_{name}") for name in ("timeout", "exit_on_timeout"))
    clock.set_limit(float(seconds or 0), exit=is_end, file=config.stash[fault_handler_stderr_fd_key])
    launch.run_aside = clock.stands_still(launch.run_aside)
    name = config.getoption("device")
    if name == "emulated":
        from emulated.build import compiler
        from emulated.device import begin_run

        if compiler() is None:
            raise pytest.UsageError("--device emulated: no C++ compiler found: apt-get install g++, or set CXX")
        begin_run()
        name = "cpu"
    try:
        start_warp()
    except OSError as error:
        raise pytest.UsageError(str(error)) from error
    if name not in (names := [device.alias for device in wp.get_devices()]):
        raise pytest.UsageError(f"--device is {name!r}; expected emulated or one of {', '.join(names)}")
    wp.set_device(name)
    trees._BUSY_WARPS = 8  # so that the small scenes of the tests are searched as large ones are, by warps of 1 to 16
    if wp.get_device().is_cuda:
        upload_to_launches()


def pytest_sessionfinish():
    if "emulated.device" in sys.modules:
        from emulated.device import end_run

        end_run()


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config, items):
    """Tests that compare with another device have the emulated one where they run on the CPU."""
    if config.getoption("device") == "cpu":
        for item in items:
            if "other_device" in item.fixturenames:
                item.add_marker("emulated")


def pytest_collection_finish():
    """What was imported stays to the end: the collector need not go through it at each of its full passes."""
    gc.collect()
    gc.freeze()


def pytest_runtest_logfinish(nodeid):
    """An error of CUDA stays with a process to its end: another one of `pytest -n` goes on with the tests."""
    device = wp.get_device()
    try:
        if device.ordinal >= 0:
            wp.zeros(1, dtype=int, device=device).numpy()
    except Exception as error:
        print(f"{nodeid}: {device} answers nothing more: {error}", file=sys.__stderr__, flush=True)
        os._exit(1)


@pytest.fixture(scope="session")
def device() -> str:
    """The name of the device that Warp takes: that of the option."""
    return str(wp.get_device())


@pytest.fixture
def other_device():
    """A context in which the run has another device: the CPU, or where it is on the CPU the emulated one."""
    from emulated.build import compiler
    from emulated.device import on_the_other_device

    if compiler() is None and wp.get_device().ordinal < 0:
        pytest.skip("no C++ compiler found: apt-get install g++, or set CXX")
    return on_the_other_device


@pytest.fixture(scope="session", params=["float64", "float32"])
def precision(request) -> str:
    """Both precisions of the kernels."""
    return request.param


# Runs `python ARGUMENTS` in a folder, in a process of its own: its status and output.
python = pytest.fixture(scope="session", name="python")(programs)
