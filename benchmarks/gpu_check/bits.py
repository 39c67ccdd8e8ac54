"""Stage: every call on the device against the same call on the CPU; all arrays must be equal in every bit.

The answers of the CPU, as digests, may come from another machine (`write_answers`): they hold where the code and the
input of a call are the same there. The CPU is then asked only for what differs.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from functools import cache, partial
from itertools import islice, zip_longest
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import warp as wp
from ccd_warp.benchmarks.gpu_check.cases import Case, all_cases
from ccd_warp.benchmarks.gpu_check.fingerprint import fingerprint
from ccd_warp.benchmarks.gpu_check.journal import read_json, write_json
from ccd_warp.benchmarks.gpu_check.record import Cases, Record
from ccd_warp.benchmarks.gpu_check.target import Target
from laws.outputs import Outputs, different

Answers = dict[str, tuple[str, str]]


def cases(target: Target, *, answers: Path | None = None, **_: Any) -> Cases:
    """The cases to compare, of all kinds among the first; elsewhere than on a GPU a few of them."""
    known = {} if answers is None else read_answers(answers, target.is_short)
    chosen = in_turn(islice(all_cases(target.is_short), 0, None, target.stride))
    found: Cases = {case.name: partial(compare, target, case, *known.get(case.name, ("", ""))) for case in chosen}
    if target.stride > 1:
        found["most cases"] = lambda record: pytest.skip(f"one of {target.stride} is compared here")
    return found


def in_turn(cases: Iterable[Case], part: int = 0) -> list[Case]:
    """The cases in an order in which few of them are of all kinds: by turns over each part of their names."""
    groups: dict[str | None, list[Case]] = {}
    for case in cases:
        groups.setdefault(case.name.split(", ")[part] if case.name.count(", ") >= part else None, []).append(case)
    ordered = [group if len(group) == 1 else in_turn(group, part + 1) for group in groups.values()]
    return [case for turn in zip_longest(*ordered) for case in turn if case is not None]


# --- answers that are carried ---


def digest_of(arrays: Outputs) -> str:
    """A digest of the names, types, shapes and bits of arrays."""
    digest = hashlib.sha256()
    for name, array in sorted(arrays.items()):
        array = np.ascontiguousarray(array)
        digest.update(f"{name} {array.dtype.str} {array.shape}\n".encode() + array.tobytes())
    return digest.hexdigest()[:16]


def write_answers(path: Path) -> None:
    """Write a digest of the input and of the CPU's answer of each case, and of each case of a rehearsal."""
    found: dict[str, dict[str, tuple[str, str]]] = {"cases": {}, "short": {}}
    for key in found:
        for case in all_cases(key == "short"):
            found[key][case.name] = digest_of(case.inputs), digest_of(case.call("cpu"))
    write_json(path, {"code": fingerprint(), "warp": wp.config.version, **found})


@cache
def read_answers(path: Path, is_short: bool = False) -> Answers:
    """The digests of inputs and answers, by case; those of a rehearsal are of small scenes.

    Raises:
        ValueError: If there are none, or they are those of other code.
    """
    given = read_json(path)
    if given is None or "cases" not in given:
        raise ValueError(f"answers is {path}; expected a file that pack has written")
    for name, ours in (("code", fingerprint()), ("warp", wp.config.version)):
        if given[name] != ours:
            raise ValueError(f"answers is {path}, made with {name} {given[name]}; expected those of {name} {ours}")
    return {name: (inputs, answer) for name, (inputs, answer) in given["short" if is_short else "cases"].items()}


# --- comparison ---


def compare(target: Target, case: Case, inputs: str, answer: str, record: Record) -> None:
    """Compare what a call gives with the carried answer, if there is one for this input, and else with the CPU."""
    is_known = inputs != "" and inputs == digest_of(case.inputs)
    expected = None if is_known else case.call("cpu")
    with target.checked():
        found = case.call(target.device)
    row = {"arrays": len(found), "values": sum(array.size for array in found.values()), "carried": int(is_known)}
    record.rows.append(row)
    if is_known and digest_of(found) == answer:
        return
    # the emulated device is the CPU to Warp, and either that or itself
    differing = different(found, case.call("cpu") if expected is None else expected)
    if differing:
        pytest.fail("\n".join(differing))
    if is_known:
        pytest.fail("the carried answer is another than that of the CPU here, which is that of the device")


def totals(rows: list[dict]) -> dict[str, int]:
    """How many arrays and values were compared, and how many calls by an answer that was carried along."""
    return {name: sum(row.get(name, 0) for row in rows) for name in ("arrays", "values", "carried")}
