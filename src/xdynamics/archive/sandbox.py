"""The process that reads untrusted files, so that a crash or an endless loop is noticed from outside.

HDF5 follows what a file says; a file can be made to keep it busy for ever, take all memory or crash. The process takes
one request a line, JSON, and answers in one line. It forks a reader, so that it starts fast, and ends with the first
file that has a fault: nothing that such a file leaves in the library affects another.
"""

from __future__ import annotations

import json
import os
import select
import signal
import sys
from functools import partial
from pathlib import Path
from typing import Any

from xdynamics.archive.integrity_checks import Examination, examine_file
from xdynamics.archive.seals import Tail
from xdynamics.runtime.files import bound_memory

PATIENCE = 60.0  # s without a request, after which the process ends
READY = "ready"
UNASKED = 64  # the exit code of a reader without further requests
# bytes of chunks kept of each variable, which is read once and in order: the library's own 64 MiB, kept until the file
# is closed, would make the memory needed that of the file
CACHE = 1_000_000


def main() -> None:
    """Answer requests until the input ends."""
    import netCDF4  # once, for every process that is forked

    netCDF4.set_chunk_cache(size=CACHE)
    _send_answer(READY)
    while True:
        child = os.fork()
        if not child:
            _answer_requests()
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        if code == UNASKED:
            return
        if code:
            _send_answer({"code": code})


def _answer_requests() -> None:
    """Answer requests until a file has a fault or there are no more, then end this process."""
    while select.select([sys.stdin], [], [], PATIENCE)[0] and (line := sys.stdin.readline()):
        examination = _examine_request(json.loads(line))
        _send_answer(vars(examination))
        if examination.faults:
            os._exit(0)
    # not sys.exit: exit handlers and buffers that the fork inherited are the parent's
    os._exit(UNASKED)


def _examine_request(request: dict[str, Any]) -> Examination:
    """Examine one file within its bounds."""
    bound_memory(request["memory"])
    # processor time: what waits for a disk or for other processes is no fault of the file
    signal.setitimer(signal.ITIMER_PROF, request["seconds"])
    try:
        examination = examine_file(
            Path(request["path"]),
            Tail(**request["tail"]),
            partial(_grant, request["bytes_per_second"]),
            values=request["values"],
        )
    except BaseException:  # noqa: BLE001 - it must not reach the loop that this process was forked from
        os._exit(1)
    signal.setitimer(signal.ITIMER_PROF, 0.0)
    return examination


def _grant(speed: float, size: int) -> None:
    """Allow the time that it takes to unpack so many bytes of a file that may have them."""
    left = signal.getitimer(signal.ITIMER_PROF)[0]
    signal.setitimer(signal.ITIMER_PROF, left + size / speed)


def _send_answer(answer: object) -> None:
    print(json.dumps(answer), flush=True)  # noqa: T201 - to the process that asked
