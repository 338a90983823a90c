"""A server of tiles on 127.0.0.1, with ranges, ETags and the faults that servers have, for tests of fetching.

It is a process of its own: GDAL holds Python's lock in some calls that read from a server, which would wait for ever
for one in the same process.
"""

from __future__ import annotations

import hashlib
import json
import re
import subprocess
import sys
import threading
import time
import urllib.request
from collections import Counter
from collections.abc import Iterator, MutableMapping
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

CONTROL = "control-of-this-server"


class Files(MutableMapping[str, bytes]):
    """What is served: path (without the first slash) → bytes, in a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def __getitem__(self, path: str) -> bytes:
        return (self.folder / path).read_bytes()

    def __setitem__(self, path: str, data: bytes) -> None:
        file = self.folder / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(data)

    def __delitem__(self, path: str) -> None:
        (self.folder / path).unlink()

    def __iter__(self) -> Iterator[str]:
        return (f.relative_to(self.folder).as_posix() for f in self.folder.rglob("*") if f.is_file())

    def __len__(self) -> int:
        return sum(1 for _ in self)


class Tiles:
    """The server as tests see it.

    Attributes:
        files: what it serves. url: where it is.
    """

    def __init__(self, url: str, folder: Path) -> None:
        self.url, self.files = url, Files(folder)

    def set(self, **state: object) -> None:
        """Set its state, and count from 0.

        Args:
            faults: what befalls the next requests of any path: a code ("429"), "cut" (half of the body), "slow",
                "drop" (no answer), "login" (a password is asked for).
            always: path → the fault of each of its requests.
            only_reads: faults befall only requests of more than one byte, GDAL's.
        """
        state = {"faults": [], "always": {}, "only_reads": False, **state}
        request = urllib.request.Request(f"{self.url}/{CONTROL}", json.dumps(state).encode(), method="POST")
        urllib.request.urlopen(request).close()

    def _told(self, name: str) -> object:
        with urllib.request.urlopen(f"{self.url}/{CONTROL}") as answer:
            return json.load(answer)[name]

    @property
    def asked(self) -> Counter[str]:
        """Requests by path."""
        return Counter(self._told("asked"))

    @property
    def sent(self) -> int:
        """Bytes of bodies."""
        return self._told("sent")

    @property
    def conditional(self) -> list[str]:
        """Paths that were asked for with If-None-Match."""
        return self._told("conditional")

    @property
    def agents(self) -> set[str]:
        return set(self._told("agents"))

    @property
    def authorizations(self) -> set[str]:
        return set(self._told("authorizations"))

    @property
    def at_once(self) -> int:
        """The most requests at one time."""
        return self._told("at_once")

    @property
    def total(self) -> int:
        return sum(self.asked.values())


class Server(ThreadingHTTPServer):
    daemon_threads = True
    request_queue_size = 128

    def __init__(self, folder: Path) -> None:
        self.folder, self.lock, self.busy = folder, threading.Lock(), 0
        self.reset({"faults": [], "always": {}, "only_reads": False})
        super().__init__(("127.0.0.1", 0), Handler)

    def reset(self, state: dict) -> None:
        self.__dict__.update(state)
        self.asked, self.sent, self.at_once = Counter(), 0, 0
        self.conditional, self.agents, self.authorizations = [], set(), set()

    def handle_error(self, *what: object) -> None:
        """A client that hangs up is no news."""


class Handler(BaseHTTPRequestHandler):
    server: Server
    protocol_version = "HTTP/1.1"

    def answer(self, body: bool) -> None:
        web, path = self.server, self.path.lstrip("/").partition("?")[0]
        wanted = re.fullmatch(r"bytes=(\d+)-(\d*)", self.headers.get("Range", ""))
        probe = wanted is not None and wanted[2] == wanted[1]
        with web.lock:
            web.asked[path] += 1
            web.agents.add(self.headers.get("User-Agent", ""))
            web.authorizations.add(self.headers.get("Authorization", ""))
            spared = probe and web.only_reads
            fault = "" if spared else web.always.get(path) or (web.faults.pop(0) if web.faults else "")
        if fault == "slow":
            time.sleep(0.1)
        if fault == "drop":
            self.close_connection = True
            return
        if fault == "login" and not self.headers.get("Authorization"):
            self.send_response(401)
            self.send_header("WWW-Authenticate", 'Basic realm="tiles"')
            self.send_header("Content-Length", "0")
            self.end_headers()
            return
        if fault.isdigit():
            self.send_response(int(fault))
            if fault == "429":
                self.send_header("Retry-After", "0")
            self.send_header("Content-Length", "0")
            self.end_headers()
            return
        file = web.folder / path
        data = file.read_bytes() if file.is_file() else b""
        if not data:
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
            web.sent += len(part)
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
        web = self.server
        if self.path != f"/{CONTROL}":
            self.counted(True)
            return
        names = ("asked", "sent", "at_once", "conditional", "agents", "authorizations")
        told = {name: getattr(web, name) for name in names}
        self.reply(json.dumps(told, default=sorted).encode())

    def do_POST(self) -> None:
        self.server.reset(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
        self.reply(b"")

    def reply(self, body: bytes) -> None:
        self.send_response(200)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def do_HEAD(self) -> None:
        self.counted(False)

    def log_message(self, *args: object) -> None:
        pass


@contextmanager
def tiles(folder: Path) -> Iterator[Tiles]:
    """A server of a folder while the block runs."""
    process = subprocess.Popen([sys.executable, __file__, str(folder)], stdout=subprocess.PIPE, text=True)
    try:
        yield Tiles(process.stdout.readline().strip(), folder)
    finally:
        process.kill()
        process.wait()


if __name__ == "__main__":
    server = Server(Path(sys.argv[1]))
    print(f"http://127.0.0.1:{server.server_port}", flush=True)
    server.serve_forever()
