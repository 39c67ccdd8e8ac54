"""Plant every fault, or those of which a name is a part: `python tests/planted [NAME …]`, or `nox -s faults`.

A fault that survives is a missing test. `python tests/planted --table` plants none, and prints a table of all of them.
"""

import sys
import tempfile
import time
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])

from planted.planting import Copy, fault_in  # noqa: E402
from planted.table import PLANTED, table, tests_of  # noqa: E402


def main(names: list[str]) -> int:
    """Plant each fault, or those of which a name is a part, and print the test that finds it."""
    if names == ["--table"]:
        print(table())
        return 0
    chosen = [fault for fault in PLANTED if not names or any(name in fault.name for name in names)]
    if not chosen:
        print(f"no fault has one of {names} in its name; expected a part of one of the {len(PLANTED)} names")
        return 2
    with tempfile.TemporaryDirectory() as folder:
        copy = Copy(Path(folder))
        begin = time.perf_counter()
        # answers of the CPU, which has no faults, and every module compiled without one
        if failed := copy.failing_test(sorted({test for fault in chosen for test in tests_of(fault)})):
            print(f"without a fault: {failed}")
            return 1
        print(f"{len(chosen)} faults; without one all tests pass, {time.perf_counter() - begin:.0f} s")
        survivors = []
        for fault in chosen:
            path, begin = copy.path_of(fault.file), time.perf_counter()
            source = path.read_text(encoding="utf-8")
            path.write_text(fault_in(fault, source), encoding="utf-8")
            copy.is_planted = True
            found = copy.failing_test(tests_of(fault))
            path.write_text(source, encoding="utf-8")
            if found is None:
                survivors.append(fault.name)
            seconds = time.perf_counter() - begin
            print(f"{seconds:5.1f} s  {fault.file}: {fault.name}: {found or 'SURVIVES'}", flush=True)
    print(
        f"{len(chosen) - len(survivors)} of {len(chosen)} found" + "".join(f"; survives: {name}" for name in survivors)
    )
    return 1 if survivors else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
