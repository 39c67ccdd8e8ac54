"""Damaged files in Warp's kernel cache: the folder is named, and the module compiled again."""

import io
import os
import subprocess
import sys
import warnings

import pytest
import warp as wp

from ccd_warp._runtime import kernel_cache
from ccd_warp._runtime.kernel_cache import announced_compilation, load_or_repair
from ccd_warp._runtime.launch import start_warp


@wp.kernel(module="unique", enable_backward=False)
def fill(begin: int, values: wp.array[float]):
    values[begin + wp.tid()] = 1.0


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    """A cache that holds the kernel alone."""
    start_warp()
    before, wp.config.kernel_cache_dir = wp.config.kernel_cache_dir, str(tmp_path_factory.mktemp("cache"))
    try:
        _load_anew()
        yield tmp_path_factory.getbasetemp() / wp.config.kernel_cache_dir
    finally:
        wp.config.kernel_cache_dir = before


def _load_anew():
    """Load the kernel as a new process does, and launch it."""
    fill.module.unload()
    with wp.ScopedDevice("cpu"):
        load_or_repair(fill, wp.get_device("cpu"), None)
        values = wp.zeros(2, dtype=float)
        wp.launch(fill, dim=1, inputs=[1], outputs=[values])
        assert values.numpy().tolist() == [0.0, 1.0]


@pytest.mark.parametrize(
    "ending, damage",
    [
        pytest.param(".o", lambda content: content[: len(content) // 2], id="half_an_object_file"),
        pytest.param(".o", lambda content: bytes(len(content)), id="an_object_file_of_zeros"),
        pytest.param(".o", lambda content: b"\xff" + content[1:], id="an_object_file_of_another_format"),
        pytest.param(".meta", lambda content: b"", id="no_metadata"),
        pytest.param(".meta", lambda content: content[:-3], id="half_of_the_metadata"),
    ],
)
def test_a_damaged_file_is_named_and_compiled_again(cache, ending, damage):
    (path,) = cache.rglob(f"*{ending}")
    path.write_bytes(damage(path.read_bytes()))
    with pytest.warns(RuntimeWarning, match=f"Warp's kernel cache is damaged in {path.parent} "):
        _load_anew()


def test_a_cache_that_is_whole_is_not_touched(cache):
    files = [path for path in cache.rglob("*") if path.is_file()]
    before = [path.stat().st_mtime_ns for path in files]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        _load_anew()
    assert before == [path.stat().st_mtime_ns for path in files]


def test_a_cache_that_cannot_be_written_is_named(cache, tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path / "file"))
    with pytest.raises(OSError, match=rf"Warp's kernel cache cannot be written in {tmp_path}/file.*WARP_CACHE_PATH"):
        _load_anew()


@pytest.mark.parametrize(
    "is_terminal, log_level, num_lines",
    [(True, wp.LOG_INFO, 1), (True, wp.LOG_WARNING, 1), (True, wp.LOG_ERROR, 0), (False, wp.LOG_INFO, 0)],
)
def test_a_terminal_is_told_once_that_kernels_are_compiled(is_terminal, log_level, num_lines, tmp_path, monkeypatch):
    stderr = io.StringIO()
    stderr.isatty = lambda: is_terminal
    monkeypatch.setattr(sys, "stderr", stderr)
    monkeypatch.setattr(wp.config, "log_level", log_level)
    monkeypatch.setattr(kernel_cache, "_is_said", False)
    for name in ("one", "other"):
        monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path / name))
        _load_anew()
        _load_anew()
    assert stderr.getvalue().count("ccd_warp: compiling kernels") == num_lines


@pytest.mark.parametrize("is_terminal", [True, False])
def test_the_command_announces_them_although_it_keeps_warp_silent(is_terminal, tmp_path, monkeypatch):
    stderr = io.StringIO()
    stderr.isatty = lambda: is_terminal
    monkeypatch.setattr(sys, "stderr", stderr)
    monkeypatch.setattr(wp.config, "log_level", wp.LOG_ERROR)
    monkeypatch.setattr(kernel_cache, "_is_said", False)
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path))
    with announced_compilation():
        _load_anew()
        _load_anew()
    line = f"\rccd_warp: compiling kernels, about 10 s on two free cores; they are kept in {tmp_path}\n"
    assert stderr.getvalue() == (line if is_terminal else "")


def test_the_command_says_so_in_one_line(tmp_path):
    (tmp_path / "file").touch()
    command = [sys.executable, "-m", "ccd_warp", "demo", "--quiet"]
    environment = {**os.environ, "WARP_CACHE_PATH": str(tmp_path / "file" / "cache")}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 2 and done.stderr.count("\n") == 1
    assert done.stderr.startswith(f"ccd-warp: error: Warp's kernel cache cannot be written in {tmp_path}/file/cache (")
