"""Shared by the small benchmarks: a raw file, and a table made from it on one page."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path

from ccd_warp.benchmarks.machine import describe, machine
from ccd_warp.benchmarks.report import with_table


def parser(description: str, page: str) -> argparse.ArgumentParser:
    """The parser of the options that `publish` reads."""
    options = argparse.ArgumentParser(description=f"{description}, as a table and as JSON.")
    options.add_argument("--output", type=Path, help="where the figures go, JSON")
    options.add_argument("--docs", type=Path, help=f"{page}, whose table is written")
    options.add_argument("--render", type=Path, metavar="FILE", help="measure nothing: the table from these figures")
    return options


def rows_of(options: argparse.Namespace, measure: Callable[[], list[dict]]) -> list[dict]:
    """The rows of the file given by ``--render``, or those that are measured now."""
    if options.render is None:
        return measure()
    rows: list[dict] = json.loads(options.render.read_text(encoding="utf-8"))["rows"]
    return rows


def publish(options: argparse.Namespace, name: str, rows: list[dict], lines: list[str]) -> None:
    """Print a table, and write the raw file and the page given by the options."""
    here = machine()
    if options.render is None:
        print("\n".join([describe(here), "", *lines]))
    if options.output and options.render is None:
        options.output.write_text(json.dumps({"machine": here, "rows": rows}, indent=1) + "\n", encoding="utf-8")
    if options.docs:
        text = options.docs.read_text(encoding="utf-8")
        options.docs.write_text(with_table(text, name, lines), encoding="utf-8")
