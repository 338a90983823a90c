"""A web server of files on 127.0.0.1 that understands ranges, and that can be unwell in the ways that servers are."""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path


class Web(ThreadingHTTPServer):
    """Serves a folder.

    Attributes:
        mood: "well"; "slow": every answer takes ``seconds``; "mute": requests are read and never answered; "busy": 503;
            "short": bodies end after half of the bytes they announce; "cut": files are shorter than they were;
            "whole": ranges are ignored, as by ``python -m http.server``.
        busy: how many more requests get a 503, whatever the mood. asked: requests so far.
    """

    request_queue_size = 128
    daemon_threads = True

    def __init__(self, folder: Path) -> None:
        self.folder, self.mood, self.seconds, self.busy, self.asked = folder, "well", 5.0, 0, 0
        self.closing = threading.Event()
        super().__init__(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self.server_port}"

    def handle_error(self, *what: object) -> None:
        """A client that hangs up is no news."""


class Handler(BaseHTTPRequestHandler):
    """Understands ``Range: bytes=a-b`` and ``bytes=-n``."""

    server: Web
    protocol_version = "HTTP/1.1"

    def answer(self, body: bool) -> None:
        web = self.server
        web.asked += 1
        mood = web.mood
        if mood == "mute":
            web.closing.wait(60)
            self.close_connection = True
            return
        if mood == "slow":
            web.closing.wait(web.seconds)
        if mood == "busy" or web.busy > 0:
            web.busy -= 1
            self.send_error(503)
            return
        path = web.folder / self.path.lstrip("/")
        if not path.is_file():
            self.send_error(404)
            return
        data = path.read_bytes()
        size = len(data)
        found = re.fullmatch(r"bytes=(\d*)-(\d*)", self.headers.get("Range", ""))
        if found and mood != "whole":
            first, last = found.groups()
            start, stop = (max(0, size - int(last)), size) if not first else (int(first), int(last or size - 1) + 1)
            stop = min(stop, size)
            if start >= size:
                self.send_error(416)
                return
            data = data[start:stop]
            if mood == "cut" and "/c/" in self.path and first:
                data = data[: len(data) // 2]
            self.send_response(206)
            self.send_header("Content-Range", f"bytes {start}-{start + len(data) - 1}/{size}")
        else:
            self.send_response(200)
        self.send_header("Accept-Ranges", "bytes")
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        if body:
            self.wfile.write(data[: len(data) // 2] if mood == "short" else data)
            self.close_connection = mood == "short"

    def do_GET(self) -> None:
        self.answer(True)

    def do_HEAD(self) -> None:
        self.answer(False)

    def log_message(self, *args: object) -> None:
        pass


@contextmanager
def serving(folder: Path) -> Iterator[Web]:
    """A server of a folder while the block runs."""
    web = Web(folder)
    threading.Thread(target=web.serve_forever, args=(0.05,), daemon=True).start()
    try:
        yield web
    finally:
        web.closing.set()
        web.shutdown()
        web.server_close()


def until(told: object, seconds: float = 30.0) -> bool:
    """Wait until a function says yes; whether it did so in time."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if told():  # type: ignore[operator]
            return True
        time.sleep(0.02)
    return False
