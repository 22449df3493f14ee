"""What speaks against a run that came to its end: said in its outcome, so that nobody takes its digits on trust."""

from __future__ import annotations

from collections.abc import Iterator

from xdynamics.march.runner import March
from xdynamics.stability import stiffness
from xdynamics.units import TIME

CONTROLLED = 300.0  # absolute tolerances that the largest value of a variable has at least, where they control it
COMPARABLE = 10.0  # ratio of absolute to relative tolerance of a value up to which the relative one was meant so
MOST_NAMED = 3
FEW_ROWS = 100  # of a run, from which on stiffness is looked for


def doubts(march: March) -> list[str]:
    """Return, each in a sentence, why the numbers of a march that is over may be worth less than they look."""
    return list(_of_tolerances(march))


def _of_tolerances(march: March) -> Iterator[str]:
    """Name the variables that were so small throughout that the absolute tolerance let pass any error of theirs."""
    asked, scales, model = march.settings.tolerances, march.settings.scales, march.model
    if not march.settings.adaptive or asked is None:
        return
    loose = []
    for name, size in zip(march.layout.used, march.run.largest.tolist(), strict=True):
        largest, atol = size * scales.of(model.dimensions[name]), asked.of(name)
        if 0.0 < largest < CONTROLLED * atol and atol > COMPARABLE * asked.rtol * largest:
            unit, factor = model.units[name].text, float(model.units[name].factor)
            unit = "" if unit == "1" else f" {unit}"
            loose.append(f"{name} (largest value {largest / factor:.3g}{unit}, atol {atol / factor:.3g}{unit})")
    if loose:
        rest = f" and {len(loose) - MOST_NAMED} more" if len(loose) > MOST_NAMED else ""
        yield (
            f"the tolerances did not control {', '.join(loose[:MOST_NAMED])}{rest}: no value reached"
            f" {CONTROLLED:.0f} times its absolute tolerance; give smaller ones by atol"
        )


def advice_on_stiffness(march: March) -> str:
    """Say so where an explicit method's chosen steps stand at the edge of its region of stability for most of a run."""
    method, model, names, rows = march.settings.method, march.model, march.layout.used, march.witnesses[1:]
    if not march.settings.adaptive or method.implicit or model.python_forces or march.now.rows < FEW_ROWS:
        return ""
    scales = march.settings.scales
    time, factors = scales.of(TIME), [scales.of(model.dimensions[name]) for name in names]

    def limited(first: int, last: int) -> float:
        chosen = rows[:, first:last]
        states = [
            {"t": t * time} | {name: x * f for name, x, f in zip(names, state, factors, strict=True)}
            for t, _, *state in chosen.T.tolist()
        ]
        return stiffness(model, method, states, (chosen[1] * time).tolist())

    # one row first: it costs a millisecond, and most runs are not stiff
    middle = rows.shape[1] // 2
    if limited(middle, middle + 1) and limited(0, rows.shape[1]) > 0.5:
        return (
            f"stiffness suspected: stability, not accuracy, limits the steps of '{method.name}' for most of the run;"
            " radau_iia takes longer ones"
        )
    return ""
