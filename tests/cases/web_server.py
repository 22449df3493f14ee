"""A web server on this machine that serves a folder, with parts of files or without, and that misbehaves as a test asks."""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any


class WebServer(ThreadingHTTPServer):
    """Serves the files of a folder.

    Attributes
    ----------
    parts : bool
        Whether it answers with parts of files.
    mark : bool
        Whether it tells versions of a file apart.
    what : str
        What happens to the next answers: ``""``, ``"cut"`` (half of one is sent, once), ``"longer"`` (ten times what is
        declared), ``"slow"`` (a byte each half a second), ``"unknown"`` (no length is declared), or a status.
    sent : int
        Bytes that it has sent.
    """

    daemon_threads = True
    request_queue_size = 64  # connections at a time: one more waits for a second

    def __init__(self, folder: Path, *, parts: bool) -> None:
        self.folder, self.parts, self.mark, self.what, self.sent = folder, parts, True, "", 0
        super().__init__(("127.0.0.1", 0), _Handler)

    @property
    def address(self) -> str:
        """The address of the folder."""
        return f"http://127.0.0.1:{self.server_port}"

    def handle_error(self, *_: Any) -> None:
        """Say nothing of connections that a reader closed."""


class _Handler(BaseHTTPRequestHandler):
    server: WebServer
    disable_nagle_algorithm = True  # else content that follows its headers waits 40 ms for their arrival

    def do_HEAD(self) -> None:
        self._answer(with_content=False)

    def do_GET(self) -> None:
        self._answer(with_content=True)

    def _answer(self, *, with_content: bool) -> None:
        server, file = self.server, self.server.folder / self.path.partition("?")[0].lstrip("/")
        if server.what[:1].isdigit() or not file.is_file():
            self.send_error(int(server.what) if server.what[:1].isdigit() else 404)
            return
        total, part = file.stat().st_size, re.fullmatch(r"bytes=(\d+)-(\d*)", self.headers.get("Range", ""))
        start, end = 0, total - 1
        if part and server.parts:
            start, end = int(part[1]), min(int(part[2] or total - 1), total - 1)
            self.send_response(206)
            self.send_header("Content-Range", f"bytes {start}-{end}/{total}")
        else:
            self.send_response(200)
        if server.what != "unknown":
            self.send_header("Content-Length", str(end + 1 - start))
        if server.mark:
            self.send_header("ETag", f'"{file.stat().st_mtime_ns}"')
        self.end_headers()
        if with_content:
            with file.open("rb") as opened:
                opened.seek(start)
                self._send(opened.read(end + 1 - start))

    def _send(self, content: bytes) -> None:
        server = self.server
        if server.what == "cut":
            server.what, content = "", content[: len(content) // 2]
        if server.what == "longer":
            content *= 10
        if server.what == "slow":
            for k in range(len(content)):
                self.wfile.write(content[k : k + 1])
                time.sleep(0.5)
        server.sent += len(content)
        self.wfile.write(content)

    def log_message(self, *_: Any) -> None:
        """Say nothing."""


@contextmanager
def web_server(folder: Path, *, parts: bool = True) -> Iterator[WebServer]:
    """Serve a folder."""
    server = WebServer(folder, parts=parts)
    threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True).start()
    try:
        yield server
    finally:
        server.shutdown()
        server.server_close()
