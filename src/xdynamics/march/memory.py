"""The memory to continue a march: all its arrays by name, or after its end the few numbers that a record keeps."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.faults import InputError
from xdynamics.kernels.program import REGIME
from xdynamics.march.log import unwritten
from xdynamics.march.outcomes import RUNNING
from xdynamics.march.past import fit_past_room, trim_past
from xdynamics.march.run import ARRAYS, CHANGING, Lifetime, Run
from xdynamics.model.reactions import MODES

Array = NDArray[Any]
Floats = NDArray[np.float64]

LARGE = 1 << 20  # bytes of an array that is worth it
OF_TRIALS = ("z", "e", "samples", "half", "whole", "located_z", "located_e", "located_samples", "full", "full_e")
OF_START = ("turning", "probe")  # and of what looks at a march that has ended
OF_SOLVERS = ("matrix", "right", "stage", "shifted", "stages", "turned", "past")
_OF_DELAYS = ("past_steps", "breaks", "book")
_OF_DEPARTURES = ("departures",)
_OF_CONTACTS = ("modes", "touches", "closed", "greatest", "grips")
# of contacts, after all others: archives of version 0.2 lack them, and go on as if nothing had moved before
LATER = ("swiftest", "lingering")
# after a node forces are evaluated anew, and a method starts as at the beginning
AT_END = tuple(name for name in CHANGING if ARRAYS[name].lifetime == Lifetime.LASTING and name not in LATER)


def changing_arrays(run: Run) -> dict[str, Array]:
    """Return a copy of every array that a march changes, except its log."""
    return {name: getattr(run, name).copy() for name in CHANGING}


def put_back(run: Run, arrays: Mapping[str, Array]) -> None:
    """Restore such arrays in a run of equal model and settings, which then continues with equal bits.

    Raises
    ------
    InputError
        If an array has a different form; the message names the first one.
    """
    if run.delays.size:
        fit_past_room(run, arrays["past_steps"].size, arrays["breaks"].shape[1])
    for name in CHANGING:
        target, source = getattr(run, name), arrays.get(name)
        if (
            source is None and not target.size
        ):  # of a version that did not have it, and by its rule, which does not need it
            continue
        if source is None or (source.dtype, source.shape) != (target.dtype, target.shape):
            raise InputError(f"the run's '{name}' has another form than here: it is of another version of xdynamics")
    for name in CHANGING:
        if name in arrays:
            getattr(run, name)[...] = arrays[name]


def final_numbers(run: Run) -> tuple[str, Floats]:
    """Return the numbers that a march needs to go on after its end, and the names of their arrays and fields.

    Shares of contacts' forces in what others bear are among them where there are any.
    """
    trim_past(run)
    names, numbers = _named_final_numbers(run)
    shares, modes, others = _shares(run)
    if shares.start == shares.stop or numbers[shares].any():
        return names, numbers
    return names.replace(modes, others), np.delete(numbers, shares)


def _named_final_numbers(run: Run) -> tuple[str, Floats]:
    names, parts = [], []
    for name in _final_array_names(run):
        array = getattr(run, name)
        fields = _kept_field_names(run, name)
        names += [f"{name}.{field}" for field in fields] if fields else [f"{name}[{array.size}]"]
        parts += [array[field] for field in fields] if fields else [array.ravel()]
    return " ".join(names), np.concatenate(parts, dtype=float, casting="unsafe")


def rest_on(run: Run, numbers: Floats) -> None:
    """Make the arrays of a finished march views of its record's numbers, instead of copies."""
    if numbers.nbytes < LARGE:
        return
    first = 0
    for name in _final_array_names(run):
        array, fields = getattr(run, name), _kept_field_names(run, name)
        if not fields and array.dtype == numbers.dtype and array.nbytes >= LARGE:
            run.put(**{name: numbers[first : first + array.size].reshape(array.shape)})
        first += array.size * max(1, len(fields))


def march_apart(march: Callable[[Run, int], None], run: Run, rows: int) -> None:
    """March for a number of rows; memory of the start alone is released before a step is made."""
    if run.probe.nbytes >= LARGE and not run.now[0].rows:
        march(run, 0)
        _unwrite_arrays(run, OF_START)
    else:
        march(run, rows)


def give_back_memory(run: Run) -> None:
    """Give back the memory of steps of a march that has ended."""
    _unwrite_arrays(run, (*OF_TRIALS, *OF_SOLVERS))


def _unwrite_arrays(run: Run, names: Iterable[str]) -> None:
    """Replace arrays that nothing reads any more by unwritten pages."""
    for name in names:
        if (array := getattr(run, name)).nbytes >= LARGE:
            run.put(**{name: unwritten(array.size)})


def go_on_from_end(run: Run, names: str, numbers: Floats) -> None:
    """Set a run to the end of another one of its model; the end is a node of this one.

    Raises
    ------
    InputError
        If the numbers belong to a run of a different form.
    """
    if run.delays.size:
        sizes = {name: int(size) for name, size in re.findall(r"(past_steps|breaks)\[(\d+)\]", names)}
        fit_past_room(run, sizes.get("past_steps", 0), sizes.get("breaks", 0) // 2)
    expected, current_numbers = _named_final_numbers(run)
    shares, modes, others = _shares(run)
    if modes not in names and others in names:
        names, numbers = (
            names.replace(others, modes),
            np.insert(numbers, shares.start, np.zeros(shares.stop - shares.start)),
        )
    short = sum(getattr(run, name).size for name in LATER)
    if names == expected.rsplit(maxsplit=len(LATER))[0] and numbers.size == current_numbers.size - short:
        names, numbers = expected, np.append(numbers, np.zeros(short))
    if names != expected or numbers.shape != current_numbers.shape:
        raise InputError("its memory of the end is of another version of xdynamics")
    first = 0
    for name in _final_array_names(run):
        array = getattr(run, name)
        fields = _kept_field_names(run, name)
        for part in [array[field] for field in fields] if fields else [array.reshape(-1)]:
            part[...] = numbers[first : first + part.size]
            first += part.size
    now = run.now[0]
    now.status, now.crossed = RUNNING, now.node - 1
    run.at[REGIME] = now.regime


def _shares(run: Run) -> tuple[slice, str, str]:
    """Return where the final numbers have shares of contacts' forces, and the name of the modes with them and without."""
    m, size, kept = run.touches.size, run.modes.size, _final_array_names(run)
    count = m * (m - 1) // 2 if run.plan[0].indeterminate else 0
    earlier = kept[: kept.index("modes")] if count else []
    first = MODES * m + sum(getattr(run, name).size * max(1, len(_kept_field_names(run, name))) for name in earlier)
    return slice(first, first + count), f"modes[{size}]", f"modes[{size - count}]"


def _kept_field_names(run: Run, name: str) -> tuple[str, ...]:
    """Return the fields of an array whose final values a record keeps; of times rests only where numbers have them."""
    fields = getattr(run, name).dtype.names or ()
    if "rest" not in fields or run.plan[0].doubled:
        return fields
    return tuple(field for field in fields if field != "rest")


def _final_array_names(run: Run) -> list[str]:
    """Return the arrays whose final values a record keeps; those of contacts and switches where there are any."""
    names = [name for name in AT_END if name not in (*_OF_CONTACTS, *_OF_DELAYS) or getattr(run, name).size]
    names += ["places"] if (run.detectors["drive"] >= 0).any() else []
    names = [name for name in names if name not in _OF_DEPARTURES or run.departures.size]
    return [*names, *LATER] if run.touches.size else names
