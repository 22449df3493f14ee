"""Processes that are forked while other threads simulate: each child simulates too, and none finds a lock taken."""

from __future__ import annotations

import itertools
import os
import signal
import threading
from collections.abc import Iterator

import pytest

import xdynamics as xd
from cases.problems import oscillator
from xdynamics.runtime.fork_safety import waited_for
from xdynamics.runtime.lazy_imports import cached_property

SECONDS = 60  # after which a child is ended that waits for a lock
pytestmark = pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")


def march(k: int) -> xd.Model:
    """March a model that no thread has met before."""
    model = oscillator().model.replace(initial={"x": 1.0 + 1e-6 * k})
    run = xd.simulate(model, method="dormand_prince", rtol=1e-6, until=1.0)
    assert run.attrs["run_outcome"] == "completed"
    return model


@pytest.fixture(scope="module")
def marching() -> Iterator[list[int]]:
    """Three threads that simulate as long as forks are tried."""
    over, done, numbers = threading.Event(), [0], itertools.count()

    def work() -> None:
        while not over.is_set():
            march(next(numbers))
            done[0] += 1

    march(-1)
    threads = [threading.Thread(target=work) for _ in range(3)]
    for thread in threads:
        thread.start()
    yield done
    over.set()
    for one in threads:
        one.join()


def child(k: int) -> int:
    """Fork a process that simulates; return how it ended."""
    number = os.fork()
    if not number:
        try:
            signal.signal(signal.SIGALRM, signal.SIG_DFL)
            signal.alarm(SECONDS)
            march(1_000_000 + k)
            os._exit(0)
        finally:
            os._exit(1)
    return os.waitstatus_to_exitcode(os.waitpid(number, 0)[1])


@pytest.mark.every(4)
@pytest.mark.cases(1000)
def test_a_child_finds_no_lock_taken(case: int, marching: list[int]) -> None:
    """Assert that what is forked while three threads simulate comes to the end of a run of its own."""
    before = marching[0]
    assert child(case) == 0
    assert marching[0] >= before


def test_a_property_is_computed_once_and_holds_no_lock() -> None:
    """Assert one value for an object whoever asks, and that another object's is computed while the first's is."""
    inner = threading.Event()

    class Slow:
        def __init__(self, after: threading.Event | None) -> None:
            self.after, self.calls = after, 0

        @cached_property
        def value(self) -> float:
            """A number."""
            self.calls += 1
            assert self.after is None or self.after.wait(10)
            return float(self.calls)

    first, second = Slow(inner), Slow(None)
    thread = threading.Thread(target=lambda: first.value)
    thread.start()
    assert second.value == 1.0
    inner.set()
    thread.join()
    assert (first.value, first.value, first.calls, Slow.value.__doc__) == (1.0, 1.0, 1, "A number.")


@pytest.mark.dear
def test_a_fork_waits_for_a_lock() -> None:
    """Assert that a child can take a lock that another thread held when it was forked, in whatever order of two."""
    one, other = waited_for(threading.RLock()), waited_for(threading.RLock())
    over = threading.Event()

    def work(locks: tuple[threading.RLock, ...]) -> None:  # type: ignore[valid-type]
        while not over.is_set():
            with locks[0], locks[1]:
                pass

    thread = threading.Thread(target=work, args=((one, other),))
    thread.start()
    for _ in range(50):
        number = os.fork()
        if not number:
            signal.signal(signal.SIGALRM, signal.SIG_DFL)
            signal.alarm(SECONDS)
            with other, one:
                os._exit(0)
        assert os.waitpid(number, 0)[1] == 0
    over.set()
    thread.join()
