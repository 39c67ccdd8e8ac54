"""The emulated device of the tests (``tests/emulated``): the CUDA source of every kernel, run on the CPU."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

_PACKAGE = "emulated.device"


def require_emulation(tests: Path | None) -> None:
    """Make the emulation importable.

    Raises:
        ValueError: If it is not at hand, or there is no C++ compiler.
    """
    if tests is None or not (tests / "emulated").is_dir():
        raise ValueError("emulated needs the folder tests/emulated of a checkout; expected --tests DIR with it")
    if str(tests) not in sys.path:
        sys.path.append(str(tests))
    if importlib.import_module("emulated.build").compiler() is None:
        raise ValueError("emulated needs a C++ compiler; expected g++, or one that the environment variable CXX names")


@contextmanager
def emulated_device() -> Iterator[None]:
    """Within this, the CPU runs the CUDA source of a kernel, and the library takes it for a GPU.

    A mesh or a pipeline that was used outside must not be used within, and the reverse.
    """
    with importlib.import_module(_PACKAGE).emulation(_modules()):
        yield


@cache
def _modules() -> Any:
    """The emulated modules, which stay from one block to the next."""
    return importlib.import_module(_PACKAGE).Emulation()
