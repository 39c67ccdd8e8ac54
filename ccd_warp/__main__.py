"""``python -m ccd_warp`` is the command ``ccd-warp``."""

import sys

from ccd_warp._cli import main

sys.exit(main())
