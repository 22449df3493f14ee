"""The command `xdynamics`: errors, warnings, signals and streams, as all its verbs treat them.

Standard streams may be closed, full or cut off while a command works; its results are not harmed.

A mistyped verb is answered with the verb that was probably meant.
"""

from __future__ import annotations

import os
import shlex
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from difflib import get_close_matches
from shutil import get_terminal_size
from types import FrameType
from typing import TYPE_CHECKING, Any, NamedTuple, TextIO

import click

from xdynamics.faults import escaped

if TYPE_CHECKING:
    import xarray as xr

CLOSED = "it is closed"


class Stream:
    """A stream that never fails: after the first error it writes nothing more, and remembers the reason.

    Parameters
    ----------
    stream : file of text, or None
        None where the process began without it.
    """

    def __init__(self, stream: TextIO | None) -> None:
        self._stream: TextIO = open(os.devnull, "w") if stream is None else stream  # noqa: PTH123, SIM115 - it lasts as long as the process
        self._closed = stream is None
        self.lost: str = ""
        self.cut_off = False  # by a reader that has seen enough, as in ``| head -1``

    def write(self, text: str) -> int:
        """Write a text, if possible."""
        if self._closed and text:
            self.lost = CLOSED
        if not self.lost:
            with self._failing():
                self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        """Flush the stream, unless it was lost."""
        if not self.lost:
            with self._failing():
                self._stream.flush()

    def isatty(self) -> bool:
        """Whether it is a terminal."""
        return not self._closed and not self.lost and self._stream.isatty()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    @contextmanager
    def _failing(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            self.lost, self.cut_off = error.strerror or str(error), isinstance(error, BrokenPipeError)
            # what is still in the buffer would fail again when Python ends, with a traceback
            with suppress(OSError, ValueError):
                nowhere = os.open(os.devnull, os.O_WRONLY)
                os.dup2(nowhere, self._stream.fileno())
                os.close(nowhere)


class Streams(NamedTuple):
    """Standard output and error of a command."""

    output: Stream
    error: Stream


@contextmanager
def surviving_streams() -> Iterator[Streams]:
    """Replace standard output and error by streams that never fail, inside a `with` block."""
    _reserve_descriptors()
    output, error = sys.stdout, sys.stderr
    streams = Streams(Stream(output), Stream(error))
    sys.stdout, sys.stderr = streams
    try:
        yield streams
    finally:
        for stream in streams:
            stream.flush()
        sys.stdout, sys.stderr = output, error


def _reserve_descriptors() -> None:
    """Point closed descriptors among 0 to 2 at the null device: otherwise an archive gets one, and messages go into it."""
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest that is free


# verb -> words for what it does
ALSO = {
    "run": ("simulate", "march", "integrate", "solve", "start", "sim", "exec", "execute"),
    "plot": ("draw", "figure", "picture", "graph", "chart"),
    "animate": ("film", "movie", "video", "animation"),
    "show": ("info", "print", "dump", "summary", "view", "open", "describe", "inspect", "events"),
    "check": ("lint", "parse", "read", "units", "equations"),
    "new": ("init", "create", "template", "start"),
    "fit": ("calibrate", "estimate", "identify"),
    "budget": ("uncertainty", "error", "errors", "uncertainties"),
    "enclose": ("enclosure", "bounds", "tube", "interval", "intervals", "rigorous", "proof"),
    "certify": ("certificate", "prove"),
    "refine": ("converge", "convergence", "refinement", "order"),
    "compare": ("diff", "difference", "cmp"),
    "validate": ("test", "validation", "ledger"),
    "diagnose": ("diagnosis", "analyse", "analyze", "lyapunov", "energy"),
    "sweep": ("scan", "ensemble", "grid", "parameter", "parameters", "montecarlo", "batch"),
    "sample": ("interpolate", "at"),
    "table": ("export", "csv", "xlsx", "excel", "frame", "latex"),
    "modes": ("eigenvalues", "frequencies", "linearise", "linearize", "stability"),
    "methods": ("solvers", "method", "integrators", "list"),
    "extend": ("continue", "resume", "longer"),
    "reproduce": ("rerun", "replay", "again"),
    "help": ("man", "docs", "manual", "guide"),
}


def verb_meant(word: str, verbs: Sequence[str]) -> str:
    """Return the verb that a word stands for; empty if none is like it."""
    word = word.lower()
    if word in verbs:
        return word
    exact = [verb for verb, synonyms in ALSO.items() if word in synonyms]
    return next(iter([*exact, *get_close_matches(word, verbs, n=1, cutoff=0.7)]), "")


def command_meant(arguments: Sequence[str], verbs: Sequence[str]) -> str:
    """Return the probable complete command for one without a known verb; empty if that is unclear.

    Examples
    --------
    >>> command_meant(["simulate", "ball.toml"], ["run", "show"])
    'xdynamics run ball.toml -o ball.nc'
    >>> command_meant(["ball.nc"], ["run", "show"])
    'xdynamics show ball.nc'
    """
    first, *remaining_args = arguments
    file = next((argument for argument in arguments if argument.endswith((".toml", ".nc"))), "")
    verb = verb_meant(first, verbs)
    if not verb and first == file:
        verb, remaining_args = "run" if file.endswith(".toml") else "show", [*arguments]
    if not verb:
        return ""
    if verb == "run" and file.endswith(".toml") and not {"-o", "--output"} & {*remaining_args}:
        remaining_args += ["-o", file.removesuffix(".toml") + ".nc"]
    return shlex.join(["xdynamics", verb, *remaining_args])


DONE, BADLY, WRONG_INPUT = 0, 1, 2
SIGNALLED = 128  # and the signal's number, as a shell reports a process that it ended: 143 for SIGTERM, 129 for SIGHUP
LEAST_MEMORY = 700_000_000  # bytes of address space: Python with the libraries, the engine and a short run take 640 MB
LIGHT = ("help", "methods", "new")  # verbs that load none of that
QUIET, JSON, WRITES = "xdynamics.quiet", "xdynamics.json", "xdynamics.writes"


class _Verb(click.Command):
    """A verb; every one can be quiet. With `makes` it writes a file although no option names it."""

    def __init__(self, *arguments: Any, makes: bool = False, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.makes = makes
        self.params.append(
            click.Option(
                ["--quiet"], is_flag=True, expose_value=False, callback=_hush, help="Print nothing but errors."
            )
        )

    def get_short_help_str(self, limit: int = 45) -> str:  # noqa: ARG002 - it is wrapped, not cut
        """Return the first sentence of the verb's help, uncut."""
        return " ".join((self.help or "").split("\n\n")[0].split()).removesuffix(".")

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the verb's own options, then those of the march, by subject."""
        sections: dict[str, list[tuple[str, str]]] = {"Options": []}
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx) if isinstance(parameter, click.Option) else None
            if record is not None:
                sections.setdefault(getattr(parameter, "group", "Options"), []).append(record)
        for title, rows in sections.items():
            with formatter.section(title):
                formatter.write_dl(rows)

    def invoke(self, ctx: click.Context) -> Any:
        """Run the verb; note whether it writes a file, beside which the printed report is secondary."""
        ctx.meta[WRITES] = self.makes or bool(ctx.params.get("output"))
        return super().invoke(ctx)


def _hush(ctx: click.Context, _option: click.Parameter, quiet: bool) -> None:
    ctx.meta[QUIET] = quiet


VERBS = {  # by what they are for, in the order in which one comes to need them
    "Start": ("new", "check", "run", "show", "plot", "table", "animate"),
    "Accuracy": ("refine", "diagnose", "validate", "budget", "compare", "modes"),
    "Data": ("sample", "fit"),
    "Many runs": ("sweep",),
    "Archives": ("verify", "reproduce", "extend", "complete", "sign", "discard"),
    "Certificates": ("certify", "bundle", "recheck", "report", "enclose"),
    "Reference": ("help", "methods"),
}


class _Command(click.Group):
    """Exits in one line: 2 for wrong input, 1 for damage or Ctrl-C, 143 for SIGTERM, 129 for SIGHUP."""

    command_class = _Verb

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:  # noqa: ARG002 - click's
        """Write the verbs by what they are for."""
        width = max(map(len, self.commands))
        for title, names in VERBS.items():
            with formatter.section(title):
                formatter.write_dl([(f"{name:{width}}", self.commands[name].get_short_help_str()) for name in names])

    def invoke(self, ctx: click.Context) -> Any:
        with surviving_streams() as streams, _terminable() as signals:
            try:
                self._invoked(ctx)
                code = DONE
            except click.exceptions.Exit as leaving:
                code = leaving.exit_code
            except SystemExit as leaving:
                code = int(leaving.code or DONE)
            except KeyboardInterrupt as stopped:  # which says what is kept, where something is
                if stopped.args or not signals:
                    complain("; ".join(["interrupted", *map(str, stopped.args)]))
                code = BADLY
            if signals:
                complain("terminated")
                code = SIGNALLED + signals[0]
            code = self._code(ctx, streams.output, code)
        return ctx.exit(code)

    def _code(self, ctx: click.Context, output: Stream, code: int) -> int:
        """Complain of a lost report; a verb that makes nothing else ends badly then."""
        output.flush()
        if not output.lost or output.cut_off:
            return code
        complain(f"the report could not be written to standard output ({output.lost})")
        return code if ctx.meta.get(WRITES) else code or BADLY

    def _invoked(self, ctx: click.Context) -> Any:
        import warnings

        from xdynamics.faults import AccuracyWarning, ArchiveError, InputError, KindWarning, SignatureWarning

        for stream in (sys.stdout, sys.stderr):
            if hasattr(stream, "reconfigure"):  # a terminal shows characters that it lacks as escapes
                stream.reconfigure(errors="backslashreplace")
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", AccuracyWarning)  # the printed outcome says the same
                warnings.simplefilter("ignore", KindWarning)  # `verify` prints it with the verdict
                warnings.simplefilter("ignore", SignatureWarning)  # and of signatures in the same line
                warnings.showwarning = lambda message, *_ignored: complain(f"warning: {message}")
                return super().invoke(ctx)
        except click.UsageError as error:
            click.UsageError(escaped(_with_example(error)), error.ctx).show()
            ctx.exit(WRONG_INPUT)
        except ArchiveError as error:
            complain(error)
            ctx.exit(BADLY)
        except InputError as error:
            complain(error)
            ctx.exit(WRONG_INPUT)
        except MemoryError:
            complain(f"memory ran out; {_memory_words()}")
            ctx.exit(BADLY)

    def resolve_command(self, ctx: click.Context, args: list[str]) -> Any:
        """Find the verb; refuse to begin if the libraries do not fit into memory, where some would wait for ever."""
        if args[0] not in self.commands and not args[0].startswith("-"):
            meant = command_meant(args, [*self.commands])
            meant = "xdynamics --version" if args[0] == "version" else meant
            remedy = f"did you mean `{meant}`?" if meant else f"there are {', '.join(sorted(self.commands))}"
            raise click.UsageError(f"there is no verb '{args[0]}'; {remedy}", ctx)
        name, command, remaining_args = super().resolve_command(ctx, args)
        limit = _memory_limit()
        if limit is not None and limit < LEAST_MEMORY and name not in LIGHT:
            complain(_memory_words())
            ctx.exit(BADLY)
        return name, command, remaining_args


def _with_example(error: click.UsageError) -> str:
    """Return the error of a command; where `--output` is missing, with an example of it."""
    text, option = error.format_message(), getattr(error, "param", None)
    if not (isinstance(error, click.MissingParameter) and option is not None and option.name == "output"):
        return text
    return f"{text} It names what is written, like -o {str(option.metavar).partition('|')[0].lower()}"


def _memory_limit() -> int | None:
    """Return how much address space this process may have, in bytes; None without a limit."""
    try:
        import resource
    except ImportError:
        return None
    limit: int = resource.getrlimit(resource.RLIMIT_AS)[0]
    return None if limit == resource.RLIM_INFINITY else limit


def _memory_words() -> str:
    needed = f"about {LEAST_MEMORY // 10**6} MB of address space are needed, and room for the record"
    limit = _memory_limit()
    return needed if limit is None else f"{needed}; the limit (ulimit -v) is {limit // 10**6} MB"


@contextmanager
def _terminable() -> Iterator[list[int]]:
    """Let SIGTERM and SIGHUP act as Ctrl-C does: end a march as an outcome, clean up, exit; list received signals."""
    received: list[int] = []

    def terminate(number: int, frame: FrameType | None) -> None:
        received.append(number)
        keyboard = signal.getsignal(signal.SIGINT)
        if not callable(keyboard):  # ignored, as in the background of a script
            raise KeyboardInterrupt
        keyboard(signal.SIGINT, frame)

    # Python allows signal handlers to be set in the main thread alone
    if threading.current_thread() is not threading.main_thread():
        yield received
        return
    numbers = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    previous = {number: signal.getsignal(number) for number in numbers}
    handled = [number for number in numbers if previous[number] is not signal.SIG_IGN]  # as under `nohup`
    for number in handled:
        signal.signal(number, terminate)
    try:
        yield received
    finally:
        for number in handled:
            signal.signal(number, previous[number])


def complain(error: Exception | str) -> None:
    """Print an error or a warning in one line over the progress line; an error may have numbered faults."""
    cleared = "\r\033[K" if sys.stderr.isatty() else ""
    click.echo(f"{cleared}xdynamics: {escaped(str(error), lines=isinstance(error, Exception))}", err=True)


def say(lines: Iterable[str]) -> None:
    """Print lines with unprintable characters escaped; none if the verb is quiet, or prints JSON."""
    meta = click.get_current_context().meta
    if not meta.get(QUIET) and not meta.get(JSON):
        for line in lines:
            click.echo(escaped(line))


def terminal_width() -> int:
    """Return how many letters a line of the terminal has; 80 where there is none."""
    return get_terminal_size((80, 24)).columns


def on_board(record: xr.Dataset) -> list[str]:
    """Return the table of a refinement or of a ledger between empty lines; of other records nothing."""
    meta = click.get_current_context().meta
    if meta.get(QUIET) or meta.get(JSON):
        return []
    from xdynamics.interchange.tables import board_of

    board = board_of(record, terminal_width())
    return ["", *board, ""] if board else []


def json_option(verb: Callable[..., Any]) -> Callable[..., Any]:
    """Add the option --json, by which standard output holds what the verb gives to `print_json`, and nothing else."""
    return click.option(
        "--json",
        is_flag=True,
        expose_value=False,
        callback=_as_json,
        help="For scripts: print JSON and nothing else; `xdynamics help json` says what is in it.",
    )(verb)


def _as_json(ctx: click.Context, _option: click.Parameter, is_json: bool) -> None:
    ctx.meta[JSON] = is_json


def print_json(subject: Any, **files: str | None) -> None:
    """Print a record, evidence, a model or plain data as JSON if `--json` is given, with the written files."""
    if click.get_current_context().meta.get(JSON):
        from xdynamics.documenting.json_data import json_text, plain_data_of

        click.echo(json_text(plain_data_of(subject) | {name: str(file) for name, file in files.items() if file}))


@click.group(cls=_Command, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(None, "-V", "-v", "--version", package_name="xdynamics", message="%(prog)s %(version)s")
def main() -> None:
    """Numerical dynamics as self-describing xarray datasets."""


class progress:  # noqa: N801 - used as a statement
    """A progress line on the terminal, after the first second, in words with {at} and {count}."""

    def __init__(self, words: str = "t = {at:.6g}, {count} rows") -> None:
        self.words = words

    def __enter__(self) -> Callable[[float, float, int], None]:
        self.started = self.last = time.monotonic()
        return self.tell

    def __exit__(self, *_: object) -> None:
        if self.last > self.started and sys.stderr.isatty():
            click.echo("\r\033[K", nl=False, err=True)

    def tell(self, done: float, march_time: float, rows: int) -> None:
        """Report how far the march is, once a second."""
        now = time.monotonic()
        if now - self.last >= 1.0 and sys.stderr.isatty():
            self.last = now
            click.echo(f"\r\033[K{done:4.0%}  {self.words.format(at=march_time, count=rows)}", nl=False, err=True)
