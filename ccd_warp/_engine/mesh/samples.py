"""Numbers spread over a range, which stand for all of it."""

import numpy as np
from numpy.typing import NDArray

_GOLDEN = (5.0**0.5 - 1.0) / 2.0


def uneven_samples(count: int, num: int) -> NDArray[np.intp]:
    """Numbers below ``count``, one from each of ``num`` equal ranges, each time at another place of it.

    At a fixed distance they could all stand for one vertex of many equal bodies or worlds.
    """
    numbers = np.arange(num)
    places: NDArray[np.intp] = ((numbers + numbers * _GOLDEN % 1.0) * (count / num)).astype(np.intp)
    return places
