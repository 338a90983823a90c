"""How buckets and web servers are reached and what their answers mean: obstore's clients and errors.

Credentials come from the environment, as for the clouds' own tools.
"""

from __future__ import annotations

import os
import re
from datetime import timedelta
from pathlib import Path
from typing import Any

from orograph.errors import StoreError, public

WEB = frozenset({"http", "https"})
BUSY = frozenset({408, 409, 425, 429, 500, 502, 503, 504})
"""HTTP statuses that mean "try again later"."""
SILENCE = 10.0
"""Seconds that a server may stay silent."""


def connected(base: str, scheme: str, options: dict[str, Any] | None, url: str, silence: float = SILENCE) -> Any:
    """obstore's client for a whole bucket or server.

    Args:
        silence: seconds that the server may stay silent.

    Raises:
        StoreError: obstore is not installed, or does not support this kind of address.
    """
    try:
        from obstore import store
        from obstore.exceptions import BaseError
    except ImportError as error:
        raise StoreError(
            "Buckets and the web are read with obstore, which is not installed.", path=url,
            remedy="pip install 'orograph[remote]'",
        ) from error  # fmt: skip
    given = dict(options or {})
    client = {
        "allow_http": True, "connect_timeout": f"{silence}s", "read_timeout": f"{silence}s",
        "timeout": "1h", **given.pop("client_options", {}),
    }  # fmt: skip
    more: dict[str, Any] = {
        "client_options": client, "retry_config": {"max_retries": 0, "retry_timeout": timedelta(seconds=1)},
    }  # fmt: skip
    try:
        if scheme in WEB:
            return store.HTTPStore(base, **more)
        if scheme in ("s3", "s3a"):
            given = {"checksum_algorithm": "sha256", **given}
            if os.environ.get("AWS_NO_SIGN_REQUEST", "").upper() in ("YES", "TRUE", "ON", "1"):
                given.setdefault("skip_signature", True)
            if (provider := _profile(given)) is not None:
                more["credential_provider"] = provider
        make: Any = store.from_url  # (typed by kinds of stores)
        return make(base, config=given, **more)
    except (BaseError, ValueError, TypeError) as error:
        why = public(" ".join(str(error).partition("Debug source")[0].split()))
        raise StoreError(f"This kind of address cannot be opened: {why}", path=url) from error


def _profile(given: dict[str, Any]) -> Any:
    """Amazon's own credential chain, where it uses profiles and single sign-on in ``~/.aws`` (by boto3); obstore knows
    all others."""
    said = {name.lower().removeprefix("aws_") for name in given}
    named = any(os.environ.get(f"AWS_{name}") for name in ("ACCESS_KEY_ID", "WEB_IDENTITY_TOKEN_FILE"))
    if named or said & {"access_key_id", "skip_signature"}:
        return None
    if not (os.environ.get("AWS_PROFILE") or (Path.home() / ".aws" / "credentials").is_file()):
        return None
    try:
        from obstore.auth.boto3 import Boto3CredentialProvider

        return Boto3CredentialProvider()
    except (ImportError, ValueError):
        return None


def status_of(text: str) -> int | None:
    """The HTTP status in obstore's message."""
    found = re.search(r"status code: (\d{3})", text)
    return int(found[1]) if found else None


def beyond(text: str) -> bool:
    """Whether an object ends before or within the requested range: it was truncated."""
    return status_of(text) == 416 or "UnexpectedRange" in text or "InvalidGetRange" in text


def passing(text: str, web: bool) -> bool:
    """Whether what failed may go well in a moment: the server is busy, or the connection broke. (To wait for a web
    server that is silent, or not there, is not worth a reader's time; a build of hours waits for its bucket.)"""
    status = status_of(text)
    if status is not None:
        return status in BUSY
    kind = re.search(r"kind: (Timeout|Connect|Interrupted|Request|Decode|Unknown)", text)
    return kind is not None and not (web and kind[1] in ("Timeout", "Connect"))
