"""Sections of a model as people read them: by the names of its file, and never changed in place."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import islice
from typing import Any, NoReturn, TypeVar

from xdynamics.faults import InputError, ModelError, display_text, first_names
from xdynamics.shapes import Shapes

Part = TypeVar("Part")
SHOWN = 6  # entries of a section that its repr has


class ReadOnlySection(Mapping[str, Part]):
    """A section of a model by the names of its file: ``u[0]``, ``r[Jupiter, x]``; any label may be given as a number.

    A model never changes: what follows from its numbers is kept beside it. `Model.replace` returns another one.

    Parameters
    ----------
    title : str
    entries : mapping of str to Part
        By the names that they have inside.
    shapes : Shapes

    Examples
    --------
    >>> from xdynamics.shapes import Extent
    >>> from xdynamics.units import parse_quantity
    >>> shapes = Shapes({"site": Extent("site", 2)}, {}, {"u": ("site",)})
    >>> start = ReadOnlySection("initial", {"u·0": parse_quantity("1 m"), "u·1": parse_quantity("2 m")}, shapes)
    >>> start
    <initial: u[0] = 1.0 m, u[1] = 2.0 m>
    >>> list(start), str(start["u[-1]"]), "u[2]" in start
    (['u[0]', 'u[1]'], '2.0 m', False)
    """

    def __init__(self, title: str, entries: Mapping[str, Part], shapes: Shapes) -> None:
        self._title, self._entries, self._shapes = title, entries, shapes

    def __getitem__(self, name: str) -> Part:
        try:
            return self._entries[self._shapes.internal_name(name)]
        except InputError as error:  # a dimension has no such element
            raise KeyError(str(error)) from None
        except KeyError:
            pass
        if dims := self._shapes.dims.get(name):
            raise KeyError(
                f"'{name}' is along {', '.join(dims)}; ask for an element, like '{display_text(self._shapes.first(name))}'"
            )
        raise KeyError(
            f"there is no '{name}' in the section {self._title}; there are {first_names([*islice(self, SHOWN + 1)])}"
        )

    def __iter__(self) -> Iterator[str]:
        return map(display_text, self._entries)

    def __len__(self) -> int:
        return len(self._entries)

    def __or__(self, right: Mapping[str, Any]) -> dict[str, Any]:
        return {**self, **right}

    def __ror__(self, left: Mapping[str, Any]) -> dict[str, Any]:
        return {**left, **self}

    def __repr__(self) -> str:
        entry_texts = [self._entry_text(name) for name in islice(self, SHOWN)]
        return f"<{self._title}: {', '.join([*entry_texts, *(['…'] * (len(self) > SHOWN))]) or 'none'}>"

    def _entry_text(self, name: str) -> str:
        """Return an entry in words: a quantity, a parameter's value, or the unit of what moves."""
        part: Any = self[name]
        if dims := getattr(part, "dims", ()):
            name = f"{name}({', '.join(dims)})"
        quantity = getattr(part, "quantity", part)
        return (
            f"{name} in {part.unit.text}"
            if not hasattr(quantity, "value")
            else f"{name} = {quantity}".removesuffix(" 1")
        )

    def _refuse(self, *_: Any, **__: Any) -> NoReturn:
        raise ModelError(
            f"{self._title} of a model cannot be changed in place; model.replace({self._title}={{…}}) returns another"
            " model with new values"
        )

    __setitem__ = __delitem__ = __ior__ = _refuse
    clear = pop = popitem = setdefault = update = _refuse
