"""The storage that a path or URL means: a folder, a bucket or web server, or anything else that fsspec reaches."""

from __future__ import annotations

import os
from typing import Any
from urllib.parse import unquote, urlsplit

from orograph.errors import UsageError
from orograph.store.bucket import SCHEMES, BucketStorage
from orograph.store.fsspec_storage import FsspecStorage
from orograph.store.storage import FolderStorage, Storage
from orograph.store.versions import folder_of, version_of


def storage_at(url: str | os.PathLike[str], options: dict[str, Any] | None = None) -> Storage:
    """Return the storage of a path, a ``file://`` URL, a bucket or web server, or any other address that fsspec knows.

    ``STORE@2`` is a version of a store (``versions``).
    """
    if not isinstance(url, str | os.PathLike):
        raise UsageError(
            f"A store must be a folder or a URL, not {type(url).__name__}.",
            remedy="Build one of it: `orograph.build(heights, 'area.oro')`.",
        )
    text = os.fspath(url)
    if text.startswith("file://"):
        from urllib.request import url2pathname  # late, for it loads what talks to servers

        return FolderStorage(url2pathname(unquote(urlsplit(text).path)))
    scheme, found, _ = text.partition("://")
    if scheme in SCHEMES:
        return version_of(BucketStorage(text, options))
    if found:
        return FsspecStorage(text, options)
    return FolderStorage(folder_of(text))
