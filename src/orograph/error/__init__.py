"""Errors in object space and on the screen, and bounding volumes: arrays in, arrays out."""

from __future__ import annotations

from typing import Literal, get_args

ErrorKind = Literal["exact", "wedgie", "midpoint"]
"""The errors of diamonds, best first (see ``octaves``)."""

KINDS: tuple[ErrorKind, ...] = get_args(ErrorKind)
