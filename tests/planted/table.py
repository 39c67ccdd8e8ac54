"""The planted faults as a table of Markdown: what is planted where, and the tests that have to find it."""

from planted import of_each_file, of_gpu, of_host
from planted.planting import Fault

_PARTS = {
    "as GPU code has them": of_gpu.PLANTED,
    "on the CPU and on the host": of_host.PLANTED,
    "for which a single file of tests is there": of_each_file.PLANTED,
}
PLANTED = [fault for faults in _PARTS.values() for fault in faults]


def tests_of(fault: Fault) -> list[str]:
    """The tests that are to find a fault."""
    return [test for finder in fault.finders for test in of_gpu.FINDERS.get(finder, [finder])]


def table() -> str:
    """A heading and a table for each part, with a row for each fault."""
    lines = []
    for title, faults in _PARTS.items():
        lines += [f"### {len(faults)} faults {title}", "", "| fault | planted in | found by |", "|---|---|---|"]
        for fault in faults:
            found_by = "<br>".join(f"`{test}`" for test in tests_of(fault))
            lines.append(f"| {fault.name} | `{fault.file}` | {found_by} |")
        lines.append("")
    return "\n".join(lines)
