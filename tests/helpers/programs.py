"""Programs in processes of their own, forked from one that has done what takes each of them most of its time.

CUDA does not outlive a fork: on a GPU they begin anew, and what is forked has none.
"""

import multiprocessing
import os
import re
import runpy
import subprocess
import sys
import traceback
from contextlib import redirect_stdout, suppress
from io import StringIO
from pathlib import Path

README = Path(__file__).resolve().parents[2] / "README.md"
# A block of a page, and what it prints.
BLOCK = re.compile(r"^```python\n(.*?)^```$(?:\n+It prints:\n+^```text\n(.*?)^```$)?", re.DOTALL | re.M)
# What a program ends with where there is no MPI.
NO_MPI = re.compile(r"No module named 'mpi4py'|cannot load MPI|needs mpi4py and an MPI")


def _run(folder: Path, *arguments: str) -> int:
    """What `python ARGUMENTS` does in a folder: its status, with its output in files there."""
    os.chdir(folder)
    for descriptor, name in ((1, "stdout"), (2, "stderr")):
        with open(name, "wb") as file:
            os.dup2(file.fileno(), descriptor)
    is_module = arguments[0] == "-m"
    sys.argv = [*arguments[is_module:]]
    try:
        (runpy.run_module if is_module else runpy.run_path)(sys.argv[0], run_name="__main__")
    except BaseException as error:
        if not isinstance(error, SystemExit) or isinstance(error.code, str):
            traceback.print_exc()
        return int(not isinstance(error, SystemExit) or bool(error.code))
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
    return 0


def _serve(asked) -> None:
    """Fork a process for each program, where `import ccd_warp` has ended, and kernels of common calls are loaded."""
    os.environ["CUDA_VISIBLE_DEVICES"] = ""
    with redirect_stdout(StringIO()), suppress(Exception):  # which the test of that page tells of
        for code, _ in BLOCK.findall(README.read_text(encoding="utf-8")):
            exec(code, {})
    while program := asked.recv():
        if (child := os.fork()) == 0:
            status = 1
            try:
                status = _run(*program)
            finally:
                os._exit(status)
        asked.send(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))


def begun(folder, *arguments, **variables):
    """What `python ARGUMENTS` does in a folder, in a process that is begun for it: its status and output."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))} | variables
    command = [sys.executable, *map(str, arguments)]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    return done.returncode, done.stdout, done.stderr


def programs(device):
    """Yields a function that runs `python ARGUMENTS` in a folder, for tests on a device: its status and output."""
    if device.startswith("cuda"):
        yield begun
        return
    processes = multiprocessing.get_context("spawn")
    ours, theirs = processes.Pipe()
    server = processes.Process(target=_serve, args=(theirs,), daemon=True)
    server.start()
    theirs.close()

    def run(folder, *arguments):
        ours.send((folder, *map(str, arguments)))
        return ours.recv(), *((folder / name).read_text(encoding="utf-8") for name in ("stdout", "stderr"))

    yield run
    ours.send(None)
    server.join()
