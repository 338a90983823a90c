"""Windows by example on the GPU: the same places and heights, to the bit, as ``windows.Endless`` makes on the CPU."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.gpu.device import Device
from orograph.gpu.program import Program
from orograph.synthesis.exemplar import Integers
from orograph.synthesis.kernels import order
from orograph.synthesis.windows import Endless, Range

_FIELDS = (
    "top", "left", "height", "width", "row0", "col0", "from_width", "rows", "cols", "step", "reach", "seed", "kappa",
    "even_row", "even_col", "inset", "doublings", "shift", "own_row0", "own_col0", "own_rows", "own_cols",
)  # fmt: skip
"""The fields of ``Run`` in ``shaders/synthesis_plane.wgsl``."""


class Steps:
    """Runs steps on a device in the order of the calls.

    Args:
        shape: of the exemplar.
    """

    def __init__(self, device: Device, shape: tuple[int, int]) -> None:
        self.device, self.shape = device, shape

    def dispatch(
        self, program: Program, pipeline: Any, r: Range, resources: dict[str, Any], values: dict[str, int]
    ) -> None:
        """Run a step for every place of a window.

        Args:
            resources: of the program, except ``run``, which is made from ``values``, the window and the exemplar.
        """
        rows, cols = self.shape
        values = values | {
            "top": r.row0, "left": r.col0, "height": r.shape[0], "width": r.shape[1], "rows": rows, "cols": cols
        }  # fmt: skip
        run = np.array([values.get(name, 0) for name in _FIELDS], np.int64).astype(np.int32)  # seeds wrap around
        group = program.bind({"run": self.device.buffer(run, "UNIFORM"), **resources})
        encoder = self.device.handle.create_command_encoder()
        step = encoder.begin_compute_pass()
        step.set_pipeline(pipeline)
        step.set_bind_group(0, group)
        step.dispatch_workgroups(-(-r.shape[1] // 8), -(-r.shape[0] // 8))
        step.end()
        self.device.queue.submit([encoder.finish()])

    def held(self, values: NDArray[Any]) -> Any:
        """A buffer with these integers."""
        return self.device.buffer(np.ascontiguousarray(values, np.int32), "STORAGE | COPY_SRC", "an example of terrain")

    def empty(self, r: Range, channels: int) -> Any:
        """A buffer for some integers per place of a window."""
        return self.device.buffer(4 * channels * r.shape[0] * r.shape[1], "STORAGE | COPY_SRC", "a window by example")


class EndlessOnGpu:
    """Windows of an endless terrain, made on a device.

    Args:
        endless: the terrain. device: makes it.

    Raises:
        DeviceLimitError: the exemplar is too large for the device.
    """

    def __init__(self, endless: Endless, device: Device) -> None:
        self.endless, self.device = endless, device
        self._steps = Steps(device, endless.exemplar.shape)
        self._places, self._heights = Program(device, "synthesis"), Program(device, "synthesis_heights")
        self._upsample, self._correct = (self._places.compute(name) for name in ("upsample", "correct"))
        self._begin, self._raise = (self._heights.compute(name) for name in ("begin", "raise"))
        self._stack = [self._steps.held(h) for h in endless.exemplar.stack]
        self._features = [self._steps.held(f) for f in endless.exemplar.features]
        self._similar = [self._steps.held(s) for s in endless.exemplar.similar]

    def coordinates(self, window: Range, level: int | None = None) -> NDArray[np.int32]:
        """See ``Endless.coordinates``."""
        level = self.endless.check(level)
        *_, (_, places, _) = self._levels(window, level, lambda *_: None)
        return self.device.read_buffer(places, np.int32).reshape(*window.shape, 2)

    def heights(self, window: Range, level: int | None = None) -> Integers:
        """See ``Endless.heights``."""
        level = self.endless.check(level)
        *_, (_, _, heights) = self._levels(window, level, self._raised)
        return self.device.read_buffer(heights, np.int32).reshape(window.shape)

    def _levels(self, window: Range, level: int, raised: Callable[..., Any]) -> list[tuple[Range, Any, Any]]:
        """Range, coordinates and heights of each level."""
        e, endless = self.endless.exemplar, self.endless
        ranges = endless.ranges(window, level)
        first = self._steps.held(endless.first(ranges[0]))
        found = [(ranges[0], first, raised(0, ranges[0], first, None, None))]
        for n in range(1, level + 1):
            above, places, heights = found[-1]
            wide = ranges[n].wider(endless.margin(n))
            one, other = self._steps.empty(wide, 2), self._steps.empty(wide, 2)
            common = {"step": e.step(n), "kappa": endless.kappa}
            self._placed(self._upsample, wide, places, one, n, **common, reach=endless.reach[n],
                         seed=endless.seed + 7919 * n, row0=above.row0, col0=above.col0,
                         from_width=above.shape[1])  # fmt: skip
            for k, (row, col) in enumerate(order(endless.passes[n])):
                self._placed(self._correct, wide, one, other, n, **common, inset=2 * (k + 1),
                             even_row=(int(row) + wide.row0) & 1, even_col=(int(col) + wide.col0) & 1)  # fmt: skip
                one, other = other, one
            inner = self._cropped(one, wide, ranges[n])
            found.append((ranges[n], inner, raised(n, ranges[n], inner, above, heights)))
        return found

    def _placed(self, pipeline: Any, r: Range, before: Any, chosen: Any, level: int, **values: int) -> None:
        resources = {"before": before, "chosen": chosen, "features": self._features[level],
                     "similar": self._similar[level]}  # fmt: skip
        self._steps.dispatch(self._places, pipeline, r, resources, values)

    def _raised(self, level: int, r: Range, chosen: Any, above: Range | None, coarse: Any) -> Any:
        out = self._steps.empty(r, 1)
        resources = {
            "chosen": chosen, "finer": self._stack[level], "heights": out,
            "coarser": self._stack[max(level - 1, 0)], "coarse": coarse or self._steps.held(np.zeros(1)),
        }  # fmt: skip
        values = {"step": self.endless.exemplar.step(level)}
        if above is not None:
            values |= {"row0": above.row0, "col0": above.col0, "from_width": above.shape[1]}
        self._steps.dispatch(self._heights, self._raise if level else self._begin, r, resources, values)
        return out

    def _cropped(self, places: Any, wide: Range, inner: Range) -> Any:
        """Coordinates of the inner range, row by row."""
        out, encoder = self._steps.empty(inner, 2), self.device.handle.create_command_encoder()
        rows, cols = inner.within(wide)
        width = 8 * inner.shape[1]
        for i in range(inner.shape[0]):
            start = 8 * ((rows.start + i) * wide.shape[1] + cols.start)
            encoder.copy_buffer_to_buffer(places, start, out, width * i, width)
        self.device.queue.submit([encoder.finish()])
        return out
