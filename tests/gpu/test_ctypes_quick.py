"""Names of C types read quickly are the types that cffi reads slowly."""

from __future__ import annotations

import pytest

from orograph.gpu.ctypes_quick import quicken, quicken_wgpu, remembered

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


def long_header() -> str:
    return HEADER + "\n".join(
        f"typedef struct S{k} {{ Outer o{k}; void * p; void (*f)(void); }} S{k};" for k in range(200)
    )


def same(a: object, b: object, names: list[str]) -> None:
    for name in names:
        text = name.partition(" ")[2]
        kind = name.partition(" ")[0]
        if kind == "typedef":
            x, y = a.typeof(text), b.typeof(text)
        elif kind in ("struct", "enum", "union"):
            x, y = a.typeof(name), b.typeof(name)
        else:
            continue
        assert repr(x) == repr(y)
        assert x.kind == y.kind
        if x.kind == "struct" and x.fields is not None:
            assert a.sizeof(x) == b.sizeof(y)
            assert [(n, repr(f.type), f.offset) for n, f in x.fields] == [
                (n, repr(f.type), f.offset) for n, f in y.fields
            ]
        elif x.kind == "enum":
            assert x.elements == y.elements


@pytest.mark.stress
def test_remembered_declarations_are_those_that_were_read(tmp_path):
    text = long_header()
    plain = cffi.FFI()
    plain.cdef(text)
    with remembered(tmp_path):
        first = cffi.FFI()
        first.cdef(text)
        (kept,) = tmp_path.iterdir()
        again = cffi.FFI()
        again.cdef(text)
        small = cffi.FFI()
        small.cdef(HEADER)
    assert again._parser._declarations is not first._parser._declarations
    assert list(tmp_path.iterdir()) == [kept]
    assert cffi.FFI.cdef.__name__ == "cdef"
    assert cffi.FFI.cdef.__module__ == "cffi.api"
    quicken(again)
    for ffi in (first, again):
        same(plain, ffi, list(plain._parser._declarations))
        assert ffi.typeof("void(*)(void)").args == ()
        assert ffi.new("S7 *", {"p": ffi.NULL}).p == ffi.NULL


def test_remembered_declarations_that_are_damaged_are_read_again(tmp_path):
    text = long_header()
    for damage in (b"", b"nonsense", b"\x80\x05K\x01."):
        with remembered(tmp_path):
            cffi.FFI().cdef(text)
            (kept,) = tmp_path.iterdir()
            kept.write_bytes(damage)
            ffi = cffi.FFI()
            ffi.cdef(text)
        assert ffi.sizeof("S3") > 40
        assert kept.read_bytes() != damage


def test_a_folder_that_cannot_be_written_is_no_hindrance(tmp_path):
    (tmp_path / "file").touch()
    with remembered(tmp_path / "file" / "folder"):
        ffi = cffi.FFI()
        ffi.cdef(long_header())
    assert ffi.sizeof("S3") > 40


def test_all_of_wgpus_header_is_remembered_as_it_is_read(tmp_path):
    wgpu = pytest.importorskip("wgpu.backends.wgpu_native._ffi")
    text = wgpu.get_wgpu_header()
    plain = cffi.FFI()
    plain.cdef(text)
    with remembered(tmp_path):
        for _ in range(2):
            ffi = cffi.FFI()
            ffi.cdef(text)
    quicken(plain)
    quicken(ffi)
    same(plain, ffi, list(plain._parser._declarations))
    assert plain._parser._int_constants == ffi._parser._int_constants
