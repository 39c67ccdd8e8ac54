"""The code of the files of this folder, compiled once: a plain import executes the code that specialisations execute.

Warp parses the source of a function once for each code object.
"""

from importlib.machinery import SourceFileLoader
from types import CodeType

_kept: dict[str, CodeType | None] = {}


class KeptCode(SourceFileLoader):
    """A loader of a file that keeps its code."""

    def get_code(self, fullname: str) -> CodeType | None:
        """The code of the file, the same object each time."""
        if fullname not in _kept:
            _kept[fullname] = super().get_code(fullname)
        return _kept[fullname]
