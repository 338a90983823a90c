"""Options of orientation aids, which show where floating objects are and how the view is turned.

Tory, Kirkpatrick, Atkins & Möller 2006 find that people judge positions in a 3D view well only with cues beside it;
these are cues within the picture. Units: true metres of height and of the ground.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, Literal

from orograph._named import named
from orograph.errors import UsageError
from orograph.scene.contours import round_number

if TYPE_CHECKING:
    from orograph.viewpoint import View

Step = float | Literal["auto"] | None

HOW = "aids are drops, shadows, poles[=METRES], grid[=METRES], walls and icon, separated by commas"

STEPPED = ("poles", "grid")

APART = 110.0
"""Approximate pixels between grid lines at the picture's middle, if no interval is given."""


@named("orograph.Aids")
@dataclass(frozen=True, slots=True)
class Aids:
    """The orientation aids to draw.

    Attributes:
        drops: lines from floating objects straight down to the ground. shadows: on the ground, straight below them.
        poles: ranging rods from the ground to floating objects, with alternating dark and orange bands of this many
            metres, counted from the ground; every fifth boundary has a plate. grid: lines of easting and northing laid
            on the ground, this many metres apart, with their values at the border. "auto": a round number; None: not
            drawn.
        walls: sections through the terrain's middle on walls around it, with its profile and the data's colours.
        icon: a cube in the furniture of a perspective that shows how the view is turned.

    Raises:
        UsageError: a step is no length.
    """

    drops: bool = False
    shadows: bool = False
    poles: Step = None
    grid: Step = None
    walls: bool = False
    icon: bool = False

    def __post_init__(self) -> None:
        for name in STEPPED:
            step = getattr(self, name)
            if not (step is None or step == "auto" or (not isinstance(step, str) and 0 < step < math.inf)):
                raise UsageError(f"The step of the aid {name} must be more than 0 metres, not {step}.")

    @classmethod
    def parse(cls, text: str) -> Aids:
        """Aids by their names.

        Raises:
            ValueError: there is no such aid, or a step is not a length.
        """
        found: dict[str, Any] = {}
        for part in text.split(","):
            name, equals, value = part.partition("=")
            if name not in {f.name for f in fields(cls)} or (equals and name not in STEPPED):
                raise ValueError(f"{HOW}, not {text!r}.")
            try:
                found[name] = (float(value) if equals and value != "auto" else "auto") if name in STEPPED else True
            except ValueError:
                raise ValueError(f"{value!r} is not a number of metres: {HOW}.") from None
        try:
            return cls(**found)
        except UsageError as error:
            raise ValueError(str(error)) from None

    @property
    def standing(self) -> bool:
        """Whether there are aids for floating objects."""
        return self.drops or self.shadows or self.poles is not None


def interval_of(aids: Aids | None, view: View) -> float | None:
    """Metres between grid lines in a picture; None: there is no grid."""
    if aids is None or aids.grid is None:
        return None
    return round_number(APART * view.whole.pixel_metres) if aids.grid == "auto" else float(aids.grid)


def aids_of(value: Any) -> Aids | None:
    """Aids in any form that users give: an ``Aids``, a text (``Aids.parse``), False or None.

    Raises:
        TypeError, ValueError: it is none of these.
    """
    if value is None or value is False:
        return None
    if isinstance(value, str):
        return Aids.parse(value)
    if not isinstance(value, Aids):
        raise TypeError(f"{HOW}, or an Aids")
    return value
