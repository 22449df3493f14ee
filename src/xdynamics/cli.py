"""The command `xdynamics`: arguments in, a few lines out. Exit codes: 0 done, 1 ended badly, 2 wrong input."""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

import click

from xdynamics.faults import escaped

if TYPE_CHECKING:
    import xarray as xr

    from xdynamics.methods import Method

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
        _complain("terminated")
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
                warnings.showwarning = lambda message, *_rest: _complain(f"warning: {message}")
                return super().invoke(ctx)
        except click.UsageError as error:
            raise click.UsageError(escaped(error.format_message()), error.ctx) from None
        except ArchiveError as error:
            _complain(error)
            ctx.exit(BADLY)
        except InputError as error:
            _complain(error)
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


def _complain(error: Exception | str) -> None:
    click.echo(f"xdynamics: {escaped(str(error), lines=isinstance(error, Exception))}", err=True)


def _say(lines: Iterable[str]) -> None:
    """Print lines, whatever the names and texts in them hold."""
    for line in lines:
        click.echo(escaped(line))


@click.group(cls=_Command, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="xdynamics", message="%(prog)s %(version)s")
def main() -> None:
    """Numerical dynamics as self-describing xarray datasets."""


@main.command()
@click.argument("model_file", metavar="MODEL.toml")
@click.option("-o", "--output", required=True, metavar="RUN.nc", help="The archive to write.")
@click.option("--method", help="Name of a method; see `xdynamics methods`.")
@click.option("--step", help="Step of the time grid, like '1 ms'; with a tolerance, the first step.")
@click.option("--rtol", help="Relative tolerance, like 1e-8: steps are chosen by the error test.")
@click.option(
    "--atol",
    "atols",
    multiple=True,
    metavar="[NAME=]VALUE",
    help="Absolute tolerance: 1e-9 is in every variable's own unit, y='1 um' for one.",
)
@click.option("--estimator", help="embedded, step_doubling, step_doubling_extrapolated or none.")
@click.option("--min-step", help="Shortest step that control may take, like '1 ns'.")
@click.option("--max-step", help="Longest step that control may take.")
@click.option("--max-steps", help="Accepted and rejected steps after which the run ends.")
@click.option("--until", help="End, like '5 s', unless an event stops the run before.")
@click.option(
    "--set",
    "changes",
    multiple=True,
    metavar="NAME=VALUE",
    help="Change a parameter or initial value; a bare number keeps its unit.",
)
@click.option(
    "--force-samples", type=click.Choice(["all", "none"]), help="Record every force evaluation (default), or none."
)
@click.option(
    "--scale",
    "scales",
    multiple=True,
    metavar="NAME=VALUE",
    help="March with a length, time or mass scale, like length='0.4 m'.",
)
@click.option("--node", "nodes", multiple=True, metavar="TIME", help="A time to land on, like '1 s'.")
@click.option("--resume", is_flag=True, help="Go on from the segments that a process left behind.")
@click.option(
    "--tables",
    type=click.Choice(["below", "anywhere"]),
    default="below",
    help="Where the model may take tables from: its own folder and below (default), or anywhere.",
)
def run(
    model_file: str,
    output: str,
    method: str | None,
    step: str | None,
    rtol: str | None,
    atols: tuple[str, ...],
    estimator: str | None,
    min_step: str | None,
    max_step: str | None,
    max_steps: str | None,
    until: str | None,
    changes: tuple[str, ...],
    force_samples: str | None,
    scales: tuple[str, ...],
    nodes: tuple[str, ...],
    resume: bool,
    tables: str,
) -> None:
    """March a model file and archive the run.

    What a long run has done is kept in segments beside the archive, until it is whole: --resume goes on from there.
    """
    from xdynamics.model import Model

    model = Model.from_toml(model_file, tables=tables)
    if changes:
        model = model.replace(**_changed(model, _pairs(changes, "--set")))
    asked: dict[str, Any] = {"method": method, "step": step, "until": until, "rtol": rtol, "atol": _absolute(atols), "estimator": estimator,
             "min_step": min_step, "max_step": max_step, "max_steps": max_steps, "force_samples": force_samples}  # fmt: skip
    from xdynamics.simulation import simulate

    asked |= {"scales": _pairs(scales, "--scale") or None, "nodes": list(nodes) or None}
    with _progress() as told:
        finished = simulate(model, **asked, path=output, resume=resume, progress=told)
    _close(finished, output)


@main.command()
@click.argument("archives", nargs=-1, required=True, metavar="RUN.nc…")
def discard(archives: tuple[str, ...]) -> None:
    """Remove the segments of runs that were not finished; archives stay."""
    from xdynamics.archive import discard as discarded

    for archive in archives:
        _say([f"discarded {discarded(archive)} segments of {archive}"])


@main.command()
@click.argument("archive", metavar="RUN.nc")
@click.option("--until", required=True, help="The new end, like '20 s'.")
@click.option("-o", "--output", required=True, metavar="LONGER.nc", help="The archive to write.")
@click.option("--resume", is_flag=True, help="Go on from the segments that a process left behind.")
def extend(archive: str, until: str, output: str, resume: bool) -> None:
    """Go on behind the end of a complete run, as if it had been asked for more at once."""
    from xdynamics.extension import extend as extended

    with _progress() as told:
        longer = extended(archive, until=until, path=output, resume=resume, progress=told)
    _close(longer, output)


def _close(finished: xr.Dataset, output: str) -> None:
    """Say what became of a run, and end with the exit code of its outcome."""
    from xdynamics.archive import has_segments
    from xdynamics.march.outcomes import GOOD
    from xdynamics.summary import summary

    _say([*summary(finished), f"archive   {finished.encoding['source']}"])
    if has_segments(Path(output)):
        _say([f"segments  kept: go on with --resume, or remove them with `xdynamics discard {output}`"])
    sys.exit(DONE if finished.attrs["run_outcome"] in GOOD else BADLY)


@main.command()
@click.argument("archive", metavar="RUN.nc")
def show(archive: str) -> None:
    """Print what an archive holds: outcome, events, parameters, settings, digests."""
    from xdynamics.archive import open_run
    from xdynamics.summary import details

    _say(details(open_run(archive)))


@main.command()
@click.argument("archive", metavar="RUN.nc")
@click.option(
    "-o", "--output", required=True, metavar="FIGURE", help="The figure to write: PNG, SVG or PDF by its ending."
)
def plot(archive: str, output: str) -> None:
    """Draw trajectory, velocity, energy error, phase portrait and step size."""
    from xdynamics.archive import open_run
    from xdynamics.figures import plot as draw

    draw(open_run(archive), output)
    _say([f"figure    {output}"])


@main.command()
def methods() -> None:
    """Print the table of methods."""
    from xdynamics.methods import METHODS
    from xdynamics.summary import shortened

    for one in METHODS.values():
        kind = "symplectic" if one.symplectic else "not symplectic"
        click.echo(
            f"{one.name}: order {one.order}, {kind}, {one.evaluations} force evaluations {'an iteration' if one.implicit else 'a step'}"
        )
        click.echo(f"    update    {shortened(one.equations())}")
        click.echo(f"    in words  {one.words}")
        click.echo(
            f"    estimate  {f'embedded formula of order {one.estimate_order}' if one.estimate else 'by step doubling'}"
        )
        click.echo(
            f"    between   re-integration, order {one.order}; or {one.interpolation}, order {one.interpolation_order}"
        )
        click.echo(f"    stable    {', '.join(_limits(one))}")
        click.echo(f"    refuses   {'; '.join(one.refuses) or 'nothing'}")
        click.echo(f"    also      {', '.join(one.synonyms)}")
        click.echo(f"    source    {one.reference}")


@main.command()
@click.argument("archives", nargs=-1, required=True, metavar="RUN.nc…")
@click.option("--key", metavar="PUBLIC.pem", help="Verify that the owner of this key signed them, too.")
def verify(archives: tuple[str, ...], key: str | None) -> None:
    """Compare every digest of archives with their data, and with --key their signatures."""
    from xdynamics.archive import open_run, signatures
    from xdynamics.archive import verify as digest_of
    from xdynamics.faults import ArchiveError
    from xdynamics.record.kinds import said_of

    damaged = False
    for archive in archives:
        try:
            digest = signatures.verify_signature(archive, key) if key else digest_of(archive)
            shown = f"signed, by '{key}'" if key else signatures.protection(Path(archive))
            with open_run(archive, check=False) as run:
                kind = said_of(run.attrs)
            line = f"as written  {archive}  {digest}: {kind}" if kind else f"verified  {archive}  {digest}"
            _say([f"{line}  ({shown})"])
        except ArchiveError as error:
            _complain(error)
            damaged = True
    sys.exit(BADLY if damaged else DONE)


@main.command()
@click.argument("archives", nargs=-1, metavar="RUN.nc…")
@click.option("--key", metavar="KEY.pem", help="Your private Ed25519 key.")
@click.option("--new-key", metavar="KEY.pem", help="Make a pair of keys first: KEY.pem and KEY.public.pem.")
def sign(archives: tuple[str, ...], key: str | None, new_key: str | None) -> None:
    """Sign archives: a file RUN.nc.sig beside each, for `verify --key PUBLIC.pem`."""
    from xdynamics.archive import signatures
    from xdynamics.faults import InputError

    if (key is None) == (new_key is None) or not (archives or new_key):
        raise InputError("sign needs archives and one of --key KEY.pem and --new-key KEY.pem; --new-key goes alone too")
    if new_key:
        _say([f"new key   {new_key} (keep it to yourself), {signatures.new_key(new_key)} (give it to others)"])

    def ask() -> str:
        asked: str = click.prompt(f"passphrase of {key}", hide_input=True, err=True) if sys.stdin.isatty() else ""
        return asked

    for archive in archives:
        _say([f"signed    {archive}  {signatures.sign(archive, key or str(new_key), passphrase=ask)}"])


@main.command()
@click.argument("archive", metavar="RUN.nc")
def reproduce(archive: str) -> None:
    """March an archive's model again and compare every bit."""
    from xdynamics.simulation import reproduce as again

    table = again(archive)
    if table.attrs["identical"]:
        part = f" in run {table.attrs['selection']} marched again" if table.attrs["selection"] else ""
        _say([f"reproduced  {archive}: {table.sizes['variable']} variables, every bit the same{part}"])
        _say([table.attrs["arithmetic"]] if table.attrs["arithmetic"] else [])
        return
    _say([f"not the same: {table.attrs['arithmetic']}; the first is {table.attrs['first_difference']}"])
    _say(f"  {line}" for line in table.attrs["settings"].splitlines())
    sys.exit(BADLY)


@main.command()
@click.argument("first", metavar="FIRST.nc")
@click.argument("second", metavar="SECOND.nc")
def compare(first: str, second: str) -> None:
    """Compare two runs: settings, bits, states at common times."""
    from xdynamics.archive import open_run
    from xdynamics.evidence.comparison import compare as compared
    from xdynamics.evidence.comparison import lines_of

    table = compared(open_run(first), open_run(second))
    _say(lines_of(table))
    sys.exit(DONE if table.attrs["identical"] else BADLY)


def _limits(method: Method) -> Iterable[str]:
    """Say how long a step may be, from the method's own lines."""
    from xdynamics.stability import decay_limit, oscillator_limit

    for limit, words in ((oscillator_limit(method), "oscillation, w*h"), (decay_limit(method), "decay, h/tau")):
        if limit == limit:  # nan where the method refuses such forces
            bound = "any" if limit == float("inf") else "none" if limit == 0 else f"up to {limit:.4g}"
            yield f"{bound} ({words})"


class _progress:  # noqa: N801 - used as a statement
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
            click.echo(f"\r\033[K{done:4.0%}  t = {at:.6g} s, {rows} rows", nl=False, err=True)


def _pairs(texts: tuple[str, ...], option: str) -> dict[str, str]:
    from xdynamics.faults import InputError

    pairs: dict[str, str] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals or not name.strip() or not value.strip():
            raise InputError(f"{option} {text!r} needs NAME=VALUE")
        if name.strip() in pairs:
            raise InputError(f"{option} sets {name.strip()!r} twice")
        pairs[name.strip()] = value.strip()
    return pairs


def _absolute(texts: tuple[str, ...]) -> dict[str, Any] | None:
    """Sort absolute tolerances: a bare number is for every variable that has none of its own."""
    from xdynamics.faults import InputError

    bare = [one for one in texts if "=" not in one]
    if len(bare) > 1:
        raise InputError(f"--atol is given {len(bare)} times without a name: {', '.join(bare)}")
    named: dict[str, Any] = dict(_pairs(tuple(one for one in texts if "=" in one), "--atol"))
    for text in bare:
        try:
            named[""] = float(text)
        except ValueError:
            raise InputError(f"--atol {text!r} needs a number, in every variable's own unit, or NAME=VALUE") from None
    return named or None


def _changed(model: Any, pairs: dict[str, str]) -> dict[str, dict[str, Any]]:
    """Sort changes into sections; a bare number goes as a number, so that it keeps the unit there."""
    from xdynamics.faults import InputError

    sections: dict[str, dict[str, Any]] = {}
    for name, text in pairs.items():
        section = "parameters" if name in model.parameters else "initial" if name in model.initial else None
        if section is None:
            raise InputError(
                f"--set {name}: no such parameter or initial value; there are {', '.join([*model.parameters, *model.initial])}"
            )
        try:
            value: Any = float(text)
        except ValueError:
            value = text
        sections.setdefault(section, {})[name] = value
    return sections
