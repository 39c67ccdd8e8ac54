"""The README as a package index shows it, and kernels in a wheel; all else about the package is in pyproject.toml."""

import os
import re
import shutil
import tomllib
from pathlib import Path

from setuptools import Distribution, setup
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build_py import build_py

ROOT = Path(__file__).resolve().parent
# A picture, or a link that stands by itself: the mark, the text in brackets and the target in parentheses.
_LINK = re.compile(r"(!?)\[([^\]]*)\]\(((?!https?:|#)[^)\s]+)\)")


def readme_for_an_index(text: str, repository: str | None) -> str:
    """The README with targets that a package index can follow, because no file of the project lies beside it there.

    Args:
        text: The README, with links and pictures relative to its folder.
        repository: Address of the public repository, as ``project.urls`` states it, or None while there is none.

    Returns:
        The text with absolute addresses in the repository; without a repository, with a picture's description and a
        file's name in the source distribution in their place, so that nothing leads nowhere.
    """

    def replacement(match: re.Match[str]) -> str:
        mark, label, target = match.groups()
        file = target.partition("#")[0]
        if repository:
            return f"{mark}[{label}]({repository.rstrip('/')}/{'raw' if mark else 'blob'}/main/{target})"
        if mark:
            return f"*Picture: {label} (`{file}` in the source distribution).*"
        return label if file in label or label == "LICENSE" else f"{label} (`{file}` in the source distribution)"

    return _LINK.sub(replacement, text)


# A folder of `ccd-warp compile --package`, which a wheel then holds; `nox -s wheel` names it.
OBJECTS = os.environ.get("CCD_WARP_OBJECTS", "")
PLATFORM = "manylinux_2_28_x86_64"  # that of Warp's own wheel: objects need no library but Warp's


class OfPlatform(Distribution):
    """A distribution for one platform."""

    def has_ext_modules(self) -> bool:
        return True


class BuildWithObjects(build_py):
    """The package with compiled kernels."""

    def run(self) -> None:
        super().run()
        if not self.editable_mode:
            into = Path(self.build_lib, "ccd_warp", "_objects")
            shutil.rmtree(into, ignore_errors=True)  # of an earlier build
            shutil.copytree(OBJECTS, into)


class WheelWithObjects(bdist_wheel):
    """A wheel for every Python on the platform."""

    def get_tag(self) -> tuple[str, str, str]:
        return "py3", "none", PLATFORM


WITH_OBJECTS = {"distclass": OfPlatform, "cmdclass": {"build_py": BuildWithObjects, "bdist_wheel": WheelWithObjects}}

if __name__ == "__main__":
    urls = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"].get("urls", {})
    setup(
        long_description=readme_for_an_index((ROOT / "README.md").read_text(encoding="utf-8"), urls.get("Repository")),
        long_description_content_type="text/markdown",
        **(WITH_OBJECTS if OBJECTS else {}),
    )
