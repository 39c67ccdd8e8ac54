"""The table of planted faults is that of the code as it is; `nox -s faults` plants them."""

import ast

import pytest

from planted import of_gpu
from planted.planting import ROOT, fault_in
from planted.table import PLANTED, table


def test_every_fault_is_a_change_of_a_file():
    for fault in PLANTED:
        source = (ROOT / fault.file).read_text(encoding="utf-8")
        planted = fault_in(fault, source)
        assert ast.dump(ast.parse(planted)) != ast.dump(ast.parse(source)), fault.name
        for finder in fault.finders:
            file, _, test = finder.partition("::")
            is_named = f"def {test}(" in (ROOT / "tests" / file).read_text(encoding="utf-8") if test else True
            assert finder in of_gpu.FINDERS or ((ROOT / "tests" / file).is_file() and is_named), fault.name
        assert fault.finders, fault.name


def test_a_fault_whose_text_is_gone_is_named():
    fault = PLANTED[0]
    with pytest.raises(LookupError, match=f"{fault.name}.* is 0 times in {fault.file}; expected once"):
        fault_in(fault, "")


def test_names_are_different():
    assert len({fault.name for fault in PLANTED}) == len(PLANTED) >= 100


def test_table_has_a_row_for_each_fault():
    rows = [row.split(" | ") for row in table().splitlines() if row.startswith("| ") and not row.startswith("| fault")]
    assert [(row[0][2:], row[1].strip("`")) for row in rows] == [(fault.name, fault.file) for fault in PLANTED]
    assert all(len(row) == 3 and ".py" in row[2] for row in rows)
