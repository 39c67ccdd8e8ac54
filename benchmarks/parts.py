"""The parts that `run.py` measures, each of which yields rows."""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import product
from pathlib import Path

import checkout
import many_worlds
import numpy as np
import raw
import rigid
import rigid_peers
import scaling
import separation
import small_scenes
import warp as wp
import whole_step
from hard_cases import FAMILIES
from interleaved import Effort, measure
from machine import commit, machine
from methods import DEFAULT_TOLERANCE, KINDS, all_methods, check_devices
from query_sets import GENERATED, QuerySet, default_data, generated_sets, make_set, published_sets
from scenes import FRONTIER, all_scenes
from scenes import small_scenes as all_small_scenes

Rows = Iterator[dict]


@dataclass(frozen=True)
class Sizes:
    """How much is measured.

    ``generated`` are the queries of each generated set, and of each family in the set of hard cases; ``case_queries``
    those of a family and kind; ``rounds`` the repeats of everything that has no effort of its own; ``small_rounds``
    those of a small scene and a single pair; ``growth`` the faces of the scenes of growing size.
    """

    max_queries: int
    tolerances: tuple[float, ...]
    generated: tuple[int, int]
    sweep: Effort
    case_queries: int
    cases: Effort
    batches: tuple[int, ...]
    rounds: int
    step_seconds: float
    step_rounds: int
    worlds: tuple[int, ...]
    small_rounds: int
    growth: tuple[int, ...]


FULL = Sizes(
    max_queries=20_000,
    tolerances=tuple(10.0**-k for k in range(1, 13)),
    generated=(5_000, 100),
    sweep=Effort(rounds=5, batch=100_000, seconds=0.05, peer_seconds=1.0, cap=0.1),
    case_queries=300,
    cases=Effort(rounds=3, batch=10_000, seconds=0.03, peer_seconds=1.5, cap=0.1),
    batches=tuple(10**k for k in range(8)),
    rounds=5,
    step_seconds=10.0,
    step_rounds=3,
    worlds=(64, 256, 1_024, 2_048),
    small_rounds=25,
    growth=(10_000, 30_000, 100_000, 300_000, 1_000_000, 2_000_000),
)
QUICK = Sizes(
    max_queries=2_000,
    tolerances=(1e-1, 1e-3, 1e-6, 1e-12),
    generated=(1_000, 20),
    sweep=Effort(rounds=3, batch=20_000, seconds=0.015, peer_seconds=0.2, cap=0.05),
    case_queries=100,
    cases=Effort(rounds=1, batch=2_000, seconds=0.01, peer_seconds=0.15, cap=0.05),
    batches=tuple(10**k for k in range(6)),
    rounds=3,
    step_seconds=2.0,
    step_rounds=2,
    worlds=(64, 1_024),
    small_rounds=7,
    growth=(10_000, 30_000, 100_000),
)


class Run:
    """The parts, each a method that yields rows."""

    def __init__(self, is_quick: bool, data: Path | None, devices: list[str]) -> None:
        self.is_quick, self.data, self.devices = is_quick, data, devices
        self.sizes = QUICK if is_quick else FULL
        self.methods = all_methods(devices)
        self._sets: list[QuerySet] = []

    def all_sets(self) -> list[QuerySet]:
        """The sets of queries, solved in exact arithmetic when they are first needed."""
        if not self._sets:
            published = [] if self.data is None else published_sets(self.data, self.sizes.max_queries)
            names = GENERATED[:1] if self.is_quick else GENERATED
            self._sets = published + generated_sets(*self.sizes.generated, names)
        return self._sets

    def sets(self) -> Rows:
        return (queries.describe() for queries in self.all_sets())

    def sweep(self) -> Rows:
        for queries, tolerance in product(self.all_sets(), self.sizes.tolerances):
            about = {"set": queries.name, "kind": queries.kind, "tolerance": tolerance}
            yield from (about | row for row in measure(self.methods, queries, tolerance, self.sizes.sweep))

    def cases(self) -> Rows:
        """Every family at the default tolerance; the unit is each query's own size, or that of its separation."""
        for (name, case), kind in product(FAMILIES.items(), KINDS):
            points = case(kind, self.sizes.case_queries, np.random.default_rng(2))
            options = {"separation": case.minimum_separation, "most": self.sizes.case_queries}
            options["length_scale"] = case.length_scale if case.minimum_separation else None
            rows = measure(self.methods, make_set(name, kind, *points, **options), DEFAULT_TOLERANCE, self.sizes.cases)
            yield from ({"family": name, "kind": kind} | row for row in rows)

    def batches(self) -> Rows:
        memory = machine()["memory_gib"]
        yield from scaling.measure_batches(self.methods, self.sizes.batches, self.sizes.rounds, memory)

    def start(self) -> Rows:
        yield from scaling.measure_start(self.devices)

    def steps(self) -> Rows:
        for (name, make), device in product(all_scenes(self.data, self.is_quick), self.devices):
            sizes, shown = self.sizes, FRONTIER[: 2 if self.is_quick else None]
            yield from whole_step.measure(make(), device, sizes.step_seconds, sizes.step_rounds, name in shown)

    def worlds(self) -> Rows:
        for name, count, device in product(many_worlds.SCENES, self.sizes.worlds, self.devices):
            yield many_worlds.measure(name, count, device, self.sizes.rounds)

    def small(self) -> Rows:
        for scene, device in product(all_small_scenes(), self.devices):
            yield small_scenes.measure(scene, device, self.sizes.small_rounds)

    def pairs(self) -> Rows:
        for kind, device in product(small_scenes.PAIR_KINDS, self.devices):
            yield small_scenes.measure_pair(kind, device, self.sizes.small_rounds)

    def growth(self) -> Rows:
        return map(whole_step.grow_apart, self.sizes.growth)

    def rigid(self) -> Rows:
        yield from rigid.measure_all(self.is_quick)

    def separation(self) -> Rows:
        yield from separation.measure(separation.NUM_FACES)


PARTS = [name for name in vars(Run) if not name.startswith("_") and name != "all_sets"]
# What --all runs besides, after the parts: counts of the code for GPUs, then pictures and tables.
PROGRAMS = (
    "benchmarks/cuda_code.py --output benchmarks/results/cuda_code.csv",
    "benchmarks/report.py",
    "docs/redraw.py method rigid readme stale",
)
# What --all needs and a part would do without, by the extra that brings it.
NEEDED = {name: "rigid-peers" for name in rigid_peers.PEERS.values()} | {"pytest": "test", "nvidia": "cuda-tools"}


def main(about: str | None) -> None:
    """Measure parts, one after the other; ``about`` is what ``--help`` says."""
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", metavar="PART", nargs="*", help=", ".join(PARTS))
    parser.add_argument("--quick", action="store_true", help="smaller samples")
    parser.add_argument("--data", type=Path, default=default_data(), help="folder of queries in the public formats")
    parser.add_argument("--devices", metavar="NAME", nargs="+", help="Warp devices of ours (the CPU and every GPU)")
    parser.add_argument("--output", type=Path, default=Path("bench_results"), help="folder of CSV files")
    parser.add_argument("--stale", action="store_true", help="say which figures of the pages are of other code")
    parser.add_argument("--all", action="store_true", help="all parts, then every table and figure of the pages")
    options = parser.parse_args()
    if options.stale:
        print("\n".join(f"{part}: {why}" for part, why in raw.stale(checkout.RESULTS).items()))
        return
    if not options.quick and (code := commit()).endswith("-dirty"):
        parser.error(f"files have changed since {code.removesuffix('-dirty')}; commit them, or measure with --quick")
    if unknown := set(options.parts) - set(PARTS):
        parser.error(f"{min(unknown)}: expected some of {', '.join(PARTS)}")
    if options.all:
        if absent := {extra for name, extra in NEEDED.items() if find_spec(name) is None}:
            parser.error(f"--all needs pip install '.[{','.join(sorted(absent))}]'")
        if options.quick or options.parts or options.data is None:
            parser.error("--all takes every part and the published queries (--data), and no --quick")
        options.output = checkout.RESULTS
    wp.config.log_level = wp.LOG_ERROR
    run = Run(options.quick, options.data, check_devices(options.devices))
    for part in options.parts or PARTS:
        begin, rows = time.monotonic(), []
        for row in getattr(run, part)():
            rows.append(row)
            words = " ".join(str(value) for value in row.values() if isinstance(value, str))
            print(f"\r{part}, {time.monotonic() - begin:.0f} s: {words:.90}\033[K", end="", file=sys.stderr, flush=True)
        seconds = round(time.monotonic() - begin)
        raw.write(options.output, part, rows, quick=options.quick, seconds=seconds)
        print(f"\r{part}: {len(rows)} rows in {seconds} s\033[K", flush=True)
    for program in PROGRAMS if options.all else ():
        print(f"python {program}", flush=True)
        subprocess.run([sys.executable, *program.split()], cwd=checkout.ROOT, check=True)
