"""Priorities of terrain, data and uncertainty: Dübel, Röhlig, Tominski & Schumann 2017, *Visualizing 3D terrain,
geo-spatial data, and uncertainty*, section 3.

Each of the three is prioritised (+) or not (−), independent of the others:

    T+  shaded relief                          T−  a line drawing: contours, silhouettes, creases, no shading
    D+  a continuous scale, single values      D−  aggregated: segments
    U+  extrinsic: signs of its own (glyphs)   U−  intrinsic: what the colour of the data loses (transparency, noise)

The intrinsic sign of a continuous scale is noise, that of segments transparency, as in figure 5 of the paper.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from orograph.errors import UsageError

SCENARIOS = {"overview": "T+D-U-", "approach": "T+D-U-", "overflight": "T-D+U-", "replanning": "T-D-U+"}
"""Names of the paper's scenarios (its section 4 and figure 5; take-off and approach, overflight, re-planning)."""


@dataclass(frozen=True, slots=True)
class Priority:
    """Which of the three comes first.

    Attributes:
        terrain, data, uncertainty: whether it is prioritised.
    """

    terrain: bool = True
    data: bool = False
    uncertainty: bool = False

    @classmethod
    def parse(cls, text: str) -> Priority:
        """``T+D-U-``, in any order, with or without spaces; what is left out is −. Or the name of a scenario.

        Raises:
            UsageError: the text is not that.
        """
        told = SCENARIOS.get(text.strip().lower(), text).replace("−", "-")
        marks = re.findall(r"([TDU])([+-])", re.sub(r"[\s,]", "", told).upper())
        letters = [letter for letter, _ in marks]
        if not marks or "".join(map("".join, marks)) != re.sub(r"[\s,]", "", told).upper() or len(set(letters)) < len(
            letters
        ):  # fmt: skip
            raise UsageError(
                f"A priority must be T, D and U, each with + or -, such as T+D-U-, or one of {', '.join(SCENARIOS)}; "
                f"not {text!r}."
            )
        said = {letter: sign == "+" for letter, sign in marks}
        return cls(said.get("T", False), said.get("D", False), said.get("U", False))

    def __str__(self) -> str:
        parts = zip("TDU", (self.terrain, self.data, self.uncertainty))
        return "".join(letter + ("+" if first else "-") for letter, first in parts)

    @property
    def style(self) -> str:
        """The style of data that have none of their own."""
        return "continuous" if self.data else "segmented"

    def sign(self, style: str) -> str:
        """The style of an uncertainty that has none of its own, of data in that style."""
        if self.uncertainty:
            return "glyphs"
        return "noise" if style == "continuous" else "transparency"
