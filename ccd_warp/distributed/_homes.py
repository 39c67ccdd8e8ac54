"""Homes: for each number of a range one rank collects what all ranks send about it, and answers each of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ccd_warp.distributed import _numbering as numbering
from ccd_warp.distributed._ranks import Ranks


@dataclass(frozen=True)
class Homes:
    """Consecutive ranges of numbers, one a rank.

    Attributes:
        ranks: The ranks.
        first: The first number of each home but the first, ascending.
    """

    ranks: Ranks
    first: NDArray[np.int64]

    def ask(self, rows: NDArray[Any], numbers: NDArray[np.int64]) -> Queries:
        """Send each row to the home of its number, and get those whose home this rank is; collective."""
        sent = numbering.by_destination(numbering.home_of(self.first, numbers), self.ranks.size)
        return Queries(self.ranks, sent, self.ranks.swap([rows[items] for items in sent]))


@dataclass(frozen=True)
class Queries:
    """What ranks have asked their homes.

    Attributes:
        ranks: The ranks.
        sent: For each rank the rows of this one that went there.
        received: The rows that have come from each rank.
    """

    ranks: Ranks
    sent: list[NDArray[np.intp]]
    received: list[NDArray[Any]]

    @property
    def rows(self) -> NDArray[Any]:
        """All rows that have come, rank after rank."""
        return np.concatenate(self.received)

    @property
    def holder(self) -> NDArray[np.intp]:
        """The rank from which each of them has come."""
        return np.repeat(np.arange(self.ranks.size), [len(part) for part in self.received])

    def answers(self, replies: NDArray[Any]) -> NDArray[Any]:
        """What the homes say to each row that this rank has sent, given what it says to each that has come; collective.

        Replies have shape [n, k], and so have the answers.
        """
        back = self.ranks.swap(np.split(replies, np.cumsum([len(part) for part in self.received])[:-1]))
        result = np.empty((sum(map(len, self.sent)), replies.shape[1]), dtype=replies.dtype)
        for items, answer in zip(self.sent, back, strict=True):
            result[items] = answer
        return result
