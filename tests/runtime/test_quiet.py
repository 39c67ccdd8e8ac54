"""What Warp says because of this library does not appear in a user's output; what it says of the user's own does."""

import os
import re
import subprocess
import sys

import pytest

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
    done = subprocess.run([sys.executable, script], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0 and re.fullmatch(shown, done.stdout, re.DOTALL), done
    assert done.stderr == "" or "warp.init()" in code or "LOG_DEBUG" in code


@pytest.mark.skipif(sys.platform != "linux", reason="the driver's name is Linux's")
def test_only_the_line_about_a_missing_driver_is_kept_from_stderr(capfd):
    line = b"Warp CUDA warning: Could not find or load the NVIDIA CUDA driver. No GPU.\n"
    with quiet._without_driver_warning():
        os.write(2, b"before\n" + line + b"after\n")
    os.write(2, b"end\n")
    assert capfd.readouterr() == ("", "before\nafter\nend\n")
