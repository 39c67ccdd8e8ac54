"""Hashes of modules that are kept in Warp's cache: those that Warp computes, and none of other files of kernels."""

import json
import os
import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
import warp as wp
from ccd_warp.kernels.boxes import rest_order
from programs import begun

import ccd_warp as ccd
from ccd_warp import kernels
from ccd_warp._runtime.every_module import every_module
from ccd_warp._runtime.kept_hashes import keep_in_cache, recall_from_cache
from ccd_warp._runtime.kernel_cache import load_or_repair
from ccd_warp._runtime.lanes import cpu_lanes
from ccd_warp._runtime.quiet import start_warp
from ccd_warp._runtime.target import set_flags

MODULE = rest_order.fill_centres.module


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """An empty cache in place of Warp's."""
    start_warp()
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path))
    return tmp_path


def _kept(module=MODULE):
    """The hash of a module, which is computed anew, and kept; an earlier test may have recalled it."""
    module.mark_modified()
    module_hash = module.get_module_hash(1)
    keep_in_cache(module, 1)
    return module_hash


def _is_recalled(module=MODULE):
    module.mark_modified()
    recall_from_cache(module, 1)
    return 1 in module.hashers


def _all_of(module):
    hashes = module.get_module_hash(1), module.resolved_options[1]
    kernels = {kernel.key: (kernel.hash, kernel.grid_stride, kernel.adj) for kernel in module._get_live_kernels()}
    return *hashes, {k: (*h, adj.kernel_dim, adj.tid_extent_limit_candidate) for k, (*h, adj) in kernels.items()}


def test_hashes_that_are_kept_are_those_that_warp_computes(cache):
    for module in every_module(cpu_lanes()).values():
        assert not _is_recalled(module)
        computed = _all_of(module)
        keep_in_cache(module, 1)
        for kernel in module._get_live_kernels():
            kernel.hash = kernel.grid_stride = kernel.adj.kernel_dim = None
        assert _is_recalled(module) and _all_of(module) == computed, module.name
    assert len([*cache.glob("wp_ccd_warp.hashes/*")]) == len(every_module(cpu_lanes()))
    wp.clear_kernel_cache()
    assert not _is_recalled(module)


DAMAGED = [b"", bytes(100), b'{"sources": ', b"[1]", b'{"sources": "of others", "hashes": {}}']


def test_a_hash_is_kept_for_its_options_of_this_package_alone_and_where_it_is_damaged_or_not_written_not(
    cache, monkeypatch
):
    @wp.kernel(module="unique")
    def of_user(x: wp.array[int]):
        x[wp.tid()] = 1

    _kept(of_user.module)
    assert not _is_recalled(of_user.module)
    set_flags(MODULE, wp.get_device("cpu"))
    _kept()
    assert _is_recalled()
    (path,) = cache.glob("wp_ccd_warp.hashes/*")
    whole = path.read_bytes()
    for damaged in DAMAGED:
        path.write_bytes(damaged)
        assert not _is_recalled(), damaged
    path.write_bytes(whole)
    assert _is_recalled()
    MODULE.options["cpu_compiler_flags"] += " -g"
    assert not _is_recalled()
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(path))
    _kept()
    assert not _is_recalled()


def test_what_is_compiled_is_named_by_warp_whatever_was_kept(cache, monkeypatch):
    kernel, module, device = rest_order.fill_centres, MODULE, wp.get_device("cpu")
    set_flags(module, device)
    right = _kept()
    (path,) = cache.glob("wp_ccd_warp.hashes/*")
    path.write_text(path.read_text("utf-8").replace(right.hex(), "0" * 64))
    assert _is_recalled(module) and module.get_module_hash(1) == bytes(32)

    def load_module(**_):
        raise RuntimeError(module.get_module_identifier(1))

    monkeypatch.setattr(wp, "load_module", load_module)
    with pytest.raises(RuntimeError, match=right.hex()[:7]):
        load_or_repair(kernel, device, None)
    module.unload()


OF_COPY = """
import sys

import warp as wp

from ccd_warp import kernels
from ccd_warp.kernels.boxes import thickness
from ccd_warp._runtime.kept_hashes import keep_in_cache, recall_from_cache
from ccd_warp._runtime.quiet import start_warp

start_warp()
module = thickness.fill_box_radius.module
edited = kernels.__path__[0] + "/boxes/thickness.py"
if len(sys.argv) > 1:  # while this process has them in memory
    text = open(edited).read()
    open(edited, "w").write("# another line\\n" + text)
recall_from_cache(module, 1)
is_recalled = 1 in module.hashers
print(is_recalled, module.get_module_hash(1).hex())
keep_in_cache(module, 1)
"""


def _outcome(copy, *arguments):
    """Whether a process that takes a copy of the package recalls the hash of a module, and the hash."""
    of_copy = {"PYTHONPATH": str(copy), "WARP_CACHE_PATH": str(copy.parent / "cache"), "PYTHONDONTWRITEBYTECODE": ""}
    is_recalled, module_hash = begun(copy, "-P", "-c", OF_COPY, *arguments, **of_copy)[1].split()[-2:]
    return is_recalled == "True", module_hash


@pytest.fixture
def copy(tmp_path):
    """A copy of the package, which a test may edit."""
    copy = tmp_path / "copy"
    unneeded = shutil.ignore_patterns("__pycache__", "_objects")
    for of_package, name in ((Path(ccd.__file__).parent, "ccd_warp"), (kernels.__path__[0], "ccd_warp/kernels")):
        shutil.copytree(of_package, copy / name, ignore=unneeded, dirs_exist_ok=True)
    return copy


def test_an_edit_of_any_file_of_kernels_makes_a_hash_useless_also_where_it_comes_between(copy, tmp_path):
    with ThreadPoolExecutor(2) as threads:
        (_, first), (_, other) = threads.map(_outcome, [copy, copy])
    assert first == other and _outcome(copy) == (True, first)
    kept = [*(tmp_path / "cache").rglob("wp_ccd_warp.hashes/*")]
    assert len(kept) == 1 and json.loads(kept[0].read_text("utf-8"))["hashes"]
    assert _outcome(copy, "edits") == (True, first), "as it was executed"
    for name, words, is_of_module in (("pair/rounding.py", "", False), ("atomics.py", "values[index] |= bits", True)):
        path = copy / "ccd_warp" / "kernels" / name
        text = path.read_text("utf-8")
        assert words in text
        path.write_text(text.replace(words, f"{words} ") if words else f"{text}\n", "utf-8")
        is_recalled, module_hash = _outcome(copy)
        assert not is_recalled and (module_hash != first) == is_of_module


def test_no_hash_of_stale_bytecode_is_kept_and_none_of_its_source_taken_for_it(copy):
    first, path = _outcome(copy)[1], copy / "ccd_warp" / "kernels" / "boxes" / "thickness.py"
    text, time = path.read_text("utf-8"), path.stat().st_mtime_ns

    def outcome_of(text):
        path.write_text(text, "utf-8")
        os.utime(path, ns=(time, time))  # as `rsync -t`, reproducible builds and layers of images leave it
        return _outcome(copy)

    edited = text.replace("1.7976931348623157e308", "1.6976931348623157e308")
    assert outcome_of(edited) == (False, first)
    time += 10**10
    is_recalled, second = outcome_of(edited)
    assert not is_recalled and second != first and outcome_of(edited) == (True, second)
    assert outcome_of(text) == (False, second)


OF_FIRST_CALL = """
import warp as wp
from ccd_warp.kernels import later

import scenes

before = len(later._functions)
scenes.ccd.mesh_ccd(*scenes.sheet_over_floor(4))
print(0 < before < len(later._functions))
"""


def test_a_first_call_reads_no_function_where_all_is_compiled(tmp_path):
    _, (_, shown, error) = (begun(tmp_path, "-P", "-c", OF_FIRST_CALL) for _ in range(2))
    assert shown.split()[-1:] == ["True"], error
