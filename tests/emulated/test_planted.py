"""The table of planted faults is that of the code as it is; `nox -s faults` plants them."""

import ast

import pytest

from emulated.planted import FINDERS, PLANTED, ROOT, fault_in


def test_every_fault_is_a_change_of_a_file():
    for fault in PLANTED:
        source = (ROOT / fault.file).read_text(encoding="utf-8")
        planted = fault_in(fault, source)
        assert ast.dump(ast.parse(planted)) != ast.dump(ast.parse(source)), fault.name
        assert fault.finders and set(fault.finders) <= FINDERS.keys(), fault.name


def test_a_fault_whose_text_is_gone_is_named():
    fault = PLANTED[0]
    with pytest.raises(LookupError, match=f"{fault.name}.* is 0 times in {fault.file}; expected once"):
        fault_in(fault, "")


def test_names_are_different():
    assert len({fault.name for fault in PLANTED}) == len(PLANTED) >= 40
