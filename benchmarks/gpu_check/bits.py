"""Stage: every call on the device against the same call on the CPU; all arrays must be equal in every bit.

The answers of the CPU, as digests, may come from another machine (`write_answers`): they hold where the code and the
input of a call are the same there. The CPU is then asked only for what differs.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from functools import cache
from itertools import islice, zip_longest
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp
from ccd_warp.benchmarks.gpu_check.cases import Case, all_cases
from ccd_warp.benchmarks.gpu_check.fingerprint import fingerprint
from ccd_warp.benchmarks.gpu_check.outputs import Outputs, different
from ccd_warp.benchmarks.gpu_check.record import Record, read_json, write_json
from ccd_warp.benchmarks.gpu_check.target import EMULATED, Target

Outcome = Outputs | str
Answers = dict[str, tuple[str, str]]

_MOST_SAID = 12  # differences that are described


def run(target: Target, record: Record, *, answers: Path | None = None, **_: Any) -> None:
    """Compare all cases, and keep a row for each: the numbers of arrays and values, and what differs or fails."""
    known = {} if answers is None else read_answers(answers, target.is_short)
    # The emulated device is the CPU to Warp, and either that or itself: what the CPU gives is computed before.
    before = references(target, record) if target.kind == EMULATED else None
    if target.stride > 1:
        record.leave_out("most cases", f"one of {target.stride} is compared here")

    with target.checked():
        for case in chosen(target):
            if before is not None and case.name not in before:
                record.leave_out(case.name, "no time was left")
                record.is_cut = True
            elif record.begins(case.name):
                inputs, answer = known.get(case.name, ("", ""))
                is_known = inputs != "" and inputs == digest_of(case.inputs)
                found = outcome(case, target.device)
                if isinstance(found, str):
                    target.check_alive()
                if is_known and not isinstance(found, str) and digest_of(found) == answer:
                    expected: Outcome = found
                else:
                    expected = outcome(case, "cpu") if before is None else before[case.name]
                compare(record, case.name, expected, found, is_known)
    record.say(f"{totals_said(record.rows)}; {sum(row.get('carried', 0) for row in record.rows)} by carried answers")


def in_turn(cases: Iterable[Case], part: int = 0) -> list[Case]:
    """The cases in an order in which few of them are of all kinds: by turns over each part of their names."""
    groups: dict[str | None, list[Case]] = {}
    for case in cases:
        groups.setdefault(case.name.split(", ")[part] if case.name.count(", ") >= part else None, []).append(case)
    ordered = [group if len(group) == 1 else in_turn(group, part + 1) for group in groups.values()]
    return [case for turn in zip_longest(*ordered) for case in turn if case is not None]


def chosen(target: Target) -> list[Case]:
    """The cases to compare."""
    return in_turn(islice(all_cases(target.is_short), 0, None, target.stride))


def references(target: Target, record: Record) -> dict[str, Outcome]:
    """What the CPU gives, for as many cases as half of the time is enough for."""
    found = {}
    end = record.left() / 2
    for case in chosen(target):
        if record.left() < end:
            break
        if case.name not in record.cases:
            found[case.name] = outcome(case, "cpu")
    return found


def outcome(case: Case, device: str) -> Outcome:
    """The arrays that a call gives, or its error in words."""
    try:
        return case.call(device)
    except Exception as error:  # to be told beside the other cases
        return f"{type(error).__name__}: {error}"[:2000]


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
            arrays = outcome(case, "cpu")
            if isinstance(arrays, str):
                raise RuntimeError(f"{case.name}: {arrays}")
            found[key][case.name] = digest_of(case.inputs), digest_of(arrays)
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


def compare(record: Record, name: str, expected: Outcome, found: Outcome, is_known: bool = False) -> None:
    """Keep the row of a case."""
    if isinstance(expected, str) or isinstance(found, str):
        said = {"on the CPU": expected, "on the device": found}
        failed = {where: what for where, what in said.items() if isinstance(what, str)}
        record.add(f"FAILED {name}: {str(failed)[:300]}", case=name, failed=failed)
        return
    row: dict[str, Any] = {"arrays": len(expected), "values": sum(array.size for array in expected.values())}
    if is_known and found is expected:
        row["carried"] = 1
    differing = different(found, expected)
    if differing:
        row["different"] = differing
    elif is_known and found is not expected:
        row["failed"] = "the carried answer is another than that of the CPU here, which is that of the device"
    is_said = differing and sum("different" in each for each in record.rows) < _MOST_SAID
    record.add(f"DIFFERENT {name}: {str(differing)[:600]}" if is_said else None, case=name, **row)


def totals(rows: list[dict]) -> dict[str, int]:
    """How many calls, arrays and values were compared, and how many calls differ or fail."""
    counts = {name: sum(row.get(name, 0) for row in rows) for name in ("arrays", "values")}
    return {
        "cases": len(rows),
        **counts,
        **{name: sum(name in row for row in rows) for name in ("different", "failed")},
    }


def totals_said(rows: list[dict]) -> str:
    """The totals in words."""
    said = "{cases} calls, {arrays:,} arrays, {values:,} values: {different} calls differ, {failed} fail"
    return said.format(**totals(rows))
