"""The last kernel of a round on CUDA where contacts are kept: it lowers the minima by each contact, and lists it."""

import warp as wp

from ..pair.query import Options
from ..parameters import norm, only_method, real
from ..step.minima import QUEUED, Minima
from ..step.pair_list import LeastToi, PairList, Round
from ..step.step import ContactList
from .pair_contacts import Outcome, record_contact
from .pair_outcome import num_pairs
from .pair_queue import SETTLED, Queue, num_taken, place_of
from .queued_launch import MAX_REGISTERS, module_of
from .sinks import Table


@wp.kernel(module=module_of("solve_pairs.placed", real, norm, only_method), cuda_max_registers=MAX_REGISTERS["placed"])
def place_contacts(
    begin: int,
    # in
    num_threads: int,
    pairs: PairList,
    options: Options,
    round: Round,
    num_rows: int,
    others: PairList,
    queue: Queue,
    # out
    table: Table,
    minima: Minima,
    contacts: ContactList,
    least: LeastToi,
):
    """Lower the minima by each contact that a round has put into the queue, and list it; after the stages above."""
    of_first = num_pairs(pairs, options, round)
    column = QUEUED + round.is_second
    following = begin + wp.tid()
    while following < num_taken(pairs.counts[pairs.kind, column]):
        n = place_of(following, pairs.counts[pairs.kind, column], queue)
        following += num_threads
        pair = queue.pairs[n]
        if pair.row < SETTLED:
            of_contact = queue.contact[n]
            outcome = Outcome()
            outcome.toi = pair.t
            outcome.status = pair.used
            outcome.parameters = wp.vec2d(of_contact[0], of_contact[1])
            outcome.gap = of_contact[2]
            outcome.width = of_contact[3]
            k = SETTLED - 1 - pair.row
            of_kind = pairs
            if k >= of_first:
                k -= of_first
                of_kind.kind = others.kind  # as in `queued_stage`
                of_kind.keys = others.keys
                of_kind.first_corners = others.first_corners
                of_kind.second_corners = others.second_corners
            record_contact(of_kind, k, outcome, options, round, minima, contacts)
