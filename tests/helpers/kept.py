"""Answers of slow oracles, kept on disk for later runs: by the question, and by the sources of the oracle."""

import hashlib
import inspect
import os
import pickle
import tempfile
import time
from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

# Beside the compiled kernels, which are kept between runs as well.
_FOLDER = Path(os.environ.get("WARP_CACHE_PATH") or Path.home() / ".cache" / "warp", "ccd_warp_answers")
# What takes less is asked again, in seconds.
_WORTH_KEEPING = 0.005


@cache
def _begun(modules: tuple[ModuleType, ...]) -> Any:
    """The hash of their sources, of which each question takes a copy."""
    return hashlib.sha256("\n".join(inspect.getsource(module) for module in modules).encode())


def _add(question: Any, value: Any) -> None:
    """Add a value to the hash of a question: arrays by their bytes, lists and dictionaries by what they hold."""
    if isinstance(value, np.ndarray):
        question.update(f"{value.dtype} {value.shape}".encode())
        question.update(np.ascontiguousarray(value).tobytes())
    elif isinstance(value, (list, tuple)):
        question.update(f"{len(value)} of".encode())
        for part in value:
            _add(question, part)
    elif isinstance(value, dict):
        _add(question, list(value.items()))
    elif isinstance(value, (str, int, float, np.generic, type(None))):
        question.update(f"{type(value)} {value!r} ".encode())
    else:
        raise TypeError(f"{type(value)} cannot be part of a question; expected arrays, numbers and texts")


def kept(
    oracle: Callable[..., Any],
    *modules: ModuleType,
    question_of: Callable[..., Iterable[Any]] = lambda *arguments, **options: (arguments, options),
) -> Callable[..., Any]:
    """The same oracle, which looks up what it was asked before.

    Args:
        oracle: Answers by its arguments alone; what it returns is pickled.
        modules: Where its source is, and that of all it uses: an answer holds until one of them changes.
        question_of: What of the arguments the answer depends on.
    """

    def ask(*arguments: Any, **options: Any) -> Any:
        question = _begun(modules).copy()
        question.update(oracle.__name__.encode())
        _add(question, list(question_of(*arguments, **options)))
        path = _FOLDER / question.hexdigest()
        try:
            return pickle.loads(path.read_bytes())
        except (OSError, EOFError, pickle.UnpicklingError):  # not there, or cut off
            begin = time.process_time()
            answer = oracle(*arguments, **options)
            if time.process_time() - begin >= _WORTH_KEEPING:
                _write(path, pickle.dumps(answer))
            return answer

    return ask


def _write(path: Path, data: bytes) -> None:
    """Write a file as a whole; several processes may write the same one."""
    _FOLDER.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=_FOLDER, delete=False) as file:
        file.write(data)
    os.replace(file.name, path)
