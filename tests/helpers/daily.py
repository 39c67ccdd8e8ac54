"""Cases of which every run of the tests has some; the others are marked long, and `nox -s long` runs them."""

import pytest


def marked(cases, daily):
    """The cases as parameters, in their order; those not among the daily ones are marked long."""
    daily = list(daily)
    assert all(case in cases for case in daily), daily
    return [
        pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=() if case in daily else pytest.mark.long)
        for case in cases
    ]
