"""The command `ccd-warp explore`: the page that it writes, its errors, and the pictures of the docs."""

import re
import runpy
import struct
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest

import ccd_warp as ccd
from ccd_warp._cli.command import main


def test_the_page_is_written_into_an_empty_folder(tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "ccd_warp", "explore"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == "wrote ccd_warp_explore.html; open it in a browser\n"
    assert [path.name for path in tmp_path.iterdir()] == ["ccd_warp_explore.html"]


def test_a_page_that_is_there_is_written_again_as_by_the_other_commands(tmp_path, capfd):
    path = tmp_path / "page.HTM"
    path.write_text("old")
    assert main(["explore", "--output", str(path)]) == 0
    assert "page.HTM" in capfd.readouterr().out
    assert path.read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    assert main(["explore", "--output", str(path), "--quiet"]) == 0
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("page.txt", "--output page.txt: the name must end in .html, .htm"),
        ("page", "must end in .html, .htm"),
        ("no_such_folder/page.html", "the folder no_such_folder does not exist; create it first"),
        ("folder.html", "cannot write folder.html (Is a directory)"),
    ],
)
def test_a_name_that_will_not_do_is_refused_in_one_line(tmp_path, capfd, monkeypatch, name, words):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder.html").mkdir()
    assert main(["explore", "--output", name]) == 2
    captured = capfd.readouterr()
    assert captured.out == "" and captured.err.count("\n") == 1 and words in captured.err
    assert [path.name for path in tmp_path.iterdir()] == ["folder.html"]


class _Outline(HTMLParser):
    """Checks that elements are closed in their order, and collects attributes."""

    VOID = frozenset({"meta", "link", "input", "circle", "line"})

    def __init__(self):
        super().__init__()
        self.open: list[str] = []
        self.attributes: list[tuple[str, str, str | None]] = []

    def handle_starttag(self, tag, attrs):
        self.attributes += [(tag, name, value) for name, value in attrs]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.attributes += [(tag, name, value) for name, value in attrs]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag, tag


def test_the_page_is_whole_and_names_no_address(explore_file):
    text = explore_file.read_text(encoding="utf-8")
    assert "{{" not in text and "}}</" not in text
    assert f"ccd-warp {ccd.__version__}" in text
    assert not re.search(r"\b(https?|ftp|wss?|file):", text)
    assert not re.search(r"@import|\bfetch\(|XMLHttpRequest|\bimport\b[^;]*\bfrom\b|url\(", text)
    outline = _Outline()
    outline.feed(text)
    outline.close()
    assert outline.open == []
    identifiers = [value for _, name, value in outline.attributes if name == "id"]
    assert len(identifiers) == len(set(identifiers)) > 40
    assert {(name, value) for _, name, value in outline.attributes if name in ("src", "href")} == {("href", "data:,")}
    policy = next(value for _, name, value in outline.attributes if name == "content" and "default-src" in value)
    assert "default-src 'none'" in policy


def test_the_pictures_of_the_docs_can_be_taken_again(browser, monkeypatch, tmp_path, capsys):
    """The two that stand there are of the same parts of the page, in the same width."""
    folder = Path(__file__).resolve().parents[2] / "docs"
    pictures = runpy.run_path(str(folder / "make_explore_pictures.py"))
    monkeypatch.setitem(pictures["main"].__globals__, "FIGURES", tmp_path)
    pictures["main"]()
    names = ["explore_bullet.png", "explore_pair.png"]
    assert sorted(path.name for path in tmp_path.iterdir()) == names
    for name in names:
        sizes = []
        for path in (tmp_path / name, folder / "figures" / name):
            data = path.read_bytes()
            assert data.startswith(b"\x89PNG") and len(data) < 400_000
            sizes.append(struct.unpack(">II", data[16:24]))
        assert sizes[0][0] == sizes[1][0] == 1200
        assert sizes[0][1] == pytest.approx(sizes[1][1], rel=0.2)  # fonts differ between machines
