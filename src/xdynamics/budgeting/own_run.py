"""What a budget says of the run that its number is of."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, NamedTuple

from xdynamics.budgeting.measurand import Measurand
from xdynamics.evidence.audit import contradiction
from xdynamics.evidence.diagnosing.heights import RULES
from xdynamics.evidence.kept_results import ResultForm
from xdynamics.evidence.stage_tasks import Task
from xdynamics.schema import STEPS

if TYPE_CHECKING:
    import xarray as xr


class OwnRun(NamedTuple):
    """The run of a budget, as far as its Dataset names it: a few words, so that the run stays where it was marched.

    Attributes
    ----------
    method, outcome : str
    units : str
        Of the number.
    step_units : str
        Of its steps, which are pure numbers where its time is.
    extreme_rule : str, optional
        How an extreme was found; None for other numbers.
    extreme_time : float
        When it was, in the model's unit of time.
    contradiction : str
        What contradicts itself in its record, in words; nothing if nothing does. See `evidence.audit`.
    """

    method: str
    outcome: str
    units: str
    step_units: str
    extreme_rule: str | None
    extreme_time: float
    contradiction: str = ""

    @classmethod
    def from_run(cls, measurand: Measurand, run: xr.Dataset) -> OwnRun:
        """Describe a run; one without rows is still to be marched.

        Raises
        ------
        InputError
            If it does not have the number.
        """
        target = measurand.target
        rule, time = (None if target.extreme is None else ""), float("nan")
        if run.sizes[STEPS] and (extreme := target.extreme_in(run, measurand.model)) is not None:
            rule, time = RULES[extreme.rule], extreme.time
        units, step_units = target.units(run).text, str(run["step_size"].attrs["units"])
        method, outcome = str(run.attrs["solver_method"]), str(run.attrs["run_outcome"])
        contradiction_text = contradiction(run, measurand.model.functions) if run.sizes[STEPS] else ""
        return cls(method, outcome, units, step_units, rule, time, contradiction_text)


OWN_RUNS = ResultForm(list, lambda entries: OwnRun(*entries))


def own_run_task(measurand: Measurand, run: Task) -> Task:
    """Return the task that describes a run."""
    task = Task.of("own_run", partial(OwnRun.from_run, measurand.unkept), (run,), *measurand.inputs)
    return task if measurand.keep is None else measurand.keep.task(task, OWN_RUNS)
