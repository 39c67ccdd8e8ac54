"""Docstrings that another completes, so that what several calls or results have in common is written once."""

import re
from collections.abc import Callable, Collection
from inspect import cleandoc
from typing import Any, TypeVar

# In the order in which a docstring has them; the first two name what a function takes, and the fields of a class.
_ARGS, _FIELDS, _ERRORS = "Args:", "Attributes:", "Raises:"
_SECTIONS = (_ARGS, _FIELDS, "Returns:", _ERRORS, "References:", "Guarantee:")
_HEADINGS = {_ARGS, _FIELDS, _ERRORS}  # which say nothing alone
_ENTRY = re.compile(r"\n(?=    \S)")

_Documented = TypeVar("_Documented", bound=Any)


def text_completed_by(source: object, *, without: Collection[str] = ()) -> Callable[[_Documented], _Documented]:
    """A decorator that adds to a docstring the sections that it lacks, and the entries that its sections lack.

    They are those of the docstring of ``source``: of arguments and fields those that what is decorated has, and of
    exceptions those that are not in ``without``. ``help()`` and the site show the whole text, an editor that only reads
    the file what is written there.
    """

    def complete(documented: _Documented) -> _Documented:
        if documented.__doc__ and source.__doc__:  # python -OO drops all of them
            is_class = isinstance(documented, type)
            names = documented.__dataclass_fields__ if is_class else documented.__code__.co_varnames
            documented.__doc__ = _completed(documented.__doc__, source.__doc__, names, without)
        return documented

    return complete


def _completed(text: str, source: str, names: Collection[str], without: Collection[str]) -> str:
    by_heading, other = _paragraphs(text), _paragraphs(source)
    paragraphs = [paragraph for first, paragraph in by_heading.items() if first not in _SECTIONS]
    for heading in _SECTIONS:
        section, lacking = by_heading.get(heading, {}), other.get(heading, {})
        entries = lacking | section
        if heading in (_ARGS, _FIELDS):
            section = {name: entries[name] for name in dict.fromkeys((heading, *names, *section)) if name in entries}
        elif heading == _ERRORS:
            section = {name: entry for name, entry in entries.items() if name not in without}
        paragraphs.append(section or lacking)
    return "\n\n".join("\n".join(paragraph.values()) for paragraph in paragraphs if paragraph.keys() - _HEADINGS)


def _paragraphs(text: str) -> dict[str, dict[str, str]]:
    """The paragraphs of a docstring by their first words, each as its heading, or all of it, and entries by names."""
    paragraphs = {}
    for paragraph in cleandoc(text).split("\n\n"):
        head, *entries = _ENTRY.split(paragraph)
        first = head.partition(" ")[0] if head.startswith(_SECTIONS) else head
        paragraphs[first] = {first: head, **{entry.strip(" *").partition(":")[0]: entry for entry in entries}}
    return paragraphs
