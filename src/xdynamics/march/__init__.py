"""The march: aim, propose, judge, reject or locate and accept, log; in compiled blocks."""

from xdynamics.march.ensemble import Runs, march_each, march_many
from xdynamics.march.log import Log, LogBlock
from xdynamics.march.outcomes import OUTCOMES, Outcome
from xdynamics.march.runner import March
from xdynamics.march.settings import Pacing, Settings
from xdynamics.march.tolerances import Tolerances

__all__ = [
    "OUTCOMES",
    "Log",
    "LogBlock",
    "March",
    "Outcome",
    "Pacing",
    "Runs",
    "Settings",
    "Tolerances",
    "march_each",
    "march_many",
]
