"""The package installs, plainly and editable, into a bare environment and imports from any folder."""

import importlib.util
import re
import shutil
import subprocess
import sys
import tomllib
import venv
import zipfile
from importlib import metadata
from pathlib import Path

import pytest

import ccd_warp

ROOT = Path(__file__).resolve().parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
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
    ignore = shutil.ignore_patterns("__pycache__", "*.egg-info", "results")
    for name in ("ccd_warp", "benchmarks", "kernels"):
        shutil.copytree(ROOT / name, copy / name, ignore=ignore)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, copy / name)
    return copy


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


@pytest.mark.parametrize("editable", [False, True], ids=["plain", "editable"])
def test_installation_imports_from_any_folder(tmp_path, source, python, editable):
    target = ["-e", source] if editable else [source]
    pip = [sys.executable, "-m", "pip", "--python", python, "--quiet", "--disable-pip-version-check"]
    _run(*pip, "install", "--ignore-installed", *_build_options(), *target, cwd=tmp_path)
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
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
    for name in ("benchmarks", "kernels"):
        modules |= {f"ccd_warp/{name}/{path.name}" for path in (ROOT / name).glob("*.py")}
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
    """`import kernels` from the root would register every Warp module twice; the benchmarks have one name, too."""
    second_name = re.compile(r"^\s*(from|import) (kernels|benchmarks)\b", flags=re.MULTILINE)
    for path in [path for name in ("ccd_warp", "benchmarks", "kernels") for path in (ROOT / name).glob("*.py")]:
        assert not second_name.search(path.read_text(encoding="utf-8")), path
