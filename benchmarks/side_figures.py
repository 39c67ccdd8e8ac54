"""Shared by the small benchmarks: interleaved rounds, and a raw file with a table made from it on one page."""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import warp as wp
from ccd_warp.benchmarks.machine import describe, machine
from ccd_warp.benchmarks.report import with_table


def interleaved(calls: dict[Any, Callable[[], Any]], rounds: int, device: Any = None) -> dict[Any, float]:
    """Median seconds of each call, after one to warm up; each includes waiting for the device."""
    seconds: dict[Any, list[float]] = {name: [] for name in calls}
    for k in range(rounds + 1):
        for name, call in calls.items():
            begin = time.perf_counter()
            call()
            wp.synchronize_device(device)
            if k:
                seconds[name].append(time.perf_counter() - begin)
    return {name: statistics.median(values) for name, values in seconds.items()}


def parser(description: str, page: str) -> argparse.ArgumentParser:
    """The parser of the options that `publish` reads."""
    options = argparse.ArgumentParser(description=f"{description}, as a table and as JSON.")
    options.add_argument("--output", type=Path, help="where the figures go, JSON")
    options.add_argument("--docs", type=Path, help=f"{page}, whose table is written")
    return options


def publish(options: argparse.Namespace, name: str, rows: list[dict], lines: list[str]) -> None:
    """Print a table, and write the raw file and the page given by the options."""
    here = machine()
    print("\n".join([describe(here), "", *lines]))
    if options.output:
        options.output.write_text(json.dumps({"machine": here, "rows": rows}, indent=1) + "\n", encoding="utf-8")
    if options.docs:
        text = options.docs.read_text(encoding="utf-8")
        options.docs.write_text(with_table(text, name, lines), encoding="utf-8")
