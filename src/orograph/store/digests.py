"""The link between a shard, its store and its place: a label in the shard, whose digest the store's root lists.

The checksum of a chunk proves its contents, not that it belongs where it lies. So between its last chunk and its index,
a shard has a *label* (``docs/store.md`` has the layout): the checksums of its chunks, and its key. The root lists the
digest of label and index. A shard that was swapped with another, or comes from another store, is therefore detected
when its index is first read, and a chunk of another shard when the chunk is read. The label contains neither paths nor
times: equal samples give equal bytes.
"""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

Spot = tuple[int, int]

SIZE = 12
"""Bytes of a digest: 16 characters of base64."""

MAGIC = b"oro\x03"
ABSENT = np.uint64(2**64 - 1)
UNKNOWN = bytes(SIZE)
ENTRY = 16
CRC = 4


def crc32c(data: bytes | NDArray[np.uint8], before: int = 0) -> int:
    """The checksum of Zarr's crc32c codec for these data, appended to data with the checksum ``before``."""
    import google_crc32c

    return int(google_crc32c.extend(before, data))


def digest_of(data: bytes) -> bytes:
    return hashlib.blake2b(data, digest_size=SIZE).digest()


def sealed(key: str, index: NDArray[np.uint64], sums: NDArray[np.uint32]) -> tuple[bytes, bytes]:
    """Return the end of a shard, after its last chunk, and the shard's digest.

    Args:
        key: the shard's key.
        index: (chunks, 2) offset and length of each chunk, ``ABSENT`` if it is not written.
        sums: (chunks,) their checksums, 0 if they are not written.
    """
    table = index.astype("<u8").tobytes()
    name = key.encode()
    label = sums.astype("<u4").tobytes() + name + len(name).to_bytes(2, "little") + MAGIC
    check = crc32c(label + table).to_bytes(CRC, "little")
    end = b"".join([label, check, table, crc32c(table).to_bytes(CRC, "little")])
    return end, digest_of(end)


def tail_length(key: str, chunks: int) -> int:
    """Bytes of a shard after its last chunk."""
    return CRC * chunks + len(key.encode()) + 2 + len(MAGIC) + CRC + ENTRY * chunks + CRC


def unsealed(tail: bytes, key: str, chunks: int, listed: bytes) -> list[tuple[int, int, int]]:
    """(offset, length, crc32c) of each chunk of a shard in C order, length 0 for those that are not written.

    Args:
        tail: the last ``tail_length`` bytes of the shard.
        key: the place where the shard lies.
        chunks: the number of chunks in a shard.
        listed: the digest that the root lists for that place.

    Raises:
        ValueError: the shard is damaged, or does not belong there; the message says which.
    """
    if digest_of(tail) != listed:
        raise ValueError(_cause(tail, key, chunks))
    sums = np.frombuffer(tail, "<u4", chunks).tolist()
    pairs = np.frombuffer(tail, "<u8", 2 * chunks, len(tail) - ENTRY * chunks - CRC).reshape(-1, 2).tolist()
    absent = int(ABSENT)
    return [(0, 0, 0) if at == absent else (at, size, check) for (at, size), check in zip(pairs, sums, strict=True)]


def _cause(tail: bytes, key: str, chunks: int) -> str:
    """Why the end of a shard differs from what the root lists."""
    split = len(tail) - ENTRY * chunks - CRC
    if split < 0 or crc32c(tail[split:-CRC]) != int.from_bytes(tail[-CRC:], "little"):
        return "its index fails its checksum"
    end = split - CRC - len(MAGIC)
    if end < 2 or tail[end : end + len(MAGIC)] != MAGIC:
        return "it has no label, so something other than Orograph has written it"
    length = int.from_bytes(tail[end - 2 : end], "little")
    start = end - 2 - length - CRC * chunks
    name = tail[max(end - 2 - length, 0) : end - 2].decode(errors="replace")
    whole = tail[start : split - CRC] + tail[split:-CRC]
    if start >= 0 and crc32c(whole) != int.from_bytes(tail[split - CRC : split], "little"):
        return "its label fails its checksum, or is that of another shard"
    if name != key:
        return f"it is the shard {name}, of this store or another"
    return "it belongs to another store, or to another version of this one"


class Digests:
    """The expected contents of all objects of a store: digests of the shards of arrays, and of all other objects.

    Safe for writing from any number of threads, each for different shards.

    Args:
        listed: path of an array → digests of its shards in C order; key of another object → its digest.
        keyed: whether objects lie under keys that end with their digests (``place``), so that several versions of a
            store can share one place.
    """

    def __init__(self, listed: Mapping[str, bytes | bytearray] | None = None, keyed: bool = False) -> None:
        self.keyed = keyed
        self.listed: dict[str, bytearray] = {path: bytearray(data) for path, data in (listed or {}).items()}

    def put(self, path: str, shards: Spot, spot: Spot, digest: bytes) -> None:
        """Record the digest of a shard of an array that has ``shards`` along each axis."""
        whole = self.listed.setdefault(path, bytearray(SIZE * shards[0] * shards[1]))
        at = SIZE * (spot[0] * shards[1] + spot[1])
        whole[at : at + SIZE] = digest

    def get(self, path: str, shards: Spot, spot: Spot) -> bytes:
        """The digest of a shard; zeros, which no shard has, if it is not listed."""
        whole = self.listed.get(path, b"")
        at = SIZE * (spot[0] * shards[1] + spot[1])
        return bytes(whole[at : at + SIZE]) or UNKNOWN

    def place(self, key: str, digest: bytes) -> str:
        """The key under which an object with this digest is stored."""
        return f"{key}.{digest.hex()}" if self.keyed else key

    def of(self, paths: Iterable[str]) -> dict[str, bytes]:
        """The digests listed for these arrays and objects."""
        return {path: bytes(self.listed[path]) for path in paths if path in self.listed}

    def joined(self, others: Digests) -> Digests:
        """These digests, updated with others."""
        both = Digests(keyed=self.keyed)
        both.listed = {**self.listed, **others.listed}
        return both

    def to_json(self) -> dict[str, str]:
        return {path: base64.b64encode(data).decode() for path, data in self.listed.items()}

    @classmethod
    def from_json(cls, listed: Mapping[str, str], keyed: bool = False) -> Digests:
        return cls({path: base64.b64decode(data) for path, data in listed.items()}, keyed)
