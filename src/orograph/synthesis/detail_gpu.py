"""Detail beyond the data on the GPU: the same heights, to the bit, as ``refining`` and ``steered`` make on the CPU.

Tiles are made one by one and read back for all readers of the terrain. The slow parts run in shaders
(``synthesis.wgsl``, ``refining.wgsl``); guides, roughness and gains, which come from the few samples of the data, are
computed with NumPy.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.gpu.device import Device
from orograph.gpu.program import Program
from orograph.synthesis.exemplar import Exemplar
from orograph.synthesis.gpu import Steps
from orograph.synthesis.kernels import ORDER
from orograph.synthesis.refining import Fractal, Integers, Lattice, Spread
from orograph.synthesis.steered import TRIES, Guide, Steered, Steering
from orograph.synthesis.windows import Range

WIDEST = 1 << 15
"""Maximum samples along a side of an exemplar, so that a random place in its plane takes 32 bits."""


class FractalOnGpu(Fractal):
    """``Fractal`` on a device."""

    def __init__(self, device: Device, base: Lattice, doublings: int, level: int, seed: int) -> None:
        super().__init__(base, doublings, level, seed)
        self.device = device
        self._program = Program(device, "refining", FRACTAL=1)
        self._refine = self._program.compute("refine")
        self._steps = Steps(device, (1, 1))

    def refined(self, coarse: Integers, above: Range, r: Range) -> Integers:
        given = _given(self._steps, coarse, above, self.scale(r), self.shift)
        heights = self._steps.empty(r, 1)
        self._steps.dispatch(
            self._program, self._refine, r, given[0] | {"heights": heights}, given[1] | {"seed": self.salt}
        )
        return self.device.read_buffer(heights, np.int32).reshape(r.shape)


class SteeringOnGpu(Steering):
    """``Steering`` on a device.

    Raises:
        DeviceLimitError: the exemplar is too large for the device.
    """

    def __init__(
        self, device: Device, exemplar: Exemplar, data: Lattice, doublings: int, stretch: float, seed: int
    ) -> None:
        super().__init__(exemplar, data, doublings, stretch, seed)
        self.device, self.steps = device, Steps(device, exemplar.shape)
        program = self._program = Program(device, "synthesis", STEERED=1, TRIES=TRIES)
        self._begin, self._upsample, self._correct = (program.compute(n) for n in ("begin", "upsample", "correct"))
        self.raising = Program(device, "refining", STEERED=1)
        self.raise_ = self.raising.compute("refine")
        held, levels = self.steps.held, range(self.at(0), exemplar.top + 1)
        self._features = {n: held(exemplar.features[n]) for n in levels}
        self._similar = {n: held(exemplar.similar[n]) for n in levels}
        self._liked, self.fine = held(self.guides), held(exemplar.stack[-1])
        self._none = self.steps.empty(Range(0, 1, 0, 1), 3)

    def residual(self, level: int) -> Steered:
        return SteeredOnGpu(self, level)

    def _begun(self, r: Range, guide: Guide) -> Any:
        if max(self.exemplar.shape) >= WIDEST:
            return self.steps.held(super()._begun(r, guide))
        chosen = self.steps.empty(r, 2)
        self._place(self._begin, 0, r, None, chosen, self.steps.held(guide), seed=self.seed)
        return chosen

    def _upsampled(self, level: int, wide: Range) -> Any:
        parents, chosen = wide.parents(), self.steps.empty(wide, 2)
        self._place(
            self._upsample, level, wide, self.steps.held(self.coordinates(level - 1, parents)), chosen, None,
            row0=parents.row0, col0=parents.col0, from_width=parents.shape[1], seed=self.seed + 7919 * level,
        )  # fmt: skip
        return chosen

    def _corrected(self, level: int, wide: Range, chosen: Any, guide: Guide) -> NDArray[np.int32]:
        other, liked = self.steps.empty(wide, 2), self.steps.held(guide)
        for k, (row, col) in enumerate(ORDER):
            self._place(
                self._correct, level, wide, chosen, other, liked, kappa=1, inset=2 * (k + 1),
                even_row=(int(row) + wide.row0) & 1, even_col=(int(col) + wide.col0) & 1,
            )  # fmt: skip
            chosen, other = other, chosen
        return self.device.read_buffer(chosen, np.int32).reshape(*wide.shape, 2)

    def _place(self, pipeline: Any, level: int, r: Range, before: Any, chosen: Any, guide: Any, **values: int) -> None:
        """One step of coordinates; inputs that it does not read may be None."""
        n = self.at(level)
        resources = {
            "before": self._none if before is None else before, "chosen": chosen, "features": self._features[n],
            "similar": self._similar[n], "guide": self._none if guide is None else guide, "guides": self._liked,
        }  # fmt: skip
        self.steps.dispatch(self._program, pipeline, r, resources, {"step": self.exemplar.step(n), **values})


class SteeredOnGpu(Steered):
    """``Steered`` on a device."""

    steering: SteeringOnGpu

    def refined(self, coarse: Integers, above: Range, r: Range) -> Integers:
        s, steps = self.steering, self.steering.steps
        given = _given(steps, coarse, above, s.gain(r, self.level), s.shift)
        heights = steps.empty(r, 1)
        resources = {"heights": heights, "chosen": steps.held(s.coordinates(self.level, r)), "fine": s.fine}
        values = {"step": 1 << (s.doublings - self.level)}
        steps.dispatch(s.raising, s.raise_, r, given[0] | resources, given[1] | values)
        return s.device.read_buffer(heights, np.int32).reshape(r.shape)


def _given(
    steps: Steps, coarse: Integers, above: Range, scale: Spread, shift: int
) -> tuple[dict[str, Any], dict[str, int]]:
    """What every doubling needs: its resources, and its numbers."""
    own = scale.own
    numbers = {
        "row0": above.row0, "col0": above.col0, "from_width": above.shape[1], "doublings": scale.doublings,
        "shift": shift, "own_row0": own.row0, "own_col0": own.col0, "own_rows": own.shape[0],
        "own_cols": own.shape[1],
    }  # fmt: skip
    return {"coarse": steps.held(coarse), "scale": steps.held(scale.values)}, numbers
