"""`ccd-warp compile` and `doctor`: kernels are where they are needed, and a line says where they come from."""

from pathlib import Path
from unittest.mock import Mock

import pytest
import warp as wp

from ccd_warp._cli import compile, doctor
from ccd_warp._cli.command import main
from ccd_warp._runtime import packaged, quiet, target
from ccd_warp._runtime.every_module import every_module
from ccd_warp._runtime.target import cpu_target


@pytest.fixture
def few(monkeypatch):
    """Two modules in place of all, for the level of every x86-64 alone."""
    every = every_module(1)
    few = {name: every[name] for name in ("contacts", "hash_grid")}
    monkeypatch.setattr("ccd_warp._runtime.every_module.every_module", lambda width: few)
    monkeypatch.setattr(compile, "LEVELS", {1: "x86-64"})
    for module in (compile, doctor):
        monkeypatch.setattr(module, "cpu_lanes", lambda: 1)
    for module in (compile, doctor, packaged, target):
        monkeypatch.setattr(module, "cpu_target", lambda: "x86-64")
    yield few
    packaged._index.cache_clear()
    for module in few.values():  # what they are called by the flags of this processor
        module.mark_modified()


def test_kernels_are_compiled_into_the_cache(few, capsys):
    for words, number in (("mesh_ccd", 1), ("pairs,hash", 2)):
        assert main(["compile", "--device", "cpu", "--for", words]) == 0
        assert capsys.readouterr().out == f"{number} modules for x86-64 are in {wp.config.kernel_cache_dir}\n"


def test_code_for_a_gpu_that_is_not_there_is_compiled_into_the_cache(few, capsys):
    assert main(["compile", "--arch", "90"]) == 0
    assert capsys.readouterr().out == f"1 modules for sm_90 are in {wp.config.kernel_cache_dir}\n"
    name = few["contacts"].get_module_identifier()
    assert Path(wp.config.kernel_cache_dir, name, f"{name}.sm90.cubin").read_bytes().startswith(b"\x7fELF")


@pytest.mark.parametrize("more", [[], ["--device", "cpu"]], ids=["for all levels", "for a device"])
def test_kernels_are_put_into_a_folder_that_the_package_takes(more, few, tmp_path, monkeypatch, capsys):
    assert main(["compile", "--package", str(tmp_path / "made"), *more, "--quiet"]) == 0
    endings = sorted(path.suffix for path in (tmp_path / "made").iterdir())
    assert endings == [".json", ".meta", ".meta", ".o", ".o"]
    monkeypatch.setattr(packaged, "FOLDER", tmp_path / "made")
    packaged._index.cache_clear()
    assert main(["doctor"]) == 0 and main(["compile", "--device", "cpu", "--all"]) == 0
    out = capsys.readouterr().out
    assert ": all kernels come with the package, 2 modules\n" in out and out.endswith("are in the package\n")
    next((tmp_path / "made").glob("*.o")).write_bytes(b"")
    assert main(["doctor"]) == 0
    assert ": 1 of 2 modules come with the package; the others differ or are damaged," in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--for", "mesh_ccd,cloth"], "argument --for: unknown cloth; expected some of mesh_ccd, pairs, "),
        (["--arch", "90", "--device", "cpu"], "argument --device: not allowed with argument --arch"),
        (["--package", "."], ".: File exists"),
    ],
)
def test_what_cannot_be_compiled_is_said_in_one_line(arguments, message, capsys):
    assert main(["compile", *arguments]) == 2
    assert f"ccd-warp: error: {message}" in capsys.readouterr().err


def test_doctor_says_why_kernels_are_compiled(capsys, monkeypatch):
    monkeypatch.setattr(quiet, "_is_started", False)
    monkeypatch.setattr(quiet, "why_no_cache", "")
    with monkeypatch.context() as patch:
        patch.setattr(wp, "init", Mock(side_effect=[PermissionError(13, "Permission denied", "/a/cache"), None]))
        patch.setattr(wp.config, "kernel_cache_dir", wp.config.kernel_cache_dir)  # another takes its place
        assert main(["doctor"]) == 0
    unwritable = "cache: none. Warp's kernel cache cannot be written in /a/cache (Permission denied); free space there"
    assert capsys.readouterr().out.splitlines()[-1].startswith(unwritable)
    monkeypatch.setattr(quiet, "why_no_cache", "")
    assert main(["doctor"]) == 0
    versions, cpu, *_, cache = capsys.readouterr().out.splitlines()
    assert wp.config.version in versions and wp.config.kernel_cache_dir in cache
    assert f"cpu ({cpu_target()}, " in cpu and "compiled when they are first needed, because" in cpu
