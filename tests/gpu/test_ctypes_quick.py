"""Names of C types read quickly are the types that cffi reads slowly."""

from __future__ import annotations

import pytest

from orograph.gpu.ctypes_quick import quicken, quicken_wgpu

cffi = pytest.importorskip("cffi")

HEADER = """
typedef struct Inner { int a; float b[4]; } Inner;
typedef struct Outer { Inner inner; struct Outer * next; uint64_t bits; } Outer;
typedef enum Kind { Kind_One = 1, Kind_Two = 2, Kind_All = 0x7fffffff } Kind;
typedef uint32_t Flags;
typedef struct HandleImpl * Handle;
typedef void (*Callback)(Handle handle, Kind kind, char const * text, void * user);
void work(Outer const * outer, Flags flags);
"""
TEXTS = (
    "int", "uint64_t", "size_t *", "char[]", "Inner", "Inner *", "Outer[3]", "struct Outer *", "struct Inner", "Kind",
    "enum Kind", "Flags[]", "Handle", "Handle *", "Callback", "void(*)(Handle, Kind, char const *, void *)",
    "Inner (*)[2]", "unsigned long long", "void *", "const Outer *", "Outer *[5]", "int(*)(Outer *, Flags)",
)  # fmt: skip


def reader() -> object:
    ffi = cffi.FFI()
    ffi.cdef(HEADER)
    return ffi


@pytest.mark.parametrize("text", TEXTS)
def test_types_are_those_that_are_read_slowly(text):
    slow, quick = reader(), reader()
    assert quicken(quick)
    a, b = slow.typeof(text), quick.typeof(text)
    assert repr(a) == repr(b)
    assert a.kind == b.kind
    if text.isidentifier() or text.endswith("*"):
        assert slow.sizeof(text) == quick.sizeof(text)
    if a.kind == "struct":
        assert [(n, repr(f.type), f.offset) for n, f in a.fields] == [(n, repr(f.type), f.offset) for n, f in b.fields]


def test_what_is_unknown_is_refused_alike():
    slow, quick = reader(), reader()
    quicken(quick)
    for text in ("Nothing *", "Inner Outer", "struct", "Kind +"):
        told = []
        for ffi in (slow, quick):
            try:
                told.append(repr(ffi.typeof(text)))
            except Exception as error:
                told.append(type(error).__name__)
        assert told[0] == told[1], text


def test_more_can_be_declared_afterwards():
    ffi = reader()
    assert quicken(ffi)
    assert quicken(ffi)  # again: nothing is wrapped twice
    ffi.cdef("typedef struct Later { Outer outer; Flags flags; } Later;")
    assert ffi.new("Later *", {"flags": 7}).flags == 7


def test_only_names_in_the_text_are_shown_to_the_parser(monkeypatch):
    ffi = reader()
    asked = []
    real = ffi._parser._parse
    monkeypatch.setattr(ffi._parser, "_parse", lambda text: asked.append(set(ffi._parser._declarations)) or real(text))
    assert quicken(ffi)
    ffi.typeof("Inner *")
    assert asked == [{"typedef Inner"}]


def test_an_ffi_built_otherwise_is_left_alone():
    assert not quicken(object())


def test_wgpus_is_quickened():
    pytest.importorskip("wgpu")
    assert quicken_wgpu()
    from wgpu.backends.wgpu_native import ffi

    assert ffi._parser._parse.quick
    assert ffi.sizeof("WGPUBufferDescriptor") > 16
