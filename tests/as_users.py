"""The users whom the README addresses, with a wheel in an environment of its own; run by `nox`, not by pytest.

In an empty folder, beside the package and what it depends on alone, each Python block of the pages below is pasted into
a file and prints what the page says, and each command of the README's block runs: `python -P …/tests/as_users.py
[OBJECTS]`. OBJECTS is a folder in which Pythons that are checked one after another leave what they have compiled.
"""

import io
import re
import runpy
import shlex
import subprocess
import sys
import sysconfig
from contextlib import redirect_stderr, redirect_stdout
from importlib import metadata
from pathlib import Path

import warp as wp
from warp._src import build

import ccd_warp as ccd
from ccd_warp._cli import command
from ccd_warp._runtime import packaged

sys.path.append(str(Path(__file__).resolve().parent / "helpers"))
from shared_objects import SharedObjects

BARE = {"ccd-warp", "numpy", "trimesh", "warp-lang", "pip", "setuptools"}
ROOT = Path(__file__).resolve().parents[1]
PAGES = ["README.md", "docs/on_device.md"]
BLOCK = re.compile(r"^```python\n(.*?)^```\n+It prints:\n+^```text\n(.*?)^```$", re.DOTALL | re.M)


def check_surroundings() -> None:
    """The package is the installed one, in an environment and a folder without anything that could help it."""
    assert Path(sysconfig.get_path("purelib")) in Path(ccd.__file__).parents, ccd.__file__
    installed = {str(found.metadata["Name"]).lower().replace("_", "-") for found in metadata.distributions()}
    assert installed <= BARE, f"more is installed than the package needs: {sorted(installed - BARE)}"
    assert not list(Path.cwd().iterdir()), f"{Path.cwd()} is not empty"


def run_blocks(page: str) -> int:
    """Run each block of a page as a program of its own; how many there are."""
    blocks = BLOCK.findall((ROOT / page).read_text(encoding="utf-8"))
    for code, promised in blocks:
        Path("pasted.py").write_text(code, encoding="utf-8")  # a file, because Warp reads the source of kernels
        with redirect_stdout(io.StringIO()) as printed:
            runpy.run_path("pasted.py", run_name="__main__")
        assert printed.getvalue() == promised, f"{page}: {printed.getvalue()!r} is not {promised!r}"
    assert blocks, page
    return len(blocks)


def run_commands() -> None:
    """Run the commands of the README, and the installed program itself."""
    section = (ROOT / "README.md").read_text(encoding="utf-8").partition("\n## From the command line\n")[2]
    lines = re.search(r"^```sh\n(.*?)^```$", section, re.DOTALL | re.M)[1].splitlines()
    with redirect_stdout(io.StringIO()) as shown, redirect_stderr(io.StringIO()) as said:
        for line in lines:
            program, *arguments = shlex.split(line)
            assert program == "ccd-warp" and command.main(arguments) == 0, f"{line}: {said.getvalue()}"
    assert (shown.getvalue().count("MISS"), said.getvalue()) == (2, ""), (shown.getvalue(), said.getvalue())
    assert Path("result.json").stat().st_size > 1_000
    program = Path(sysconfig.get_path("scripts"), "ccd-warp")
    done = subprocess.run([program, "--version"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, f"ccd-warp {ccd.__version__}\n", ""), done


def check_kernels() -> None:
    """Under this Python, a wheel that brings kernels has all that this processor can be asked to run."""
    with redirect_stdout(io.StringIO()) as said:
        assert command.main(["doctor"]) == 0
    lines = [line for line in said.getvalue().splitlines() if line.startswith("cpu ")]
    if not packaged.why_none(wp.get_device("cpu")):
        assert ": all kernels come with the package" in lines[0], lines
    print(*lines)


def main() -> None:
    check_surroundings()
    check_kernels()
    if len(sys.argv) > 1:
        shared = SharedObjects(Path(sys.argv[1]))
        build.build_cpu = shared.build_cpu
    for page in PAGES:
        print(f"{page}: {run_blocks(page)} blocks print what the page says", flush=True)
    run_commands()
    if len(sys.argv) > 1:
        print(f"{shared.compiled} modules compiled, {shared.taken} written in the same C++ as by an earlier Python")


if __name__ == "__main__":
    main()
