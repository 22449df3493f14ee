"""Words, numbers and signs of an expression, taken from the left, and errors that say where one stands."""

from __future__ import annotations

import re
from dataclasses import dataclass

from xdynamics.faults import InputError

LONGEST_TEXT = 1_000_000

_ALLOWED = re.compile(r"[A-Za-z0-9_+\-*/().,<>=!\[\] ]*")
_TOKEN = re.compile(
    r" *(?:(?P<number>(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)(?![A-Za-z0-9_.])"
    r"|(?P<word>[A-Za-z_][A-Za-z0-9_]*)|(?P<quoted>\"[^\"']*\"|'[^\"']*')|(?P<sign>\*\*|[<>=!]=|[-+*/(),<>\[\]]))"
)
_QUOTED = re.compile(r"(?<=,)( *)(?:\"[A-Za-z0-9_+\-*/(). ]{1,100}\"|'[A-Za-z0-9_+\-*/(). ]{1,100}')(?= *\))")
_REMEDIES = {
    "^": "; a power is written **",
    ":": "; there are no slices: neighbours are shift(u, site, 1, fill), and a part is where(index(site) < 3, u, fill)",
    "'": "; no sign stands for a derivative: the velocity of x is v_x, and its acceleration follows from the forces",
}


def _check_raw(source: str) -> None:
    """Refuse a text that is empty, too long, or has characters outside the language."""
    if not source:
        raise InputError("expression is empty")
    if len(source) > LONGEST_TEXT:
        raise InputError(f"expression {_quoted_excerpt(source)} has {len(source)} characters, {LONGEST_TEXT} at most")
    good = _ALLOWED.match(_QUOTED.sub(lambda match: " " * len(match[0]), source))
    end = good.end() if good else 0
    if end < len(source):
        remedy = _REMEDIES.get(source[end], "")
        raise InputError(
            f"expression {_quoted_excerpt(source)} has the character {source[end]!r} at column {end + 1}{remedy}"
        )
    if match := re.search(r"(?<![A-Za-z0-9_])[0-9.]+_", source):
        raise InputError(
            f"expression {_quoted_excerpt(source)} has an underscore in a number at column {match.start() + 1}"
        )


def _quoted_excerpt(source: str) -> str:
    return repr(source if len(source) <= 60 else source[:60] + "…")


@dataclass(frozen=True)
class Token:
    """A word, number, sign or text in quotes, with its column from 1."""

    kind: str
    text: str
    column: int


class Tokens:
    """The tokens of a text, of which the next one is seen before it is taken.

    Parameters
    ----------
    source : str

    Attributes
    ----------
    next : Token
        Of kind ``end`` behind the last one.

    Raises
    ------
    InputError
        If the text is empty, too long, or has characters outside the language.
    """

    def __init__(self, source: str) -> None:
        _check_raw(source)
        self.source = source
        self.position = 0
        self.next = self._token()

    def take_token(self) -> Token:
        """Return the next token, and see the one behind it."""
        token, self.next = self.next, Token("end", "", 0)
        if token.text:
            self.next = self._token()
        return token

    def _token(self) -> Token:
        match = _TOKEN.match(self.source, self.position)
        if match is None and self.source[self.position :].strip():
            column = self.position + 1
            raise InputError(
                f"expression {_quoted_excerpt(self.source)} cannot be read at column {column}: no word, number or sign of the"
                " language"
            )
        if match is None or match.lastgroup is None:
            return Token("end", "", len(self.source) + 1)
        self.position = match.end()
        return Token(match.lastgroup, match[match.lastgroup], match.start(match.lastgroup) + 1)

    def unreadable(self, problem: str, token: Token | None = None) -> InputError:
        """Return the error of a text that ends or goes on otherwise than it may, at a token, or else at the next one."""
        column = (token or self.next).column
        return InputError(f"expression {_quoted_excerpt(self.source)} cannot be read at column {column}: {problem}")

    def fault(self, column: int, problem: str) -> InputError:
        """Return the error of what is read, and wrong."""
        return InputError(f"expression {_quoted_excerpt(self.source)}, column {column}: {problem}")
