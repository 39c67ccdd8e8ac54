"""What PTX, the words of ``ptxas -v`` and a disassembly say of each kernel: registers, stack, spills, instructions."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

# Of a multiprocessor, sm_80 to sm_90: registers, warps, and registers that a warp gets at a time.
_REGISTERS, _WARPS, _REGISTER_UNIT = 65_536, 64, 256
_FUNCTION = re.compile(r"^(?:\.visible |\.weak )*\.(entry|func)\s+(?:\([^)]*\)\s*)?([\w$]+)", re.MULTILINE)
_PROPERTIES = re.compile(
    r"Function properties for (\S+)\s+(\d+) bytes stack frame, (\d+) bytes spill stores, (\d+) bytes spill loads"
)
_SECTION = re.compile(r"^\.section\s+\.text\.([\w$]+)|^\s*\.section\s+\.text\.([\w$]+)", re.MULTILINE)
_MACHINE_INSTRUCTION = re.compile(r"^\s+/\*[0-9a-f]{4,}\*/\s+(?:@!?\w+\s+)?([A-Z][\w.]*)", re.MULTILINE)


def count(ptx: str, said: str, disassembly: str | None = None) -> dict[str, dict[str, int]]:
    """The figures of each kernel of a module.

    Args:
        ptx: Its PTX.
        said: What ``ptxas -v`` said of it.
        disassembly: What ``nvdisasm -c`` made of it, if it was found.
    """
    starts = list(_FUNCTION.finditer(ptx))
    ends = [start.start() for start in starts[1:]] + [len(ptx)]
    bodies = {start[2]: ptx[start.end() : end] for start, end in zip(starts, ends, strict=True)}
    entries = [start[2] for start in starts if start[1] == "entry"]
    called = {name: _called(body, bodies, name) for name, body in bodies.items()}
    properties = {name: [int(x) for x in rest] for name, *rest in _PROPERTIES.findall(said)}
    used = {name: (int(registers), int(stack or 0)) for name, registers, stack in _used(said)}
    machine = _by_section(disassembly) if disassembly is not None else {}
    figures = {}
    for name in entries:
        reached = _reached(name, called)
        own = properties[name]
        stores, loads = (sum(properties[f][k] for f in reached if f in properties) for k in (1, 2))
        registers, cumulative = used[name]
        row = {
            "registers": registers,
            "stack": max(own[0], cumulative),
            "spill_stores": stores,
            "spill_loads": loads,
            "ptx": sum(_instructions(bodies[f]) for f in reached),
            "ptx_own": _instructions(bodies[name]),
            "warps": warps(registers),
        }
        if name in machine:
            row["sass"] = len(machine[name])
            row["wide_loads"] = sum(op.startswith("LD") and ".128" in op for op in machine[name])
        figures[readable(name)] = row
    return figures


def warps(registers: int) -> int:
    """Warps of a multiprocessor that its registers allow, of 64."""
    of_a_warp = -(-32 * registers // _REGISTER_UNIT) * _REGISTER_UNIT
    return min(_WARPS, _REGISTERS // max(of_a_warp, 1))


def readable(name: str) -> str:
    """The name of a kernel in its source."""
    name = name.removesuffix("_cuda_kernel_forward")
    return re.sub(r"_[0-9a-f]{8}$", "", name).split("__locals__")[-1]


def _used(said: str) -> Iterable[tuple[str, str, str]]:
    """Of each kernel its name, registers, and stack with that of the functions called where ptxas knows it."""
    parts = re.split(r"(?=Compiling entry function)", said)
    for part in parts:
        found = re.search(r"Compiling entry function '([^']+)'", part)
        registers = re.search(r"Used (\d+) registers", part)
        stack = re.search(r"(\d+) bytes cumulative stack", part)
        if found and registers:
            yield found[1], registers[1], stack[1] if stack else ""


def _instructions(body: str) -> int:
    """Instructions of a function of PTX: what ends with a semicolon and is no directive."""
    return sum(line.endswith(";") and not line.startswith((".", "//")) for line in map(str.strip, body.splitlines()))


def _called(body: str, names: Iterable[str], of: str) -> set[str]:
    """Functions that a body names."""
    words = set(re.findall(r"[\w$]+", body))
    return {name for name in names if name in words and name != of}


def _reached(name: str, called: Mapping[str, set[str]]) -> set[str]:
    """A function and all that it calls, directly or not."""
    reached, pending = set(), [name]
    while pending:
        at = pending.pop()
        if at not in reached:
            reached.add(at)
            pending += called[at]
    return reached


def _by_section(disassembly: str) -> dict[str, list[str]]:
    """Machine instructions by kernel; the functions that it calls are in its section."""
    sections = list(_SECTION.finditer(disassembly))
    ends = [section.start() for section in sections[1:]] + [len(disassembly)]
    return {
        section[1] or section[2]: _MACHINE_INSTRUCTION.findall(disassembly[section.end() : end])
        for section, end in zip(sections, ends, strict=True)
    }
