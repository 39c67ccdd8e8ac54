"""Stage: every call on the device against the same call on the CPU; all arrays must be equal in every bit."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from typing import Any

import numpy as np
from ccd_warp.benchmarks.gpu_check.cases import Arrays, Case, all_cases
from ccd_warp.benchmarks.gpu_check.record import Record
from ccd_warp.benchmarks.gpu_check.target import EMULATED, Target

Outcome = Arrays | str

_MOST_SAID = 12  # differences that are described


def run(target: Target, record: Record, **_: Any) -> None:
    """Compare all cases, and keep a row of counts, and a row for each case that differs or fails."""
    counts = dict.fromkeys(("cases", "arrays", "values", "different_cases", "failed_cases"), 0)
    # The emulated device is the CPU to Warp, and either that or itself: what the CPU gives is computed before.
    known: Iterator[Outcome] = iter(references(target, record) if target.kind == EMULATED else ())
    if target.stride > 1:
        record.leave_out("most cases", f"one of {target.stride} is compared here")
    with target.checked():
        # two sets of cases, since a mesh keeps what it was used with
        for case, same in zip(chosen(target), chosen(target), strict=True):
            if record.left() <= 0:
                record.leave_out(f"cases from '{case.name}' on", "no time was left")
                break
            expected = next(known, None) if target.kind == EMULATED else outcome(same, "cpu")
            if expected is None:
                record.leave_out(f"cases from '{case.name}' on", "no time was left")
                break
            compare(record, case.name, expected, outcome(case, target.device), counts)
    record.add(
        "{cases} calls, {arrays} arrays, {values:,} values: {different_cases} calls differ, {failed_cases} fail".format(
            **counts
        ),
        **counts,
    )


def chosen(target: Target) -> Iterator[Case]:
    """The cases to compare."""
    return islice(all_cases(target.is_short), 0, None, target.stride)


def references(target: Target, record: Record) -> list[Outcome]:
    """What the CPU gives, for as many cases as half of the time is enough for."""
    found = []
    end = record.left() / 2
    for case in chosen(target):
        if record.left() < end:
            break
        found.append(outcome(case, "cpu"))
    return found


def outcome(case: Case, device: str) -> Outcome:
    """The arrays that a call gives, or its error in words."""
    try:
        return case.call(device)
    except Exception as error:  # to be told beside the other cases
        return f"{type(error).__name__}: {error}"[:2000]


def compare(record: Record, name: str, expected: Outcome, found: Outcome, counts: dict[str, int]) -> None:
    """Count a case, and keep a row if it differs or fails."""
    counts["cases"] += 1
    if isinstance(expected, str) or isinstance(found, str):
        counts["failed_cases"] += 1
        said = {"on the CPU": expected, "on the device": found}
        failed = {where: what for where, what in said.items() if isinstance(what, str)}
        record.add(f"FAILED {name}: {str(failed)[:300]}", case=name, failed=failed)
        return
    counts["arrays"] += len(expected)
    counts["values"] += sum(array.size for array in expected.values())
    differing = differences(expected, found)
    if differing:
        counts["different_cases"] += 1
        is_said = counts["different_cases"] <= _MOST_SAID
        record.add(f"DIFFERENT {name}: {str(differing)[:600]}" if is_said else None, case=name, different=differing)


def differences(expected: Arrays, found: Arrays) -> dict[str, str]:
    """The arrays that are not the same bits, and how they differ."""
    result = {}
    for name in expected | found:
        if name not in expected or name not in found:
            result[name] = "only one has it"
            continue
        a, b = (np.ascontiguousarray(x) for x in (expected[name], found[name]))
        if a.shape != b.shape or a.dtype != b.dtype:
            result[name] = f"{a.dtype} {a.shape} on the CPU, {b.dtype} {b.shape} on the device"
        elif a.tobytes() != b.tobytes():
            is_different = bits_of(a) != bits_of(b)
            where = tuple(int(k) for k in np.argwhere(is_different)[0])
            result[name] = f"{int(is_different.sum())} of {a.size}, first at {where}: {a[where]!r} and {b[where]!r}"
    return result


def bits_of(array: np.ndarray) -> np.ndarray:
    """An array as integers of its bits."""
    return array.view(f"u{array.dtype.itemsize}") if array.dtype != bool else array
