"""The codec *compact* for zarr-python, which finds it by its entry point wherever Orograph is installed."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from zarr.abc.codec import ArrayBytesCodec
from zarr.core.common import JSON, parse_named_configuration

from orograph.store import compact

if TYPE_CHECKING:
    from zarr.core.array_spec import ArraySpec
    from zarr.core.buffer import Buffer, NDBuffer


@dataclass(frozen=True)
class Compact(ArrayBytesCodec):
    """Chunks of two dimensions, of int32, as bytes."""

    is_fixed_size = False

    @classmethod
    def from_dict(cls, data: dict[str, JSON]) -> Compact:
        parse_named_configuration(data, compact.NAME, require_configuration=False)
        return cls()

    def to_dict(self) -> dict[str, JSON]:
        return {"name": compact.NAME, "configuration": {}}

    async def _decode_single(self, chunk_bytes: Buffer, chunk_spec: ArraySpec) -> NDBuffer:
        rows, cols = chunk_spec.shape
        found: Any = await asyncio.to_thread(compact.decompressed, chunk_bytes.to_bytes(), (rows, cols))
        return chunk_spec.prototype.nd_buffer.from_ndarray_like(found)

    async def _encode_single(self, chunk_array: NDBuffer, chunk_spec: ArraySpec) -> Buffer:
        data = await asyncio.to_thread(compact.compressed, np.asarray(chunk_array.as_ndarray_like(), np.int32))
        return chunk_spec.prototype.buffer.from_bytes(data)

    def compute_encoded_size(self, input_byte_length: int, _chunk_spec: ArraySpec) -> int:
        raise NotImplementedError  # it depends on the samples
