"""The tests under every Python that pyproject.toml claims and that is found here: run `nox`.

Interpreters that are absent are skipped, and nox says so. What follows `--` goes to pytest: `nox -- -k bullet`.
"""

import nox

nox.needs_version = ">=2024.10"
nox.options.error_on_missing_interpreters = False
nox.options.reuse_existing_virtualenvs = True
PYTHONS = nox.project.python_versions(nox.project.load_toml("pyproject.toml"))


@nox.session(python=PYTHONS)
def tests(session: nox.Session) -> None:
    """Install the package with what its tests need, as a user would, and run them."""
    session.install(".[test]")
    session.run("python", "-m", "pytest", *session.posargs)
