"""The codecs *compact* and *smallest* for zarr-python, which finds them by their entry points."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from types import ModuleType
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from zarr.abc.codec import ArrayBytesCodec
from zarr.core.common import JSON, parse_named_configuration

from orograph.store import compact, smallest

if TYPE_CHECKING:
    from zarr.core.array_spec import ArraySpec
    from zarr.core.buffer import Buffer, NDBuffer


@dataclass(frozen=True)
class _Own(ArrayBytesCodec):
    """Encodes two-dimensional chunks of int32."""

    is_fixed_size = False
    module: ClassVar[ModuleType]

    @classmethod
    def from_dict(cls, data: dict[str, JSON]) -> Self:
        parse_named_configuration(data, cls.module.NAME, require_configuration=False)
        return cls()

    def to_dict(self) -> dict[str, JSON]:
        return {"name": self.module.NAME, "configuration": {}}

    async def _decode_single(self, chunk_bytes: Buffer, chunk_spec: ArraySpec) -> NDBuffer:
        rows, cols = chunk_spec.shape
        found: Any = await asyncio.to_thread(self.module.decompressed, chunk_bytes.to_bytes(), (rows, cols))
        return chunk_spec.prototype.nd_buffer.from_ndarray_like(found)

    async def _encode_single(self, chunk_array: NDBuffer, chunk_spec: ArraySpec) -> Buffer:
        data = await asyncio.to_thread(self.module.compressed, np.asarray(chunk_array.as_ndarray_like(), np.int32))
        return chunk_spec.prototype.buffer.from_bytes(data)

    def compute_encoded_size(self, input_byte_length: int, _chunk_spec: ArraySpec) -> int:
        raise NotImplementedError  # it depends on the samples


@dataclass(frozen=True)
class Compact(_Own):
    """``orograph.compact``."""

    module: ClassVar[ModuleType] = compact


@dataclass(frozen=True)
class Smallest(_Own):
    """``orograph.smallest``."""

    module: ClassVar[ModuleType] = smallest
