"""The README: a screen for each kind of user first, short examples, commands that run, the guarantee; every option."""

import ast
import inspect
import json
import re
import shlex
from dataclasses import fields
from pathlib import Path

import ccd_warp as ccd
from ccd_warp._input.options import Options

ROOT = Path(__file__).resolve().parents[2]
README = ROOT / "README.md"


def _blocks(language: str) -> list[str]:
    return re.findall(
        rf"^```{language}\n(.*?)^```$", README.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE
    )


USERS = {
    "In Python": "docs/solver.md",
    "On the device": "docs/on_device.md",
    "From the command line": "docs/command_line.md",
}


def _sections() -> dict[str, str]:
    parts = re.split(r"^## (.*)$", README.read_text(encoding="utf-8"), flags=re.MULTILINE)
    return {"": parts[0], **dict(zip(parts[1::2], parts[2::2], strict=True))}


def test_each_kind_of_user_comes_first_with_a_screen_of_their_own():
    """What it does, how to install it, some ten lines, a picture and where to read on; tables and theory come after."""
    sections = _sections()
    assert list(sections)[1 : 1 + len(USERS)] == list(USERS)
    assert "pip install -e . && ccd-warp demo" in sections[""]
    for title, page in USERS.items():
        assert f"](#{title.lower().replace(' ', '-')})" in sections[""]
        assert re.search(r"^```(python|sh)$", sections[title], re.M)
        assert re.search(r"^!\[[^]]+\]\(docs/figures/\w+\.png\)$", sections[title], re.M)
        assert f"({page}" in sections[title]
        assert len(sections[title].splitlines()) <= 50 and "\n| " not in sections[title]


def test_examples_are_about_ten_lines():
    examples = _blocks("python")
    assert len(examples) == 2
    for code in examples:
        assert sum(bool(line) and not line.startswith(("import", "from")) for line in code.splitlines()) <= 10


def test_the_page_is_short():
    text = README.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 165 and len(text.split()) < 1250


def test_the_command_line_of_the_page_runs(tmp_path, monkeypatch, capsys):
    from ccd_warp._cli.command import main

    monkeypatch.chdir(tmp_path)
    (block,) = re.findall(r"^```sh\n(.*?)^```$", _sections()["From the command line"], re.DOTALL | re.M)
    for command in block.splitlines():
        program, *arguments = shlex.split(command)
        assert program == "ccd-warp" and main(arguments) == 0, capsys.readouterr().err
    assert json.loads((tmp_path / "result.json").read_text())


def test_the_two_commands_stand_alone():
    commands = [line for block in _blocks("sh") for line in block.splitlines()]
    assert "pip install -e . && ccd-warp demo" in commands
    assert "pip install -e '.[test]' && pytest -n auto" in commands


def test_guarantee_is_stated():
    text = " ".join(README.read_text(encoding="utf-8").replace("\n> ", " ").split())
    assert (
        "If the exact trajectories first touch (or come within the minimum separation) at τ ≤ t_max, the reported toi "
        "is ≤ τ. `inf` is certain. A finite toi without a collision is possible only where the L∞ gap falls below "
        "separation + δ + ε." in text
    )


def _options(text: str) -> dict[str, object]:
    return {name: ast.literal_eval(default) for name, default in re.findall(r"^\| `(\w+)` \| `(\S+)` \|", text, re.M)}


def test_the_tables_hold_every_option_and_its_default():
    text = (ROOT / "docs" / "calls.md").read_text(encoding="utf-8").partition("\n## Options\n")[2]
    of_all, _, of_searches = text.partition("`launch_line_search` also take:")
    table = _options(of_all)
    assert table == {field.name: field.default for field in fields(Options)}
    assert table.keys() == ccd.MeshOptions.__optional_keys__
    for search in (ccd.line_search, ccd.CollisionPipeline.launch_line_search):
        defaults = {name: parameter.default for name, parameter in inspect.signature(search).parameters.items()}
        assert _options(of_searches).items() <= defaults.items()
        rounds = {name: value for name, value in defaults.items() if name.endswith("_rounds")}
        assert all(f"`{name}`" in of_searches and f"`{value}`" in of_searches for name, value in rounds.items())
