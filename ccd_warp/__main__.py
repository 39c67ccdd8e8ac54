"""``python -m ccd_warp`` is the command ``ccd-warp``."""

from ccd_warp._cli.command import run_program

run_program()
