"""An object store on this machine, and a way to it that loses, delays, cuts and refuses what a test asks for."""

from __future__ import annotations

import http.client
import logging
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import pytest

Rule = Callable[[str, str], str]  # of method and path: what happens to the request


class Way(ThreadingHTTPServer):
    """Hands requests on to a store, but for those to which something is to happen.

    The answers of `rule`: ``""`` (handed on), ``"dropped"`` (before it arrives), ``"lost"`` (its answer is), ``"cut"`` (half
    of the answer is), ``"silent"`` (no answer), ``"503 SlowDown"`` (a status and the store's word for it).
    """

    daemon_threads = True

    def __init__(self, store: tuple[str, int]) -> None:
        self.store, self.rule, self.log = store, (lambda *_: ""), []
        self.over = threading.Event()
        super().__init__(("127.0.0.1", 0), _Passing)

    def handle_error(self, *_: Any) -> None:
        """Say nothing of connections that a test broke."""

    @contextmanager
    def going(self, rule: Rule) -> Iterator[Way]:
        """Let a rule hold for a while."""
        self.rule, self.log = rule, []
        self.over.clear()
        try:
            yield self
        finally:
            self.rule = lambda *_: ""
            self.over.set()

    def once(self, what: str, method: str, times: int = 1) -> Any:
        """Let something happen to the first requests of a method whose path names an object."""
        left = [times]

        def rule(asked: str, path: str) -> str:
            if asked != method or path.count("/") < 2 or "list-type" in path or not left[0]:
                return ""
            left[0] -= 1
            return what

        return self.going(rule)


class _Passing(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server: Way

    def _pass(self) -> None:
        length = int(self.headers.get("Content-Length") or 0)
        expecting = "chunked" in (self.headers.get("Transfer-Encoding") or "")
        body = self._chunks() if expecting else self.rfile.read(length)
        what = self.server.rule(self.command, self.path)
        self.server.log.append((self.command, self.path, what))
        self.close_connection = True
        if what == "silent":
            self.server.over.wait(20.0)
        if what in ("dropped", "silent"):
            return
        if what[:1].isdigit():
            status, _, code = what.partition(" ")
            text = f"<Error><Code>{code}</Code><Message>as the test asks</Message></Error>".encode()
            self._answer(int(status), [("Content-Type", "application/xml")], text)
            return
        onward = http.client.HTTPConnection(*self.server.store)
        headers = {name: value for name, value in self.headers.items() if name.lower() != "transfer-encoding"}
        onward.request(self.command, self.path, body, headers | {"Content-Length": str(len(body))})
        answer = onward.getresponse()
        content = answer.read()
        onward.close()
        if what == "lost":
            return
        kept = [
            (name, value)
            for name, value in answer.getheaders()
            if name.lower() not in ("transfer-encoding", "connection")
        ]
        self._answer(answer.status, kept, content, cut=what == "cut")

    do_GET = do_PUT = do_POST = do_HEAD = do_DELETE = _pass

    def _chunks(self) -> bytes:
        body = b""
        while size := int(self.rfile.readline().split(b";")[0], 16):
            body += self.rfile.read(size)
            self.rfile.readline()
        while self.rfile.readline().strip():
            pass
        return body

    def _answer(self, status: int, headers: list[tuple[str, str]], content: bytes, *, cut: bool = False) -> None:
        self.send_response_only(status)
        for name, value in headers:
            self.send_header(name, value)
        if not any(name.lower() == "content-length" for name, _ in headers):
            self.send_header("Content-Length", str(len(content)))
        self.send_header("Connection", "close")
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(content[: len(content) // 2] if cut else content)

    def log_message(self, *_: Any) -> None:
        """Say nothing."""


@contextmanager
def object_server() -> Iterator[Way]:
    """Run a store of moto's, loopback alone, and a way to it."""
    from moto.server import ThreadedMotoServer

    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    store = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    store.start()
    way = Way(store.get_host_and_port())
    threading.Thread(target=way.serve_forever, args=(0.05,), daemon=True).start()
    try:
        yield way
    finally:
        way.shutdown()
        way.server_close()
        store.stop()


@contextmanager
def bucket(secret: str = "secret") -> Iterator[Way]:
    """Run a store with the bucket `bucket`, and let this process and those that it starts reach it."""
    from xdynamics.archive import filesystems

    with object_server() as way, pytest.MonkeyPatch.context() as patch:
        patch.setenv("AWS_ENDPOINT_URL", f"http://127.0.0.1:{way.server_port}")
        patch.setenv("AWS_ACCESS_KEY_ID", "somebody")
        patch.setenv("AWS_SECRET_ACCESS_KEY", secret)
        patch.setenv("AWS_DEFAULT_REGION", "us-east-1")
        patch.setattr(filesystems, "ATTEMPTS", 2)
        patch.setattr(filesystems, "READ", 20.0)  # a busy machine answers late
        filesystems.filesystem("s3").call_s3("create_bucket", Bucket="bucket")
        yield way
