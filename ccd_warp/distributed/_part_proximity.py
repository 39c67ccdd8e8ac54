"""What is near at one time, how near each vertex is to anything, and how far it may move, on one rank."""

from ccd_warp._engine.at_one_time.proximity_step import DisplacementStep, HoldStep, ProximityStep
from ccd_warp.distributed._part_step import StepTogether


class PartProximityStep(StepTogether, ProximityStep):
    """The pairs within a distance among the primitives of a part."""


class PartDisplacementStep(StepTogether, DisplacementStep):
    """How far the vertices of a part may move, as far as its own pairs tell."""


class PartHoldStep(StepTogether, HoldStep):
    """How near the vertices of a part are to anything, as far as its own pairs tell."""
