"""The package installs, plainly and editable, into a bare environment and imports from any folder."""

import email
import importlib.util
import re
import runpy
import shutil
import subprocess
import sys
import tarfile
import tomllib
import venv
import zipfile
from importlib import metadata
from pathlib import Path

import pytest

import ccd_warp

ROOT = Path(__file__).resolve().parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
IGNORED = ("__pycache__", "*.egg-info", ".*_cache", ".hypothesis")
PROBE = "import ccd_warp, ccd_warp.kernels; print(ccd_warp.__version__, ccd_warp.__file__, ccd_warp.kernels.__file__)"


def _run(*command, cwd: Path) -> str:
    done = subprocess.run([str(part) for part in command], cwd=cwd, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def _build_options() -> list[str]:
    """Build with the setuptools of this environment where it is new enough, so that nothing is downloaded."""
    try:
        major = int(metadata.version("setuptools").split(".")[0])
    except metadata.PackageNotFoundError:
        major = 0
    return ["--no-deps", *(["--no-build-isolation"] if major >= 77 else [])]


def _link_dependencies(links: Path) -> None:
    """Fill a folder with links to the packages of this environment, all but ccd_warp itself and pip."""
    links.mkdir()
    specs = [importlib.util.find_spec(name) for name in ("warp", "numpy", "trimesh", "setuptools")]
    folders = {str(Path(spec.origin).parent.parent) for spec in specs if spec and spec.origin}
    # In the order of the search path, so that of two versions the one that this environment imports is linked.
    for entry in (entry for folder in sorted(folders, key=sys.path.index) for entry in Path(folder).iterdir()):
        is_ours = entry.name.startswith(("ccd_warp", "__editable__", "pip"))
        if not is_ours and entry.suffix != ".pth" and not (links / entry.name).exists():
            (links / entry.name).symlink_to(entry, target_is_directory=entry.is_dir())


@pytest.fixture
def source(tmp_path) -> Path:
    """A copy of what an installation takes from the project, so that no build output lands in the tree."""
    copy = tmp_path / "source"
    ignore = shutil.ignore_patterns(*IGNORED)
    for name in ("ccd_warp", "kernels"):
        shutil.copytree(ROOT / name, copy / name, ignore=ignore)
    for name in ("pyproject.toml", "setup.py", "MANIFEST.in", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, copy / name)
    return copy


@pytest.fixture(scope="module")
def distribution(tmp_path_factory) -> Path:
    """The source distribution, built from a copy of the tree without build output, and unpacked."""
    folder = tmp_path_factory.mktemp("sdist")
    ignored = shutil.ignore_patterns(*IGNORED, "build", "dist", ".venv", ".nox", ".git", "*.journal")
    shutil.copytree(ROOT, folder / "tree", ignore=ignored)
    command = "import sys, setuptools.build_meta as b; print(b.build_sdist(sys.argv[1]))"
    name = _run(sys.executable, "-c", command, folder, cwd=folder / "tree").splitlines()[-1]
    with tarfile.open(folder / name) as archive:
        archive.extractall(folder, filter="data")
    return folder / name.removesuffix(".tar.gz")


@pytest.fixture
def python(tmp_path) -> Path:
    """The interpreter of a fresh environment that sees this one's dependencies, but no ccd_warp."""
    folder = tmp_path / "venv"
    venv.create(folder, with_pip=False)  # its setuptools may be too old to build the project
    interpreter = folder / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")
    paths = _run(interpreter, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))", cwd=tmp_path).strip()
    _link_dependencies(tmp_path / "dependencies")
    (Path(paths) / "dependencies.pth").write_text(f"{tmp_path / 'dependencies'}\n", encoding="utf-8")
    return interpreter


def test_source_distribution_holds_what_its_tests_and_pages_need(distribution):
    needed = ["pyproject.toml", "setup.py", "noxfile.py", "MANIFEST.in", "LICENSE", "CITATION.cff", ".ci/run"]
    needed += [path.name for path in ROOT.glob("*.md")]
    for folder, suffixes in {
        "ccd_warp": {".py", ".typed"},
        "kernels": {".py"},
        "benchmarks": {".py", ".csv"},
        "docs": {".py", ".md", ".png", ".css"},
        "examples": {".py"},
        "tests": {".py"},
    }.items():
        files = [path for path in (ROOT / folder).rglob("*") if path.suffix in suffixes and path.is_file()]
        needed += [path.relative_to(ROOT).as_posix() for path in files]
    assert [name for name in needed if not (distribution / name).is_file()] == []
    for path in distribution.rglob("*"):
        assert not any(path.match(pattern) for pattern in IGNORED if pattern != "*.egg-info"), path


def test_tests_pass_from_the_source_distribution(distribution):
    """Those that read files of the project; all the others see no difference."""
    arguments = ["-q", "-p", "no:cacheprovider", "tests/docs/test_readme.py", "tests/test_layout.py"]
    _run(sys.executable, "-m", "pytest", *arguments, cwd=distribution)


def test_metadata_names_authors_addresses_and_every_python_that_is_tested(distribution):
    about = email.message_from_string((distribution / "PKG-INFO").read_text(encoding="utf-8"))
    assert about["Author"] and about["Description-Content-Type"] == "text/markdown"
    assert all(url.partition(", ")[2].startswith("https://") for url in about.get_all("Project-URL"))
    pythons = re.findall(r"Python :: (3\.\d+)", "\n".join(about.get_all("Classifier")))
    assert pythons and about["Requires-Python"] == f">={pythons[0]}"
    assert f"{sys.version_info.major}.{sys.version_info.minor}" in pythons


def test_every_link_of_the_readme_works_on_a_package_index(distribution):
    about = email.message_from_string((distribution / "PKG-INFO").read_text(encoding="utf-8"))
    shown = about.get_payload()
    assert "## The guarantee" in shown
    targets = re.findall(r"\]\(([^)]*)\)", shown)
    assert targets and [target for target in targets if not target.startswith(("https://", "#"))] == []


def test_links_of_the_readme_lead_to_the_repository_once_there_is_one():
    rewrite = runpy.run_path(str(ROOT / "setup.py"))["readme_for_an_index"]
    text = "![A ball](docs/a.png) [solver](docs/solver.md#many) [Warp](https://warp.dev) [above](#top)"
    assert rewrite(text, "https://forge.example/ccd/") == (
        "![A ball](https://forge.example/ccd/raw/main/docs/a.png) "
        "[solver](https://forge.example/ccd/blob/main/docs/solver.md#many) [Warp](https://warp.dev) [above](#top)"
    )
    assert rewrite(text, None) == (
        "*Picture: A ball (`docs/a.png` in the source distribution).* "
        "solver (`docs/solver.md` in the source distribution) [Warp](https://warp.dev) [above](#top)"
    )


def test_package_imports_beside_a_checkout_of_its_name_and_inside_one(tmp_path):
    """A folder without `__init__.py` is a package to Python, which a finder of an editable installation comes after."""
    (tmp_path / "ccd_warp").mkdir()
    outside, inside = (_run(sys.executable, "-c", PROBE, cwd=folder).split() for folder in (tmp_path, ROOT))
    assert outside[0] == inside[0] == PROJECT["version"]
    assert Path(inside[2]).parent in (ROOT / "kernels", ROOT / "ccd_warp" / "kernels")


# CI itself installs the project editable, and a wheel under two Pythons besides (`nox -s users`).
@pytest.mark.long
@pytest.mark.parametrize("editable", [pytest.param(False, id="plain"), pytest.param(True, id="editable")])
def test_installation_imports_from_any_folder(tmp_path, source, python, editable):
    target = ["-e", source] if editable else [source]
    pip = [sys.executable, "-m", "pip", "--python", python, "--quiet", "--disable-pip-version-check"]
    _run(*pip, "install", "--ignore-installed", *_build_options(), *target, cwd=tmp_path)
    elsewhere = tmp_path / "elsewhere"
    (elsewhere / "ccd_warp").mkdir(parents=True)  # as beside a checkout
    version, package, kernels = _run(python, "-c", PROBE, cwd=elsewhere).split()
    assert version == PROJECT["version"]
    home = source if editable else tmp_path / "venv"
    assert home in Path(package).parents and home in Path(kernels).parents
    assert _run(python, "-m", "ccd_warp", "--version", cwd=elsewhere) == f"ccd-warp {PROJECT['version']}\n"
    script = python.parent / ("ccd-warp.exe" if sys.platform == "win32" else "ccd-warp")
    assert _run(script, "--version", cwd=elsewhere) == f"ccd-warp {PROJECT['version']}\n"
    _run(script, "explore", "--quiet", cwd=elsewhere)  # its page is made of files that are no modules
    assert (elsewhere / "ccd_warp_explore.html").stat().st_size > 50_000


def test_wheel_holds_the_kernels_the_types_and_the_page_and_no_path_of_this_machine(tmp_path, source):
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
    _run(*pip, "wheel", "--wheel-dir", tmp_path / "wheels", *_build_options(), source, cwd=tmp_path)
    (wheel,) = (tmp_path / "wheels").glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
        contents = {name: archive.read(name) for name in names}
    modules = {path.relative_to(ROOT).as_posix() for path in (ROOT / "ccd_warp").rglob("*.py")}
    modules |= {f"ccd_warp/{path.relative_to(ROOT).as_posix()}" for path in (ROOT / "kernels").rglob("*.py")}
    pages = {path.relative_to(ROOT).as_posix() for path in (ROOT / "ccd_warp" / "_cli" / "page").iterdir()}
    assert len(pages) > 5
    assert modules | pages | {"ccd_warp/py.typed"} == {name for name in names if ".dist-info/" not in name}
    assert any(name.endswith("LICENSE") for name in names)
    for name, content in contents.items():
        for path in (str(ROOT), str(Path.home()) + "/", str(tmp_path)):
            assert path.encode() not in content, f"{name} names {path}"


def test_version_is_stated_once():
    assert ccd_warp.__version__ == PROJECT["version"]
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert re.search(r"^version: (\S+)$", citation, flags=re.MULTILINE)[1] == PROJECT["version"]


def test_the_host_package_never_imports_kernels_by_a_second_name():
    """`import kernels` from the root would register every Warp module twice."""
    second_name = re.compile(r"^\s*(from|import) kernels\b", flags=re.MULTILINE)
    for path in [path for name in ("ccd_warp", "benchmarks", "kernels") for path in (ROOT / name).rglob("*.py")]:
        assert not second_name.search(path.read_text(encoding="utf-8")), path
