"""The README's example is short, and its commands, its guarantee and its options are there."""

import ast
import re
from dataclasses import fields
from pathlib import Path

import ccd_warp as ccd
from ccd_warp._input.options import Options

README = Path(__file__).resolve().parent.parent / "README.md"


def _blocks(language: str) -> list[str]:
    return re.findall(
        rf"^```{language}\n(.*?)^```$", README.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE
    )


def test_example_is_about_ten_lines():
    (code,) = _blocks("python")
    assert sum(bool(line) and not line.startswith(("import", "from")) for line in code.splitlines()) <= 10


def test_the_two_commands_stand_alone():
    commands = [line for block in _blocks("sh") for line in block.splitlines()]
    assert "pip install -e . && ccd-warp demo" in commands
    assert "pip install -e '.[test]' && pytest" in commands


def test_guarantee_is_stated():
    text = " ".join(README.read_text(encoding="utf-8").replace("\n> ", " ").split())
    assert (
        "If the exact trajectories first touch (or come within the minimum separation) at τ ≤ t_max, the reported toi "
        "is ≤ τ. `inf` is certain. A finite toi without a collision is possible only where the L∞ gap falls below "
        "separation + δ + ε." in text
    )


def test_the_table_holds_every_option_and_its_default():
    text = README.read_text(encoding="utf-8").partition("\n## Options\n")[2].partition("\n## ")[0]
    table = {name: ast.literal_eval(default) for name, default in re.findall(r"^\| `(\w+)` \| `(\S+)` \|", text, re.M)}
    assert table == {field.name: field.default for field in fields(Options)}
    assert table.keys() == ccd.MeshOptions.__optional_keys__
