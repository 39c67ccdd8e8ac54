"""Files of these folders as templates: each is executed once for every set of parameters, into a module of its own.

A template imports the parameters on which it depends from `parameters`; in a specialisation they have the values of
that, and what the template imports from other templates is specialised alike. A file that imports no parameter is an
ordinary module. Imported plainly, a template is the specialisation for the values that stand in `parameters`. So
kernels are plain functions of plain modules, while each precision, number of lanes and norm compiles only what it
needs.
"""

import builtins
import importlib
import re
import sys
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from types import CodeType, ModuleType, SimpleNamespace
from typing import Any

from . import parameters
from .kept_code import KeptCode
from .later import BUILTINS
from .once import building, once, uncollected

_FOLDER = Path(__file__).parent
_FOLDERS = {"", *(path.name for path in _FOLDER.iterdir() if path.is_dir())}
# What a file imports from here: how many folders up, a module and its names, or a folder and modules.
_IMPORT = re.compile(r"^ *from (\.+)([\w.]*) import (\([^)]*\)|.*)", re.MULTILINE)
_NAME = re.compile(r"(\w+)(?: as \w+)?")


@cache
def _read(name: str) -> tuple[str, CodeType, str]:
    """The path, the code and the source of a file."""
    full_name, path = f"{__package__}.{name}", str(_FOLDER / f"{name.replace('.', '/')}.py")
    loader = KeptCode(full_name, path)
    return path, loader.get_code(full_name), loader.get_source(full_name)


def _modules(name: str, level: int, imported: str, wanted: Iterable[str]) -> dict[str, str]:
    """The modules of an import in a file by name: several, or one with no name from which names are taken."""
    folder = name.split(".")[:-1]
    path = [*folder[: len(folder) - level + 1], *filter(None, imported.split("."))]
    if "/".join(path) in _FOLDERS:
        return {module: ".".join([*path, module]) for module in wanted}
    return {"": ".".join(path)}


@cache
def _parameters_of(name: str) -> frozenset[str]:
    """The parameters on which a file depends: those that it imports and those of what it imports, if it imports any."""
    used: set[str] = set()
    modules: set[str] = set()
    for dots, imported, names in _IMPORT.findall(_read(name)[2]):
        wanted = _NAME.findall(names)
        from_here = _modules(name, len(dots), imported, wanted)
        modules.update(from_here.values())
        used.update(wanted if from_here.get("") == "parameters" else ())
    if used:
        used.update(*map(_parameters_of, modules - {"parameters"}))
    return frozenset(used)


@once
def _specialise(name: str, values: tuple[tuple[str, Any], ...]) -> ModuleType:
    """A template, executed with parameters other than those of a plain import."""
    suffix = ".".join(str(getattr(value, "__name__", value)) for _, value in values)
    module = ModuleType(f"{__package__}.{name}.{suffix}")
    alike = dict(values)

    def import_alike(imported: str, scope: Any = None, local: Any = None, wanted: Any = (), level: int = 0) -> Any:
        if level == 0:
            return BUILTINS["__import__"](imported, scope, local, wanted, level)
        modules = _modules(name, level, imported, wanted)
        if "" not in modules:
            return SimpleNamespace(**{name: specialised(module, **alike) for name, module in modules.items()})
        return SimpleNamespace(**alike) if modules[""] == "parameters" else specialised(modules[""], **alike)

    path, code, _ = _read(name)
    module.__dict__.update(
        __file__=path,
        __package__=f"{__package__}.{name}".rpartition(".")[0],
        __builtins__={**vars(builtins), "__import__": import_alike},
    )
    sys.modules[module.__name__] = module  # where those look for it who read the source of a function
    exec(code, module.__dict__)
    return module


def specialised(name: str, **values: Any) -> Any:
    """A template for parameters, once for each set of those on which it depends.

    Args:
        name: Its folder and its name, as in ``pair.solver``.
        values: The parameters by name; those left out are as in a plain import.

    Raises:
        ValueError: If there is no such parameter.
    """
    plain = vars(parameters)
    if not values.keys() <= plain.keys():
        raise ValueError(f"{name} is asked for with {', '.join(values)}; expected parameters of kernels/parameters.py")
    wanted = sorted(_parameters_of(name))
    settings = tuple((parameter, values.get(parameter, plain[parameter])) for parameter in wanted)
    if all(value == plain[parameter] for parameter, value in settings):
        module = sys.modules.get(f"{__package__}.{name}")
        if module is not None and not getattr(module.__spec__, "_initializing", False):
            return module
        with building, uncollected():  # before the locks of imports: a thread that specialises imports with it locked
            return importlib.import_module(f"{__package__}.{name}")
    return _specialise(name, settings)
