"""Checks under every Python that pyproject.toml claims and that is found here: `nox` runs all tests.

Interpreters that are absent are skipped, and nox says so. What follows `--` goes to pytest: `nox -- -k bullet`.
"""

import os
from pathlib import Path
from tempfile import TemporaryDirectory

import nox

nox.needs_version = ">=2025.2.9"
nox.options.error_on_missing_interpreters = False
nox.options.default_venv_backend = "uv|virtualenv"  # uv where it is installed, which else would fetch what is absent
os.environ.setdefault("UV_PYTHON_DOWNLOADS", "never")
nox.options.sessions = ["tests"]
# What the Pythons have compiled of the kernels, by its source, for each other and for later runs.
OBJECTS = Path(os.environ.get("WARP_CACHE_PATH") or Path.home() / ".cache" / "warp", "ccd_warp_objects")
PYTHONS = nox.project.python_versions(nox.project.load_toml("pyproject.toml"))
TESTS = Path(__file__).resolve().parent / "tests"
# What a Python can break: the options' signatures, arguments, the readers. Steps and kernels are those of the users.
FEW = ["input/test_options", "input/test_mesh", "files/test_files"]


@nox.session(python=PYTHONS)
def tests(session: nox.Session) -> None:
    """Install the package with what its tests need, as a user would, and run them."""
    session.install(".[test]")
    session.run("python", "-m", "pytest", "-n", "auto", "-m", "not long", *session.posargs)


@nox.session(python=[PYTHONS[0], PYTHONS[-1]], venv_backend="virtualenv")
def users(session: nox.Session) -> None:
    """Under the oldest and the newest Python: install a wheel by pip and nothing else, act as the README's users in an
    empty folder, and run a few tests: `-- WHEEL`; not under a Python that follows it, under which all tests run anyway.
    """
    if not session.posargs:
        session.error("expected the path of one wheel: nox --session users -- dist/NAME.whl")
    if session.python in session.posargs[1:]:
        session.skip("all tests run under it")
    session.install(str(Path(session.posargs[0]).resolve()))
    # kernels are read anew, by this Python, and compiled where they differ from those that an earlier one has read;
    # without the seed, Warp writes the same functions in an order of its own
    variables = {"PYTHONHASHSEED": "0"}
    with TemporaryDirectory() as kernels, TemporaryDirectory() as empty, session.chdir(empty):
        variables["WARP_CACHE_PATH"] = kernels
        session.run("python", "-P", str(TESTS / "as_users.py"), str(OBJECTS), env=variables)
    session.install("pytest")
    session.run("python", "-P", "-m", "pytest", "-q", *(str(TESTS / f"{name}.py") for name in FEW))


@nox.session(python=PYTHONS[0])
def wheel(session: nox.Session) -> None:
    """A wheel for Linux on x86-64 with compiled kernels, for the Warp of pyproject.toml: `-- FOLDER`, and after it, for
    those of GPUs, `--arch 80 90 120`. `python -m build` makes the wheel for all others.
    """
    folder, *options = session.posargs or session.error("expected a folder: nox -s wheel -- dist")
    warp = next(line for line in nox.project.load_toml("pyproject.toml")["project"]["dependencies"] if "warp" in line)
    session.install("build", warp.replace(">=", "=="), ".")
    with TemporaryDirectory() as made:
        session.run("ccd-warp", "compile", "--package", f"{made}/objects", *options)
        build = ["python", "-m", "build", "--wheel", "--outdir", folder]
        session.run(*build, env={"CCD_WARP_OBJECTS": f"{made}/objects"})


@nox.session(python=PYTHONS[0])
def lowest(session: nox.Session) -> None:
    """Before a release: all tests with the lowest versions that pyproject.toml allows, all of them wheels.

    Left out are tools that no test runs, and `rigid-peers`, which at their lowest ask for different versions of NumPy.
    """
    project = nox.project.load_toml("pyproject.toml")["project"]
    extras = project["optional-dependencies"]
    taken = [extras[name] for name in extras.keys() - {"dev", "lint", "rigid-peers"}]
    lines = {line for lines in [project["dependencies"], *taken] for line in lines if not line.startswith("ccd-warp[")}
    session.install("--only-binary", ":all:", *sorted(line.replace(">=", "==") for line in lines))
    session.install("--no-deps", ".")
    session.run("python", "-m", "pytest", "-n", "auto", *session.posargs)


@nox.session(python=PYTHONS[0])
def newest(session: nox.Session) -> None:
    """All tests with the newest Warp of the index, pre-releases too: three modules use names that it may change."""
    session.install(".[test]")
    session.install("--upgrade", "--pre", "warp-lang")
    session.run("python", "-m", "pytest", "-n", "auto", *session.posargs)


@nox.session(venv_backend="none")
def long(session: nox.Session) -> None:
    """The tests that take minutes, in this environment, then `faults`; `-- -k first`: some of these tests alone."""
    session.run("python", "-m", "pytest", "-m", "long", *session.posargs, external=True)
    if not session.posargs:
        session.notify("faults")


@nox.session(venv_backend="none")
def faults(session: nox.Session) -> None:
    """Plant faults in a copy, one by one, and let the tests find each: `-- NAME` some of them."""
    session.run("python", str(TESTS / "planted"), *session.posargs, external=True)


@nox.session(venv_backend="none")
def figures(session: nox.Session) -> None:
    """Say which figures and tables of the pages are stale, in this environment: `-- method rotor` some of them."""
    session.run("python", "docs/redraw.py", "--check", *session.posargs, external=True)
