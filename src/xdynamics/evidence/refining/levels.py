"""What is varied from level to level of a refinement, from coarse to fine, and the run of each level."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.evidence.refining.convergence import HIGHEST
from xdynamics.evidence.runs import march
from xdynamics.faults import InputError
from xdynamics.march.configuration import settings_for
from xdynamics.methods.scheme import REINTEGRATE, RULES
from xdynamics.model import Model
from xdynamics.model.motion import variables
from xdynamics.model.switches import smooth_switches
from xdynamics.units import Quantity, Unit, time_in

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]

FEWEST = 2  # levels
MOST = 24  # levels, where they are added until changes are small
LOCATED = ("events", "contacts", "frictions")  # sections whose entries have time tolerances


@dataclass(frozen=True)
class Varied:
    """One thing that can be varied.

    Attributes
    ----------
    keyword : str
        Of `refine`.
    name : str
        The variable of the levels in the evidence.
    units, said : str
        `TIME_UNIT` of what is in the model's unit of time.
    ratio : float
        From one level to the next, where levels are added.
    """

    keyword: str
    name: str
    units: str
    said: str
    ratio: float


TIME_UNIT = ""
STEPS = Varied("steps", "step_size", TIME_UNIT, "step of the level", 2.0)
RTOLS = Varied("rtols", "rtol", "1", "relative tolerance of the level", 10.0)
TIME_TOLERANCES = Varied("time_tolerances", "time_tolerance", TIME_UNIT, "time tolerance of every event, contact and switch of the level", 10.0)  # fmt: skip
CHOICES = Varied("rules", "rule", "1", "how states between accepted ones, and events, are found in the level", 1.0)
ALL = (STEPS, RTOLS, TIME_TOLERANCES, CHOICES)


@dataclass(frozen=True)
class Levels:
    """One model from level to level.

    Attributes
    ----------
    model : Model
    varied : Varied
    values : ndarray of float, or of str
        From coarse to fine.
    formal : float
        The order that errors have in them: the method's in its step, 1 in a tolerance, nan of rules.
    asked : dict
        Settings that all levels share.
    keep : Path, optional
        A folder that the runs are streamed to; without it they stay in memory.
    order : float
        That of the method in its step, whatever is varied.
    """

    model: Model
    varied: Varied
    values: NDArray[Any]
    formal: float
    asked: dict[str, Any] = field(default_factory=dict)
    keep: Path | None = None
    order: float = HIGHEST

    @classmethod
    def of(
        cls, model: Model, given: Mapping[str, Any], asked: dict[str, Any], *, fewest: int, keep: Path | None = None
    ) -> Levels:
        """Read what is varied.

        Raises
        ------
        InputError
            If it is not one thing that gets finer.
        """
        said = [one for one in ALL if given[one.keyword] is not None]
        if len(said) != 1:
            raise InputError(f"refine needs {', '.join(f'{one.keyword}=[…]' for one in ALL[:-1])} or rules=[…], one of them")  # fmt: skip
        varied, values = said[0], given[said[0].keyword]
        if isinstance(values, str | float | int):
            raise InputError(f"{varied.keyword} is {values!r}, needs a row of them, from coarse to fine")
        found = np.array([_read(model, varied, one) for one in values])
        if varied is CHOICES:
            if len(found) < FEWEST or not {*found.tolist()} <= {*RULES} or len({*found.tolist()}) < len(found):
                raise InputError(f"rules are {[*map(str, values)]}, need both of {', '.join(RULES)}")
        elif len(found) < fewest or not (np.diff(found) < 0).all() or not (found > 0).all():
            raise InputError(f"{varied.keyword} are {[*map(str, values)]}, need {fewest} or more that get smaller, all positive")  # fmt: skip
        one = cls(model, varied, found, 1.0, asked, keep)
        order = float(settings_for(one.model_of(found[0]), **one.asked_of(found[0])).method.order)
        return replace(one, formal={STEPS: order, CHOICES: np.nan}.get(varied, 1.0), order=order)

    def finer(self) -> Levels:
        """Return the levels with one more, as much finer as the last one was.

        Raises
        ------
        InputError
            If there are as many as there may be.
        """
        if len(self.values) == MOST:
            raise InputError(f"there are {MOST} at most")
        ratio = self.values[-2] / self.values[-1] if len(self.values) > 1 else self.varied.ratio
        return replace(self, values=np.append(self.values, self.values[-1] / ratio))

    @property
    def ordered(self) -> bool:
        """Whether levels are numbers that errors shrink with."""
        return self.varied is not CHOICES

    def rule(self, k: int) -> str:
        """Return how states between accepted ones are found in a level."""
        return REINTEGRATE if self.ordered else str(self.values[k])

    @property
    def settings(self) -> dict[str, Any]:
        """Settings of the march that all levels share; how much memory one may take is none."""
        return {key: one for key, one in self.asked.items() if key != "memory"}

    def model_of(self, value: Any) -> Model:
        """Return the model of a level: events are located as the level says, whatever they say themselves."""
        if self.varied is TIME_TOLERANCES:
            return _located(self.model, LOCATED, {"time_tolerance": f"{float(value)!r} {self.model.time_unit.text}"})
        if self.varied is CHOICES:
            return _located(self.model, LOCATED[:1], {"root_state": str(value)})
        return self.model

    def asked_of(self, value: Any) -> dict[str, Any]:
        """Return the settings of a level."""
        keys = {STEPS: "step", RTOLS: "rtol", TIME_TOLERANCES: "time_tolerance"}
        varied = {keys[self.varied]: float(value)} if self.ordered else {}
        if self.varied is RTOLS:
            coarsest = self.settings | {"rtol": float(self.values[0])}
            tolerances = settings_for(self.model, **coarsest).tolerances
            if tolerances:  # what follows its variable goes with rtol by itself
                varied |= absolute_tolerances(self.model, coarsest, float(value) / float(self.values[0]))
        return {"force_samples": "none"} | self.settings | varied

    def located(self) -> Levels | None:
        """Return the levels with every switch located, those that are declared smooth too; none where that is not written."""
        said = tomllib.loads(self.model.to_toml())
        changed = {
            part: {name: {**one, "smooth": False} for name, one in said.get(part, {}).items() if one.get("smooth")}
            for part in ("forces", "states")
        }
        written = {name for names in changed.values() for name in names}
        if not {one.owner for one in smooth_switches(self.model)} <= written:
            return None
        return replace(self, model=self.model.replace(**{part: one for part, one in changed.items() if one}), keep=None)

    def marched(self, k: int) -> xr.Dataset:
        """Return the run of a level."""
        path = None if self.keep is None else self.keep / f"level_{k}.nc"
        memory = self.asked.get("memory")
        return march(self.model_of(self.values[k]), path, memory=memory, **self.asked_of(self.values[k]))


def absolute_tolerances(model: Model, asked: dict[str, Any], ratio: float = 1.0) -> dict[str, Any]:
    """Return given absolute tolerances, or a part of them, as they are in any units: a bare number is in those of the march."""
    tolerances = settings_for(model, **asked).tolerances
    if tolerances is None:
        return {}
    given = {name: tolerances.of(name) for name in variables(model)}
    found = {name: Quantity(ratio * one, Unit("", model.dimensions[name])) for name, one in given.items() if one is not None}  # fmt: skip
    return {"atol": found} if found else {}


def _read(model: Model, varied: Varied, given: Any) -> Any:
    if varied is CHOICES:
        return str(given)
    if varied is RTOLS:
        try:
            return float(given)
        except (TypeError, ValueError):
            raise InputError(f"rtols has {given!r}, needs numbers") from None
    return time_in(model.time_unit, given, varied.keyword)


def _located(model: Model, sections: tuple[str, ...], how: dict[str, str]) -> Model:
    """Return a model whose entries of some sections are located in another way."""
    said = tomllib.loads(model.to_toml())
    kept = {part: {name: _without_place(one) for name, one in said.get(part, {}).items()} for part in sections}
    changed = {part: {name: one | how for name, one in entries.items()} for part, entries in kept.items() if entries}
    return model.replace(**changed) if changed else model


def _without_place(entry: dict[str, Any]) -> dict[str, Any]:
    """Return an entry without its position tolerance, which would locate it as well in every level."""
    return {key: value for key, value in entry.items() if key != "position_tolerance"}
