"""Energy of sun and sky on the ground over a day, a month or a year, under a cloudless sky, in Wh/m².

Bands: ``direct`` (the beam, with shadows, on the inclined ground), ``diffuse`` (the sky's light: uniform over the sky
that is seen, so the clear sky's on level ground times the sky-view factor of the inclined surface, Dozier & Frew 1990,
eq. 7b) and ``global``, their sum. Light from other ground is not in them. The clear sky is that of ``clearsky``.

The suns of all moments (one per time step, of the real sun over the terrain's middle) are gathered before the terrain
is looked at. With n the ground's normal and s, E the sun's direction and strength, what reaches a sample is

    Σ E (n · s)  over suns above its horizon  =  n · Σ E s,

so each azimuth needs one table: the vector Σ E s of all its suns above an altitude, which one lookup with the horizon's
angle turns into the energy from that azimuth, however many moments went in. Suns between two azimuths count for both in
proportion; the disc (0.53°) is in the tables, and so is the height of the ground, over which they are interpolated.
As many horizons are swept as there are azimuths, each once.

A period is a year (2026), a month (2026-06) or a day (2026-06-21), from midnight to midnight in mean solar time at the
terrain's middle.
"""

from __future__ import annotations

import datetime
import math
import re
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orograph._numba import inlined, kernel
from orograph.errors import UsageError
from orograph.geo.grid import Grid
from orograph.lighting.clearsky import beam, diffuse, extraterrestrial
from orograph.lighting.context import Context, Options, Values
from orograph.lighting.gather import Sweep, Window, by_azimuth
from orograph.lighting.products import Product, compute
from orograph.lighting.sun import DIAMETER, grid_azimuths, place, positions
from orograph.lighting.sweep_lines import direction

Array = NDArray[np.float64]

BANDS = ["direct", "diffuse", "global"]
TURBIDITY = 3.0
STEP = 10.0
"""Minutes."""

FINE = 0.05
"""Degrees of altitude between the entries of a table."""
LOWEST = -1.0
"""Degrees: the altitude of a table's first entry."""
COUNT = round((90.0 - LOWEST) / FINE) + 1
_LAYER = 500.0
"""Metres between the heights for which tables are made; the beam is interpolated between them (error below 2e-4)."""


def period(text: str) -> tuple[datetime.datetime, datetime.datetime]:
    """The first moment and the end of "2026", "2026-06" or "2026-06-21", without zone.

    Raises:
        UsageError: it is none of these.
    """
    found = re.fullmatch(r"(\d{4})(?:-(\d\d)(?:-(\d\d))?)?", text.strip())
    try:
        if found is None:
            raise ValueError
        year, month, day = (int(p) if p else None for p in found.groups())
        begin = datetime.datetime(year or 0, month or 1, day or 1)
        if day:
            return begin, begin + datetime.timedelta(days=1)
        if month:
            return begin, datetime.datetime(begin.year + (month == 12), month % 12 + 1, 1)
        return begin, datetime.datetime(begin.year + 1, 1, 1)
    except ValueError:
        raise UsageError(
            f"{text!r} is not a period: write a year (2026), a month (2026-06) or a day (2026-06-21)."
        ) from None


def _checked(date: str, step: float, turbidity: float) -> tuple[datetime.datetime, datetime.datetime]:
    begin, end = period(date)
    if not 0 < step <= 60:
        raise UsageError(f"A time step is more than 0 and at most 60 minutes, not {step:g}.")
    if not 0 <= turbidity <= 20:
        raise UsageError(f"Linke's turbidity lies between 0 (no air) and 20, not {turbidity:g}.")
    return begin, end


def asked(options: Options, what: str) -> tuple[str, float, float]:
    """Period, step and turbidity of a product's options.

    Args:
        what: the product, for the message.

    Raises:
        UsageError: there is no period, or one of them makes no sense.
    """
    more = options.more
    if "date" not in more:
        raise UsageError(f"{what} is over a period.", remedy='Give a year, a month or a day (`date="2026-06-21"`).')
    found = str(more["date"]), float(more.get("step", STEP)), float(more.get("turbidity", TURBIDITY))
    _checked(*found)
    return found


@dataclass(frozen=True, slots=True)
class Suns:
    """The suns of a period, those with some of the disc above the horizon.

    Attributes:
        azimuth: (n,) degrees from grid north. altitude: (n,) apparent. normal: (n,) W/m² outside the atmosphere.
        hours: that each represents.
        sky: Wh/m² of diffuse light on level, open ground, over the whole period.
        turbidity: Linke's T.
    """

    azimuth: Array
    altitude: Array
    normal: Array
    hours: float
    sky: float
    turbidity: float

    @classmethod
    def over(cls, grid: Grid, date: str, step: float = STEP, turbidity: float = TURBIDITY) -> Suns:
        """The suns over a terrain's middle, one in the middle of every ``step`` minutes.

        Raises:
            UsageError: the period, step or turbidity is none, or it is not known where on Earth the terrain lies.
        """
        begin, end = _checked(date, step, turbidity)
        try:
            longitude, latitude = place(grid)
        except UsageError as error:
            raise UsageError(
                error.what,
                remedy="The sun's path is that over a place on Earth: give data with a CRS there (`assume_crs`).",
            ) from None
        zone = datetime.timezone(datetime.timedelta(minutes=round(4 * longitude)))
        minutes = (end - begin).total_seconds() / 60
        count = math.ceil(minutes / step)
        step = minutes / count
        first = begin.replace(tzinfo=zone)
        times = [first + datetime.timedelta(minutes=(k + 0.5) * step) for k in range(count)]
        table = positions(times, longitude, latitude)
        normal = np.array([extraterrestrial(t) for t in times])
        sky = float(diffuse(normal, table[:, 2], turbidity).sum()) * step / 60
        seen = table[:, 1] > -DIAMETER / 2
        azimuth = grid_azimuths(grid, table[seen, 0]) if seen.any() else np.empty(0)
        return cls(azimuth, table[seen, 1], normal[seen], step / 60, sky, turbidity)

    def tables(self, azimuths: int, low: float, high: float) -> tuple[NDArray[np.float32], Array]:
        """Σ E s of the suns above an altitude, by azimuth and height of the ground.

        Args:
            azimuths: how many, evenly spread from north. low, high: heights of the ground, metres.

        Returns:
            (azimuths, heights, altitudes, 3) float32, Wh/m² east, north and up; the heights (h,), metres.
        """
        layers = np.linspace(low, high, max(2, math.ceil((high - low) / _LAYER) + 1))
        a, h = np.radians(self.azimuth), np.radians(self.altitude)
        sun = np.stack([np.sin(a) * np.cos(h), np.cos(a) * np.cos(h), np.sin(h)])
        mass = np.zeros((azimuths, len(layers), COUNT, 3))
        for layer, height in enumerate(layers):
            energy = beam(self.normal, self.altitude, height, self.turbidity) * self.hours
            for c in range(3):
                self._spread(energy * sun[c], mass[:, layer, :, c])
        return _above(mass).astype(np.float32), layers

    def hours_above(self, azimuths: int) -> NDArray[np.float32]:
        """Hours in which suns stand above an altitude, by azimuth.

        Args:
            azimuths: how many, evenly spread from north.

        Returns: (azimuths, altitudes) float32.
        """
        mass = np.zeros((azimuths, COUNT, 1))
        self._spread(np.full(len(self.azimuth), self.hours), mass[..., 0])
        return np.ascontiguousarray(_above(mass)[..., 0], np.float32)

    def _spread(self, amounts: Array, table: Array) -> None:
        """Add each sun's amount (n,) to the entries around it in a table (azimuths, altitudes), linearly."""
        azimuths = len(table)
        place_az = (self.azimuth % 360.0) * (azimuths / 360.0)
        place_alt = np.clip((self.altitude - LOWEST) / FINE, 0.0, COUNT - 1.001)
        k, j = np.floor(place_az).astype(np.int64), np.floor(place_alt).astype(np.int64)
        f, g = place_az - k, place_alt - j
        for dk, u in ((0, 1 - f), (1, f)):
            for dj, v in ((0, 1 - g), (1, g)):
                np.add.at(table, ((k + dk) % azimuths, j + dj), amounts * u * v)


def _above(mass: Array) -> Array:
    """The part above each altitude of discs with masses: (…, altitudes, 3), float64."""
    from orograph.lighting.shade import disc_fraction

    reach = math.ceil(DIAMETER / 2 / FINE)
    count = mass.shape[-2]
    # Beyond the disc's reach a mass counts fully; within it, by the part of the disc that is above.
    whole = np.cumsum(mass[..., ::-1, :], axis=-2)[..., ::-1, :]
    out = np.zeros_like(mass)
    out[..., : count - reach - 1, :] = whole[..., reach + 1 :, :]
    for d in range(-reach, reach + 1):
        share = float(disc_fraction(0.0, d * FINE, DIAMETER))
        out[..., max(-d, 0) : count - max(d, 0), :] += share * mass[..., max(d, 0) : count + min(d, 0), :]
    return out


@inlined
def _open(c: float, nz: float, t: float) -> float:
    """∫ ⟨ω, n⟩ cos θ dθ from the elevation of tangent t to the zenith; the normal's parts c (level), nz (up)."""
    square = 1.0 / (1.0 + t * t)
    part: float = 0.5 * (nz * square + c * (0.5 * np.pi - np.arctan(t) - t * square))
    return part


@kernel
def _add(
    slope: Values, heights: Values, gx: Values, gy: Values, toward: tuple[float, float], table: Values,
    layers: tuple[float, float], shine: bool, row0: int, col0: int, out: Values,
) -> None:  # fmt: skip
    """Add one azimuth's direct energy to ``out[0]`` and its part of the sky to ``out[1]``.

    slope, heights, gx, gy: (rows, cols) of the window at (row0, col0) of out. toward: the azimuth's unit vector,
    east and north. table: (heights, altitudes, 3); layers: the first height and the next ones' distance, metres.
    shine: whether any sun stands in this azimuth.
    """
    (east, north), (low, spacing), most, count = toward, layers, table.shape[0], table.shape[1]
    for i in range(slope.shape[0]):
        for j in range(slope.shape[1]):
            g, h = np.float64(gx[i, j]), np.float64(gy[i, j])
            t = max(np.float64(slope[i, j]), g * east + h * north)  # a slope hides the sky behind it
            if t != t:
                out[0, i + row0, j + col0] = out[1, i + row0, j + col0] = np.nan
                continue
            nz = 1.0 / np.sqrt(1.0 + g * g + h * h)
            out[1, i + row0, j + col0] += np.float32(2.0 * _open(-(g * east + h * north) * nz, nz, t))
            if not shine:
                continue
            x = (np.degrees(np.arctan(t)) - LOWEST) / FINE
            k = min(np.int64(x), count - 2)
            f = x - k
            y = min(max((heights[i, j] - low) / spacing, 0.0), most - 1.0)
            m = min(np.int64(y), most - 2)
            u = y - m
            energy = 0.0
            for c in range(3):
                n = -g * nz if c == 0 else -h * nz if c == 1 else nz
                p = table[m, k, c] * (1.0 - f) + table[m, k + 1, c] * f
                q = table[m + 1, k, c] * (1.0 - f) + table[m + 1, k + 1, c] * f
                energy += n * (p * (1.0 - u) + q * u)
            out[0, i + row0, j + col0] += np.float32(max(energy, 0.0))


def make(context: Context) -> Sweep:
    """The product: ``date`` (needed), ``step`` (minutes, 10) and ``turbidity`` (Linke's, 3) among the other options."""
    options = context.options
    grid = context.terrain.grid
    suns = Suns.over(grid, *asked(options, "Insolation"))
    low, high = context.terrain.height_range
    if not math.isfinite(low):
        low = high = 0.0
    table, layers = suns.tables(options.azimuths, low, max(high, low + 1.0))
    spacing = float(layers[1] - layers[0])
    fan = options.directions()
    shine: NDArray[np.bool_] = np.asarray(table.any(axis=(1, 2, 3)))

    def add(out: Values, slopes: Values, gx: Values, gy: Values, row0: int, col0: int, index: int) -> None:
        heights = context.heights(row0, row0 + slopes.shape[0], col0, col0 + slopes.shape[1])
        _add(
            slopes, np.ascontiguousarray(heights), gx, gy, direction(fan[index]), table[index],
            (float(layers[0]), spacing), bool(shine[index]), row0, col0, out,
        )  # fmt: skip

    def finish(canvas: Values, window: Window) -> Values:
        direct, sky = canvas[:, window[0] : window[1], window[2] : window[3]]
        scattered = np.clip(sky / np.float32(options.azimuths), 0.0, 1.0) * np.float32(suns.sky)
        return np.stack([direct, scattered, direct + scattered])

    return Sweep(fan, 2, by_azimuth(context, add), finish)


def insolation(
    heights: ArrayLike,
    grid: Grid,
    date: str,
    *,
    azimuths: int = 64,
    step: float = STEP,
    turbidity: float = TURBIDITY,
    jobs: int | None = None,
) -> Values:
    """Direct, diffuse and global insolation of every sample over a period, Wh/m² (see the module).

    Args:
        heights: (rows, cols), metres, NaN where missing. grid: where on Earth they lie, in metres.
        date: "2026", "2026-06" or "2026-06-21".
        azimuths: how many horizons are swept. step: minutes between suns. turbidity: Linke's T.
        jobs: threads; None: all processors. The result does not depend on it.

    Returns:
        (3, rows, cols) float32; NaN where heights are.

    Raises:
        UsageError: the period, step, turbidity or grid is none that can be used.
    """
    from orograph.store.memory import MemoryTerrain

    options = Options(azimuths, more={"date": date, "step": step, "turbidity": turbidity})
    context = Context(MemoryTerrain(np.ascontiguousarray(heights, np.float32), grid, "heights"), options, jobs=jobs)
    return compute(context, "insolation")


def _check(options: Options) -> None:
    asked(options, "Insolation")


def _range(band: str, options: Options) -> dict[str, Any]:
    """The range of 8-bit files and stores: up to more than any ground on Earth receives, even without air.

    That is 13.5 kWh in a day (level ground at the South Pole in December), and 10 kWh a day on average over a year (a
    plane facing the equator).
    """
    begin, end = period(str(options.more.get("date", "2026-06-21")))
    days = (end - begin).days
    return {"byte": (0.0, (14_000.0 if days < 365 else 10_500.0) * days)}


PRODUCTS = [
    Product(
        "insolation",
        lambda options: BANDS,
        "Wh/m2",
        "Energy of sun and sky on the ground over a day, a month or a year, under a cloudless sky.",
        make,
        about=_range,
        check=_check,
    )
]
