"""`docs/redraw.py` finds figures and tables that are stale, and only these: planted ones, of every sort."""

import importlib.util
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
FIGURES = Path("docs", "figures")

image = pytest.importorskip("matplotlib.image", reason="the extra docs is not installed")
specification = importlib.util.spec_from_file_location("redraw", ROOT / "docs" / "redraw.py")
redraw = importlib.util.module_from_spec(specification)
specification.loader.exec_module(redraw)

BY_NAME = {maker.name: maker for maker in redraw.MAKERS}


@pytest.fixture
def checkout(tmp_path):
    """The pages and figures of this checkout, to plant faults in."""
    shutil.copytree(ROOT / "docs", tmp_path / "docs")
    shutil.copy(ROOT / "README.md", tmp_path)
    return tmp_path


def test_a_figure_is_stale_where_a_number_on_it_is_another(checkout):
    assert redraw.stale_of(BY_NAME["rigid"], checkout) == {}
    path = checkout / FIGURES / "arcs.png"
    pixels = image.imread(path).copy()
    x, y = np.argwhere(pixels[..., 0] < 0.3)[0]  # where something is written, as wide as a digit
    pixels[x : x + 8, y : y + 5, :3] = 1.0 - pixels[x : x + 8, y : y + 5, :3]
    image.imsave(path, pixels)
    (found,) = redraw.stale_of(BY_NAME["rigid"], checkout).items()
    assert found[0] == FIGURES / "arcs.png" and re.fullmatch(r"differs in \d+ pixels", found[1])


def test_a_figure_of_another_size_or_none_is_stale(checkout):
    made = ROOT / FIGURES / "arcs.png"
    assert redraw.difference(made, made) == ""
    assert "pixels, not" in redraw.difference(ROOT / FIGURES / "simple.png", made)
    assert redraw.difference(checkout / "none.png", made) == "is missing"


def test_a_table_is_stale_where_a_figure_in_it_is_another(checkout):
    pytest.importorskip("psutil", reason="the extra bench is not installed")
    page = checkout / "docs" / "choosing.md"
    text = page.read_text(encoding="utf-8")
    assert redraw.stale_of(BY_NAME["separation"], checkout) == {}
    table = re.search("<!-- separation: begin -->.*<!-- separation: end -->", text, re.DOTALL)[0]
    contacts = re.findall(r"\| (\d+) \|", table)[-1]
    page.write_text(text.replace(table, table.replace(contacts, str(int(contacts) + 1), 1)), encoding="utf-8")
    (found,) = redraw.stale_of(BY_NAME["separation"], checkout).items()
    assert found[0] == Path("docs", "choosing.md") and found[1].startswith("differs in 2 lines, as -| ")


def test_a_figure_of_an_example_is_stale_where_the_program_or_the_figure_is_another(tmp_path):
    (tmp_path / "examples").mkdir()
    (tmp_path / FIGURES).mkdir(parents=True)
    program, beside = tmp_path / "examples" / "spin.py", tmp_path / "examples" / "spun.py"
    figure = tmp_path / FIGURES / "spin.png"
    program.write_text("import spun\n\nTURNS = 3  # a step\n")
    beside.write_text("SPEED = 1.0\n")
    figure.write_bytes(b"drawn")
    (maker,) = redraw.examples(tmp_path)
    assert "never recorded" in redraw.stale_example(maker, tmp_path)
    redraw.record([maker], {"spin": 2.0}, tmp_path)
    assert redraw.stale_example(maker, tmp_path) == "" and redraw.read_records(tmp_path)["spin"]["seconds"] == 2
    program.write_text("import spun\n\nTURNS = 3  # in a step\n")
    assert redraw.stale_example(maker, tmp_path) == ""
    for path, changed in ((program, "import spun\n\nTURNS = 4\n"), (beside, "SPEED = 2.0\n")):
        before = path.read_text()
        path.write_text(changed)
        assert redraw.stale_example(maker, tmp_path) == "was drawn before examples/spin.py was changed"
        path.write_text(before)
    figure.write_bytes(b"painted")
    assert redraw.stale_example(maker, tmp_path) == "is another than the one that its program drew"


def test_every_figure_has_one_maker_and_every_program_that_draws_is_one():
    makers = [*redraw.MAKERS, *redraw.examples()]
    made = [name for maker in makers for name in maker.figures]
    assert sorted(made) == sorted(p.stem for p in (ROOT / FIGURES).glob("*.png") if "explore" not in p.stem)
    commands = " ".join(maker.command for maker in makers)
    for path in (ROOT / "docs").glob("make_*.py"):
        assert f"docs/{path.name}" in commands
    listed = redraw.listed(makers)
    assert "    python docs/make_figures.py docs/figures" in listed
    assert not any("{" in line for line in listed)


def test_tables_between_marks_have_a_maker():
    pages = {page for maker in redraw.MAKERS for page in maker.pages}
    for path in [ROOT / "README.md", *ROOT.glob("docs/**/*.md")]:
        name = path.relative_to(ROOT).as_posix()
        for mark in re.findall("<!-- (.*): begin -->", path.read_text(encoding="utf-8")):
            assert redraw.ONLY_MEASURED.get(mark, [None])[0] == name or name in pages, (name, mark)
