"""An S3 server on 127.0.0.1 (moto), behind a layer that can be unwell in the ways that clouds are, that counts what it
is asked, and that lets one conditional write through at a time, as S3 does and moto does not promise to."""

from __future__ import annotations

import contextlib
import random
import threading
import time
import urllib.request
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

BUSY = [("Content-Type", "application/xml"), ("Content-Length", "0")]


class Bucket:
    """The WSGI application around moto's.

    Attributes:
        asked: requests by kind: "GET", "PUT", "HEAD", "DELETE", "POST", "LIST". sent, received: bytes of bodies.
        refuse: share of requests that get a 503. cut: share of answers that end half way, or are lost.
        slow: seconds that each answer takes. stale: whether listings are as old as the bucket, which was empty then.
        ignores: whether writes take place whatever their conditions.
        log: (kind, path, whether it had a condition) of all requests.
    """

    def __init__(self) -> None:
        from moto.server import DomainDispatcherApplication, create_backend_app

        self.app = DomainDispatcherApplication(create_backend_app)
        self.asked, self.sent, self.received = Counter[str](), 0, 0
        self.refuse, self.cut, self.slow, self.stale = 0.0, 0.0, 0.0, False
        self.log: list[tuple[str, str, bool]] = []
        self.ignores = False
        self.chance = random.Random(1)
        self.one = threading.RLock()
        self.url = ""

    def well(self) -> None:
        """No more faults, and count anew."""
        self.refuse, self.cut, self.slow, self.stale = 0.0, 0.0, 0.0, False
        self.asked.clear()
        self.log.clear()
        self.sent = self.received = 0

    def __call__(self, environ: dict[str, Any], start: Any) -> list[bytes]:
        method, path, query = environ["REQUEST_METHOD"], environ["PATH_INFO"], environ.get("QUERY_STRING", "")
        kind = "LIST" if method == "GET" and "list-type" in query else method
        condition = "HTTP_IF_NONE_MATCH" in environ or "HTTP_IF_MATCH" in environ
        with self.one:
            self.asked[kind] += 1
            self.log.append((kind, path, condition))
            self.received += int(environ.get("CONTENT_LENGTH") or 0)
            refused, cut = self.chance.random() < self.refuse, self.chance.random() < self.cut
        if kind == "LIST" and self.stale:
            environ["QUERY_STRING"] = "list-type=2&prefix=none%2Fof%2Fthese%2F"
        time.sleep(self.slow)
        if refused:
            start("503 Slow Down", BUSY)
            return [b""]
        if self.ignores:
            environ.pop("HTTP_IF_NONE_MATCH", None)
            environ.pop("HTTP_IF_MATCH", None)
        with self.one if condition or kind == "LIST" else contextlib.nullcontext():
            status, headers, body = self._answer(environ)
        self.sent += len(body)
        if cut:
            lost = len(body) // 2
            headers = [(k, v) for k, v in headers if k.lower() != "content-length"] + [
                ("Content-Length", str(len(body) or 9))
            ]
            start(status, headers)
            return [body[:lost]]
        start(status, headers)
        return [body]

    def _answer(self, environ: dict[str, Any]) -> tuple[str, list[tuple[str, str]], bytes]:
        said: list[Any] = []
        result = self.app(environ, lambda status, headers, *_: said.append((status, headers)))
        body = b"".join(result)
        if hasattr(result, "close"):
            result.close()
        return *said[0], body

    def put(self, path: str, data: bytes | None = None) -> None:
        """Make a bucket, or an object in one, directly."""
        kind = {"Content-Type": "application/octet-stream"}
        urllib.request.urlopen(
            urllib.request.Request(f"{self.url}/{path}", data, kind, method="PUT"), timeout=20
        ).close()


ENVIRONMENT = {"AWS_ACCESS_KEY_ID": "key-of-the-test", "AWS_SECRET_ACCESS_KEY": "secret-of-the-test"}


@contextmanager
def bucket_server() -> Iterator[Bucket]:
    """A server with the bucket ``terrain`` while the block runs."""
    import logging

    from werkzeug.serving import make_server

    logging.getLogger("werkzeug").setLevel(logging.CRITICAL)
    bucket = Bucket()
    server = make_server("127.0.0.1", 0, bucket, threaded=True)
    bucket.url = f"http://127.0.0.1:{server.server_port}"
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        bucket.put("terrain")
        bucket.well()
        yield bucket
    finally:
        server.shutdown()
        thread.join()
        server.server_close()
