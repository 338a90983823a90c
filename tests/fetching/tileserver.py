"""A server of tiles on 127.0.0.1, with ranges, ETags and the faults that servers have, for tests of fetching."""

from __future__ import annotations

import hashlib
import re
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer


class Tiles(ThreadingHTTPServer):
    """Serves bytes by path.

    Attributes:
        files: path (without the first slash) → bytes.
        faults: what befalls the next requests of any path: "429", "503", "cut" (half of the body), "slow" or "drop".
        always: path → a fault of each of its requests, or a code such as "404", "401".
        only_reads: faults befall only requests of more than one byte, GDAL's.
        asked: requests by path; sent: bytes of bodies by path; agents: User-Agents that came; at_once: most requests
        at one time.
    """

    daemon_threads = True
    request_queue_size = 128

    def __init__(self) -> None:
        self.files: dict[str, bytes] = {}
        self.faults: list[str] = []
        self.always: dict[str, str] = {}
        self.only_reads = False
        self.asked: Counter[str] = Counter()
        self.sent: Counter[str] = Counter()
        self.conditional: list[str] = []
        self.agents: set[str] = set()
        self.busy = self.at_once = 0
        self.lock = threading.Lock()
        super().__init__(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self.server_port}"

    def handle_error(self, *what: object) -> None:
        """A client that hangs up is no news."""

    @property
    def total(self) -> int:
        return sum(self.asked.values())


class Handler(BaseHTTPRequestHandler):
    server: Tiles
    protocol_version = "HTTP/1.1"

    def answer(self, body: bool) -> None:
        web, path = self.server, self.path.lstrip("/").partition("?")[0]
        wanted = re.fullmatch(r"bytes=(\d+)-(\d*)", self.headers.get("Range", ""))
        probe = wanted is not None and wanted[2] == wanted[1]
        with web.lock:
            web.asked[path] += 1
            web.agents.add(self.headers.get("User-Agent", ""))
            spared = probe and web.only_reads
            fault = "" if spared else web.always.get(path) or (web.faults.pop(0) if web.faults else "")
        if fault == "slow":
            time.sleep(0.5)
        if fault == "drop":
            self.close_connection = True
            return
        if fault.isdigit():
            self.send_response(int(fault))
            if fault == "429":
                self.send_header("Retry-After", "0")
            self.send_header("Content-Length", "0")
            self.end_headers()
            return
        data = web.files.get(path)
        if data is None:
            self.send_response(404)
            self.send_header("Content-Length", "0")
            self.end_headers()
            return
        etag = f'"{hashlib.md5(data).hexdigest()}"'
        if (since := self.headers.get("If-None-Match")) is not None:
            web.conditional.append(path)
            if since == etag:
                self.send_response(304)
                self.send_header("ETag", etag)
                self.end_headers()
                return
        size = len(data)
        if wanted:
            start, stop = int(wanted[1]), min(int(wanted[2] or size - 1) + 1, size)
            if start >= size:
                self.send_response(416)
                self.send_header("Content-Length", "0")
                self.end_headers()
                return
            data = data[start:stop]
            self.send_response(206)
            self.send_header("Content-Range", f"bytes {start}-{stop - 1}/{size}")
        else:
            self.send_response(200)
        self.send_header("ETag", etag)
        self.send_header("Accept-Ranges", "bytes")
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        if body:
            part = data[: len(data) // 2] if fault == "cut" else data
            self.wfile.write(part)
            web.sent[path] += len(part)
            if fault == "cut":
                self.close_connection = True

    def counted(self, body: bool) -> None:
        web = self.server
        with web.lock:
            web.busy += 1
            web.at_once = max(web.at_once, web.busy)
        try:
            self.answer(body)
        finally:
            with web.lock:
                web.busy -= 1

    def do_GET(self) -> None:
        self.counted(True)

    def do_HEAD(self) -> None:
        self.counted(False)

    def log_message(self, *args: object) -> None:
        pass


@contextmanager
def tiles() -> Iterator[Tiles]:
    """A server while the block runs."""
    web = Tiles()
    threading.Thread(target=web.serve_forever, args=(0.05,), daemon=True).start()
    try:
        yield web
    finally:
        web.shutdown()
        web.server_close()
