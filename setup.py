"""The README as a package index shows it; everything else about the package is stated in pyproject.toml."""

import re
import tomllib
from pathlib import Path

from setuptools import setup

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


if __name__ == "__main__":
    urls = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"].get("urls", {})
    setup(
        long_description=readme_for_an_index((ROOT / "README.md").read_text(encoding="utf-8"), urls.get("Repository")),
        long_description_content_type="text/markdown",
    )
