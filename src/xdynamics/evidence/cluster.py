"""The dask cluster that computes stages: connected, checked, watched, and left as it was.

Before processes are started, the calling script is checked for a main guard: without it, every process that the script
starts would run the script again.
"""

from __future__ import annotations

import ast
import logging
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from importlib.metadata import version
from pathlib import Path
from types import FrameType
from typing import Any

from xdynamics.elementary import NAME
from xdynamics.faults import InputError, numbered_lines
from xdynamics.kernels.engine_part import source_digest

GUARD = 'if __name__ == "__main__":'


def check_main_guard() -> None:
    """Check that processes may be started: each imports the script first, except what its main guard protects.

    Without one, each would start processes of its own, is refused, and is started anew, for ever.

    Raises
    ------
    InputError
    """
    path = getattr(sys.modules.get("__main__"), "__file__", None)
    if path is None:  # a session, which no process imports
        return
    frame: FrameType | None = sys._getframe()  # noqa: SLF001 - as `inspect` reads it, which is dear to import
    while frame is not None:
        if frame.f_code.co_name == "<module>" and frame.f_globals.get("__name__") in ("__main__", "__mp_main__"):
            if frame.f_code.co_filename == path and not _is_guarded(path, frame.f_lineno):
                raise InputError(
                    f"'{Path(path).name}' starts the processes of a cluster in line {frame.f_lineno}, and each of them imports"
                    f" the script first and would start them again; put what it does below the line {GUARD}"
                )
            return
        frame = frame.f_back


def _is_guarded(path: str, line: int) -> bool:
    """Whether a statement of a script stands in, or behind, one that asks for `__name__`; so where it cannot be read."""
    try:
        statements = ast.parse(Path(path).read_bytes()).body
    except (OSError, SyntaxError, ValueError):
        return True
    guards = [statement for statement in statements if isinstance(statement, ast.If) and statement.lineno <= line]
    return any(
        isinstance(node, ast.Name) and node.id == "__name__"
        for statement in guards
        for node in ast.walk(statement.test)
    )


PATIENCE = "10s"  # with a scheduler that does not answer
RESTARTING = "300s"  # for a killed worker; after 15 s, too few on a busy machine, it would be given up for good
OFTEN = 0.5  # s between two questions how far a graph is
ASKED = 10  # times at most, workers that are lost meanwhile
# before any task: of two threads that unpickle what names xarray's modules, each would wait for the other to import them
WHOLE = "import xarray; import dask.array"
DEAF = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)"  # Ctrl-C of a terminal reaches its workers too
UNFINISHED = ("waiting", "processing", "queued", "no-worker")
Tell = Callable[[float, float, int], None]


def connected() -> Any:
    """Return the client of the cluster on which dask computes; None if it computes in this process.

    Raises
    ------
    InputError
        If dask is to compute on a cluster, and its client is closed.
    """
    distributed: Any = sys.modules.get("distributed")
    if distributed is None:
        return None
    import dask.config

    if dask.config.get("scheduler", None) != "dask.distributed":
        return None
    client = None
    with suppress(ValueError):  # there is none
        client = distributed.default_client()
    if client is None or client.status in ("closing", "closed"):
        raise InputError(
            "dask is to compute on a cluster, and its client is closed; open another, distributed.Client('tcp://…'), or"
            " compute here, dask.config.set(scheduler='threads')"
        )
    return client


def log_worker_event(topic: str, entry: Any) -> None:
    """Log a task's event with the scheduler, if this process works for one; the client reads it later."""
    distributed: Any = sys.modules.get("distributed")
    if distributed is None:
        return
    with suppress(ValueError):  # it is no worker
        distributed.get_worker().log_event(topic, entry)


def worker_events(topic: str) -> list[Any]:
    """Return the events that workers logged under a topic; none without a cluster."""
    try:
        client = connected()
        if client is None:
            return []
        return [entry for _, entry in client.get_events(topic)]
    except Exception:  # noqa: BLE001 - whatever a cluster that is gone answers: nothing is known of what it did
        return []


def environment() -> dict[str, str]:
    """Return the versions that must agree between processes, for equal bits and for objects sent between them."""
    versions = {name: version(name) for name in ("xdynamics", "numpy", "llvmlite")}
    python = ".".join(map(str, sys.version_info[:2]))
    return versions | {"Python": python, "math functions": NAME, "engine": source_digest()[:12]}


def check_workers(client: Any) -> None:
    """Check that the workers of a cluster have the versions, math functions and engine of this process.

    Raises
    ------
    InputError
        Naming each worker that has others; or if there is no worker.
    """
    try:
        environments = _environments(client)
    except Exception as error:  # noqa: BLE001 - whatever a worker without this package answers
        raise InputError(
            f"the workers of {_scheduler_address(client)} cannot be asked for their versions: {error}"
        ) from None
    if not environments:
        raise InputError(
            f"the cluster at {_scheduler_address(client)} has no workers; start one with: dask worker {_scheduler_address(client)}; or where"
            " jobs still wait in a queue, wait for them: cluster.wait_for_workers(1)"
        )
    mine = environment()
    faults = [fault for worker, theirs in environments.items() for fault in _environment_faults(worker, mine, theirs)]
    if faults:
        remedy = "install the same versions on all machines"
        raise InputError(f"the workers are not as this process; {remedy}:{numbered_lines(faults)}", tuple(faults))


def _environments(client: Any) -> dict[str, Any]:
    """Return each worker's environment; if a worker was lost meanwhile, ask the remaining workers again."""
    for _ in range(ASKED):
        environments: dict[str, Any] = client.run(environment, on_error="return")
        if not any(isinstance(answer, OSError) for answer in environments.values()):
            break
        time.sleep(OFTEN)
    return environments


def _environment_faults(worker: str, mine: dict[str, str], theirs: Any) -> Iterator[str]:
    if not isinstance(theirs, dict):
        yield f"worker {worker} cannot be asked: {theirs!s:.200}"
        return
    for name, value in mine.items():
        if theirs.get(name) != value:
            yield f"worker {worker} has {name} {theirs.get(name, 'unknown')}, and this process {value}"


def cluster(where: str | int | None = None) -> AbstractContextManager[Any]:
    """Have stages and sweeps computed on a cluster as long as the context lasts; results are unchanged.

    Its workers are asked first for their versions, math functions and engine; where they differ from those here, or the
    cluster is gone, that is an error of a few words.

    Parameters
    ----------
    where : str, or int
        The address of a scheduler, ``"tcp://10.0.0.1:8786"``; or how many processes to start on this machine, each with
        one thread, ``4`` or ``"4"``, which end with the context: a script that does so has its lines below
        ``if __name__ == "__main__":``. By default neither: dask computes as it is set to, by threads of this process.

    Returns
    -------
    context manager
        Of the `dask.distributed.Client`; of None where there is no cluster.

    Raises
    ------
    InputError
        If there is no such cluster, it has no workers, or they differ; each is named. If processes are to be started by
        a script without that line, which each of them would run again.

    Examples
    --------
    >>> import xdynamics as xd
    >>> model = xd.Model.from_toml("data/models/harmonic_oscillator.toml")
    >>> study = xd.refine(model, steps=["20 ms", "10 ms"], until="1 s", compute=False)
    >>> with cluster():  # cluster(4), cluster("tcp://10.0.0.1:8786")
    ...     study = study.compute()
    """
    if where is None:
        return cluster_of(None, None)
    if isinstance(where, str) and where.strip() and not where.strip().isdecimal():
        return cluster_of(where.strip(), None)
    count = int(where) if isinstance(where, str) and where.strip() else where
    if isinstance(count, bool) or not isinstance(count, int) or count < 1:
        raise InputError(
            f"a cluster is {where!r}, needs the address of a scheduler, like 'tcp://10.0.0.1:8786', or how many"
            " processes to start here"
        )
    return cluster_of(None, count)


@contextmanager
def cluster_of(scheduler: str | None, workers: int | None) -> Iterator[Any]:
    """Connect to a cluster, or start processes here, and check them; None without a scheduler and workers.

    Parameters
    ----------
    scheduler : str, optional
        Address of a cluster, like ``tcp://10.0.0.1:8786``.
    workers : int, optional
        How many processes to start on this machine; they end with the context.

    Raises
    ------
    InputError
        If both are given, there is no such cluster, its workers differ, or a script would start them without end.
    """
    if scheduler is None and workers is None:
        yield None
        return
    if scheduler is not None and workers is not None:
        raise InputError(f"scheduler is {scheduler!r} and workers {workers}; a cluster has its own workers, give one")
    if scheduler is not None and "@" in scheduler:
        raise InputError(
            "credentials stand in the address of a scheduler, which has none: give tcp://host:port, or tls://host:port"
            " with certificates by dask's configuration (distributed.comm.tls)"
        )
    try:
        import dask.config
        import distributed
    except ImportError:
        raise InputError("a cluster needs dask's distributed: pip install xdynamics[distributed]") from None
    library: Any = distributed  # its classes are not typed
    if workers is not None:
        check_main_guard()
        settings = {
            "threads_per_worker": 1,
            "dashboard_address": None,
            # else its pages are at port 8787, and it warns where another cluster has that
            "scheduler_kwargs": {"dashboard_address": "127.0.0.1:0"},
            "silence_logs": "CRITICAL",
            "preload": [DEAF, WHOLE],
        }
        with (
            dask.config.set({"distributed.deploy.lost-worker-timeout": RESTARTING}),
            library.LocalCluster(n_workers=workers, **settings) as local_cluster,
            library.Client(local_cluster) as client,
            reached(client),
        ):
            check_workers(client)
            with _quiet_end():
                yield client
        return
    try:
        library.comm.resolve_address(scheduler)  # else a client that failed would stay dask's
        client = library.Client(scheduler, timeout=PATIENCE)
    except (OSError, ValueError, TypeError) as error:
        raise InputError(f"the scheduler {scheduler!r} cannot be reached: {error}") from None
    with client, reached(client):
        check_workers(client)
        with _quiet_end():
            yield client


@contextmanager
def _quiet_end() -> Iterator[None]:
    """Where Ctrl-C ends the wait for a cluster, keep the library's own tasks, which nobody waits for any more, from the terminal."""
    logging.getLogger("asyncio").addFilter(_is_awaited)  # one task may be told of before the wait has ended here
    try:
        yield
    except KeyboardInterrupt:
        logging.getLogger("asyncio").setLevel(logging.CRITICAL)
        raise


def _is_news(log_record: logging.LogRecord) -> bool:
    """Whether a log record is no report of the lost cluster, which one line of this package reports."""
    cancelled = (
        log_record.exc_info
        and log_record.exc_info[0] is not None
        and log_record.exc_info[0].__name__ == "CancelledError"
    )
    return not cancelled and not log_record.getMessage().startswith("Failed to reconnect to scheduler")


def _is_awaited(log_record: logging.LogRecord) -> bool:
    """Whether a log record is no report that a wait for results has ended because nobody wants them."""
    return not (
        log_record.exc_info and log_record.exc_info[0] is not None and log_record.exc_info[0].__name__ == "AllExit"
    )


def compute_in_one_graph(*collections: Any, tell: Tell | None = None) -> Any:
    """Compute dask's collections together: here, or on the cluster, of which `tell` is told how far it is.

    Raises
    ------
    InputError
        If the cluster is gone.
    """
    import dask.base

    compute: Any = dask.base.compute  # it is not typed
    client = connected()
    if client is None:
        return compute(*collections)
    with reached(client), progress_reported(client, tell):
        return compute(*collections)


@contextmanager
def reached(client: Any) -> Iterator[None]:
    """Raise in one line that a cluster is gone, or that its workers died of a task.

    Raises
    ------
    InputError
    """
    import distributed

    library: Any = distributed
    closed = getattr(library.client, "ClosedClientError", library.comm.CommClosedError)  # of newer versions
    gone = (library.comm.CommClosedError, library.client.FutureCancelledError, TimeoutError, closed)
    address = _scheduler_address(client)
    logging.getLogger("distributed.client").addFilter(_is_news)  # it tells some of it after the end
    try:
        yield
    except library.scheduler.KilledWorker as error:
        raise InputError(
            f"the cluster at {address} lost several workers at '{error.task}', as they do where memory runs out; give"
            " each more of it, or a smaller task"
        ) from None
    except gone as error:
        raise InputError(
            f"the cluster at {address} is gone ({type(error).__name__}); start it again, and compute the stages again:"
            " what was written to files is kept"
        ) from None


def _scheduler_address(client: Any) -> str:
    return str(getattr(client.scheduler, "address", "an unknown address"))


@contextmanager
def progress_reported(client: Any, tell: Tell | None) -> Iterator[None]:
    """Report the fraction of a cluster's tasks that are done, as long as the context lasts."""
    finished = threading.Event()

    def poll_progress() -> None:
        max_unfinished = 1
        while not finished.wait(OFTEN):
            with suppress(Exception):  # a cluster that is gone is told by whoever waits for its results
                unfinished = client.run_on_scheduler(_unfinished)
                max_unfinished = max(max_unfinished, unfinished)
                report(1.0 - unfinished / max_unfinished, 0.0, max_unfinished - unfinished)

    if tell is None:
        yield
        return
    report, thread = tell, threading.Thread(target=poll_progress, daemon=True)
    thread.start()
    try:
        yield
    finally:
        finished.set()
        thread.join()


def _unfinished(dask_scheduler: Any) -> int:
    return sum(task.state in UNFINISHED for task in dask_scheduler.tasks.values())
