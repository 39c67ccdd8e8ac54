"""The README's example is short, and its commands, its guarantee and its options are there."""

import ast
import inspect
import re
from pathlib import Path

import ccd_warp as ccd

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


def test_every_option_is_in_the_table():
    text = README.read_text(encoding="utf-8")
    for function in (ccd.vertex_face_ccd, ccd.edge_edge_ccd, ccd.mesh_ccd, ccd.collision_free_step):
        for name, parameter in inspect.signature(function).parameters.items():
            if parameter.kind is not inspect.Parameter.KEYWORD_ONLY:
                continue
            row = re.search(rf"^\| `{name}` \| (\S+) \|", text, flags=re.MULTILINE)
            assert row, f"{function.__name__}: option {name} is not in the README's table"
            default = ast.literal_eval(row[1].strip("`"))
            assert default == parameter.default, f"{function.__name__}: {name} defaults to {parameter.default!r}"
