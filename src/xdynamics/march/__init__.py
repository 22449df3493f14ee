"""The march: propose, judge, locate, accept, note; in compiled blocks."""

from xdynamics.march.log import Log
from xdynamics.march.outcomes import OUTCOMES, Outcome
from xdynamics.march.runner import Block, March, Settings

__all__ = ["OUTCOMES", "Block", "Log", "March", "Outcome", "Settings"]
