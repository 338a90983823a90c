"""Fast look-up of C types from wgpu's header, which took half of the time until a window appears.

wgpu-py describes calls to the GPU by C structures named in text (``ffi.new("WGPUBufferDescriptor *")``), which cffi
parses with pycparser. Two steps are made faster, with the same results; if cffi is not built as expected, nothing is
changed:

- the first time a text occurs, it is parsed together with a ``typedef`` line for each of the header's thousand names
  (cffi's ``cparser.Parser._parse`` notes that this could be improved): 20 ms for each of a hundred texts. Only names
  that occur in the text affect how it is parsed; with those alone it takes 0.2 ms (``quicken``);
- the header itself is parsed at every start: 0.2 s. The result is kept in the cache folder, by the header's text and
  the versions of the parsers (``remembered``): 5 ms.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib
import io
import pickle
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

_WORD = re.compile(r"[A-Za-z_]\w*")
_LARGE = 10_000
"""Minimum characters of declarations that are worth storing."""


def quicken(ffi: Any) -> bool:
    """Let an ``ffi`` parse names of types fast; returns whether it does. A second call changes nothing."""
    parser = getattr(ffi, "_parser", None)
    parse = getattr(parser, "_parse", None)
    if parser is None or not callable(parse) or not isinstance(getattr(parser, "_declarations", None), dict):
        return False
    if getattr(parse, "quick", False):
        return True

    def quick(text: str) -> Any:
        """Parse with only the typedefs of the names in the text; callers hold the ffi's lock."""
        known = parser._declarations
        words = {f"typedef {word}" for word in _WORD.findall(text)}
        parser._declarations = {name: known[name] for name in words if name in known}
        try:
            return parse(text)
        finally:
            parser._declarations = known

    quick.quick = True  # type: ignore[attr-defined]
    parser._parse = quick
    return True


@contextlib.contextmanager
def remembered(folder: Path) -> Iterator[None]:
    """A context in which long declarations (``FFI.cdef``) come from a folder if they were parsed before."""
    cffi: Any = importlib.import_module("cffi")
    real = cffi.FFI.cdef

    def cdef(self: Any, csource: str, *args: Any, **options: Any) -> None:
        known = self._parser._declarations or self._parser._int_constants
        if known or args or options or not isinstance(csource, str) or len(csource) < _LARGE:
            real(self, csource, *args, **options)
            return
        path = folder / f"declarations-{_name(csource)}.pickle"
        found = _load(path)
        if found is None:
            real(self, csource)
            _keep(path, self._parser)
            return
        with self._lock:
            self._cdef_version = object()
            self._parser._declarations, self._parser._int_constants, self._parser._anonymous_counter = found
            self._cdefsources.append(csource)

    cffi.FFI.cdef = cdef
    try:
        yield
    finally:
        cffi.FFI.cdef = real


def _name(csource: str) -> str:
    """The key of stored declarations: their text, and the parsers."""
    versions = (str(importlib.import_module(name).__version__) for name in ("cffi", "pycparser"))
    readers = "\n".join((sys.version, sys.platform, *versions, ""))
    return hashlib.sha256((readers + csource).encode()).hexdigest()[:24]


def _constants() -> dict[str, Any]:
    """Types that cffi compares by identity: they are stored by name."""
    model = importlib.import_module("cffi.model")
    return {name: getattr(model, name) for name in ("void_type", "voidp_type", "char_array_type")}


def _load(path: Path) -> tuple[dict[str, Any], dict[str, int], int] | None:
    constants = _constants()

    class Reader(pickle.Unpickler):
        def persistent_load(self, name: str) -> Any:
            return constants[name]

    try:
        declarations, numbers, counter = Reader(io.BytesIO(path.read_bytes())).load()
    except Exception:  # missing, damaged or outdated: parse the header
        return None
    if not (isinstance(declarations, dict) and isinstance(numbers, dict) and isinstance(counter, int)):
        return None
    return declarations, numbers, counter


def _keep(path: Path, parser: Any) -> None:
    from orograph.output import Beside

    names = {id(value): name for name, value in _constants().items()}

    class Writer(pickle.Pickler):
        def persistent_id(self, value: Any) -> str | None:
            return names.get(id(value))

    with contextlib.suppress(Exception):  # the folder is not writable: parse the header again the next time
        out = io.BytesIO()
        Writer(out, 5).dump((parser._declarations, parser._int_constants, parser._anonymous_counter))
        path.parent.mkdir(parents=True, exist_ok=True)
        with Beside(path) as part:
            part.write_bytes(out.getvalue())


def quicken_wgpu() -> bool:
    """Load wgpu's library fast and let its types be parsed fast; returns whether it is installed."""
    try:
        if "wgpu.backends.wgpu_native" not in sys.modules:
            from orograph.folders import cache_folder

            with remembered(cache_folder()):
                importlib.import_module("wgpu.backends.wgpu_native")
        return quicken(importlib.import_module("wgpu.backends.wgpu_native").ffi)
    except (ImportError, AttributeError):
        return False
