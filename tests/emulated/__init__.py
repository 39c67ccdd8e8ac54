"""The CUDA side of the library without a GPU: the CUDA source that Warp generates, run on threads of the CPU."""

import sys
from pathlib import Path

# The scenes, where no conftest.py has found them.
_HELPERS = str(Path(__file__).resolve().parent.parent / "helpers")
if _HELPERS not in sys.path:
    sys.path.append(_HELPERS)
