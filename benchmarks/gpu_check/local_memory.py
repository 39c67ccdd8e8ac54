"""The table of docs/cuda.md: the stack of each kernel, and the memory that a GPU reserves for it.

    python -m ccd_warp.benchmarks.gpu_check.local_memory cuda_code/cuda_code.json [--docs docs/cuda.md]

The file is that of ``python -m ccd_warp.benchmarks.cuda_code``.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from ccd_warp.benchmarks.numbers import table

# Of an H100 or H200: threads that can be resident on a multiprocessor, and multiprocessors.
THREADS, MULTIPROCESSORS = 2048, 132
_LEAST = 64  # bytes of stack from which on a kernel is listed
_MARKS = "<!-- stacks: begin -->", "<!-- stacks: end -->"


def reserved(stack: int) -> int:
    """Bytes that the driver reserves, at most, for the stacks of all threads that can be resident."""
    return stack * THREADS * MULTIPROCESSORS


def stack_table(kernels: dict[str, dict[str, int]]) -> list[str]:
    """The kernels with a stack, the largest first."""
    rows = sorted((row["stack"], row["registers"], name) for name, row in kernels.items() if row["stack"] >= _LEAST)
    cells = [
        [name.partition(": ")[0], registers, f"{stack:,}", f"{reserved(stack) / 1e6:,.0f} MB"]
        for stack, registers, name in rows[::-1]
    ]
    return table(["kernel", "registers", "stack, bytes", "local memory"], cells)


def with_table(page: str, lines: list[str]) -> str:
    """A page with the table in its place."""
    begin, end = (page.index(mark) for mark in _MARKS)
    return page[: begin + len(_MARKS[0])] + "\n" + "\n".join(lines) + "\n" + page[end:]


def main() -> None:
    """Print the table, or write it into the page."""
    parser = argparse.ArgumentParser(description="The stacks of the kernels, and the memory that they take on a GPU.")
    parser.add_argument("figures", metavar="cuda_code.json", type=Path)
    parser.add_argument("--docs", metavar="docs/cuda.md", type=Path, help="page to write")
    given = parser.parse_args()
    lines = stack_table(json.loads(given.figures.read_text(encoding="utf-8"))["kernels"])
    print("\n".join(lines))
    if given.docs is not None:
        page = given.docs.read_text(encoding="utf-8")
        given.docs.write_text(with_table(page, lines), encoding="utf-8")


if __name__ == "__main__":
    main()
