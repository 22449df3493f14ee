"""The rows of a validation ledger: single rows, their Dataset, and their lines of text.

The elements of a quantity share one row: that of the worst element, with the number of elements that were judged.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from xdynamics.evidence.evidence_dataset import ROLE as SCALED
from xdynamics.evidence.evidence_dataset import attrs_of, divide_by_scale, evidence_dataset
from xdynamics.evidence.kept_results import ResultForm
from xdynamics.faults import first_names
from xdynamics.record.flag_words import words_of_flag
from xdynamics.schema import CASE, RESIDUAL_SCALE, SCALED_RESIDUAL, flag_attributes
from xdynamics.shapes import display_text

if TYPE_CHECKING:
    import xarray as xr

    from xdynamics.shapes.blocks import Block

VERDICTS = ("passed", "failed", "refused")
PASSED, FAILED, REFUSED = range(len(VERDICTS))
ROLE = "validation"
SCALE_RULE = (
    "largest size of the closed form where it is compared (of an event's time from the start), never its value at one"
    " time, which may pass zero; where it is 0 throughout, largest size of what was computed"
)
IN_UNITS = {"comment": "in the unit that case_units names"}


@dataclass(frozen=True)
class LedgerRow:
    """One line of the ledger."""

    name: str
    method: str
    stage: int
    relation: str
    observable: str
    where: str
    rule: str
    units: str = "1"
    norm: str = "largest absolute difference"
    residual: float = np.nan
    bound: float = np.nan
    scale: float = np.nan
    note: str = ""
    run: str = ""
    elements: int = 1
    failed_elements: int = 0
    worst: str = ""
    of_form: float = 0.0
    of_start: float = 0.0

    @property
    def verdict(self) -> int:
        """Index into `VERDICTS`; a residual of nan has failed."""
        if self.note and np.isnan(self.bound):
            return REFUSED
        return PASSED if self.residual <= self.bound else FAILED


ROWS = ResultForm(
    lambda rows: [[*asdict(row).values()] for row in rows], lambda rows: [LedgerRow(*row) for row in rows]
)


def ledger_dataset(rows: Sequence[LedgerRow], title: str) -> xr.Dataset:
    """Return the rows of a ledger as a Dataset, along `case`."""
    words = {
        "case_name": ("name", "case and closed form"),
        "case_method": ("method", "method"),
        "case_relation": ("relation", "closed form of time and parameters"),
        "case_observable": ("observable", "what is compared"),
        "case_where": ("where", "where it is compared"),
        "case_norm": ("norm", "norm of the residual"),
        "case_units": ("units", "unit of residual and bound"),
        "case_bound_rule": ("rule", "how the bound is derived"),
        "case_note": ("note", "why a case was refused, or what was missing"),
        "case_run": ("run", "content digest of the run"),
        "case_worst_element": ("worst", "element of the largest residual, where several are judged as one case"),
    }
    variables: dict[str, Any] = {
        name: ((CASE,), np.array([display_text(getattr(row, key)) for row in rows]), attrs_of("1", long_name, ROLE))
        for name, (key, long_name) in words.items()
    }
    numbers = attrs_of("1", "", ROLE) | IN_UNITS
    variables |= {
        "case_stage": (
            (CASE,),
            np.array([row.stage for row in rows]),
            attrs_of("1", "stage of the ledger; 0 of a model's own closed forms", ROLE),
        ),
        "residual": (
            (CASE,),
            np.array([row.residual for row in rows]),
            numbers | {"long_name": "largest difference from the closed form"},
        ),
        "bound": (
            (CASE,),
            np.array([row.bound for row in rows]),
            numbers | {"long_name": "largest residual with which the case passes"},
        ),
        RESIDUAL_SCALE: ((CASE,), np.array([row.scale for row in rows]), numbers | {"long_name": SCALE_RULE}),
        SCALED_RESIDUAL: (
            (CASE,),
            divide_by_scale(*np.array([(row.residual, row.scale) for row in rows]).reshape(-1, 2).T),
            attrs_of("1", "residual over residual_scale", SCALED) | {"scale_rule": SCALE_RULE},
        ),
        "verdict": (
            (CASE,),
            np.array([row.verdict for row in rows], np.int8),
            attrs_of("1", "result of the case", "flag") | flag_attributes(dict(enumerate(VERDICTS))),
        ),
    }
    variables |= _parts_of_bounds(rows)
    variables |= _element_counts(rows)
    runs = [digest for digest in dict.fromkeys(row.run for row in rows) if digest]
    return evidence_dataset("ledger", title, runs, variables, {})


def _parts_of_bounds(rows: Sequence[LedgerRow]) -> dict[str, Any]:
    """Return the part of each bound that covers the rounding of expressions."""
    parts = {
        "bound_closed_form": ("of_form", "part of bound: rounding of the closed form, beside the same with 31 digits"),
        "bound_start": ("of_start", "part of bound: rounding of the start's expressions, carried by another march"),
    }
    return {
        name: ((CASE,), np.array([getattr(row, key) for row in rows]), attrs_of("1", long_name, ROLE) | IN_UNITS)
        for name, (key, long_name) in parts.items()
    }


def _element_counts(rows: Sequence[LedgerRow]) -> dict[str, Any]:
    """Return how many elements each line is of, and how many of them have failed."""
    counts = {
        "case_elements": ("elements", "how many elements of the quantity are judged as one case"),
        "case_elements_failed": ("failed_elements", "how many of these have a residual above their bound"),
    }
    return {
        name: ((CASE,), np.array([getattr(row, key) for row in rows]), attrs_of("1", long_name, ROLE))
        for name, (key, long_name) in counts.items()
    }


def ledger_lines(ledger: xr.Dataset) -> Iterator[str]:
    """Describe a ledger line by line: each failed case, refusals with their reasons, and the number of passes."""
    words = words_of_flag(ledger["verdict"])
    refused: dict[tuple[str, str], list[str]] = {}
    for k, word in enumerate(words):
        entry = {
            name: str(ledger[f"case_{name}"][k].item())
            for name in ("name", "method", "observable", "where", "units", "note")
        }
        if word == "failed":
            residual, bound, scale, over_scale = (
                float(ledger[name][k]) for name in ("residual", "bound", RESIDUAL_SCALE, SCALED_RESIDUAL)
            )
            many = int(ledger["case_elements"][k]) if "case_elements" in ledger else 1
            if many > 1:
                failed, worst = int(ledger["case_elements_failed"][k]), str(ledger["case_worst_element"][k].item())
                entry["observable"] += (
                    f" ({failed} of {many} elements; worst {worst})" if worst else f" ({many} elements)"
                )
            numbers = f"residual {residual:.3g} {entry['units']}, bound {bound:.3g} {entry['units']}"
            numbers += f", scaled {over_scale:.3g} by {scale:.3g} {entry['units']}" if np.isfinite(scale) else ""
            yield (
                f"failed    {entry['name']} by {entry['method']}: {entry['observable']}, {entry['where']}:"
                f" {numbers}{'; ' if entry['note'] else ''}{entry['note']}"
            )
        elif word == "refused":
            refused.setdefault((entry["method"], entry["note"]), []).append(entry["name"])
    for (method, note), names in refused.items():
        yield f"refused   {first_names(names)} by {method}: {note}"
    counts = ", ".join(f"{words.count(word)} {word}" for word in VERDICTS)
    methods = dict.fromkeys(str(entry) for entry in ledger["case_method"].values)
    yield f"ledger    {len(words)} cases of {len(methods)} method{'s' * (len(methods) > 1)}: {counts}"


SUMMARIES = {"ledger": ledger_lines}


MOST_ALONE = 100  # elements of one closed form, each of which has a line of its own


def of_worst(
    row: LedgerRow, block: Block, residual: Any, bound: Any, scale: Any, of_form: Any = 0.0, of_start: Any = 0.0
) -> LedgerRow:
    """Return a line with residual, bound and scale of the element whose residual is the largest part of its bound.

    Parameters
    ----------
    row : LedgerRow
    block : Block
        The elements; without dimensions there is one number.
    residual, bound, scale : float or ndarray, shape of the block or ()
        A residual of nan has failed.
    of_form, of_start : float or ndarray, shape of the block or ()
        The parts of the bound that are for the rounding of expressions.
    """
    row_numbers = (residual, bound, scale, of_form, of_start)
    residuals, bounds, scales, forms, starts = (np.broadcast_to(number, block.shape).ravel() for number in row_numbers)
    failed = ~(residuals <= bounds)
    parts = np.divide(residuals, bounds, out=np.where(residuals > 0.0, np.inf, 0.0), where=bounds > 0.0)
    parts = np.where(np.isnan(parts) | np.isnan(residuals), np.inf, parts)
    # a quotient may round to 1 on either side of the bound: where any has failed, the worst is one of those
    worst = int(np.argmax(np.where(failed, parts, -1.0) if failed.any() else parts))
    return replace(
        row,
        residual=float(residuals[worst]),
        bound=float(bounds[worst]),
        scale=float(scales[worst]),
        of_form=float(forms[worst]),
        of_start=float(starts[worst]),
        worst=block.element(worst) if block.dims else "",
        failed_elements=int(failed.sum()),
    )
