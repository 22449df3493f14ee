"""A bundle: a certificate in a folder with its model, run, ledger, figures and scripts, made again in one line."""

from __future__ import annotations

import json
import stat
from collections.abc import Callable, Mapping
from hashlib import file_digest
from pathlib import Path
from typing import TYPE_CHECKING, Any

from xdynamics import archive
from xdynamics.archive.folder_store import is_folder, store_of
from xdynamics.archive.store import GIVEN, Given, LocalFile, Place, location_of, resolve_links
from xdynamics.archive.target import taking_path_name
from xdynamics.budgeting import certificate as certificates
from xdynamics.budgeting.numerical import march_own_run
from xdynamics.documenting import carried_wheel
from xdynamics.documenting.equations import plain_markdown
from xdynamics.evidence.evidence_dataset import stated_value
from xdynamics.evidence.validating.ledger import validate
from xdynamics.faults import ArchiveError, InputError, numbered_lines
from xdynamics.figures import plot
from xdynamics.model import Model
from xdynamics.runtime.files import KINDS
from xdynamics.schema import ROOT_DIGEST

if TYPE_CHECKING:
    import xarray as xr

CERTIFICATE, RUN, LEDGER, MODEL = "certificate.nc", "run.nc", "ledger.nc", "model.toml"
SCRIPT, README, SUMS, CRATE = "plot.py", "README.md", "SHA256SUMS", "ro-crate-metadata.json"
LONGEST_SUMS = 100_000  # bytes of a dozen lines
LICENSE = "https://spdx.org/licenses/CC-BY-4.0"
SAID = {
    CERTIFICATE: "the number with its budget, gates and ledger cases",
    RUN: "the run that it is of: accepted states with their forces, rejected trials, events",
    LEDGER: "residuals of the method in exact cases, with derived bounds",
    MODEL: "the model, with measured tables in it",
    "certificate.png": "terms of the budget, and intervals of draws",
    "run.png": "the run",
    "ledger.png": "residuals over bounds",
    SCRIPT: "draws the figures from the archives",
    README: "what is here, and the one line that makes it again",
}
_SCRIPT = '''"""Draw the figures of this bundle from its archives: python plot.py"""

import xdynamics as xd

for name in ("certificate", "run", "ledger"):
    xd.plot(xd.open_run(f"{name}.nc"), f"{name}.png")
'''


def bundle(
    folder: Given,
    certificate: xr.Dataset | Given,
    *,
    functions: Mapping[str, Callable[..., float]] | None = None,
    license: str = LICENSE,  # noqa: A002 - as RO-Crate calls it
) -> Place:
    """Write a certificate into a folder with its model, run, ledger, figures and the scripts that reproduce it.

    Parameters
    ----------
    folder : str or Path
        Made if it does not exist; must be empty. Or ``"s3://bucket/bundle"``.
    certificate : xarray.Dataset, str or Path
        What `certify` returned, or its archive.
    functions : mapping of str to callable, optional
        The Python functions that the model's forces call.
    license : str
        Address of the licence that the metadata name.

    Returns
    -------
    Path
        The folder: `certificate.nc`, `run.nc` (the accepted-state log), `ledger.nc` (validation residuals), `model.toml`,
        their figures and `plot.py` that draws them, this package as a wheel, `README.md`, digests of all in `SHA256SUMS`,
        and RO-Crate metadata.

    Raises
    ------
    InputError
        If the folder holds something, or it is no certificate, or the package `rocrate` is missing, or this one is not
        installed.
    ArchiveError
        If the run that is marched is another than the certificate's.
    """
    try:
        from rocrate.rocrate import ROCrate
    except ImportError:
        raise InputError("bundles need the package rocrate: pip install xdynamics[report]") from None
    record = certificates.certificate_of(certificate)
    target, wheel = location_of(folder), carried_wheel.wheel_name()
    store_of(target).check_empty(target)
    model = Model.from_record(record["model_toml"].values.item(), functions=functions)
    run = march_own_run(model, json.loads(str(record.attrs["asked"])))
    digest, stated_digest = archive.digest_of_run(run), str(record["run_digest"].values[0])
    if digest != stated_digest:
        raise ArchiveError(f"the repeated run has the content digest {digest}, the certificate states {stated_digest}")
    ledger = validate([str(record.attrs["solver_method"])])
    with store_of(target).taking_folder(target) as built:
        for name, dataset in ((CERTIFICATE, record), (RUN, run), (LEDGER, ledger)):
            archive.save(dataset, built / name)
            plot(dataset, (built / name).with_suffix(".png"))
        _write_text(built / MODEL, model.to_toml())
        _write_text(built / SCRIPT, _SCRIPT)
        carried_wheel.write_wheel(built / wheel)
        _write_text(built / README, _readme(record, resolve_links(target).name, wheel))
        _crate(ROCrate(), built, record, license, SAID | {wheel: carried_wheel.ABOUT})
        names = [*SAID, wheel, CRATE]
        _write_text(built / SUMS, "".join(f"{_file_digest(LocalFile(built / name, name))}  {name}\n" for name in names))
    return target


def recheck(
    certificate: xr.Dataset | Given, *, functions: Mapping[str, Callable[..., float]] | None = None
) -> xr.Dataset:
    """Make a certificate again from nothing but itself, or its bundle, and compare every number.

    Parameters
    ----------
    certificate : xarray.Dataset, str or Path
        What `certify` returned, its archive, or the folder of a bundle, of which every file is compared with its digest,
        and the run is marched again and compared too.
    functions : mapping of str to callable, optional
        The Python functions that the model's forces call.

    Returns
    -------
    xarray.Dataset
        The new certificate.

    Raises
    ------
    ArchiveError
        If any value differs, naming it with both values; or if a file is damaged, missing or added.
    InputError
        If it is no certificate.
    """
    if not isinstance(certificate, GIVEN) or not is_folder(location_of(certificate)):
        return certificates.remake_certificate(certificate, functions)
    folder = location_of(certificate)
    if faults := _bundle_faults(folder):
        raise ArchiveError(f"'{folder}' is no whole bundle:{numbered_lines(faults)}", tuple(faults))
    new_certificate = certificates.remake_certificate(folder / CERTIFICATE, functions)
    model_file = store_of(folder).local_file(folder / MODEL)
    model = Model.from_toml(model_file.path, functions=functions)
    if model.digest != new_certificate.attrs["model_digest"]:
        raise ArchiveError(f"'{folder / MODEL}' is another model than the certificate's")
    with archive.open_run(folder / RUN) as run:
        if run.attrs[ROOT_DIGEST] != str(new_certificate["run_digest"].values[0]):
            raise ArchiveError(f"'{folder / RUN}' is another run than the certificate's")
    return new_certificate


def check_files(folder: Place) -> None:
    """Check, before anything is opened, that a bundle holds nothing but regular files.

    Raises
    ------
    ArchiveError
        Naming the links, pipes, folders in it.
    """
    if not isinstance(folder, Path) or not folder.is_dir():
        return
    irregular_entries = sorted(
        (entry.name, entry.lstat().st_mode) for entry in folder.iterdir() if not stat.S_ISREG(entry.lstat().st_mode)
    )
    if irregular_entries:
        kinds = {stat.S_IFLNK: "a link"} | KINDS
        faults = tuple(
            f"{name} is {kinds.get(stat.S_IFMT(mode), 'no file')}, and no file of its own"
            for name, mode in irregular_entries
        )
        raise ArchiveError(f"'{folder}' is no whole bundle:{numbered_lines(faults)}", faults)


def _bundle_faults(folder: Place) -> list[str]:
    """Compare every file of a bundle with its digest."""
    check_files(folder)
    store = store_of(folder)
    present = {entry.name: entry for entry in store.names(folder) if store.kind(entry) is None}
    if SUMS not in present:
        return [f"there is no {SUMS}"]
    sums = store.content(present[SUMS], LONGEST_SUMS).decode(errors="replace")
    rows = [line.partition("  ") for line in sums.splitlines()]
    digests = {name: digest for digest, _, name in rows}
    files = {*SAID, CRATE, *filter(carried_wheel.is_wheel, digests)}
    missing_files = [f"{name} is missing" for name in sorted(files) if name not in digests or name not in present]
    damaged_files = [
        f"{name} differs from its digest"
        for name, digest in digests.items()
        if name in files & {*present} and _file_digest(store.local_file(present[name])) != digest
    ]
    added_files = sorted({*present} - files - {SUMS})
    return [*missing_files, *damaged_files, *(f"{name} is none of its files" for name in added_files)]


def _file_digest(stored_file: LocalFile) -> str:
    with stored_file.path.open("rb") as file:
        return file_digest(file, "sha256").hexdigest()


def _write_text(path: Path, text: str) -> None:
    with taking_path_name(path) as target:
        target.part.write_text(text, encoding="utf-8")


def _readme(certificate: xr.Dataset, name: str, wheel: str) -> str:
    """Describe the bundle: its number, its files, and how to reproduce it."""
    described = SAID | {wheel: carried_wheel.ABOUT}
    files = "\n".join(f"* `{file}`: {description}" for file, description in described.items() if file != README)
    gates = "\n".join(f"* {plain_markdown(line)}" for line in certificates.certificate_lines(certificate)[1:-2])
    return f"""# {plain_markdown(certificate.attrs["title"])}

{plain_markdown(certificate.attrs["of"])} = {stated_value(certificate, "result")}

{gates}

All of it is made again, and compared number by number, by

    {remaking_command(name, wheel)}

![Terms of the budget](certificate.png)

![The run](run.png)

{files}
"""


def remaking_command(name: str, wheel: str) -> str:
    """Return the line that makes a bundle again, where its folder stands."""
    return f"pip install {name}/{wheel} && xdynamics recheck {name}"


def _crate(crate: Any, target: Path, certificate: xr.Dataset, licence: str, described: Mapping[str, str]) -> None:
    """Write RO-Crate metadata of the files (Soiland-Reyes and others 2022, doi:10.3233/DS-210053)."""
    kinds = {
        ".nc": "application/x-netcdf",
        ".toml": "application/toml",
        ".png": "image/png",
        ".py": "text/x-python",
        ".md": "text/markdown",
        ".whl": "application/zip",
    }
    crate.name = str(certificate.attrs["title"])
    crate.description = f"{certificate.attrs['of']} = {stated_value(certificate, 'result')}"
    crate.datePublished = str(certificate.attrs["date_created"])
    crate.license = licence
    for name, description in described.items():
        properties = {
            "name": name,
            "description": description,
            "encodingFormat": kinds[Path(name).suffix],
            "contentSize": str((target / name).stat().st_size),
            "sha256": _file_digest(LocalFile(target / name, name)),
        }
        crate.add_file(target / name, dest_path=name, properties=properties)
    crate.metadata.write(target)
