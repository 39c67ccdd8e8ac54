"""What is near at one time, on one rank."""

from ccd_warp._engine.proximity_step import ProximityStep
from ccd_warp.distributed._part_step import StepTogether


class PartProximityStep(StepTogether, ProximityStep):
    """The pairs within a distance among the primitives of a part."""
