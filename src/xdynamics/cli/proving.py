"""Verbs that prove: enclose, verify, sign, reproduce."""

from __future__ import annotations

import sys

import click

from xdynamics.cli.command import BADLY, DONE, WRONG_INPUT, complain, json_option, main, print_json, progress, say
from xdynamics.cli.marching import read_changed_model

WHERE = " (xdynamics reproduce computes a run again, and says at which rows)"
RESEALED = "every number agrees, the seal is gone: xd.save seals it again"


@main.command()
@click.argument("archives", nargs=-1, required=True, metavar="RUN.nc…")
@click.option("--key", metavar="PUBLIC.pem", help="Also verify that the owner of this key signed them.")
@click.option("--audit", is_flag=True, help="Also look for contradictions between each record and its model.")
@json_option
def verify(archives: tuple[str, ...], key: str | None, audit: bool) -> None:
    """Compare every digest of archives, or of folders of sweeps, with their data; with --key their signatures too.

    verified: every byte is as it was written. repacked: another program wrote the file, and every number agrees. edited: the
    file is sound, and says something else than was archived. damaged: its bytes are not those that were written. Exit code 1
    for the latter two.
    """
    from xdynamics.archive import open_run, signatures
    from xdynamics.archive import verify as compared
    from xdynamics.archive.folder_store import is_folder
    from xdynamics.archive.integrity_checks import DAMAGED, EDITED, REPACKED, VERIFIED
    from xdynamics.archive.store import location_of
    from xdynamics.faults import ArchiveError, InputError, first_names
    from xdynamics.record.schemas import kind_description
    from xdynamics.sweeping.catalogue import is_sweep_folder

    damaged = wrong = False
    verdicts: list[dict[str, str]] = []
    for archive in archives:
        try:
            location = location_of(archive)
            if is_sweep_folder(location):
                verdict, digest, text = _verified_sweep(archive)
                verdicts.append({"archive": archive, "verdict": verdict, "digest": digest, "text": text})
                say([text])
                continue
            if key:
                verdict, digest = VERIFIED, signatures.verify_signature(archive, key)
            else:
                examination = compared(archive)
                verdict, digest = examination.verdict, examination.digest
            protection_words = (
                f"signed, by '{key}'{signatures.coverage_note(location)}" if key else signatures.protection(location)
            )
            protection_words = RESEALED if verdict == REPACKED else protection_words
            with open_run(archive, check=False) as run:
                kind = kind_description(run.attrs)
            text = f"{verdict}  {archive}  {digest}{f': {kind}' if kind else ''}  ({protection_words})"
            verdicts.append({"archive": archive, "verdict": verdict, "digest": digest, "text": text})
            say([text])
            damaged = (audit and not _audited(archive, verdicts[-1])) or damaged
        except ArchiveError as error:
            verdict, text = error.verdict or DAMAGED, str(error)
            if error.verdict and not is_folder(location):
                text = f"{verdict}  {archive}: {first_names(error.faults)}{WHERE if verdict == EDITED else ''}"
                say([text])
            else:
                complain(error)
            verdicts.append({"archive": archive, "verdict": verdict, "text": text})
            damaged = True
        except InputError as error:
            complain(error)
            verdicts.append({"archive": archive, "verdict": "not verified", "text": str(error)})
            wrong = True
    print_json({"kind": "verification", "archives": verdicts})
    sys.exit(BADLY if damaged else WRONG_INPUT if wrong else DONE)


def _audited(archive: str, verdict: dict[str, str]) -> bool:
    """Print the contradictions in a run's record, and add them to its verdict; whether there are none."""
    from xdynamics.archive import open_run
    from xdynamics.evidence.audit import audit as audited
    from xdynamics.evidence.evidence_dataset import FAILED

    with open_run(archive, check=False) as run:
        gates = audited(run)
    say(
        [f"{gate.verdict}  {archive}  {gate.name}: {gate.reason}" for gate in gates] or [f"nothing to audit  {archive}"]
    )
    verdict["audit"] = "failed" if any(gate.verdict == FAILED for gate in gates) else "passed"
    return verdict["audit"] == "passed"


def _verified_sweep(folder: str) -> tuple[str, str, str]:
    """Verify a sweep's catalogue and every run that it names; return verdict, digest, and both in words."""
    from xdynamics.archive.store import location_of
    from xdynamics.sweeping.catalogue import unfinished_folders, verify_sweep

    examination, files = verify_sweep(folder)
    note = (
        "; members were being added to it: the same sweep, called again, goes on"
        if unfinished_folders(location_of(folder))
        else ""
    )
    runs = f" and its {files} archived run{'s' if files > 1 else ''}" if files else ""
    verdict, digest = examination.verdict, examination.digest
    return verdict, digest, f"{verdict}  {folder}  {digest}: a sweep{runs}{note}"


@main.command(makes=True)
@click.argument("archives", nargs=-1, metavar="RUN.nc…")
@click.option("--key", metavar="KEY.pem", help="Your private Ed25519 key.")
@click.option("--new-key", metavar="KEY.pem", help="First make a pair of keys, KEY.pem and KEY.public.pem.")
def sign(archives: tuple[str, ...], key: str | None, new_key: str | None) -> None:
    """Sign archives: a file RUN.nc.sig beside each, for `verify --key PUBLIC.pem`."""
    from xdynamics.archive import signatures
    from xdynamics.archive import verify as verify_archive
    from xdynamics.faults import InputError

    if (key is None) == (new_key is None) or not (archives or new_key):
        raise InputError("sign needs archives and one of --key KEY.pem and --new-key KEY.pem; --new-key goes alone too")
    if new_key:
        for archive in archives:
            verify_archive(archive)  # a key is made for what can be signed
        say([f"new key   {new_key} (keep it to yourself), {signatures.new_key(new_key)} (give it to others)"])

    def ask() -> str:
        passphrase: str = click.prompt(f"passphrase of {key}", hide_input=True, err=True) if sys.stdin.isatty() else ""
        return passphrase

    for archive in archives:
        say([f"signed    {archive}  {signatures.sign(archive, key or str(new_key), passphrase=ask)}"])


@main.command()
@click.argument("archive", metavar="RUN.nc")
@json_option
def reproduce(archive: str) -> None:
    """Run the model of an archive again and compare every bit."""
    from xdynamics.simulation.single_run import reproduce as again

    table = again(archive)
    print_json(table)
    if table.attrs["identical"]:
        part = f" in run {table.attrs['selection']} computed again" if table.attrs["selection"] else ""
        say([f"reproduced  {archive}: {table.sizes['variable']} variables, every bit the same{part}"])
        say([table.attrs["arithmetic"]] if table.attrs["arithmetic"] else [])
        return
    say([f"not the same: {table.attrs['arithmetic']}; the first is {table.attrs['first_difference']}"])
    say(f"  {line}" for line in table.attrs["settings"].splitlines())
    sys.exit(BADLY)


@main.command()
@click.argument("model_file", metavar="MODEL.toml|RUN.nc")
@click.option("-o", "--output", metavar="E.nc", help="Where to write the bounds.")
@click.option(
    "--until", metavar="TIME", help="Up to which time to prove; by default the last --at, or the model's own."
)
@click.option(
    "--at", "times", multiple=True, metavar="TIME", help="A time at which to prove bounds, or times like '0:10:101 s'."
)
@click.option("--rtol", type=float, help="What truncation may add in a step, as a part of the largest value (1e-16).")
@click.option("--order", type=int, help="Order of the Taylor polynomials; by default from --rtol: 20.")
@click.option("--max-steps", type=int, help="Steps after which the proof ends (100000).")
@click.option("--parts", type=int, help="Into how many parts to cut a wide set, for narrower bounds; needs --at (1).")
@click.option("--set", "values", multiple=True, metavar="NAME=VALUE", help="Change a parameter or initial value.")
@json_option
def enclose(
    model_file: str,
    output: str | None,
    until: str | None,
    times: tuple[str, ...],
    rtol: float | None,
    order: int | None,
    max_steps: int | None,
    parts: int | None,
    values: tuple[str, ...],
) -> None:
    """Prove bounds of all motions, for every start and parameter within its half_width.

    Intervals rounded outward hold coordinates, velocities, states, energies and observables of all these motions after each
    step, or at the times of --at, and the times at which all of them pass the zeros of events that record. What has no
    half_width is the number as it is written; a table over time counts as the polynomials of floats that runs look up, and
    steps land on its points. Where every motion of the set passes an event that switches or resets, all go on by the other
    forces, or from what it sets; at one that stops, bounds end before the first does. At a kink or jump that a force has by
    itself (abs, min, max, sign, floor, mod, where), of the motion or of time, bounds end: write its two sides as regimes
    with an event that switches, of time also as a table. Refused: contacts and friction (an impact on a plane is a reset,
    too), constraints, controllers, periodic events, delays, tables of the motion, forces in Python. Ends with exit code 1, and says why, where no further step is proven.
    """
    from xdynamics.archive import check_archive, save
    from xdynamics.archive.store import location_of
    from xdynamics.evidence.enclosing.enclosure import COMPLETED, enclosure_lines
    from xdynamics.evidence.enclosing.enclosure import enclose as enclosed

    model = read_changed_model(model_file, values)
    if output:
        check_archive(location_of(output))
    requested_times = list(times) if len(times) > 1 else times[0] if times else None
    with progress("t = {at:.6g}, {count} steps") as report:
        tube = enclosed(
            model,
            until=until,
            at=requested_times,
            rtol=rtol,
            order=order,
            max_steps=max_steps,
            parts=parts,
            progress=report,
        )
    archive_path = str(save(tube, output)) if output else None
    say([str(tube.attrs["title"]), *enclosure_lines(tube), *([f"archive   {archive_path}"] if archive_path else [])])
    print_json(tube, archive=archive_path)
    sys.exit(DONE if tube.attrs["outcome"] == COMPLETED else BADLY)
