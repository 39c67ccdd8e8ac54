"""Objects that do not change: their arrays are read-only."""

from typing import Any

import numpy as np


class ReadOnly:
    """A base of classes whose instances do not change."""

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore the attributes and make their arrays read-only, a property that pickling loses."""
        for value in state.values():
            if isinstance(value, np.ndarray):
                value.flags.writeable = False
        vars(self).update(state)
