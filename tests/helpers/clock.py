"""The clock of a test, at whose end pytest ends the process: it stands still while kernels are compiled."""

import faulthandler
from collections.abc import Callable
from functools import wraps
from typing import Any

_LONGEST = 8  # times of a test that one compilation may take, or the wait for that of another process
_limit: dict[str, Any] = {}


def set_limit(seconds: float, **how: Any) -> None:
    """Say how long a test may take, and what happens then, as `faulthandler.dump_traceback_later` takes it."""
    _limit.update(how, seconds=seconds)


def stands_still(compiling: Callable[..., Any]) -> Callable[..., Any]:
    """A function that compiles, after which the clock of the test begins anew."""

    @wraps(compiling)
    def outside(*arguments: Any, **options: Any) -> Any:
        _begin(_LONGEST)
        try:
            return compiling(*arguments, **options)
        finally:
            _begin(1)

    return outside


def _begin(times: int) -> None:
    if _limit.get("seconds"):
        faulthandler.dump_traceback_later(times * _limit["seconds"], file=_limit["file"], exit=_limit["exit"])
