"""Examples and tutorials run again when the package has changed, not only when they have.

Sphinx-Gallery runs a file again if the file itself has changed. What its code prints and draws follows from the package
as well: the table of methods, say.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

DOCS = Path(__file__).resolve().parents[1]
KEPT = DOCS / "made" / "package.txt"


def digest() -> str:
    """Of all that the package's code is."""
    found = hashlib.blake2b(digest_size=16)
    source = DOCS.parent / "src"
    for path in sorted(source.rglob("*")):
        if path.suffix in (".py", ".wgsl"):
            found.update(str(path.relative_to(source)).encode() + path.read_bytes())
    return found.hexdigest()


def is_stale() -> bool:
    """Whether what was made last was made by another package."""
    return not KEPT.exists() or KEPT.read_text() != digest()


def _keep(app: Any, failure: Exception | None) -> None:
    if failure is None:
        KEPT.parent.mkdir(exist_ok=True)
        KEPT.write_text(digest())


def setup(app: Any) -> dict[str, bool]:
    """Sphinx's hook."""
    app.connect("build-finished", _keep)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
