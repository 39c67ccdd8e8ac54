"""The name under which Warp keeps a compiled module is the same in every process, whatever was built before."""

import os
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

SCRIPT = """
    import warp as wp

    wp.config.log_level = wp.LOG_ERROR
    from cuda_modules import cuda_modules

    wp.init()
    modules = {name: module for name, module in cuda_modules(reals=(wp.float64,)).items() if "float64" in name}


    def names():
        for module in modules.values():
            module.hashers.clear()
        return {name: module.get_module_identifier() for name, module in modules.items()}


    before = names()
    for name, module in modules.items():
        if "points_toi" in name:
            module._run_codegen(module.resolve_options(wp.config) | {"output_arch": 90}, False)
    after = names()
    print(*(name for name in modules if before[name] != after[name]), sep=", ")
"""


@pytest.mark.emulated
def test_what_was_built_before_does_not_change_the_name_of_a_module():
    """Else a second run would compile modules again that the first has compiled under other names.

    Warp takes a local variable of a function for a constant of that name, as its own number ``e``, until it has built
    the function once.
    """
    command = [sys.executable, "-P", "-c", textwrap.dedent(SCRIPT)]
    path = os.pathsep.join([str(Path(__file__).parents[1] / "helpers"), os.environ.get("PYTHONPATH", "")])
    environment = {**os.environ, "PYTHONPATH": path}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""
