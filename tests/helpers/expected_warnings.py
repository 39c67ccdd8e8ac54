"""Marks of tests whose scenes are such that the library warns of them; what is warned of besides is still shown."""

import pytest

OF_ROUNDING = pytest.mark.filterwarnings("ignore:rounding (at the size|hides):RuntimeWarning")
OF_STRAIGHT_MOTION = pytest.mark.filterwarnings("ignore:motion is None:RuntimeWarning")  # of rigid bodies
OF_DISTANCES = pytest.mark.filterwarnings(
    "ignore:the distance (at which pairs touch|of a pair|in which pairs):RuntimeWarning"
)
