"""The benchmark: the tasks in their order. Every task is saved, so that a run can be interrupted and resumed."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from functools import cache, partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from ccd_warp.benchmarks import broad_phases, many_worlds, rigid, scaling, small_scenes, whole_step
from ccd_warp.benchmarks.interleaved import Effort, measure
from ccd_warp.benchmarks.machine import machine
from ccd_warp.benchmarks.methods import KINDS, Method, all_methods
from ccd_warp.benchmarks.numbers import DEFAULT_TOLERANCE
from ccd_warp.benchmarks.query_sets import GENERATED, QuerySet, generated_sets, make_set, published_sets
from ccd_warp.benchmarks.raw_file import merged, write_raw
from ccd_warp.benchmarks.scenes import all_scenes, cloth_over_sphere
from ccd_warp.benchmarks.scenes import small_scenes as all_small_scenes
from hard_cases import FAMILIES
from tqdm import tqdm

from ccd_warp._files.journal import Journal, fingerprint

SECTIONS = ("sweep", "cases", "batches", "start", "threads", "steps", "broad", "worlds", "small", "pairs", "growth")
SECTIONS += ("rigid",)
JOURNAL = "bench.journal"
RAW = "bench.json"


@dataclass(frozen=True)
class Settings:
    """What a run measures.

    Attributes:
        quick: Whether the run should end within five minutes on two cores.
        data: Folder of queries in the public formats, or None.
        devices: Warp devices on which ours is measured.
        sections: Those of :data:`SECTIONS` that are measured.
        max_queries: Largest number of queries in a set; a larger set is sampled.
        tolerances: Tolerances of the sweep.
        generated: Queries of each generated set, and of each family in the set of hard cases.
        sweep: Effort of a point of the sweep.
        case_queries: Queries of a family and kind in the table of hard cases.
        cases: Effort of a cell row of that table.
        batches: Sizes of batches.
        rounds: Interleaved repeats of everything else.
        step_seconds: Time of the rounds of a scene.
        step_rounds: Least rounds of a scene.
        worlds: Numbers of worlds.
        small_rounds: Rounds of a small scene, and of a single pair.
        growth: Faces of the scenes of growing size.
        rigid: Steps, pairs and dice of the part on rigid bodies.
    """

    quick: bool
    data: str | None
    devices: tuple[str, ...]
    sections: tuple[str, ...]
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
    rigid: rigid.Sizes

    @classmethod
    def make(
        cls,
        *,
        quick: bool,
        data: Path | None,
        devices: list[str],
        sections: tuple[str, ...] = SECTIONS,
        max_queries: int | None = None,
    ) -> Settings:
        """The full run, or the quick one."""
        common: dict[str, Any] = {
            "quick": quick,
            "data": None if data is None else str(data),
            "devices": tuple(devices),
            "sections": sections,
        }
        if quick:
            return cls(
                **common,
                max_queries=max_queries or 2_000,
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
                rigid=rigid.QUICK,
            )
        return cls(
            **common,
            max_queries=max_queries or 20_000,
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
            rigid=rigid.FULL,
        )

    def as_dict(self) -> dict:
        """The settings for the raw file, which has only the name of the folder."""
        return {**asdict(self), "data": None if self.data is None else Path(self.data).name}


@dataclass(frozen=True)
class Task:
    """One thing to measure.

    Attributes:
        key: Its name in the journal; the part before the first | is its section.
        seconds: Estimated duration, for the remaining time.
        run: Measures it and returns a JSON object.
    """

    key: str
    seconds: float
    run: Callable[[], Any]


def tasks(settings: Settings, about: dict, quiet: bool) -> Iterator[Task]:
    """Every task in order. Sets and scenes are made when they are first needed."""
    methods = all_methods(list(settings.devices))
    folder = None if settings.data is None else Path(settings.data)

    @cache
    def sets() -> dict[tuple[str, str], QuerySet]:
        found = [] if folder is None else published_sets(folder, settings.max_queries, progress=not quiet)
        found += generated_sets(*settings.generated, GENERATED[:1] if settings.quick else GENERATED)
        return {(q.name, q.kind): q for q in found}

    def effort_seconds(effort: Effort) -> float:
        in_process = sum(m.solve is not None for m in methods)
        return effort.rounds * (1.6 * effort.peer_seconds + in_process * effort.seconds) + 0.1 * in_process

    def each(section: str, seconds: float, call: Callable[..., Any], *axes: dict[str, Any]) -> Iterator[Task]:
        """A task for each combination of what has a name on some axes, the last of which goes round first."""
        for chosen in product(*(axis.items() for axis in axes)) if section in settings.sections else ():
            names, values = [name for name, _ in chosen], [value for _, value in chosen]
            yield Task("|".join((section, *names)), seconds, partial(call, *values))

    def measure_point(queries: QuerySet, tolerance: float) -> dict:
        about = {"set": queries.name, "kind": queries.kind, "tolerance": tolerance, "points": queries.fingerprint()}
        return {**about, "rows": measure(methods, queries, tolerance, settings.sweep)}

    devices, kinds = ({name: name for name in names} for names in (settings.devices, KINDS))
    rounds, few_rounds = settings.rounds, settings.small_rounds
    scenes = dict(all_scenes(folder, settings.quick))
    if "sweep" in settings.sections:
        yield Task("sets", 3.0, lambda: [q.describe() for q in sets().values()])
        points = {f"{name}|{kind}": queries for (name, kind), queries in sets().items()}
        tolerances = {f"{tolerance:g}": tolerance for tolerance in settings.tolerances}
        yield from each("sweep", effort_seconds(settings.sweep), measure_point, points, tolerances)
    yield from each(
        "cases",
        effort_seconds(settings.cases),
        lambda name, kind: measure_case(methods, case_set(name, kind, settings.case_queries), settings.cases),
        {name: name for name in FAMILIES},
        kinds,
    )
    yield from each(
        "batches",
        rounds * settings.batches[-1] * 3e-6,
        lambda: scaling.measure_batches(methods, settings.batches, rounds, about["memory_gib"]),
    )
    yield from each("start", 35.0 * len(devices), lambda: scaling.measure_start(list(devices)))
    yield from each(
        "threads",
        10.0,
        lambda: (
            scaling.measure_threads(200_000, rounds) + scaling.measure_mesh_threads(cloth_over_sphere(100_000), rounds)
        ),
    )
    for section, of_scene in (("steps", whole_step.measure), ("broad", broad_phases.measure)):
        yield from each(
            section,
            settings.step_seconds + 5.0,
            lambda make, device, of=of_scene: of(make(), device, settings.step_seconds, settings.step_rounds),
            scenes,
            devices,
        )
    for name, count in product(many_worlds.SCENES, settings.worlds):
        yield from each(
            "worlds",
            6e-4 * (rounds + 3) * count + 1.0,
            lambda name, count, device: many_worlds.measure(name, count, device, rounds),
            {name: name},
            {str(count): count},
            devices,
        )
    yield from each(
        "small",
        0.05 * few_rounds + 0.5,
        lambda scene, device: small_scenes.measure(scene, device, few_rounds),
        {scene.name: scene for scene in all_small_scenes()},
        devices,
    )
    yield from each(
        "pairs",
        0.01 * few_rounds + 0.2,
        lambda kind, device: small_scenes.measure_pair(kind, device, few_rounds),
        {kind: kind for kind in small_scenes.PAIR_KINDS},
        devices,
    )
    for size in settings.growth:
        yield from each("growth", 4.0 + 8e-6 * size, whole_step.grow_apart, {str(size): size})
    yield from each("rigid", settings.rigid.seconds, lambda call: call(), rigid.calls(settings.rigid))


def measure_case(methods: list[Method], queries: QuerySet, effort: Effort) -> dict:
    """Measure the methods on a family, at the default tolerance."""
    return {
        "family": queries.name,
        "kind": queries.kind,
        "why": FAMILIES[queries.name].why,
        "tolerance": DEFAULT_TOLERANCE,
        "points": queries.fingerprint(),
        "rows": measure(methods, queries, DEFAULT_TOLERANCE, effort),
    }


def case_set(name: str, kind: str, count: int) -> QuerySet:
    """The queries of a family; the unit is each query's own size, unless the family has its own separation."""
    case = FAMILIES[name]
    points = case(kind, count, np.random.default_rng(2))
    scale = case.length_scale if case.minimum_separation else None
    return make_set(name, kind, *points, most=count, separation=case.minimum_separation, length_scale=scale)


def run(settings: Settings, folder: Path, *, quiet: bool = False, kept: dict | None = None) -> tuple[dict | None, bool]:
    """Measure everything that the journal does not contain yet.

    Args:
        settings: What to measure.
        folder: Folder of the journal and the raw file.
        quiet: Whether to show no progress bar.
        kept: Raw figures whose other parts are kept.

    Returns:
        The raw figures, and whether they are complete: False after an interruption by Ctrl-C. None if that came before
        the first figure; then nothing is written.
    """
    about = machine()
    mark = fingerprint(asdict(settings), about, settings.data and Path(settings.data), Path(__file__).parent)
    journal = Journal(folder / JOURNAL, mark)

    def say(line: str) -> None:
        if not quiet:
            print(line, file=sys.stderr, flush=True)

    if journal.set_aside:
        say(f"what another run has measured is kept in {journal.set_aside}")
    if journal.records:
        say(f"going on after {len(journal.records)} tasks of an interrupted run")
    complete = True
    try:
        if "sweep" in settings.sections:
            say("reading and solving the sets of queries in exact arithmetic …")
        todo = list(tasks(settings, about, quiet))
        bar_format = "{l_bar}{bar}| {elapsed} gone, about {postfix[0]} left: {postfix[1]}"
        total = sum(task.seconds for task in todo)
        with tqdm(
            total=total,
            file=sys.stderr,
            bar_format=bar_format,
            postfix=["?", ""],
            disable=quiet or None,  # None: where there is no terminal
            leave=False,
        ) as bar:
            for task in todo:
                if task.key in journal.records:
                    bar.total -= task.seconds
                    continue
                bar.postfix = [_clock(_left(bar)), task.key.replace("|", " ")]
                bar.refresh()
                journal.add(task.key, task.run())
                bar.update(min(task.seconds, bar.total - bar.n))  # rounded sums of floats may exceed the total
    except KeyboardInterrupt:
        complete = False
    if not journal.records:
        return None, complete
    raw = assemble(settings, about, journal.records, complete, mark)
    if kept is not None:
        raw = merged(kept, raw, settings.sections)
    write_raw(folder / RAW, raw)
    if complete:
        journal.close()
    return raw, complete


def _left(bar: tqdm) -> float:
    """Estimate of the remaining seconds, corrected by its accuracy so far."""
    done, elapsed = bar.n, bar.format_dict["elapsed"]
    return (bar.total - done) * (elapsed / done if done > 0.05 * bar.total else 1.0)


def _clock(seconds: float) -> str:
    return f"{int(seconds) // 60}:{int(seconds) % 60:02d}"


def assemble(settings: Settings, about: dict, records: dict[str, Any], complete: bool, mark: str) -> dict:
    """The raw file from the records of the tasks."""
    raw: dict[str, Any] = {
        "machine": about,
        "settings": settings.as_dict(),
        "complete": complete,
        "fingerprint": mark,
        "methods": [{"name": m.name, "group": m.group, "note": m.note} for m in all_methods(list(settings.devices))],
        "sets": records.get("sets", []),
    }
    for section in SECTIONS:
        if section in records:
            raw[section] = records[section]
        else:
            raw[section] = [record for key, record in records.items() if key.startswith(section + "|")]
    if len(raw["growth"]) > 1:
        raw["exponents"] = whole_step.exponents(raw["growth"])
    return raw
