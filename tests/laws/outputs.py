"""What calls return, as named NumPy arrays whose bits can be compared."""

import hashlib
import os
import pickle
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

import ccd_warp as ccd

# Times that calls took, and what tells how the work was divided, which is for each device to choose.
_NOT_COMPARED = {"timings", "num_boxes", "num_sorted_sets", "num_searches", "num_batches"}
# What contacts know beside their fields.
_OF_CONTACTS = ("points", "vertices", "weights", "bodies", "world")
# What is compared of results that are no plain fields.
_OF_PAIRS = ("kind", "primitives", "parameters", "points", "vertices")
_NAMES: dict[type, tuple[str, ...]] = {
    ccd.Proximities: (*_OF_PAIRS, "distance", "direction", "features", "shared_by"),
    ccd.Intersections: (*_OF_PAIRS, "edge_parameter", "bodies", "world", "is_crossing"),
    ccd.RigidMotion: ("poses_t0", "poses_t1"),
}

Outputs = dict[str, np.ndarray]
# The folder in which processes keep the answers of the CPU for each other, as those of `planted` do.
_KEPT = os.environ.get("CCD_WARP_KEPT_ANSWERS")


def outputs_of(value: Any, name: str = "") -> Outputs:
    """The arrays and numbers of a result and its parts."""
    if value is None:
        return {}
    if isinstance(value, (ccd.LaunchResult, ccd.DeviceContacts)):
        return _of_launch(value, name) if isinstance(value, ccd.LaunchResult) else _of_device_contacts(value, name)
    if isinstance(value, ccd.Candidates):
        value = value.sorted()  # the one device sorts them, the other does not
    if isinstance(value, wp.array):
        return {name: value.numpy().copy()}
    if type(value) in _NAMES:
        value = {name: getattr(value, name) for name in _NAMES[type(value)]}
    if isinstance(value, tuple) and not all(isinstance(part, (int, float)) for part in value):
        value = dict(enumerate(value))
    if isinstance(value, Mapping):
        parts = {str(key): item for key, item in value.items()}
    elif is_dataclass(value):
        parts = {field.name: getattr(value, field.name) for field in fields(value)}
    else:
        array = np.array(value)
        assert array.dtype != object, f"{name} is {value!r}; expected a value whose bits can be compared"
        return {name: array}
    if isinstance(value, ccd.Contacts):
        parts |= {key: getattr(value, key) for key in _OF_CONTACTS}
    found: Outputs = {}
    for key, part in parts.items():
        if key not in _NOT_COMPARED and not key.startswith("_"):
            found |= outputs_of(part, f"{name}.{key}")
    return found


def _of_launch(result: ccd.LaunchResult, name: str) -> Outputs:
    names = ("toi", "world_toi", "body_toi", "vertex_toi", "flags", "world_flags", "num_pairs")
    found = {f"{name}.{key}": getattr(result, key).numpy().copy() for key in names}
    return found | outputs_of(result.contacts, f"{name}.contacts")


def rows_in_order(contacts: ccd.DeviceContacts) -> NDArray[np.intp]:
    """Rows of the contacts that are stored, in the order of `Contacts`, for on a device they come in any."""
    num_stored = min(int(contacts.count.numpy()[0]), len(contacts.kind))
    pairs = np.column_stack([contacts.kind.numpy(), contacts.primitives.numpy()])[:num_stored]
    return np.lexsort(pairs.T[::-1])


def _of_device_contacts(contacts: ccd.DeviceContacts, name: str) -> Outputs:
    """Contacts that are stored, in the order of `Contacts`."""
    stored = {key: array.numpy() for key, array in vars(contacts).items() if key != "count"}
    for key in _OF_CONTACTS:
        with suppress(ValueError):  # points that a launch with a motion does not know
            stored[key] = getattr(contacts, key).numpy()
    order = rows_in_order(contacts)
    found = {f"{name}.{key}": values[order] for key, values in stored.items()}
    return found | {f"{name}.count": contacts.count.numpy().copy()}


def rows_of(found):
    """What was found, as (kind, first, second) in order."""
    return [(k, *pair) for k, pair in zip(found.kind.tolist(), found.primitives.tolist(), strict=True)]


def tois_of(contacts: ccd.Contacts) -> dict[tuple[int, int, int], float]:
    """The toi of each contact, by kind and primitives."""
    keys = map(tuple, np.column_stack([contacts.kind, contacts.primitives]).tolist())
    return dict(zip(keys, contacts.toi.tolist(), strict=True))


def kept_outputs(case: Any, call: Callable[[], Any]) -> Any:
    """What a call returns, or has returned in another process."""
    path = Path(_KEPT or "", hashlib.sha256(repr(case).encode()).hexdigest())
    if _KEPT and path.exists():
        return pickle.loads(path.read_bytes())
    answer = call()
    if _KEPT:
        path.write_bytes(pickle.dumps(answer))
    return answer


def different(ours: Outputs, theirs: Outputs) -> list[str]:
    """What is not equal in every bit, a line each."""
    lines = [f"{name}: only one has it" for name in ours.keys() ^ theirs.keys()]
    for name in ours.keys() & theirs.keys():
        a, b = ours[name], theirs[name]
        if a.shape != b.shape or a.dtype != b.dtype:
            lines.append(f"{name}: {a.dtype} {a.shape}, expected {b.dtype} {b.shape}")
        elif a.tobytes() != b.tobytes():
            rows = np.flatnonzero(
                [x.tobytes() != y.tobytes() for x, y in zip(np.atleast_1d(a), np.atleast_1d(b), strict=True)]
            )
            shown = [f"[{row}] {np.atleast_1d(a)[row]}, expected {np.atleast_1d(b)[row]}" for row in rows[:3]]
            lines.append(f"{name}: {len(rows)} of {len(np.atleast_1d(a))} rows: {'; '.join(shown)}")
    return sorted(lines)


def assert_shared_bits(launched: Any, host: Any, *names: str) -> None:
    """What both results have is equal in every bit, and has these names."""
    launched, host = outputs_of(launched), outputs_of(host)
    shared = launched.keys() & host.keys()
    assert shared >= {*names} and len(shared) > 4
    assert different(*({name: each[name] for name in shared} for each in (launched, host))) == []
