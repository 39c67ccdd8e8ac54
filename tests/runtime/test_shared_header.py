"""Threads that compile take one precompiled header, and wait for the thread that makes it."""

import shutil
import threading
import types
from pathlib import Path

import pytest
from warp._src import context

from ccd_warp._runtime import shared_header
from ccd_warp._runtime.shared_header import one_header


@pytest.fixture
def runtime(tmp_path, monkeypatch):
    """A runtime of Warp that gives each thread a folder, in place of its own."""
    monkeypatch.setattr(shared_header, "_BEGINS_WITHIN", 0.0)

    def folder_of_thread():
        folder = tmp_path / str(threading.get_ident())
        folder.mkdir(exist_ok=True)
        return str(folder)

    fake = types.SimpleNamespace(get_clang_pch_dir=folder_of_thread)
    monkeypatch.setattr(context, "runtime", fake)
    return fake


def folder_here() -> str:
    with one_header():
        return context.runtime.get_clang_pch_dir()


def on_another_thread(call, timeout=None):
    """What a call gives on another thread, in a list that stays empty until it is given."""
    found = []
    thread = threading.Thread(target=lambda: found.append(call()), daemon=True)
    thread.start()
    thread.join(timeout)
    return thread, found


def test_threads_that_compile_share_a_folder_once_its_header_has_its_name_or_make_their_own(runtime, monkeypatch):
    folder = Path(folder_here())
    assert on_another_thread(folder_here)[1] == [str(folder)] != on_another_thread(runtime.get_clang_pch_dir)[1]
    begun = folder / "header.pch.tmp"
    begun.touch()
    thread, found = on_another_thread(folder_here, timeout=0.2)
    assert not found
    begun.rename(folder / "header.pch")
    thread.join()
    assert found == [str(folder)]
    begun.touch()
    monkeypatch.setattr(shared_header, "_LONGEST_WAIT", 0.0)
    assert on_another_thread(folder_here)[1] != [str(folder)]
    assert folder_here() == str(folder)  # whose header the others take from now on
    shutil.rmtree(folder)  # one that is gone is not given
    assert Path(folder_here()).is_dir()
