"""Ask a server about a tile: whether it exists, its size and state; politely, and with retries where they may help.

GDAL reads the samples (``reading``). One request of a single byte provides what it does not report: the status code and
the ETag. Accounts are those that GDAL uses too: ``~/.netrc`` (or ``$NETRC``), GDAL_HTTP_USERPWD, GDAL_HTTP_BEARER,
GDAL_HTTP_HEADERS.
"""

from __future__ import annotations

import base64
import http.client
import http.cookiejar
import importlib.metadata
import netrc
import os
import re
import time
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from email.utils import parsedate_to_datetime
from pathlib import Path
from typing import Any

from orograph.fetching.products import Product
from orograph.folders import temporary

PAUSES = [0.5, 2.0, 6.0]
"""Seconds before each retry."""

LONGEST = 60.0
"""Maximum seconds that a server may ask to wait."""

SILENCE = 30.0
"""Seconds without a byte after which a server counts as not answering."""

PASSING = {408, 425, 429, 500, 502, 503, 504}
"""Status codes after which a retry may succeed."""


@dataclass(frozen=True, slots=True)
class Answer:
    """A server's answer about a file.

    Attributes:
        code: of the answer; 0: no answer. etag, modified: its state. size: bytes, None if unknown.
        cause: the reason for no answer, or the meaning of the code.
    """

    code: int
    etag: str = ""
    modified: str = ""
    size: int | None = None
    cause: str = ""

    @property
    def there(self) -> bool:
        return self.code in (200, 206)

    @property
    def passing(self) -> bool:
        """Whether the error is transient, so that a retry may help."""
        return self.code == 0 or self.code in PASSING

    @property
    def state(self) -> tuple[str, str, int | None]:
        """The state of the file, which changes whenever the file does."""
        return self.etag, "" if self.etag else self.modified, self.size

    def __str__(self) -> str:
        return f"the server answers {self.code} ({self.cause})" if self.code else self.cause


def user_agent() -> str:
    """This program's name and version."""
    try:
        return f"orograph/{importlib.metadata.version('orograph')}"
    except importlib.metadata.PackageNotFoundError:
        return "orograph"


def public(url: str) -> str:
    """A URL without user, password and query."""
    return re.sub(r"://[^/@]*@", "://", url).partition("?")[0]


def ask(url: str, *, etag: str = "", modified: str = "", again: bool = True) -> Answer:
    """Ask for the first byte of a file; given its known state, ask whether that is still valid (code 304).

    Args:
        again: retry where that may help, after ``PAUSES`` or when the server permits.
    """
    for pause in [*(PAUSES if again else []), None]:
        answer, wait = _ask(url, etag, modified)
        if pause is None or not answer.passing:
            return answer
        time.sleep(min(max(pause, wait), LONGEST))
    raise AssertionError


def _ask(url: str, etag: str, modified: str) -> tuple[Answer, float]:
    """An answer, and the seconds that the server asks to wait."""
    plain = re.sub(r"://([^/@]*)@", "://", url)
    request = urllib.request.Request(plain, headers={"User-Agent": user_agent(), "Range": "bytes=0-0"})
    for name, value in _authorization(urllib.parse.urlsplit(url)).items():
        request.add_unredirected_header(name, value)
    if etag:
        request.add_header("If-None-Match", etag)
    elif modified:
        request.add_header("If-Modified-Since", modified)
    try:
        with _opener().open(request, timeout=SILENCE) as found:
            return _of(found.status, found.headers), 0.0
    except urllib.error.HTTPError as error:
        with error:
            return Answer(error.code, cause=error.reason or "no reason given"), _wait(error.headers)
    except urllib.error.URLError as error:
        return Answer(0, cause=_cause(error.reason)), 0.0
    except (OSError, http.client.HTTPException) as error:
        return Answer(0, cause=_cause(error)), 0.0


def _of(code: int, headers: Any) -> Answer:
    total = re.fullmatch(r"bytes \d+-\d+/(\d+)", headers.get("Content-Range", ""))
    length = headers.get("Content-Length", "")
    size = int(total[1]) if total else int(length) if code == 200 and length.isdigit() else None
    return Answer(code, headers.get("ETag", ""), headers.get("Last-Modified", ""), size, "it is there")


def _wait(headers: Any) -> float:
    text = headers.get("Retry-After", "") if headers is not None else ""
    if text.isdigit():
        return float(text)
    try:
        return max(0.0, parsedate_to_datetime(text).timestamp() - time.time())
    except (TypeError, ValueError):
        return 0.0


def _cause(reason: object) -> str:
    if isinstance(reason, TimeoutError):
        return f"the server does not answer ({SILENCE:g} s without a byte)"
    text = getattr(reason, "strerror", None) or str(reason) or type(reason).__name__
    return f"there is no connection ({text})"


def _authorization(url: urllib.parse.SplitResult) -> dict[str, str]:
    """The headers from GDAL's settings, or the user and the password of a URL."""
    headers = {}
    for line in re.split(r"\r?\n|\\r\\n|,(?=[\w-]+:)", os.environ.get("GDAL_HTTP_HEADERS", "")):
        name, colon, value = line.partition(":")
        if colon:
            headers[name.strip()] = value.strip()
    if bearer := os.environ.get("GDAL_HTTP_BEARER"):
        headers["Authorization"] = f"Bearer {bearer}"
    elif login := _login(url) or os.environ.get("GDAL_HTTP_USERPWD"):
        headers["Authorization"] = "Basic " + base64.b64encode(login.encode()).decode()
    return headers


def _login(url: urllib.parse.SplitResult) -> str:
    """NAME:PASSWORD of a URL, "" if it has none."""
    name, password = (urllib.parse.unquote(part or "") for part in (url.username, url.password))
    return f"{name}:{password}" if name else ""


class _Netrc(urllib.request.HTTPPasswordMgrWithDefaultRealm):
    """Passwords of ``~/.netrc`` by host."""

    def find_user_password(self, realm: Any, authuri: str) -> tuple[str | None, str | None]:
        host = urllib.parse.urlsplit(authuri if "://" in authuri else f"//{authuri}").hostname or ""
        try:
            found = netrc.netrc(_netrc_file()).authenticators(host)
        except (OSError, netrc.NetrcParseError):
            found = None
        return (found[0], found[2]) if found else (None, None)


def _netrc_file() -> str:
    return os.environ.get("GDAL_HTTP_NETRC_FILE") or os.environ.get("NETRC") or str(Path.home() / ".netrc")


def _opener() -> urllib.request.OpenerDirector:
    cookies = urllib.request.HTTPCookieProcessor(http.cookiejar.CookieJar())
    return urllib.request.build_opener(cookies, urllib.request.HTTPBasicAuthHandler(_Netrc()))


@contextmanager
def gdal_settings(product: Product) -> Iterator[dict[str, Any]]:
    """GDAL's settings for reading from a server; those in the environment take precedence."""
    with temporary() as folder:
        settings: dict[str, Any] = {
            "GDAL_HTTP_USERAGENT": user_agent(),
            "GDAL_HTTP_CONNECTTIMEOUT": SILENCE,
            "GDAL_HTTP_LOW_SPEED_TIME": max(1, round(SILENCE)),
            "GDAL_HTTP_LOW_SPEED_LIMIT": 1,
            "GDAL_DISABLE_READDIR_ON_OPEN": "EMPTY_DIR",  # a tile has no companion files
            "GDAL_INGESTED_BYTES_AT_OPEN": 65536,  # all directories of a COG
            "CPL_VSIL_CURL_NON_CACHED": f"/vsicurl/{product.base}",  # retry after a first failure
        }
        if Path(_netrc_file()).is_file():
            settings["GDAL_HTTP_NETRC_FILE"] = _netrc_file()
        if product.account:  # a login leads through several servers
            jar = Path(folder) / "cookies"
            settings |= {"GDAL_HTTP_COOKIEFILE": str(jar), "GDAL_HTTP_COOKIEJAR": str(jar)}
            if os.environ.get("GDAL_HTTP_BEARER"):
                settings["GDAL_HTTP_AUTH"] = "BEARER"
        yield {name: value for name, value in settings.items() if name not in os.environ}
