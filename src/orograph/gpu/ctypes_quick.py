"""Names of C types looked up quickly: wgpu asks cffi for hundreds, and cffi reads a thousand typedefs for each.

wgpu-py describes calls to the GPU by C structures named in text (``ffi.new("WGPUBufferDescriptor *")``). The first time
that cffi meets such a text it has pycparser read it, together with a ``typedef`` line for every name of wgpu's header
(cffi's ``cparser.Parser._parse`` notes that this could be done better): 20 ms each, more than a second until a window
shows its first frame. Only names that occur in the text matter to how it is read, so ``quicken`` shows the parser only
those: 0.2 ms. Nothing else changes; where cffi is built otherwise than expected, nothing is done.
"""

from __future__ import annotations

import re
from typing import Any

_WORD = re.compile(r"[A-Za-z_]\w*")


def quicken(ffi: Any) -> bool:
    """Have an ``ffi`` read names of types quickly; whether it does. A second time changes nothing."""
    parser = getattr(ffi, "_parser", None)
    parse = getattr(parser, "_parse", None)
    if parser is None or not callable(parse) or not isinstance(getattr(parser, "_declarations", None), dict):
        return False
    if getattr(parse, "quick", False):
        return True

    def quick(text: str) -> Any:
        """Parse with the typedefs of the names in the text only; callers hold the ffi's lock."""
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


def quicken_wgpu() -> bool:
    """``quicken`` wgpu's, if it is there; whether it was."""
    try:
        from wgpu.backends.wgpu_native import ffi
    except ImportError:
        return False
    return quicken(ffi)
