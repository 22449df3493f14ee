"""The quantity varied from level to level of a refinement, from coarse to fine, and the run of each level."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.evidence.refining.convergence import HIGHEST, are_restrained
from xdynamics.evidence.stage_tasks import Task, march_task, results_of
from xdynamics.faults import InputError
from xdynamics.kernels import layout_of
from xdynamics.march.configuration import settings_for
from xdynamics.methods.scheme import PRECISIONS, REINTEGRATE, RULES
from xdynamics.model import Model
from xdynamics.model.switches import smooth_switches
from xdynamics.model.toml import section_tables
from xdynamics.units import Quantity, Unit, time_in

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]

FEWEST = 2  # levels
MOST = 24  # levels, if they are added until changes are small
COUNT = 5  # of levels, where the coarsest one is given alone
LOCATED = ("events", "contacts", "frictions")  # sections whose entries have time tolerances


@dataclass(frozen=True)
class Varied:
    """A quantity that can be varied.

    Attributes
    ----------
    keyword : str
        Of `refine`.
    name : str
        The variable of the levels in the evidence.
    units, long_name : str
        Its units, `TIME_UNIT` for the model's unit of time, and its long name.
    ratio : float
        From one level to the next, where levels are added.
    """

    keyword: str
    name: str
    units: str
    long_name: str
    ratio: float


TIME_UNIT = ""
STEPS = Varied("steps", "step_size", TIME_UNIT, "step of the level", 2.0)
RTOLS = Varied("rtols", "rtol", "1", "relative tolerance of the level", 10.0)
TIME_TOLERANCES = Varied(
    "time_tolerances",
    "time_tolerance",
    TIME_UNIT,
    "time tolerance of every event, contact and switch of the level",
    10.0,
)
CHOICES = Varied("rules", "rule", "1", "how states between accepted ones, and events, are found in the level", 1.0)
KINDS = Varied("precisions", "precision", "1", "kind of the numbers of the level", 1.0)
ALL = (STEPS, RTOLS, TIME_TOLERANCES, KINDS, CHOICES)
WORDS = {KINDS: PRECISIONS, CHOICES: RULES}  # what is varied that is no number


@dataclass(frozen=True)
class Levels:
    """One model at every level of a refinement.

    Attributes
    ----------
    model : Model
    varied : Varied
    values : ndarray of float, or of str
        From coarse to fine.
    formal : float
        The order of errors in the values: the method's in its step, 1 in a tolerance, nan for rules.
    shared_settings : dict
        Settings that all levels share.
    keep : Path, optional
        A folder to which the runs are streamed; without it they stay in memory.
    order : float
        The method's in its step, whatever is varied.
    """

    model: Model
    varied: Varied
    values: NDArray[Any]
    formal: float
    shared_settings: dict[str, Any] = field(default_factory=dict)
    keep: Path | None = None
    order: float = HIGHEST

    @classmethod
    def of(
        cls,
        model: Model,
        choices: Mapping[str, Any],
        shared_settings: dict[str, Any],
        *,
        fewest: int,
        keep: Path | None = None,
    ) -> Levels:
        """Read the values of the levels.

        Raises
        ------
        InputError
            If not exactly one quantity is varied, or its values do not get finer.
        """
        varied_candidates = [candidate for candidate in ALL if choices[candidate.keyword] is not None]
        if len(varied_candidates) != 1:
            raise InputError(
                f"refine needs {', '.join(f'{candidate.keyword}=[…]' for candidate in ALL[:-1])} or rules=[…], one of"
                " them"
            )
        varied, values = varied_candidates[0], choices[varied_candidates[0].keyword]
        if isinstance(values, str | float | int):
            raise InputError(f"{varied.keyword} is {values!r}, needs a row of them, from coarse to fine")
        level_values = np.array([_read_level_value(model, varied, candidate) for candidate in values])
        if varied in WORDS:
            if (
                len(level_values) < FEWEST
                or not {*level_values.tolist()} <= {*WORDS[varied]}
                or len({*level_values.tolist()}) < len(level_values)
            ):
                raise InputError(f"{varied.keyword} are {[*map(str, values)]}, need both of {', '.join(WORDS[varied])}")
        elif len(level_values) < fewest or not (np.diff(level_values) < 0).all() or not (level_values > 0).all():
            raise InputError(
                f"{varied.keyword} are {[*map(str, values)]}, need {fewest} or more that get smaller, all positive"
            )
        candidate = cls(model, varied, level_values, 1.0, shared_settings, keep)
        order = float(
            settings_for(
                candidate.model_of(level_values[0]), **candidate.settings_of_level(level_values[0])
            ).method.order
        )
        return replace(candidate, formal=({STEPS: order} | dict.fromkeys(WORDS, np.nan)).get(varied, 1.0), order=order)

    def finer(self) -> Levels:
        """Return the levels with one more, as much finer as the last one was.

        Raises
        ------
        InputError
            If there are as many levels as allowed.
        """
        if len(self.values) == MOST:
            raise InputError(f"there are {MOST} at most")
        ratio = self.values[-2] / self.values[-1] if len(self.values) > 1 else self.varied.ratio
        return replace(self, values=np.append(self.values, self.values[-1] / ratio))

    @property
    def ordered(self) -> bool:
        """Whether levels are numbers with which errors shrink."""
        return self.varied not in WORDS

    def are_restrained(self, accepted: Sequence[int]) -> bool:
        """Whether something else than the tolerances of the levels sets their steps, of which each accepted so many."""
        return self.varied == RTOLS and are_restrained(accepted, self.values, self.order)

    def rule(self, k: int) -> str:
        """Return the rule by which states between accepted ones are interpolated in a level."""
        return str(self.values[k]) if self.varied == CHOICES else REINTEGRATE

    @property
    def settings(self) -> dict[str, Any]:
        """Settings of the march that all levels share, without the limit of memory."""
        return {key: value for key, value in self.shared_settings.items() if key != "memory"}

    def model_of(self, value: Any) -> Model:
        """Return the model of a level: events are located as the level prescribes, not as the model does."""
        if self.varied == TIME_TOLERANCES:
            return _with_location(
                self.model, LOCATED, {"time_tolerance": f"{float(value)!r} {self.model.time_unit.text}"}
            )
        if self.varied == CHOICES:
            return _with_location(self.model, LOCATED[:1], {"root_state": str(value)})
        return self.model

    def settings_of_level(self, value: Any) -> dict[str, Any]:
        """Return the settings of a level."""
        keys = {STEPS: "step", RTOLS: "rtol", TIME_TOLERANCES: "time_tolerance"}
        varied: dict[str, Any] = {keys[self.varied]: float(value)} if self.ordered else {}
        varied |= {"precision": str(value)} if self.varied == KINDS else {}
        if self.varied == RTOLS:
            coarsest = self.settings | {"rtol": float(self.values[0])}
            tolerances = settings_for(self.model, **coarsest).tolerances
            if tolerances:  # those that follow their variable scale with rtol by themselves
                varied |= absolute_tolerances(self.model, coarsest, float(value) / float(self.values[0]))
        return {"force_samples": "none"} | self.settings | varied

    def located(self) -> Levels | None:
        """Return the levels with every switch located, even if declared smooth; None if a switch has no such entry."""
        tables = section_tables(self.model.statement)
        changed = {
            part: {
                name: {**entry, "smooth": False} for name, entry in tables.get(part, {}).items() if entry.get("smooth")
            }
            for part in ("forces", "states")
        }
        changed_names = {name for names in changed.values() for name in names}
        if not {entry.owner for entry in smooth_switches(self.model)} <= changed_names:
            return None
        return replace(
            self, model=self.model.replace(**{part: entry for part, entry in changed.items() if entry}), keep=None
        )

    def marched(self, k: int) -> xr.Dataset:
        """Return the run of a level."""
        run: xr.Dataset = results_of(self.task(k))[0]
        return run

    def task(self, k: int) -> Task:
        """Return the task that marches a level."""
        value, path = self.values[k], None if self.keep is None else self.keep / f"level_{k}.nc"
        return march_task(
            self.model_of(value), path, self.shared_settings.get("memory"), **self.settings_of_level(value)
        )


def absolute_tolerances(model: Model, settings: dict[str, Any], ratio: float = 1.0) -> dict[str, Any]:
    """Return the absolute tolerances that were set, times a ratio, as quantities; a bare number has the march's unit.

    Raises
    ------
    InputError
        If a setting is wrong.
    """
    tolerances = settings_for(model, **settings).tolerances
    if tolerances is None:
        return {}
    dims, scaled = model.shapes.dims, dict[str, Quantity]()
    for name, tolerance in tolerances.of_blocks(layout_of(model).used).items():
        first = model.shapes.first(name) if name in dims else name
        scaled[name] = Quantity(ratio * tolerance, Unit("", model.elements.dimensions[first]))
    return {"atol": scaled} if scaled else {}


def levels_from_coarsest(
    model: Model, step: Any, rtol: Any, *, count: int = COUNT, ratio: float | None = None, head: str = ""
) -> dict[str, list[float]]:
    """Return the levels that begin with one step, by default that of the model's [run], or with one tolerance.

    Parameters
    ----------
    model : Model
    step, rtol : optional
        One of them.
    count : int
        Of the levels.
    ratio : float, optional
        From one to the next; by default 2 for steps and 10 for tolerances.
    head : str
        What stands before the names of settings in messages.

    Raises
    ------
    InputError
        If both are given, or neither, or one is none.
    """
    coarsest = step if step is not None or rtol is not None else model.run.get("step")
    if step is not None and rtol is not None:
        raise InputError(f"{head}step and {head}rtol are both given; one of them is varied")
    if rtol is None and coarsest is None:
        raise InputError(
            f"model '{model.name}' has no step in its [run]; give {head}step or {head}rtol, the coarsest one"
        )
    if rtol is None:
        varied, first = STEPS, time_in(model.time_unit, coarsest, f"{head}step")
    else:
        try:
            varied, first = RTOLS, float(rtol)
        except (TypeError, ValueError):
            raise InputError(f"{head}rtol is {rtol!r}, needs a number") from None
    return {varied.keyword: [first / (ratio or varied.ratio) ** k for k in range(count)]}


def _read_level_value(model: Model, varied: Varied, value: Any) -> Any:
    if varied in WORDS:
        return str(value)
    if varied == RTOLS:
        try:
            return float(value)
        except (TypeError, ValueError):
            raise InputError(f"rtols has {value!r}, needs numbers") from None
    return time_in(model.time_unit, value, varied.keyword)


def _with_location(model: Model, sections: tuple[str, ...], change: dict[str, str]) -> Model:
    """Return a model in which the entries of some sections are located in another way."""
    tables = section_tables(model.statement)
    unplaced = {
        part: {name: _without_place(entry) for name, entry in tables.get(part, {}).items()} for part in sections
    }
    changed = {
        part: {name: entry | change for name, entry in entries.items()} for part, entries in unplaced.items() if entries
    }
    return model.replace(**changed) if changed else model


def _without_place(entry: dict[str, Any]) -> dict[str, Any]:
    """Return an entry without its position tolerance, which would locate it equally well in every level."""
    return {key: value for key, value in entry.items() if key != "position_tolerance"}
