"""The identity of a march: model, settings and program, as words that can be compared one by one."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import fields, is_dataclass, replace
from typing import TYPE_CHECKING, Any

from xdynamics.faults import InputError
from xdynamics.march import OUTCOMES, March, Pacing, Settings, Tolerances
from xdynamics.march.configuration import settings_for
from xdynamics.march.outcomes import INTERRUPTED
from xdynamics.methods import Method
from xdynamics.model import Model
from xdynamics.model.motion import variables
from xdynamics.record.arguments import recorded_arguments
from xdynamics.record.circumstances import xdynamics_version
from xdynamics.record.provenance import force_digest
from xdynamics.units import Unit
from xdynamics.units.rounded import decimal_text

if TYPE_CHECKING:
    import xarray as xr

_SHOWN = 60  # characters of a value that are kept; longer values are abbreviated with a digest


def identity(march: March) -> dict[str, str]:
    """Return every word on which the bits of a march depend."""
    program = {
        "version": xdynamics_version(),
        "math_functions": march.settings.math_functions,
        "law": force_digest(march),
    }
    words = dict(_words_of_value("", replace(march.settings, compress=False)))
    return {name: _abbreviated(value) for name, value in (words | program).items()} | model_words(march.model)


def model_words(model: Model) -> dict[str, str]:
    """Return what a model says, a word for each entry: the same whether elements have numbers or an expression."""
    return {name: _abbreviated(value) for name, value in _words_of_value("model", model.written_out())}


def input_digest(march: March) -> str:
    """Return the digest of all inputs on which the bits of a march depend."""
    return hashlib.sha256(json.dumps(identity(march), sort_keys=True).encode()).hexdigest()


def word_differences(recorded_words: Mapping[str, str], current_words: Mapping[str, str]) -> list[str]:
    """List the words in which two marches differ; the law's digest only if nothing else does."""
    names = [
        name for name in {**recorded_words, **current_words} if recorded_words.get(name) != current_words.get(name)
    ]
    names = [name for name in names if name != "law"] or names
    return [
        f"{name} was {recorded_words.get(name, 'not given')} and is {current_words.get(name, 'not given')}"
        for name in names
    ]


def is_of(run: xr.Dataset, march: March) -> bool:
    """Whether a finished record is of a march's model and law, by this version; settings are not compared."""
    expected_attributes = {
        "force_digest": force_digest(march),
        "xdynamics_version": xdynamics_version(),
        "math_functions": march.settings.math_functions,
    }
    if any(run.attrs.get(name) != value for name, value in expected_attributes.items()):
        return False
    return run.attrs["run_outcome"] != OUTCOMES[INTERRUPTED].word and is_of_model(run, march.model)


def is_of_model(run: xr.Dataset, model: Model) -> bool:
    """Whether a record's model is one, perhaps with numbers where this has an expression."""
    if run.attrs.get("model_digest") == model.digest:
        return True
    with suppress(InputError, KeyError):  # of functions that are not those of this model; of what was left out
        recorded_model = Model.from_record(run["model_toml"].values.item(), functions=model.functions)
        return recorded_model.digest == run.attrs["model_digest"] and model_words(recorded_model) == model_words(model)
    return False


def comes_of(run: xr.Dataset, march: March) -> bool:
    """Whether a finished record is that of a march, including its settings."""
    if not is_of(run, march):
        return False
    settings = settings_for(march.model, **recorded_arguments(run))
    return same_settings(settings, march.settings, variables(march.model))


def same_settings(first_settings: Settings, second_settings: Settings, names: tuple[str, ...]) -> bool:
    """Whether the settings of two marches of a model with these variables agree, however their tolerances are given."""
    return _settings_by_name(first_settings, names) == _settings_by_name(second_settings, names)


def _settings_by_name(settings: Settings, names: tuple[str, ...]) -> dict[str, Any]:
    tolerances = settings.tolerances
    absolute = {f"atol of {name}": tolerances.atol_of(name) for name in names} if tolerances else {}
    return {
        name: value
        for name, value in _words_of_value("", replace(settings, compress=False))
        if not name.startswith(("atol", "bare"))
    } | absolute


def _words_of_value(name: str, value: Any) -> Iterator[tuple[str, str]]:
    """Take a value apart into names and texts."""
    if isinstance(value, Method):
        yield name, value.name
    elif isinstance(value, Unit):  # the model's own, which is no setting
        return
    elif is_dataclass(value):
        prefix = "" if isinstance(value, Settings | Tolerances | Pacing) else f"{name}."
        for entry in fields(value):
            yield from _words_of_value(prefix + entry.name, getattr(value, entry.name))
    elif isinstance(value, Mapping):
        for key, entry in value.items():
            yield from _words_of_value(f"{name}.{key}", entry)
    elif value is not None:
        yield name, _value_text(value)


def _value_text(value: Any) -> str:
    """Return a value as a text, numbers with all digits that are known of them."""
    if isinstance(value, list) and {*map(type, value)} != {float}:
        return f"[{', '.join(map(_value_text, value))}]"
    return decimal_text(value) if isinstance(value, float) else repr(value)


def _abbreviated(text: str) -> str:
    if len(text) <= _SHOWN:
        return text
    return f"{text[:20]}… ({len(text)} characters, sha256 {hashlib.sha256(text.encode()).hexdigest()[:16]})"
