"""The sections of docs/benchmarks.md on steps of scenes and on single calls, each from the raw figures."""

from __future__ import annotations

import statistics

from ccd_warp.benchmarks.machine import describe
from ccd_warp.benchmarks.numbers import memory_text, ratio_text, table, time_text


def step_cells(row: dict) -> list[str]:
    """Milliseconds of the peer and of ours on a whole step."""
    s = row["seconds"]
    whole = s["peer build"] + s["peer step"]
    values = (s["peer build"], s["find_candidates"], whole, s["collision_free_step"], s["mesh_ccd"])
    return [f"{1e3 * value:.1f}" for value in values]


_CALLS = ("find_candidates", "collision_free_step", "mesh_ccd")
STEP_HEADER = (
    "scene, faces",
    "LBVH",
    "`find_candidates`",
    "LBVH and step",
    "`collision_free_step`",
    "`mesh_ccd`",
)


def scene_name(row: dict) -> str:
    return row["scene"] if row["device"] == "cpu" else f"{row['scene']} ({row['device']})"


def steps(raw: dict) -> list[str]:
    lines = table(STEP_HEADER, ([scene_name(row), *step_cells(row)] for row in raw["steps"]))
    ratios = [
        [
            scene_name(row),
            *(ratio_text(row["ratio"][n]) for n in _CALLS),
            *(time_text(row["first"][n]) for n in _CALLS[1:]),
            f"{row['step']:.6g} / {row['peer_step']:.6g}",
            f"{sum(row['candidates']):,} / {sum(row['peer_candidates']):,}",
            row["disagreements"],
            row["rounds"],
        ]
        for row in raw["steps"]
    ]
    header = ["ratio of times, peer's to ours", *(f"`{name}`" for name in _CALLS)]
    header += ["first `collision_free_step`", "first `mesh_ccd`", "step: ours / peer's", "candidates: ours / peer's"]
    lines += ["", *table([*header, "other than the peer's", "rounds"], ratios)]
    return [*lines, *beside_the_other(raw, "steps"), *apart(raw, "steps")]


def broad(raw: dict) -> list[str]:
    """Times of both broad phases and of the peer's."""
    names = ("LBVH", "tree find_candidates", "hash find_candidates")
    names += ("tree boxes", "hash boxes", "tree pairs", "hash pairs", "tree mesh_ccd", "hash mesh_ccd")
    rows = (
        [
            scene_name(row),
            *(f"{1e3 * row['seconds'][name]:.1f}" for name in names),
            f"{sum(row['candidates']):,}",
            "yes" if row["are_equal"] else "no",
            row["disagreements"],
            row["rounds"],
        ]
        for row in raw["broad"]
    )
    header = ["scene, faces", "LBVH", "`find_candidates`: tree", "hash", "boxes: tree", "hash", "pairs: tree", "hash"]
    header += ["`mesh_ccd`: tree", "hash", "candidates", "equal", "other than the peer's", "rounds"]
    return [*table(header, rows), *beside_the_other(raw, "broad"), *apart(raw, "broad")]


# Calls of the table of many worlds; `many_worlds.measure` names them.
WORLD_CALLS = ("mesh_ccd", "launch", "collision_free_step", "launch_line_search", "mesh_ccd, hash", "launch, hash")


def worlds(raw: dict) -> list[str]:
    """Processor time of a world, by their number, and launches against calls."""
    rows = (
        [
            scene_name(row),
            f"{row['worlds']:,}",
            f"{row['contacts']:,}",
            *(f"{1e6 * row['seconds'][name] / row['worlds']:.1f}" for name in WORLD_CALLS),
            *(f"{row['seconds'][f'launch{of}'] / row['seconds'][f'mesh_ccd{of}']:.2f}" for of in ("", ", hash")),
            "yes" if row["are_equal"] else "no",
        ]
        for row in raw["worlds"]
    )
    names = [", ".join([f"`{call}`", *of]) for call, *of in (name.split(", ") for name in WORLD_CALLS)]
    header = ["scene", "worlds", "contacts", *names]
    lines = table([*header, "`launch` to `mesh_ccd`", "with the hash", "equal"], rows)
    return [*lines, *apart(raw, "worlds")]


# Calls of the table of small scenes; `small_scenes.measure` names them.
SMALL_PEERS = ("LBVH, Tight-Inclusion", "LBVH, additive")
SMALL_CALLS = ("collision_free_step", "mesh_ccd", "pipeline.collision_free_step", "pipeline.mesh_ccd", "launch")


def small(raw: dict) -> list[str]:
    """Times of a call on small scenes, and the steps that they give."""
    rows = (
        [
            scene_name(row),
            *(time_text(row["seconds"][name]) for name in (*SMALL_PEERS, *SMALL_CALLS)),
            f"{row['step']:.5g} / {row['peer_step']:.5g} / {row['additive_step']:.5g}",
            f"{row['contacts']:,}",
        ]
        for row in raw["small"]
    )
    header = ["scene, faces", *SMALL_PEERS, *(f"`{name}`" for name in SMALL_CALLS)]
    lines = table([*header, "step: ours / Tight-Inclusion's / additive's", "contacts"], rows)
    return [*lines, *apart(raw, "small")]


def pair_name(row: dict) -> str:
    return row["pair"].replace("_", "-") + ("" if row["device"] == "cpu" else f" ({row['device']})")


def single_pairs(raw: dict) -> list[str]:
    """Times of a call with one pair."""
    rows = ([pair_name(row), *map(time_text, row["seconds"].values())] for row in raw["pairs"])
    return [*table(["a call with one pair", "additive CCD", "ours"], rows), *apart(raw, "pairs")]


def machine_of(raw: dict, section: str) -> dict:
    """The machine, and the date, of a part."""
    about: dict = raw.get("measured_apart", {}).get(section, raw)["machine"]
    return about


# The parts with a table of whole scenes, and in each the figure of the same call of the peer and of ours.
_SAME_CALLS = {"steps": ("peer build", "find_candidates"), "broad": ("LBVH", "tree find_candidates")}
_SCENE_PLACES = {"steps": "[whole steps](#whole-steps)", "broad": "[broad phases](#broad-phases)"}
# Ratios of the same call in two parts within which the machine is taken to have been as fast.
_ALIKE = 1.25


def beside_the_other(raw: dict, here: str) -> list[str]:
    """What the reader of a table of scenes has to know who has read the other one: the same calls, at another time."""
    (other,) = _SAME_CALLS.keys() - {here}
    rows = {part: {scene_name(row): row["seconds"] for row in raw.get(part) or []} for part in _SAME_CALLS}
    common = rows[here].keys() & rows[other].keys()
    if not common:
        return []
    calls = list(zip(_SAME_CALLS[here], _SAME_CALLS[other], strict=True))
    ratios = [[rows[here][name][at] / rows[other][name][there] for name in common] for at, there in calls]
    is_slower = statistics.median(ratios[0]) >= 1.0
    if not is_slower:
        ratios = [[1.0 / ratio for ratio in values] for values in ratios]
    texts = [" to ".join(f"{of(values):.1f}" for of in (min, max)) for values in ratios]
    of_this, of_that = ("Here", "there") if is_slower else ("There", "here")
    text = (
        f"The table of {_SCENE_PLACES[other]} has LBVH and `find_candidates` of the same scenes, too, measured at "
        f"another time. {of_this} LBVH takes {texts[0]} times as long as {of_that}, and `find_candidates` {texts[1]} "
        "times."
    )
    if max(max(*values, *(1.0 / ratio for ratio in values)) for values in ratios) > _ALIKE:
        text += (
            " LBVH is the same program, called alike and on all cores for both, so the ratios say how free the machine "
            "was at either time. The calls of one table take turns and met the same conditions: compare within a table."
        )
    return ["", text]


def apart(raw: dict, section: str) -> list[str]:
    """The machine of a part that was measured in a separate run."""
    mark = raw.get("measured_apart", {}).get(section)
    if mark is None:
        return []
    quick = " with `--quick`" if mark["quick"] else ""
    about = f"Measured apart{quick} on: {describe(mark['machine'])}. Code and settings: {mark['fingerprint'][:12]}."
    return ["", f"{about} Made again by `ccd-warp bench --only {section} --merge --output benchmarks/results --docs .`"]


def growth(raw: dict) -> list[str]:
    rows = [
        [
            f"{row['faces']:,}",
            *(time_text(row["seconds"][n]) for n in _CALLS),
            memory_text(row["peak_bytes_above_input"]),
        ]
        for row in raw["growth"]
    ]
    lines = table(["faces", *(f"`{name}`" for name in _CALLS), "peak MiB beside the input"], rows)
    if "exponents" in raw:
        powers = ", ".join(f"{name} {value:.2f}" for name, value in raw["exponents"].items())
        lines += ["", f"Powers of the number of faces, fitted to all of these: {powers}."]
        lines += ["Below one they say that fixed costs still count at the small end."]
    return lines
