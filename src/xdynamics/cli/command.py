"""The command `xdynamics`: what becomes of errors, warnings and signals, and what all its verbs use."""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

import click

from xdynamics.faults import escaped

DONE, BADLY, WRONG_INPUT = 0, 1, 2
TERMINATED = 143  # as a shell reports a process that SIGTERM ended


class _Command(click.Group):
    """Turns wrong input into one line and exit code 2, damage found into exit code 1, SIGTERM into 143."""

    def invoke(self, ctx: click.Context) -> Any:
        with _terminable() as signals:
            try:
                return self._invoked(ctx)
            except (KeyboardInterrupt, SystemExit):
                if not signals:
                    raise
        complain("terminated")
        return ctx.exit(TERMINATED)

    def _invoked(self, ctx: click.Context) -> Any:
        import warnings

        from xdynamics.faults import AccuracyWarning, ArchiveError, InputError, KindWarning

        for stream in (sys.stdout, sys.stderr):
            if hasattr(stream, "reconfigure"):  # a terminal without a sign for it shows it written out
                stream.reconfigure(errors="backslashreplace")
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", AccuracyWarning)  # the outcome, which is printed, says the same
                warnings.simplefilter("ignore", KindWarning)  # `verify` says it where others are verified
                warnings.showwarning = lambda message, *_rest: complain(f"warning: {message}")
                return super().invoke(ctx)
        except click.UsageError as error:
            raise click.UsageError(escaped(error.format_message()), error.ctx) from None
        except ArchiveError as error:
            complain(error)
            ctx.exit(BADLY)
        except InputError as error:
            complain(error)
            ctx.exit(WRONG_INPUT)


@contextmanager
def _terminable() -> Iterator[list[int]]:
    """Let SIGTERM do what Ctrl-C does: end a march as an outcome, clear up, leave; gather the signals that came."""
    came: list[int] = []

    def terminate(number: int, frame: FrameType | None) -> None:
        came.append(number)
        keyboard = signal.getsignal(signal.SIGINT)
        if not callable(keyboard):  # ignored, as in the background of a script
            raise KeyboardInterrupt
        keyboard(signal.SIGINT, frame)

    if threading.current_thread() is not threading.main_thread():
        yield came
        return
    previous = signal.signal(signal.SIGTERM, terminate)
    try:
        yield came
    finally:
        signal.signal(signal.SIGTERM, previous)


def complain(error: Exception | str) -> None:
    """Print an error or a warning in one line, or one with faults that are numbered."""
    click.echo(f"xdynamics: {escaped(str(error), lines=isinstance(error, Exception))}", err=True)


def say(lines: Iterable[str]) -> None:
    """Print lines, whatever the names and texts in them hold."""
    for line in lines:
        click.echo(escaped(line))


@click.group(cls=_Command, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="xdynamics", message="%(prog)s %(version)s")
def main() -> None:
    """Numerical dynamics as self-describing xarray datasets."""


class progress:  # noqa: N801 - used as a statement
    """A line on the terminal that counts, from the second second on."""

    def __enter__(self) -> Callable[[float, float, int], None]:
        self.started = self.last = time.monotonic()
        return self.tell

    def __exit__(self, *_: object) -> None:
        if self.last > self.started and sys.stderr.isatty():
            click.echo("\r\033[K", nl=False, err=True)

    def tell(self, done: float, at: float, rows: int) -> None:
        """Say how far the march is, once a second."""
        now = time.monotonic()
        if now - self.last >= 1.0 and sys.stderr.isatty():
            self.last = now
            click.echo(f"\r\033[K{done:4.0%}  t = {at:.6g}, {rows} rows", nl=False, err=True)
