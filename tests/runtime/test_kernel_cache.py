"""Damaged files in Warp's kernel cache: the folder is named, and the module compiled again."""

import warnings
from pathlib import Path
from types import SimpleNamespace

import pytest
import warp as wp
from one_kernel import DAMAGE, double, load_anew
from shared_objects import SharedObjects
from warp._src import build

from ccd_warp._runtime import kernel_cache
from ccd_warp._runtime.kernel_cache import is_current, load_or_repair
from ccd_warp._runtime.quiet import start_warp


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    """A cache that holds the kernel alone; what the compiler makes of it is kept in the usual one."""
    start_warp()
    with pytest.MonkeyPatch.context() as patch:
        objects = SharedObjects(Path(wp.config.kernel_cache_dir) / "ccd_warp_objects")
        patch.setattr(build, "build_cpu", objects.build_cpu)
        patch.setattr(wp.config, "kernel_cache_dir", str(tmp_path_factory.mktemp("cache")))
        load_anew()
        yield Path(wp.config.kernel_cache_dir)


@pytest.mark.parametrize("name", DAMAGE)
def test_a_damaged_file_is_named_and_compiled_again_and_a_whole_one_is_not_touched(cache, name):
    ending, damage = DAMAGE[name]
    (path,) = cache.rglob(f"*{ending}")
    path.write_bytes(damage(path.read_bytes()))
    with pytest.warns(RuntimeWarning, match=f"Warp's kernel cache is damaged in {path.parent} "):
        load_anew()
    times = {path: path.stat().st_mtime_ns for path in cache.rglob("*") if path.is_file()}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load_anew()
    assert times == {path: path.stat().st_mtime_ns for path in times}


def test_a_gpu_takes_its_own_code_from_the_cache_and_no_other(tmp_path, monkeypatch):
    loads = []
    module = SimpleNamespace(get_module_identifier=lambda _: "m", options={}, _get_live_kernels=list)
    module.load = lambda device, block_dim, **how: loads.append(how)
    monkeypatch.setattr(wp, "load_module", lambda **how: loads.append("as Warp does"))
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path))
    (tmp_path / "m").mkdir()
    for name in ("m.sm90.cubin", "m.sm80.cubin", "m.meta"):
        (tmp_path / "m" / name).touch()
    for arch in (90, 89):
        device = SimpleNamespace(is_cpu=False, is_cuda=True, arch=arch, context=None)
        load_or_repair(SimpleNamespace(module=module), device, 64)
    files = {"binary_path": str(tmp_path / "m/m.sm90.cubin"), "meta_path": str(tmp_path / "m/m.meta")}
    assert loads == [{"output_arch": 90, **files}, "as Warp does"]


def test_a_cache_that_cannot_be_written_is_named(cache, tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path / "file"))
    with pytest.raises(OSError, match=rf"Warp's kernel cache cannot be written in {tmp_path}/file.*WARP_CACHE_PATH"):
        load_anew()


def test_a_first_compilation_is_told_once_in_a_line_where_there_is_no_terminal(cache, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path))
    monkeypatch.setattr(kernel_cache, "_is_said", False)
    monkeypatch.setattr(wp.config, "log_level", wp.LOG_WARNING)
    load_anew()
    kernel_cache._say_once(wp.get_device("cpu"))
    shown = capsys.readouterr()
    assert (shown.out, shown.err.count("\n")) == ("", 1)
    assert shown.err.startswith("ccd_warp: compiling kernels, ") and shown.err.endswith(f"kept in {tmp_path}\n")


def test_what_is_loaded_on_the_cpu_stays_where_it_is_compiled_for_a_gpu(cache, tmp_path, monkeypatch):
    load_anew()
    module, cpu = double.module, wp.get_device("cpu")
    loaded = module.load(cpu, 1)
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path))  # an empty one
    monkeypatch.setattr(wp, "load_module", lambda **how: None)
    load_or_repair(double, SimpleNamespace(is_cpu=False, is_cuda=True, arch=90, context=None), 256)
    assert module.load(cpu, 1) is loaded and is_current(module, cpu)


CHANGED = """
import gc

import numpy as np
import trimesh
from warp._src.context import Module, ModuleExec

import ccd_warp as ccd

made, begin = [], ModuleExec.__init__
ModuleExec.__init__ = lambda self, *given, **named: made.append(self) or begin(self, *given, **named)
ball = trimesh.creation.icosphere(4)
mesh = ccd.CollisionMesh.from_trimesh([ball, ball.copy().apply_translation([1.9, 0, 0])])
x = mesh.vertices
y = x - np.where(mesh.vertex_body[:, None] == 1, [0.5, 0, 0], 0.0)
found = {len(ccd.find_candidates(mesh, x, y, num_threads=4).edge_edge)}
count = len(made)
modules = [module for module in gc.get_objects() if isinstance(module, Module) and module.execs]
for _ in range(10):
    for module in modules:
        module.options["cpu_compiler_flags"] = None
        module.mark_modified()
    found.add(len(ccd.find_candidates(mesh, x, y, num_threads=4).edge_edge))
print(len(modules) > 1, len(made) - count, len(found))
"""


def test_threads_do_not_load_what_has_changed_each_for_itself(tmp_path, python):
    """Warp names what two threads load alike, and with the one unloads the other: the process crashes."""
    (tmp_path / "changed.py").write_text(CHANGED, encoding="utf-8")
    assert python(tmp_path, "changed.py")[:2] == (0, "True 0 1\n")
