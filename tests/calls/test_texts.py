"""The text of every public call and result: each argument and each field is described once, also where it is shared."""

import inspect
import re
from dataclasses import dataclass, fields, is_dataclass

import pytest

import ccd_warp as ccd
from ccd_warp import datasets, distributed
from ccd_warp._texts import text_completed_by

PUBLIC = [getattr(part, name) for part in (ccd, datasets, distributed) for name in part.__all__]
INDEXED = ("borrowed", "step", "id")  # internal, and by the number of a step or a query alone
OBJECTS = [each for each in PUBLIC if inspect.isclass(each)]
CALLS = [each for each in PUBLIC if inspect.isfunction(each)]
CALLS += [
    each
    for of in OBJECTS
    for name, each in inspect.getmembers(of, lambda each: inspect.isfunction(each) or inspect.ismethod(each))
    if not name.startswith("_") and name not in INDEXED
]


def described(documented: object, section: str) -> list[str]:
    """The names in a section of a docstring."""
    found = re.search(rf"^{section}:\n(.*?)(\n\n|\Z)", inspect.getdoc(documented), re.S | re.M)
    return re.findall(r"^    \*{0,2}(\w+):", found[1], re.M) if found else []


@pytest.mark.parametrize("call", CALLS, ids=lambda call: call.__qualname__)
def test_every_argument_of_a_call_is_described_once_and_in_order(call):
    names = [name for name in inspect.signature(call).parameters if name != "self"]
    assert described(call, "Args") == names


@pytest.mark.parametrize("table", [*filter(is_dataclass, PUBLIC)], ids=lambda table: table.__name__)
def test_every_field_of_a_result_is_described_once(table):
    names = [field.name for field in fields(table) if not field.name.startswith("_")]
    assert sorted(described(table, "Attributes")) == sorted(names)


@pytest.mark.parametrize("name", [name for name in ccd.__all__ if hasattr(ccd.CollisionPipeline, name)])
def test_a_method_of_a_pipeline_says_what_its_function_says(name):
    function, method = getattr(ccd, name), getattr(ccd.CollisionPipeline, name)
    of_function, of_method = inspect.getdoc(function), inspect.getdoc(method)
    assert f":func:`ccd_warp.{name}`" in of_method
    assert of_function[of_function.index("\n\nReturns:") : of_function.index("\n\nRaises:")] in of_method
    assert of_method.endswith(of_function[of_function.index("\n\nGuarantee:") :])
    assert described(function, "Raises") == ["ValueError", "TypeError"]
    assert described(method, "Raises") == ["ValueError"]  # a pipeline has its options


def test_what_a_text_says_itself_comes_before_what_completes_it():
    def whole(first, second, **options):
        """All.

        A paragraph.

        Args:
            first: One,
                on two lines.
            second: Two.
            **options: More.

        Raises:
            ValueError: If bad.
            TypeError: If wrong.

        Guarantee: certain.
        """

    @text_completed_by(whole, without=("TypeError",))
    def part(second, first):
        """Some.

        Args:
            second: Its own.

        Returns:
            A number: 1.
        """

    assert inspect.getdoc(part) == inspect.cleandoc(
        """
        Some.

        Args:
            second: Its own.
            first: One,
                on two lines.

        Returns:
            A number: 1.

        Raises:
            ValueError: If bad.

        Guarantee: certain.
        """
    )


def test_without_docstrings_nothing_is_completed():
    """As under python -OO."""

    @dataclass
    class Row:
        count: int

    Row.__doc__ = None
    assert text_completed_by(test_without_docstrings_nothing_is_completed)(Row).__doc__ is None
