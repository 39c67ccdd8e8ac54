"""The code of the files of this folder, compiled once: a plain import executes the code that specialisations execute.

Warp parses the source of a function once for each code object.
"""

from importlib.machinery import SourceFileLoader
from types import CodeType, ModuleType

from .later import BUILTINS, sources

codes: dict[str, CodeType] = {}  # of the files that have been executed, by their paths, as in `sources`


class KeptCode(SourceFileLoader):
    """A loader of a file that keeps its code."""

    def get_code(self, fullname: str) -> CodeType:
        """The code of the file, the same object each time."""
        if self.path not in codes:
            sources[self.path] = self.get_data(self.path)
            code = super().get_code(fullname)
            assert code is not None
            codes[self.path] = code
        return codes[self.path]

    def exec_module(self, module: ModuleType) -> None:
        """Execute the file, with functions and kernels that Warp reads later."""
        module.__dict__["__builtins__"] = BUILTINS
        super().exec_module(module)
