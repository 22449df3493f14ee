"""Archives read by a separate process, with bounded time and memory, until their bytes are known here."""

from __future__ import annotations

import atexit
import json
import os
import select
import signal
import subprocess
import sys
import threading
from collections import OrderedDict
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar

from xdynamics.archive.file_structure import MOST_PACKED
from xdynamics.archive.integrity_checks import Examination, compare_file, examine_file, harmed
from xdynamics.archive.sandbox import READY
from xdynamics.archive.seals import Tail
from xdynamics.archive.shared_handles import Identity

Key = TypeVar("Key")


SECONDS = 1.5  # of processor time for a small file


BYTES_PER_SECOND = 20_000_000  # of processor time for a large one, a tenth of what it takes


UNPACKED_PER_SECOND = 100_000_000  # more, of what is compressed


MEMORY = 200_000_000  # bytes beside the libraries


WAITED = 10  # times as long by the clock, and a little for a machine that is busy


STARTING = 30.0


LONGEST = 1e6  # s, which a clock can wait for


MOST_KNOWN = 50_000  # files whose digests are remembered


# digests of files that were written here, or read whole without a fault, the one used longest ago first
_known_seals: OrderedDict[str, None] = OrderedDict()


_seen_files: OrderedDict[Identity, None] = OrderedDict()  # and files whose objects are known


_lock = threading.Lock()


def know(digest: str) -> None:
    """Remember the seal of a file that was written here; with too many, the one used longest ago is forgotten."""
    _remember_key(_known_seals, digest)


def see(identity: Identity) -> None:
    """Remember that a file, as it is now, has no object that the netCDF library would follow out of it."""
    _remember_key(_seen_files, identity)


def is_seen(identity: Identity) -> bool:
    """Whether a file is known to have no such object."""
    return identity in _seen_files


def _remember_key(table: OrderedDict[Key, None], key: Key) -> None:
    with _lock:
        table[key] = None
        table.move_to_end(key)
        if len(table) > MOST_KNOWN:
            table.popitem(last=False)


def is_known(tail: Tail) -> bool:
    """Whether a seal holds for bytes that were written or examined here before."""
    if not tail.digest or tail.digest not in _known_seals:
        return False
    know(tail.digest)
    return True


def examine_sandboxed(path: Path, tail: Tail) -> Examination:
    """Compare an archive with its seal and digests, in a process where it can do no harm."""
    if is_known(tail):
        return compare_file(path, tail)
    examination = _EXAMINER.examine(path, tail)
    if tail.digest and not examination.faults:
        know(tail.digest)
    return examination


def examine_structure(path: Path) -> Examination:
    """Compare the structure and attributes of an archive, of which there is a partial copy, with their digests there."""
    sealed = Tail("unread")  # by the digests of its extents, which are compared as they are copied
    return _EXAMINER.examine(path, sealed, values=False)


class _Examiner:
    """The separate process: started on first use, given one request at a time, restarted when it has ended."""

    def __init__(self) -> None:
        self._turn = threading.Lock()
        self._process: subprocess.Popen[str] | None = None
        self._has_read = False  # whether the reader of that process has read another file before

    def examine(
        self, path: Path, tail: Tail, seconds: float = SECONDS, memory: int = MEMORY, *, values: bool = True
    ) -> Examination:
        """Examine an archive in the separate process.

        Parameters
        ----------
        path : Path
        tail : Tail
        seconds : float
            Processor time for a small file; a large one has more.
        memory : int
            Bytes that reading it may take.
        values : bool
            Whether values are read, too.
        """
        seconds += path.stat().st_size / BYTES_PER_SECOND
        unpacking = path.stat().st_size * MOST_PACKED / UNPACKED_PER_SECOND
        question = {
            "path": os.fspath(path.absolute()),
            "tail": vars(tail),
            "seconds": seconds,
            "memory": memory,
            "bytes_per_second": UNPACKED_PER_SECOND,
            "values": values,
        }
        with self._turn:
            try:
                answer = self._ask_reader(json.dumps(question), min(WAITED * (seconds + unpacking) + STARTING, LONGEST))
            except BaseException:
                self.end()
                raise
        if answer == READY:
            return examine_file(path, tail, values=values)
        if answer is None or answer.get("code") == -signal.SIGPROF:
            return harmed(f"it takes more than {seconds:.2g} s to read, which no archive of its size does")
        if "code" in answer:
            return harmed(f"the libraries break off when they read it (exit code {answer['code']})")
        return Examination(**answer | {"faults": tuple(answer["faults"])})

    def end(self) -> None:
        """End the process, whatever it does."""
        if self._process is not None:
            with suppress(ProcessLookupError):
                os.killpg(self._process.pid, signal.SIGKILL)  # with the reader that it forked
            self._process.communicate()
            self._process = None
        self._has_read = False

    def forget(self) -> None:
        """Leave the process to the parent that this one was forked from."""
        self._turn = threading.Lock()
        if self._process is not None:
            self._process.returncode = 0  # not ours to wait for
            self._process = None
        self._has_read = False

    def _ask_reader(self, question: str, seconds: float) -> Any:
        """Ask a question, again if the reader may have a fault from another file; return the answer."""
        for _ in range(2):
            answer = self._answered(question, seconds)
            had_read, self._has_read = self._has_read, _is_faultless(answer)
            if answer is None:
                self.end()
            if self._has_read or not had_read:
                break
        return answer

    def _answered(self, question: str, seconds: float) -> Any:
        """Return the answer; None without one, `READY` if there is no process to ask."""
        # the process reads no file itself: its own end, for example after a long pause, is no fault of a file
        for _ in range(2):
            process = self._reader_process()
            if process is None:
                return READY
            with suppress(BrokenPipeError):
                print(question, file=process.stdin, flush=True)
            answer = _next_answer(process, seconds)
            with suppress(subprocess.TimeoutExpired):
                process.wait(0.0 if answer else 0.2)
            if answer is not None or process.returncode is None:
                return answer
        return None

    def _reader_process(self) -> subprocess.Popen[str] | None:
        """Return the process when it is ready; None if none can be started, so that files are read here."""
        if self._process is not None and self._process.poll() is None:
            return self._process
        self.end()
        if not sys.executable or getattr(sys, "frozen", False):
            return None
        program = f"import sys; sys.path[:] = {sys.path!r}; from xdynamics.archive.sandbox import main; main()"
        with suppress(OSError):
            self._process = subprocess.Popen(  # noqa: S603 - this very interpreter
                [sys.executable, "-I", "-c", program],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
                env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
                # a group of its own, which `end` kills together with the reader,
                # and which Ctrl-C at a terminal does not reach
                start_new_session=True,
            )
            if _next_answer(self._process, STARTING) != READY:
                self.end()
        return self._process


def _is_faultless(answer: Any) -> bool:
    """Whether an answer is that of a reader which goes on to the next file."""
    return isinstance(answer, dict) and not answer.get("faults", True)


def _next_answer(process: subprocess.Popen[str], seconds: float) -> Any:
    """Return the next answer of a process; None if it gives none in time, or ends."""
    assert process.stdout is not None  # noqa: S101
    # select refuses descriptors from 1024 on, and a process may have as many files open
    ready = select.poll()
    ready.register(process.stdout, select.POLLIN)
    if not ready.poll(1000 * seconds):
        return None
    with suppress(ValueError):  # half a line of a process that ended
        return json.loads(process.stdout.readline())
    return None


_EXAMINER = _Examiner()
atexit.register(_EXAMINER.end)
os.register_at_fork(after_in_child=_EXAMINER.forget)
