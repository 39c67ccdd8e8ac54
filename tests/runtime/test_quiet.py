"""What Warp says because of this library does not appear in a user's output; what it says of the user's own does."""

import os
import re
import sys

import numpy as np
import pytest
import warp as wp
from programs import begun

import ccd_warp as ccd
from ccd_warp._runtime import quiet

SOLVE = """
import numpy as np
import ccd_warp as ccd
points_t0 = np.array([[[0.0, 0, 1], [-1, -1, 0], [1, -1, 0], [0, 2, 0]]])
points_t1 = points_t0 - [[[0, 0, 2], [0, 0, 0], [0, 0, 0], [0, 0, 0]]]
print(ccd.vertex_face_ccd(points_t0, points_t1).toi[0].round(3))
"""
OWN = """
import warp as wp
@wp.kernel
def fill(a: wp.array[float]):
    a[wp.tid()] = 1.0
a = wp.zeros(2, device="cpu")
wp.launch(fill, dim=2, inputs=[a], device="cpu")
print(a)
"""
# The name of an object in a thread that reads the version while another writes it.
FIRST_NAME = """
import warp as wp
import ccd_warp._runtime.quiet as quiet
quiet.start_warp()
wp._src.context.runtime.get_llvm_version = lambda: ""
print(wp.get_module("own")._get_compile_output_name(wp.get_device("cpu")))
"""


@pytest.mark.parametrize(
    "code, shown",
    [
        (SOLVE + OWN, r"0\.5\nModule __main__[^\n]*\n\[1\. 1\.\]\n"),
        ("import ccd_warp, warp\nwarp.init()\n" + SOLVE, r"Warp (?!.*ccd_warp\.).*\n0\.5\n"),
        ("import warp\nwarp.config.log_level = warp.LOG_DEBUG\n" + SOLVE, r"Warp .*Module ccd_warp\..*"),
    ],
    ids=["own kernels", "own start", "all"],
)
def test_a_script_prints_what_it_prints_and_what_its_user_has_asked_for(tmp_path, code, shown):
    script = tmp_path / "script.py"  # a file, because Warp reads the source of kernels
    script.write_text(code, encoding="utf-8")
    status, out, error = begun(tmp_path, script)
    assert status == 0 and re.fullmatch(shown, out, re.DOTALL), (out, error)
    shown = [line for line in error.splitlines() if not line.startswith("ccd_warp: compiling kernels")]
    assert shown == [] or "warp.init()" in code or "LOG_DEBUG" in code


def test_threads_that_compile_first_do_not_ask_warp_for_the_version_of_its_compiler_at_once(tmp_path):
    """Warp 1.19 writes it into one buffer: a thread may read an empty text, and name its object without it."""
    status, shown, error = begun(tmp_path, "-c", FIRST_NAME)
    assert status == 0 and re.search(r"\.cpu[0-9a-f]{8}\.o$", shown.strip()), (shown, error)


def test_a_gpu_that_is_not_there_is_refused_without_a_line_of_warp(capfd):
    if wp.is_cuda_available():
        pytest.skip("there is a GPU")
    with pytest.raises(ValueError, match="device is 'cuda'; expected one of 'cpu'"):
        ccd.CollisionPipeline(ccd.CollisionMesh.from_arrays([(np.eye(3), [[0, 1, 2]])]), device="cuda")
    assert capfd.readouterr() == ("", "")


@pytest.mark.skipif(sys.platform != "linux", reason="the driver's name is Linux's")
def test_only_the_line_about_a_missing_driver_is_kept_from_stderr(capfd):
    line = b"Warp CUDA warning: Could not find or load the NVIDIA CUDA driver. No GPU.\n"
    with quiet._without_driver_warning():
        os.write(2, b"before\n" + line + b"after\n")
    os.write(2, b"end\n")
    assert capfd.readouterr() == ("", "before\nafter\nend\n")
