"""Speed against error of CCD (continuous collision detection), ours and every peer's, in one run: ``ccd-warp bench``.

It is installed as ``ccd_warp.benchmarks``; its additional requirements are the extra ``bench``.
"""

import sys
from importlib.util import find_spec
from pathlib import Path

# The oracle and the hard cases are those of the tests.
sys.path += [str(Path(__file__).resolve().parents[1] / folder) for folder in ("tests", "tests/helpers")]

# Module of each requirement of the extra, by the name under which it is installed.
REQUIRED = {
    "ipctk": "ipctk",
    "matplotlib": "matplotlib",
    "pandas": "pandas",
    "psutil": "psutil",
    "python-flint": "flint",
    "tqdm": "tqdm",
}


def require_extra() -> None:
    """Check that the extra ``bench`` is installed.

    Raises:
        ValueError: If a requirement is missing; the message names it and how to install it.
    """
    missing = [package for package, module in REQUIRED.items() if find_spec(module) is None]
    if missing:
        raise ValueError(f"bench needs {', '.join(missing)}; install with: pip install 'ccd-warp[bench]'")
