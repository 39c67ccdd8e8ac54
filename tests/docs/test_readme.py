"""The README: a screen for each kind of user first, commands that run, the guarantee; every option in one table."""

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
TEXT = (ROOT / "README.md").read_text(encoding="utf-8")
SECTIONS = dict(zip(*[iter(re.split(r"^## (.*)$", "## \n" + TEXT, flags=re.MULTILINE)[1:])] * 2, strict=True))


def test_each_kind_of_user_comes_first_with_a_screen_of_their_own_and_the_guarantee_is_stated():
    pages = {"In Python": "solver", "On the device": "on_device", "From the command line": "command_line"}
    assert list(SECTIONS)[1:4] == list(pages)
    assert all(command in SECTIONS[""] for command in ("pip install -e . && ccd-warp demo", "pytest -n auto"))
    for title, page in pages.items():
        assert f"](#{title.lower().replace(' ', '-')})" in SECTIONS[""]
        assert f"(docs/{page}.md" in SECTIONS[title] and len(SECTIONS[title].splitlines()) <= 50
        assert re.search(r"^```(python|sh)$", SECTIONS[title], re.M) and "![" in SECTIONS[title]
    assert (
        "If the exact trajectories first touch (or come within the minimum separation) at τ ≤ t_max, the reported toi "
        "is ≤ τ. `inf` is certain. A finite toi without a collision is possible only where the L∞ gap falls below "
        "separation + δ + ε."
    ) in " ".join(SECTIONS["The guarantee"].replace("\n> ", " ").split())


def test_the_command_line_of_the_page_runs(tmp_path, monkeypatch, capsys):
    from ccd_warp._cli.command import main

    monkeypatch.chdir(tmp_path)
    (block,) = re.findall(r"^```sh\n(.*?)^```$", SECTIONS["From the command line"], re.DOTALL | re.M)
    for command in block.splitlines():
        program, *arguments = shlex.split(command)
        assert program == "ccd-warp" and main(arguments) == 0, capsys.readouterr().err
    assert json.loads((tmp_path / "result.json").read_text())
    assert capsys.readouterr().out.count("MISS") == 2  # of the demo, at both ends of its first step


def _options(text: str) -> dict[str, object]:
    return {name: ast.literal_eval(default) for name, default in re.findall(r"^\| `(\w+)` \| `(\S+)` \|", text, re.M)}


def test_the_table_of_calls_holds_every_option_and_its_default():
    text = (ROOT / "docs" / "calls.md").read_text(encoding="utf-8").partition("\n## Options\n")[2]
    of_all, _, of_searches = text.partition("`launch_line_search` also take:")
    assert _options(of_all) == {field.name: field.default for field in fields(Options)}
    assert _options(of_all).keys() == ccd.MeshOptions.__optional_keys__
    for search in (ccd.line_search, ccd.CollisionPipeline.launch_line_search):
        defaults = {name: parameter.default for name, parameter in inspect.signature(search).parameters.items()}
        assert _options(of_searches).items() <= defaults.items()
