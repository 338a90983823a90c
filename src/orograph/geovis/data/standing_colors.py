"""Colours of what stands along lines and depths, and what they mean: values on their scale, paler where uncertain."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph.errors import UsageError
from orograph.geovis.data.dataset import Dataset
from orograph.geovis.data.priority import Priority
from orograph.geovis.data.scales import ColorScale, doubted
from orograph.geovis.data.signs import colored
from orograph.geovis.data.standing import PALER, key_of, scale_of
from orograph.geovis.data.standing_marks import MARKS
from orograph.geovis.keys import Legend

Array = NDArray[np.float64]

ITEMS = Priority(data=True)
"""The priority of what stands for single samples, such as those of a borehole: their own values."""


class Caption(NamedTuple):
    """The text on data in a legend.

    Attributes:
        name, unit, note: in words. classes: the names of values 0, 1, …; None: they are numbers.
    """

    name: str
    unit: str
    note: str
    classes: tuple[str, ...] | None = None


class Colored(NamedTuple):
    """Values as they are shown.

    Attributes:
        rgb: (n, 3) linear. legend: what they mean. u: (n,) uncertainties along their scale. sign: that shows them.
    """

    rgb: NDArray[np.float32]
    legend: Legend
    u: Array
    sign: str


def colors_of(
    dataset: Dataset, values: Array, sigma: Array | None, caption: Caption, marked: bool | None = None,
    priority: Priority = ITEMS,
) -> Colored:  # fmt: skip
    """Colours of values (n,), and their legend.

    Args:
        sigma: (n,) standard deviations; None: nothing is known.
        marked: whether signs that lie over them are the usual ones; None: there is no place for such.
        priority: of the data.

    Raises:
        UsageError: the sign of an uncertainty cannot be shown so.
    """
    scale = (
        ColorScale.of_classes(caption.classes, dataset.colormap) if caption.classes else
        scale_of(dataset, values, priority)
    )  # fmt: skip
    usual = "glyphs" if marked else "whiteness"
    sign = "none" if dataset.uncertainty is None else dataset.uncertainty.style or usual
    known = PALER if marked is None else (*MARKS, *PALER)
    if sign not in known:
        why = "they show values by colour, and nothing along which a bar could stand" if sign == "errorbars" else ""
        raise UsageError(
            f"The uncertainty of {dataset.style} cannot be shown by {sign}{': ' * bool(why)}{why}.",
            path=dataset.called, remedy=f"There are {', '.join(known)}.",
        )  # fmt: skip
    doubt = (0.0, 1.0)
    if sigma is not None and dataset.uncertainty is not None:
        doubt = dataset.uncertainty.range or doubted(sigma)
    u = np.zeros(len(values)) if sigma is None else np.clip((sigma - doubt[0]) / (doubt[1] - doubt[0]), 0, 1)
    legend = key_of(dataset, caption.name, values, scale, caption.unit, caption.note, sign, doubt, caption.classes)
    return Colored(colored(values, u, scale, sign), legend, u, sign if sigma is not None else "none")
