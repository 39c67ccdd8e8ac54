"""The code of the files of this folder, compiled once: a plain import executes the code that specialisations execute.

Warp parses the source of a function once for each code object.
"""

from importlib.machinery import SourceFileLoader
from types import CodeType, ModuleType

from .later import BUILTINS, sources

_kept: dict[str, CodeType | None] = {}


class KeptCode(SourceFileLoader):
    """A loader of a file that keeps its code."""

    def get_code(self, fullname: str) -> CodeType | None:
        """The code of the file, the same object each time."""
        if fullname not in _kept:
            sources[self.path] = self.get_data(self.path)
            _kept[fullname] = super().get_code(fullname)
        return _kept[fullname]

    def exec_module(self, module: ModuleType) -> None:
        """Execute the file, with functions and kernels that Warp reads later."""
        module.__dict__["__builtins__"] = BUILTINS
        super().exec_module(module)
