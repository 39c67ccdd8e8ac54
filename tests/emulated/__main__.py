"""Run a program on the emulated device: `python tests/emulated (-m MODULE | SCRIPT) [ARGUMENT …]`."""

import runpy
import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parent.parent)

from emulated.device import emulation  # noqa: E402

is_module = sys.argv[1:2] == ["-m"]
sys.argv[:] = sys.argv[1 + is_module :]
with emulation() as emulated:
    (runpy.run_module if is_module else runpy.run_path)(sys.argv[0], run_name="__main__")
print(f"{len(emulated.launches)} kernels run {sum(emulated.launches.values())} times", file=sys.stderr)
