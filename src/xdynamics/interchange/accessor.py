"""`run.dynamics`: the usual questions to a run in a notebook, each by the verb that answers it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from xdynamics.archive import digest_of_run, without_stale_units
from xdynamics.documenting.summary import summary
from xdynamics.dynamics.recorded_steps import wanted_times
from xdynamics.evidence.evidence_dataset import attrs_of, evidence_dataset
from xdynamics.evidence.sampling import sample
from xdynamics.faults import InputError
from xdynamics.interchange.pages import page, show_pages, show_time_notes
from xdynamics.interchange.solution import Solution, solution
from xdynamics.interchange.tables import frame, table
from xdynamics.interchange.tree import states_on_side, tree
from xdynamics.record import check_kind
from xdynamics.record.flag_words import time_unit_of, without_bounds, words_of_flag
from xdynamics.record.named_rows import rows_of_events
from xdynamics.record.pint_records import is_quantified, quantified, teach, without_pint_units
from xdynamics.schema import AT, AT_TIME, EVENTS, KINEMATIC, STEPS
from xdynamics.simulation.single_run import model_of_run

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    import pandas as pd
    import xarray as xr

    from xdynamics.archive.store import Given
    from xdynamics.figures.animation import Film
    from xdynamics.figures.sheet import Picture
    from xdynamics.model import Model

teach()  # whoever imported pint-xarray too
show_pages()
show_time_notes()


class Dynamics:
    """The usual questions to a run record: states between steps, events, tables, pictures.

    Examples
    --------
    >>> import xdynamics as xd
    >>> run = xd.simulate(xd.Model.from_toml("data/models/ball_drag.toml"), method="dop853", rtol=1e-9)
    >>> float(run.dynamics.at("1 s").y.round(4))
    13.709
    >>> run.dynamics.events("apex").event_time.round(6).values.tolist()
    [1.798787]
    >>> run.dynamics.frame("event").columns[:2].tolist()
    ['event_time', 'event_time_bounds_lower']
    """

    def __init__(self, run: xr.Dataset) -> None:
        teach()
        self._received = run
        self._run = without_pint_units(run) if is_quantified(run) else run

    def _in_kind(self, result: xr.Dataset) -> xr.Dataset:
        """Return a result with units in its arrays, if the record has them there."""
        return quantified(result) if self._run is not self._received else result

    def __repr__(self) -> str:
        return "\n".join(summary(self._run))

    def _repr_html_(self) -> str:
        return page(self._run)

    def at(self, times: Any, **how: Any) -> xr.Dataset:
        """Return the states at any times inside the run; see `xdynamics.sample`.

        At one time, ``"1 s"`` or 1.0, each is one number; at ``[0.1, 0.2]`` or ``"0:20:201 s"`` they lie along `at`. Of
        a refinement, a comparison, states at given times, what stands at these: nothing is interpolated.

        Raises
        ------
        InputError
            If a time lies outside the run, or is none of those that the Dataset has.
        """
        values = (
            self._rows_at_common_times(times, how)
            if {AT, STEPS} & {*self._run.sizes} == {AT}
            else sample(self._run, times, **how)
        )
        states = self._in_kind(values)
        is_one = np.ndim(times) == 0 and not {":", ","} & {*str(times)}
        return states.isel({AT: 0}) if is_one else states

    def _rows_at_common_times(self, times: Any, how: Mapping[str, Any]) -> xr.Dataset:
        """Return the rows of a Dataset at some of its common times."""
        if how:
            raise InputError(
                f"{', '.join(how)} says how a run is sampled; this Dataset has its values at `at_time` alone"
            )
        common_times = np.asarray(self._run[AT_TIME].values)
        if common_times.ndim != 1:
            raise InputError("the times of this Dataset are of each member its own; select a member first")
        requested_times = wanted_times(times, time_unit_of(self._run))
        rows = [np.flatnonzero(common_times == time) for time in requested_times.tolist()]
        if missing := [repr(time) for time, row in zip(requested_times.tolist(), rows, strict=True) if not row.size]:
            known_times = ", ".join(map(repr, common_times[:10].tolist())) + (" …" if common_times.size > 10 else "")
            raise InputError(f"there is no time {', '.join(missing)} here; at_time has {known_times}")
        return self._run.isel({AT: [int(row[0]) for row in rows]})

    def events(self, name: str | None = None) -> xr.Dataset:
        """Return the located events, or those of one name, with the states on both sides.

        Returns
        -------
        xarray.Dataset
            Along `event`: `event_name`, `event_time`, `event_time_uncertainty`, declared observables there, and of every
            coordinate, velocity, acceleration and state y `before_y` and `after_y`.

        Raises
        ------
        InputError
            If the run has no such event.
        """
        check_kind(self._run)
        run, names = without_stale_units(self._run), self._names()
        event_names = (
            str(run["event_detector"].attrs.get("flag_meanings", "")).split() if "event_detector" in run else []
        )
        if name is not None and name not in event_names:
            raise InputError(f"the run knows no event {name!r}; there are {', '.join(event_names) or 'none'}")
        rows = np.flatnonzero(names == name) if name is not None else np.arange(len(names))
        left_out = ("event_row_before", "event_row_after", "event_detector")
        event_variables = [
            variable
            for variable in map(str, run.data_vars)
            if run[variable].dims == (EVENTS,) and variable not in left_out
        ]
        variables: dict[str, Any] = {
            "event_name": ((EVENTS,), names[rows], attrs_of("1", "event, contact or friction element", "name"))
        }
        variables |= {
            variable: ((EVENTS,), run[variable].values[rows], without_bounds(run[variable].attrs))
            for variable in ("event_time", *event_variables)
        }
        for side in ("before", "after"):
            states = states_on_side(run, side, rows_of_events(run, side, rows), KINEMATIC)
            variables |= {
                word: (state.dims, state.data, state.attrs) for word, state in states.items() if state.ndim == 1
            }
        title = f"{run.attrs.get('title', 'run')}: {name or 'events'}"
        return self._in_kind(evidence_dataset("events", title, [digest_of_run(self._run)], variables, {}))

    def frame(self, dim: str = STEPS) -> pd.DataFrame:
        """Return everything along one dimension as a pandas table, one row for each entry; flags as their words.

        Parameters
        ----------
        dim : {"step", "trial", "event", "sample", "at"}

        Returns
        -------
        pandas.DataFrame
            Columns named as the variables; ``frame.attrs["units"]`` has the unit of each.

        Raises
        ------
        InputError
            If the record has no such dimension.
        """
        return frame(self._run, dim)

    def table(self, of: str | None = None, *, rounded: bool = False) -> pd.DataFrame:
        """Return a table with units in its headers, a row a step, event, level, case, term or member; see `interchange.tables`.

        Examples
        --------
        >>> import xdynamics as xd
        >>> run = xd.simulate(xd.Model.from_toml("data/models/ball_drag.toml"), method="dop853", rtol=1e-9)
        >>> run.dynamics.table("events")[["event_detector", "event_time [s]"]].round(3).values.tolist()
        [['apex', 1.799], ['ground', 3.711]]
        """
        return table(self._run, of, rounded=rounded)

    def tree(self) -> xr.DataTree:
        """Return the run as a tree of plain tables: ``/steps``, ``/events`` with both one-sided states, and so on.

        Examples
        --------
        >>> import xdynamics as xd
        >>> run = xd.simulate(xd.Model.from_toml("data/models/ball_drag.toml"), method="dop853", rtol=1e-9)
        >>> run.dynamics.tree()["events"].dataset[["event_time", "before_v_y"]].to_dataframe().shape
        (2, 2)
        """
        return tree(self._run)

    def model(self, functions: Mapping[str, Callable[..., float]] | None = None) -> Model:
        """Return the run's model, with the settings that it was marched with as its `[run]`; see `simulate`."""
        return model_of_run(self._run, functions)

    @property
    def solution(self) -> Solution:
        """The run as scipy's solve_ivp returns one: t, y, sol, t_events, y_events, status, message."""
        return solution(self._run)

    def quantify(self) -> xr.Dataset:
        """Return the record with units in its arrays, by pint-xarray; every verb takes it so."""
        return quantified(self._run)

    def plot(self, path: Given | None = None, **how: Any) -> Picture:
        """Draw the run; see `xdynamics.plot`."""
        from xdynamics.figures import plot

        return plot(self._run, path, **how)

    def animate(self, path: Given | None = None, **how: Any) -> Film:
        """Film the motion in the plane; see `xdynamics.animate`."""
        from xdynamics.figures.animation import animate

        return animate(self._run, path, **how)

    def _names(self) -> Any:
        return np.array(words_of_flag(self._run["event_detector"]) if self._run.sizes.get(EVENTS, 0) else [], dtype=str)
