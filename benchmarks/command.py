"""The command ``ccd-warp bench``."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from ccd_warp.benchmarks import require_extra

SECTIONS_HELP = "sweep, cases, batches, start, threads, steps, broad, worlds, small, pairs, growth, rigid"
INTERRUPTED = 130


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command, without importing anything of the extra."""
    parser.add_argument("--quick", action="store_true", help="smaller samples: within five minutes on two cores")
    parser.add_argument(
        "--data", metavar="DIR", type=Path, help="folder of queries and frames in the public formats (CCD_WARP_DATA)"
    )
    parser.add_argument(
        "--output",
        metavar="DIR",
        type=Path,
        default=Path("ccd_warp_bench"),
        help="folder of raw figures, pictures and report (ccd_warp_bench)",
    )
    parser.add_argument("--only", metavar="PART", nargs="+", help=f"parts to measure: {SECTIONS_HELP} (all)")
    parser.add_argument(
        "--merge", action="store_true", help="with --only: keep the other parts that --output holds, and replace these"
    )
    parser.add_argument("--devices", metavar="NAME", nargs="+", help="Warp devices of ours (the CPU and every GPU)")
    parser.add_argument("--max-queries", metavar="N", type=int, help="most queries of a set (20000; quick: 2000)")
    parser.add_argument(
        "--compare",
        metavar="OLD.json",
        type=Path,
        help="say what became slower or less accurate, by ratio to the peer in the same run; exit status 1 if worse",
    )
    parser.add_argument(
        "--threshold", metavar="X", type=float, help="largest ratio that --compare lets pass, above 1 (1.25)"
    )
    parser.add_argument("--render", action="store_true", help="measure nothing: pictures, report from the raw figures")
    parser.add_argument("--docs", metavar="DIR", type=Path, help="root of a checkout whose docs and README to write")
    parser.add_argument("--quiet", action="store_true", help="print nothing but errors, and what --compare finds")


def run(arguments: argparse.Namespace) -> int:
    """Measure, draw, write, compare.

    Returns:
        0; 1 if ``--compare`` found something worse; 130 after Ctrl-C, with what was measured kept.

    Raises:
        ValueError: If an argument is wrong, or the extra is not installed.
    """
    require_extra()
    from ccd_warp.benchmarks import bench, compare
    from ccd_warp.benchmarks.figures import draw_all
    from ccd_warp.benchmarks.methods import check_devices
    from ccd_warp.benchmarks.query_sets import default_data
    from ccd_warp.benchmarks.raw_file import read_raw
    from ccd_warp.benchmarks.report import check_docs, document, summary, write_docs

    from ccd_warp._cli.progress import waiting

    threshold = compare.DEFAULT_THRESHOLD if arguments.threshold is None else arguments.threshold
    if not threshold > 1:
        raise ValueError(f"threshold is {threshold}; expected a number above 1")
    if arguments.max_queries is not None and arguments.max_queries < 1:
        raise ValueError(f"max-queries is {arguments.max_queries}; expected a positive integer")
    for part in arguments.only or []:
        if part not in bench.SECTIONS:
            raise ValueError(f"only holds {part!r}; expected some of {', '.join(bench.SECTIONS)}")
    # all errors of the arguments are found before the hours of measuring
    old = None if arguments.compare is None else read_raw(arguments.compare)
    folder: Path = arguments.output
    if arguments.merge and not arguments.only:
        raise ValueError("merge is given without --only; expected both, or neither")
    kept = read_raw(folder / bench.RAW) if arguments.merge else None
    if arguments.docs is not None:
        check_docs(arguments.docs)
        if arguments.only and kept is None:
            raise ValueError("docs are written from all parts; expected --docs without --only, or with --merge")
    say = (lambda line: None) if arguments.quiet else print
    if arguments.render:
        raw: dict | None = read_raw(folder / bench.RAW)
        complete = True
    else:
        if arguments.only and kept is None and (folder / bench.RAW).exists():
            raise ValueError(f"{folder} holds figures that --only would drop; expected another --output, or --merge")
        data = arguments.data if arguments.data is not None else default_data()
        if arguments.data is not None and not arguments.data.is_dir():
            raise ValueError(f"data is {arguments.data}; expected a folder")
        if data is None:
            say("no published queries (--data): generated ones only")
        settings = bench.Settings.make(
            quick=arguments.quick,
            data=data,
            devices=check_devices(arguments.devices),
            sections=tuple(s for s in bench.SECTIONS if arguments.only is None or s in arguments.only),
            max_queries=arguments.max_queries,
        )
        try:
            folder.mkdir(parents=True, exist_ok=True)
            (folder / bench.JOURNAL).touch()
        except OSError as error:
            raise ValueError(f"output is {folder}; expected a folder to write to ({error.strerror})") from error
        raw, complete = bench.run(settings, folder, quiet=arguments.quiet, kept=kept)
    if raw is None:
        print("interrupted before the first figure", file=sys.stderr)
        return INTERRUPTED
    with waiting("drawing the pictures and writing the report", is_quiet=arguments.quiet):
        written = draw_all(raw, folder)
        (folder / "bench.md").write_text(document(raw, figures="."), encoding="utf-8")
    for line in summary(raw):
        say(line)
    say(f"\nraw figures, {len(written)} pictures and bench.md are in {folder}")
    if arguments.docs is not None and raw["complete"]:
        with waiting("drawing the pictures of the docs", is_quiet=arguments.quiet):
            draw_all(raw, arguments.docs / "docs" / "figures")
        for path in write_docs(arguments.docs, raw):
            say(f"wrote {path}")
    if not complete:
        print("interrupted; what was measured is kept, and the same command goes on from there", file=sys.stderr)
        return INTERRUPTED
    if old is None:
        return 0
    lines, is_worse = compare.compare(old, raw, threshold)
    print("\n".join(lines))
    return int(is_worse)
