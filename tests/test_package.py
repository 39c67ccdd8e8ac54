"""Distributions hold what they must, and the package imports from any folder."""

import email
import os
import re
import runpy
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest

import ccd_warp

ROOT = Path(__file__).resolve().parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
IGNORED = "__pycache__ *.egg-info .*_cache .hypothesis build dist .venv .nox .git".split()


def _run(*command, cwd: Path, **variables: str) -> str:
    how = {"capture_output": True, "text": True, "env": os.environ | variables}
    done = subprocess.run([str(part) for part in command], cwd=cwd, check=False, **how)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def tree(tmp_path_factory) -> Path:
    """A copy of the project, so that no build output lands in the tree."""
    copy = tmp_path_factory.mktemp("copy") / "tree"
    shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(*IGNORED))
    return copy


def _built(kind: str, tree: Path, folder: Path, **variables: str) -> Path:
    """A distribution of the tree, built by the setuptools of this environment, so that nothing is downloaded."""
    command = f"import sys, setuptools.build_meta as b; print(b.build_{kind}(sys.argv[1]))"
    return folder / _run(sys.executable, "-c", command, folder, cwd=tree, **variables).splitlines()[-1]


@pytest.fixture(scope="module")
def distribution(tree, tmp_path_factory) -> Path:
    """The source distribution, unpacked."""
    folder = tmp_path_factory.mktemp("sdist")
    packed = _built("sdist", tree, folder)
    with tarfile.open(packed) as archive:
        archive.extractall(folder, filter="data")
    return folder / packed.name.removesuffix(".tar.gz")


@pytest.fixture
def about(distribution):
    return email.message_from_string((distribution / "PKG-INFO").read_text(encoding="utf-8"))


def test_source_distribution_holds_what_its_tests_and_pages_need(distribution):
    needed = ["pyproject.toml", "setup.py", "noxfile.py", "MANIFEST.in", "LICENSE", "CITATION.cff", ".ci/run"]
    needed += [path.name for path in ROOT.glob("*.md")]
    suffixes = {".py", ".typed", ".md", ".png", ".css", ".html", ".js"}
    for folder in ("ccd_warp", "kernels", "docs", "examples", "tests"):
        files = [path for path in (ROOT / folder).rglob("*") if path.suffix in suffixes]
        needed += [path.relative_to(ROOT).as_posix() for path in files]
    unneeded = [path for path in distribution.rglob("*") if path.name in ("__pycache__", ".hypothesis")]
    assert [name for name in needed if not (distribution / name).is_file()] == [] == unneeded


def test_metadata_names_authors_addresses_and_every_python_that_is_tested(about):
    assert about["Author"] and about["Description-Content-Type"] == "text/markdown"
    assert all(url.partition(", ")[2].startswith("https://") for url in about.get_all("Project-URL"))
    pythons = re.findall(r"Python :: (3\.\d+)", "\n".join(about.get_all("Classifier")))
    assert pythons and about["Requires-Python"] == f">={pythons[0]}"
    assert f"{sys.version_info.major}.{sys.version_info.minor}" in pythons
    assert ccd_warp.__version__ == PROJECT["version"] == about["Version"]


def test_every_link_of_the_readme_works_on_a_package_index(about):
    targets = re.findall(r"\]\(([^)]*)\)", about.get_payload())
    assert targets and [target for target in targets if not target.startswith(("https://", "#"))] == []
    rewrite = runpy.run_path(str(ROOT / "setup.py"))["readme_for_an_index"]
    text = "![A ball](docs/a.png) [solver](docs/solver.md#many) [Warp](https://warp.dev)"
    shown = rewrite(text, "https://forge.example/ccd/")
    assert "/raw/main/docs/a.png) [solver](https://forge.example/ccd/blob/main/docs/solver.md#many) [Warp]" in shown


def test_package_imports_beside_a_checkout_of_its_name_and_without_its_parts(tmp_path):
    """A folder without `__init__.py` is a package to Python, which a finder of an editable installation comes after."""
    (tmp_path / "ccd_warp").mkdir()
    code = "import sys, ccd_warp as c; print(c.__version__, *(f'ccd_warp.{p}' in sys.modules for p in ['viz']))"
    code += "; print(callable(c.viz.render_step), 'pyvista' in sys.modules)"
    code += "; print({n for n in dir(c) if not n.startswith('__')} == set(c.__all__) - {'__version__'})"
    version, *shown = _run(sys.executable, "-c", code, cwd=tmp_path).split()
    assert version == PROJECT["version"] and shown == "False True False True".split()
    with pytest.raises(AttributeError, match="module 'ccd_warp' has no attribute 'nothing'"):
        _ = ccd_warp.nothing


def test_wheel_with_objects_is_of_a_platform_and_the_next_one_holds_what_is_installed_alone(tmp_path, tree):
    (tmp_path / "objects").mkdir()
    (tmp_path / "objects" / "index.json").write_text("{}")
    wheel = _built("wheel", tree, tmp_path, CCD_WARP_OBJECTS=str(tmp_path / "objects"))
    assert wheel.name.endswith("-py3-none-manylinux_2_28_x86_64.whl")
    with zipfile.ZipFile(wheel) as archive:
        assert archive.read("ccd_warp/_objects/index.json") == b"{}"
        (about,) = (archive.read(name).decode() for name in archive.namelist() if name.endswith(".dist-info/WHEEL"))
    assert "Root-Is-Purelib: false\nTag: py3-none-manylinux_2_28_x86_64\n" in about
    # the next one holds the kernels and the types, none of these objects, and no path of this machine
    with zipfile.ZipFile(_built("wheel", tree, tmp_path)) as archive:
        contents = {name: archive.read(name) for name in archive.namelist()}
    files = (ROOT / "ccd_warp").rglob("*.py")
    expected = {path.relative_to(ROOT).as_posix() for path in files} | {"ccd_warp/py.typed"}
    for name in [name for name in ("benchmarks", "kernels") if any(f"ccd_warp/{name}/" in each for each in contents)]:
        expected |= {f"ccd_warp/{path.relative_to(ROOT).as_posix()}" for path in (ROOT / name).rglob("*.py")}
    assert "ccd_warp/kernels/once.py" in expected == {name for name in contents if ".dist-info/" not in name}
    assert any(name.endswith("LICENSE") for name in contents)
    for name, content in contents.items():
        for path in (str(ROOT), str(Path.home()) + "/", str(tmp_path)):
            assert path.encode() not in content, f"{name} names {path}"
