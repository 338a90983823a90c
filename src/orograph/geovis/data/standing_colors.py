"""Colours of what stands along lines and depths, and what they mean: values on their scale, paler where uncertain."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph.errors import UsageError
from orograph.geovis.data.dataset import Dataset
from orograph.geovis.data.scales import ColorScale, spanned
from orograph.geovis.data.signs import colored
from orograph.geovis.data.standing import key_of
from orograph.geovis.keys import Legend

Array = NDArray[np.float64]

SIGNS = ("saturation", "whiteness", "palette", "none")


class Told(NamedTuple):
    """The text on data in a legend.

    Attributes:
        name, unit, note: in words. classes: the names of values 0, 1, …; None: they are numbers.
    """

    name: str
    unit: str
    note: str
    classes: tuple[str, ...] | None = None


def colors_of(
    dataset: Dataset, values: Array, sigma: Array | None, told: Told
) -> tuple[NDArray[np.float32], Legend]:  # fmt: skip
    """Linear colours (n, 3) of values (n,), and their legend.

    Args:
        sigma: (n,) standard deviations; None: nothing is known.

    Raises:
        UsageError: the sign of an uncertainty cannot be shown so.
    """
    scale = (
        ColorScale.of_classes(told.classes, dataset.colormap) if told.classes else
        ColorScale.of(values, dataset.plain_colormap, dataset.range)
    )  # fmt: skip
    sign = "none" if dataset.uncertainty is None else dataset.uncertainty.style or "whiteness"
    if sign not in SIGNS:
        raise UsageError(
            f"The uncertainty of {dataset.style} cannot be shown by {sign}.", remedy=f"There are {', '.join(SIGNS)}."
        )
    doubt = (0.0, 1.0)
    if sigma is not None and dataset.uncertainty is not None:
        doubt = dataset.uncertainty.range or (0.0, spanned(sigma, None)[1])
    u = np.zeros(len(values)) if sigma is None else np.clip((sigma - doubt[0]) / (doubt[1] - doubt[0]), 0, 1)
    legend = key_of(dataset, told.name, scale, told.unit, told.note, sign, doubt, told.classes)
    return colored(values, u, scale, sign), legend
