"""One model over a sequence of steps or tolerances: what each number comes to, at which order, and how sure it is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import archive, record
from xdynamics.evidence.convergence import VERDICTS, judge, observed_orders
from xdynamics.evidence.observing import observe
from xdynamics.faults import InputError
from xdynamics.march import March
from xdynamics.march.asking import settings_for
from xdynamics.model import Model
from xdynamics.record.words import words_of
from xdynamics.schema import AT, AT_TIME, LEVEL, OCCURRENCE, flags
from xdynamics.units import parse_time

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]

GATES = ("failed", "passed")
FEWEST = 2  # levels
EPS = float(np.finfo(float).eps)


def refine(
    model: Model,
    *,
    method: str | None = None,
    steps: Sequence[str | float] | None = None,
    rtols: Sequence[float] | None = None,
    at: Sequence[str | float] | str | float | None = None,
    observables: Sequence[str] | None = None,
    **asked: Any,
) -> xr.Dataset:
    """March a model with one step or tolerance after the other, and compare at common physical times.

    Parameters
    ----------
    model : Model
    method : str, optional
        As for `simulate`, like everything in `asked`; the same for all levels.
    steps, rtols : sequence
        Steps, like ``["10 ms", "5 ms", "2.5 ms"]``, or relative tolerances with an `atol` that goes with each in
        proportion (1 for each unit where none is given): from coarse to fine, at least two.
    at : times, optional
        Where to compare; by default the earliest end of a level's run.
    observables : sequence of str, optional
        Coordinates, velocities, states, energies, declared observables; by default all coordinates, velocities, states.
    **asked
        Further settings, as for `simulate`.

    Returns
    -------
    xarray.Dataset
        Over `level`, from coarse to fine: `step_size` or `rtol`, `run_digest`, `run_outcome`. Over `level` and `at`, for
        each observable y: y, `difference_y` (to the next finer level), `order_y` (signed, of a level with its
        neighbours), `interpolation_error_y`, `gate_y` (whether that is smaller than the difference). Over `at`:
        `verdict_y`, `limit_y`, `uncertainty_y` (of the finest level's value, at about 95 %). The same of
        `event_time_<name>` over `occurrence`, of which the location is what interpolation is to states, and
        `event_count_<name>` over `level`.

    Raises
    ------
    InputError
        If there are not two levels that get finer, a setting is wrong, or a time is not in every run.

    Notes
    -----
    The order is that of the method in its step, and 1 in the tolerance, to which errors at the end are proportional. What
    is said of each number, and by which rule it is uncertain: `xdynamics.evidence.convergence`.

    Examples
    --------
    >>> import xdynamics as xd
    >>> model = xd.Model.from_toml("data/models/harmonic_oscillator.toml")
    >>> study = refine(model, method="rk4", steps=["40 ms", "20 ms", "10 ms", "5 ms"], at=["1 s"], observables=["x"])
    >>> study.order_x.values.round(1).ravel().tolist()
    [nan, 4.0, 4.0, nan]
    >>> study.verdict_x.attrs["flag_meanings"].split()[int(study.verdict_x[0])]
    'asymptotic'
    """
    study = _Study.of(model, method, steps, rtols, asked)
    runs = [study.marched(k) for k in range(len(study.numbers))]
    ends = [float(run["time"][-1]) for run in runs]
    times = np.array([min(ends)]) if at is None else _times(at, runs, ends)
    names = tuple(model.units) if observables is None else tuple(observables)
    return study.dataset(runs, times, names)


@dataclass(frozen=True)
class _Study:
    """What is varied, and how each level is marched."""

    model: Model
    key: str
    numbers: Floats
    formal: float
    asked: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, model: Model, method: str | None, steps: Any, rtols: Any, asked: dict[str, Any]) -> _Study:
        """Read what is varied.

        Raises
        ------
        InputError
            If it is not one thing that gets finer.
        """
        if (steps is None) == (rtols is None):
            raise InputError("refine needs steps=[…] or rtols=[…], one of them")
        key, given = ("step", steps) if rtols is None else ("rtol", rtols)
        if isinstance(given, str | float | int):
            raise InputError(f"{key}s is {given!r}, needs a row of them, from coarse to fine")
        numbers = np.array([parse_time(one, key) if key == "step" else float(one) for one in given])
        if len(numbers) < FEWEST or not (np.diff(numbers) < 0).all() or not (numbers > 0).all():
            raise InputError(f"{key}s are {[*map(str, given)]}, need {FEWEST} or more that get smaller, all positive")
        more = asked | ({"method": method} if method else {})
        first = settings_for(model, **more, **{key: float(numbers[0])})
        return cls(model, key, numbers, float(first.method.order) if key == "step" else 1.0, more)

    def marched(self, k: int) -> xr.Dataset:
        """Return the run of a level."""
        asked = {"force_samples": "none"} | self.asked | {self.key: float(self.numbers[k])}
        march = March(self.model, settings_for(self.model, **asked))
        run: xr.Dataset = archive.marched(record.dataset(march, march.blocks()))
        return run

    def dataset(self, runs: list[xr.Dataset], times: Floats, names: tuple[str, ...]) -> xr.Dataset:
        """Gather everything."""
        import xarray as xr

        found = [observe(run, self.model, names, times) for run in runs]
        about = {
            "step": ("step_size", "s", "step of the level"),
            "rtol": ("rtol", "1", "relative tolerance of the level"),
        }
        name, units, said = about[self.key]
        variables: dict[str, Any] = {
            name: ((LEVEL,), self.numbers, _about(units, said)),
            "run_digest": ((LEVEL,), np.array([archive.content_digest(run) for run in runs], object), {"long_name": "content digest of the level's run", "role": "digest"}),
            "run_outcome": ((LEVEL,), np.array([run.attrs["run_outcome"] for run in runs], object), {"long_name": "outcome of the level's run", "role": "outcome"}),
            AT_TIME: ((AT,), times, _about("s", "time of comparison")),
        }  # fmt: skip
        for one in names:
            values, errors = (np.stack([level[one][i] for level in found], axis=-1) for i in (0, 1))
            units = str(runs[-1][one].attrs["units"])
            rounding = _rounding(runs[-1], values)
            limited = np.array([self._moved_by_events(runs, one, time) for time in times])
            variables |= self._judged(one, units, values, errors, rounding, limited, AT)
        met = [words_of(run["event_detector"]) for run in runs]
        for detector in dict.fromkeys(name for names in met for name in names):
            variables |= self._of_events(runs, met, detector)
        dataset = xr.Dataset(variables).set_coords(AT_TIME)
        digests = " ".join(map(str, variables["run_digest"][1]))
        return dataset.assign_attrs({
            "title": f"refinement of {self.model.name}, by {runs[0].attrs['solver_method']}", "role": "refinement", "runs": digests,
            "solver_method": runs[0].attrs["solver_method"], "formal_order": self.formal, "model_digest": self.model.digest,
            "norm": "absolute differences of neighbouring levels",
        })  # fmt: skip

    def _of_events(self, runs: list[xr.Dataset], met: list[list[str]], detector: str) -> dict[str, Any]:
        """Compare the times at which one event function was met, occurrence by occurrence."""
        times, errors = [], []
        for run, names in zip(runs, met, strict=True):
            mine = np.flatnonzero(np.array(names) == detector)
            times.append(run["event_time"].values[mine])
            errors.append(run["event_time_uncertainty"].values[mine])
        most = max(map(len, times))
        values, doubts = (np.stack([_filled(one, most) for one in each], axis=-1) for each in (times, errors))
        rounding = 4 * EPS * np.abs(values[:, -1])
        counts = np.array([len(one) for one in times])
        name = f"event_time_{detector}"
        found = self._judged(name, "s", values, doubts, rounding, np.zeros(most), OCCURRENCE)
        return found | {f"event_count_{detector}": ((LEVEL,), counts, _about("1", f"how often {detector} was met"))}

    def _judged(self, name: str, units: str, values: Floats, errors: Floats, rounding: Floats, limited: Floats, dim: str) -> dict[str, Any]:  # fmt: skip
        """Return all that is said of one number at several places, levels last in the arrays given."""
        change = np.full(values.shape, np.nan)
        change[:, :-1] = np.diff(values, axis=-1)
        # the finest level has no difference of its own: its gate is that of the last one
        last = np.abs(np.concatenate([change[:, :-1], change[:, -2:-1]], axis=-1))
        gate = (errors <= last).astype(np.int8)
        judged = [
            judge(
                values[k], self.numbers, self.formal, float(rounding[k]), float(errors[k, -2:].max()), float(limited[k])
            )
            for k in range(len(values))
        ]
        rules = sorted({one.rule for one in judged})
        each, once = (LEVEL, dim), (dim,)
        return {
            name: (each, values.T, _about(units, name)),
            f"difference_{name}": (each, change.T, _about(units, f"{name} of the next finer level less that of this one")),
            f"order_{name}": (each, observed_orders(values, self.numbers).T, _about("1", f"observed order of {name}, with the levels before and behind; below 0 differences grow")),
            f"interpolation_error_{name}": (each, errors.T, _about(units, f"how far interpolation, or the location of an event, may have {name} off")),
            f"gate_{name}": (each, gate.T, _about("1", "whether that is at most the difference to the next finer level", "flag") | flags(dict(enumerate(GATES)))),
            f"verdict_{name}": (once, np.array([one.verdict for one in judged], np.int8), _about("1", f"what the levels tell of {name}", "flag") | flags(dict(enumerate(VERDICTS)))),
            f"limit_{name}": (once, np.array([one.limit for one in judged]), _about(units, f"{name} with ever smaller {self.key}s")),
            f"uncertainty_{name}": (once, np.array([one.uncertainty for one in judged]), _about(units, f"uncertainty of {name} at the finest level, at about 95 %") | {"rules": "; ".join(rules)}),
            f"uncertainty_rule_{name}": (once, np.array([rules.index(one.rule) for one in judged], np.int8), _about("1", f"where the uncertainty of {name} is from", "flag") | flags({i: one.replace(" ", "_") for i, one in enumerate(rules)})),
        }  # fmt: skip

    def _moved_by_events(self, runs: list[xr.Dataset], name: str, time: float) -> float:
        """Return how far the uncertain times of events before it may have an observable off; without bound where their number differs."""
        counts = [int((run["event_time"].values < time).sum()) for run in runs[-2:]]
        if len(set(counts)) > 1:
            return np.inf
        run = runs[-1]
        if not counts[-1]:
            return 0.0
        rows, rates = run["event_row_before"].values[: counts[-1]], _rates(run, name)
        return float(np.sum(np.abs(rates[rows]) * run["event_time_uncertainty"].values[: counts[-1]]))


def _rates(run: xr.Dataset, name: str) -> Floats:
    """Return how fast an observable changed in the step to each row; times of events stand twice."""
    time, values = run["time"].values, run[name].values
    span = np.diff(time)
    with np.errstate(divide="ignore", invalid="ignore"):
        found = np.where(span > 0.0, np.diff(values) / span, 0.0)
    return np.concatenate([found[:1], found])


def _rounding(run: xr.Dataset, values: Floats) -> Floats:
    """Return what rounding may have added up to in the finest run: of the largest value, growing as the root of steps."""
    found: Floats = 4.0 * EPS * np.nanmax(np.abs(values), axis=-1) * np.sqrt(run.sizes["step"])
    return found


def _filled(values: Floats, size: int) -> Floats:
    return np.concatenate([values, np.full(size - len(values), np.nan)])


def _about(units: str, said: str, role: str = "refinement") -> dict[str, Any]:
    return {"units": units, "long_name": said, "role": role}


def _times(at: Any, runs: list[xr.Dataset], ends: list[float]) -> Floats:
    """Read the times of comparison."""
    given = [at] if isinstance(at, str | float | int) else list(at)
    times = np.array([parse_time(one, "at") for one in given])
    begin, end = float(runs[0]["time"][0]), min(ends)
    for one in times.tolist():
        if not begin <= one <= end:
            raise InputError(f"at has {one!r} s, needs times in every run, from {begin!r} s to {end!r} s")
    return times
