"""The position of the sun: a given direction, or the real sun at a time and place.

The sun's declination and the equation of time are NOAA's (Meeus, *Astronomical Algorithms*, 1998, ch. 25, without
nutation's small terms), computed by the library ``astral``; from there a rotation leads to the sky of any place, the
poles included: within 0.02° of the Solar Position Algorithm (SPA: Reda & Andreas 2004), 0.003° on average, at 300
random moments and places of 2000–2080.
Altitudes are *apparent*: lifted by the refraction of a standard atmosphere at sea level (Sæmundsson 1986, as in the
SPA: 0.48° for a sun geometrically on the horizon, 0.09° at 10°), because light arrives from where the sun appears.

The real sun's azimuth counts from *true* north. A terrain's grid has its own north, which differs by the convergence of
the meridians (up to some degrees in a UTM zone, any angle in a polar projection): a moment's sun is rotated by it. A
sun given by hand counts from grid north, like every other azimuth. A terrain has one sun, that of its middle: 50 km
from there the true one is off by up to 0.5°.

Units: degrees; azimuth clockwise from north towards the sun; altitude above the horizon.
"""

from __future__ import annotations

import datetime
import math
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pyproj import CRS

from orograph._named import named
from orograph.errors import UsageError
from orograph.geo.grid import Grid

Array = NDArray[np.float64]

DIAMETER = 0.53
"""Mean diameter of the sun's disc, degrees (0.524 in July, 0.542 in January)."""

_EARTH = 6378137.0
_STEP = 100.0
"""Length of the step on the ellipsoid that gives an azimuth's direction on the grid, metres."""


MONTHS = ("Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec")


@named("A sun")
@dataclass(frozen=True, slots=True)
class Sun:
    """A distant disc of light.

    Attributes:
        azimuth: degrees clockwise from grid north, towards the sun.
        altitude: degrees above the horizon, apparent.
        diameter: degrees.
        when: the moment for which it was computed; None: none. Suns that differ only in this are equal.
    """

    azimuth: float = 315.0
    altitude: float = 45.0
    diameter: float = DIAMETER
    when: datetime.datetime | None = field(default=None, compare=False)

    def __post_init__(self) -> None:
        if not math.isfinite(self.azimuth):
            raise UsageError(f"The sun's azimuth must be an angle in degrees, not {self.azimuth:g}.")
        if not -90 <= self.altitude <= 90:
            raise UsageError(f"The sun's altitude must be between −90 and 90 degrees, not {self.altitude:g}.")
        if not 0 <= self.diameter < 90:
            raise UsageError(f"The sun's diameter must be an angle in degrees, not {self.diameter:g}.")

    @property
    def words(self) -> str:
        """Its position and time, for people: "21 Sep 2026 18:30 −06:00, sun 263°, 11.2° high"."""
        high = f"{abs(round(self.altitude, 1)):g}° {'high' if round(self.altitude, 1) >= 0 else 'below the horizon'}"
        if self.when is None:
            return f"Light from {round(self.azimuth, 1):g}°, {high}"
        zone = self.when.strftime("%z")  # ±hhmm, and seconds of historical zones
        offset = f"{zone[:3]}:{zone[3:5]}".replace("-", "−") if self.when.utcoffset() else "UTC"
        day = f"{self.when.day} {MONTHS[self.when.month - 1]} {self.when.year}"
        return f"{day} {self.when:%H:%M} {offset}, sun {round(self.azimuth) % 360}°, {high}"

    @property
    def direction(self) -> tuple[float, float, float]:
        """Unit vector (east, north, up) towards the sun."""
        a, h = math.radians(self.azimuth), math.radians(self.altitude)
        return math.sin(a) * math.cos(h), math.cos(a) * math.cos(h), math.sin(h)


@dataclass(frozen=True, slots=True)
class Placed:
    """A sun given by hand: the same everywhere; azimuth from grid north."""

    azimuth: float
    altitude: float

    def over(self, grid: Grid) -> Sun:
        return Sun(self.azimuth, self.altitude)


@dataclass(frozen=True, slots=True)
class Moment:
    """The real sun at a time with a time zone."""

    when: datetime.datetime

    def over(self, grid: Grid) -> Sun:
        azimuth, altitude = position(self.when, *place(grid))
        return Sun(grid_azimuth(grid, azimuth), altitude, when=self.when)


@dataclass(frozen=True, slots=True)
class Passage:
    """The real sun from one moment to a later one, as in a film.

    Raises:
        UsageError: the end is not after the beginning.
    """

    begin: Moment
    end: Moment

    def __post_init__(self) -> None:
        if not self.end.when > self.begin.when:
            raise UsageError(
                f"The sun's passage ends at {self.end.when.isoformat()}, which is not after its beginning, "
                f"{self.begin.when.isoformat()}."
            )

    def at(self, share: float) -> Moment:
        """The moment after a share of it, 0 to 1, in the time zone of its beginning."""
        return Moment(self.begin.when + share * (self.end.when.astimezone(self.begin.when.tzinfo) - self.begin.when))

    def __str__(self) -> str:
        return f"{self.begin.when.isoformat()}..{self.end.when.isoformat()}"


def passage(given: object) -> Passage | None:
    """A passage from any of its forms; None if it is something else.

    Args:
        given: text ``A..B``, two times with their zones (``2026-10-15T06:30-07:00..2026-10-15T18:00-07:00``, or
            ``…..18:00`` for the same day and zone), two such times or datetimes, or a ``Passage``.

    Raises:
        UsageError: one of two is no time with a zone, or they are in the wrong order.
    """
    if isinstance(given, Passage):
        return given
    if isinstance(given, str) and ".." in given:
        first, _, last = (part.strip() for part in given.partition(".."))
        begin = _moment(first)
        try:
            clock = datetime.time.fromisoformat(last)
        except ValueError:
            return Passage(begin, _moment(last))
        clock = clock if clock.tzinfo is not None else clock.replace(tzinfo=begin.when.tzinfo)
        return Passage(begin, Moment(datetime.datetime.combine(begin.when.date(), clock)))
    if isinstance(given, tuple | list) and len(given) == 2:
        ends = [_moment(one) if isinstance(one, str) else Moment(_zoned(one)) for one in given
                if isinstance(one, str | datetime.datetime)]  # fmt: skip
        if len(ends) == 2:
            return Passage(*ends)
    return None


def _moment(text: str) -> Moment:
    found = None if "," in text else parse(text)
    if not isinstance(found, Moment):
        raise UsageError(
            f"{text!r} is not a time.",
            remedy="A moving sun is A..B, two times with their zones: 2026-10-15T06:30-07:00..2026-10-15T18:00-07:00.",
        )
    return found


def parse(text: str) -> Placed | Moment:
    """Read ``"AZ,ALT"`` in degrees or an ISO 8601 time with its zone (``2026-06-21T12:00+02:00``, ``…Z``).

    Raises:
        UsageError: it is neither, the time has no zone, or an angle is out of range.
    """
    if ".." in text:
        raise UsageError(
            f"{text!r} is a sun that moves, but this has one sun.",
            remedy=f'Give one time; for a film of the moving sun use orograph movie, which takes "{text}".',
        )
    parts = text.split(",")
    if len(parts) == 2:
        try:
            azimuth, altitude = (float(p) for p in parts)
        except ValueError:
            raise UsageError(f"{text!r} is not a sun: write AZIMUTH,ALTITUDE in degrees, like 315,45.") from None
        Sun(azimuth, altitude)  # checks the angles
        return Placed(azimuth, altitude)
    try:
        when = datetime.datetime.fromisoformat(text.strip())
    except ValueError:
        raise UsageError(
            f"{text!r} is not a sun: write AZIMUTH,ALTITUDE in degrees (315,45) "
            "or a time with its zone (2026-06-21T12:00+02:00)."
        ) from None
    return Moment(_zoned(when))


Given = Sun | Placed | Moment | datetime.datetime | str | tuple[float, float]
"""The forms of a sun (see ``sun_of``)."""


def sun_of(given: Given, grid: Grid) -> Sun:
    """The sun over a terrain, from any of its forms.

    Args:
        given: a ``Sun``; (azimuth, altitude) in degrees; a datetime with its zone; or text as for ``parse``.
        grid: the terrain's, which gives the place for a moment's sun.

    Raises:
        UsageError: it is none of these, an angle is out of range, the time has no zone, or the grid no place on Earth.
    """
    if isinstance(given, Sun):
        return given
    if isinstance(given, str):
        given = parse(given)
    elif isinstance(given, datetime.datetime):
        given = Moment(_zoned(given))
    if isinstance(given, Placed | Moment):
        return given.over(grid)
    try:
        azimuth, altitude = (float(v) for v in given)
    except (TypeError, ValueError):
        raise UsageError(
            f"{given!r} is not a sun.",
            remedy="Give (azimuth, altitude) in degrees, a datetime with its zone, or a Sun.",
        ) from None
    return Sun(azimuth, altitude)


def _zoned(when: datetime.datetime) -> datetime.datetime:
    if when.utcoffset() is None:
        raise UsageError(
            f"{when.isoformat()} has no time zone, but the sun depends on it.",
            remedy=f"Add the offset from UTC: {when.isoformat()}+02:00, or Z for UTC.",
        )
    return when


def position(
    when: datetime.datetime, longitude: float, latitude: float, *, refraction: bool = True
) -> tuple[float, float]:
    """The sun's position in the sky at a place.

    Args:
        when: with a time zone.
        longitude, latitude: degrees, east and north.
        refraction: apparent altitude; else the geometric one.

    Returns:
        (azimuth from true north in [0, 360), altitude), degrees.

    Raises:
        UsageError: the time has no zone, or the place is none.
    """
    if not (abs(latitude) <= 90 and abs(longitude) <= 360):
        raise UsageError(f"There is no place at longitude {longitude:g}, latitude {latitude:g}.")
    declination, noon = _above(_zoned(when).astimezone(datetime.UTC))
    # The direction in the horizon's axes, which changes smoothly over the poles too.
    d, h, p = math.radians(declination), math.radians(longitude - noon), math.radians(latitude)
    east, south = -math.cos(d) * math.sin(h), math.sin(p) * math.cos(d) * math.cos(h) - math.cos(p) * math.sin(d)
    up = math.sin(p) * math.sin(d) + math.cos(p) * math.cos(d) * math.cos(h)
    azimuth, altitude = math.degrees(math.atan2(east, -south)), math.degrees(math.atan2(up, math.hypot(east, south)))
    return azimuth % 360.0, altitude + refracted(altitude) if refraction else altitude


def _above(when: datetime.datetime) -> tuple[float, float]:
    """(declination, longitude where it is noon), degrees, at a time in UTC."""
    from astral.julian import julianday, julianday_to_juliancentury
    from astral.sun import eq_of_time, sun_declination

    midnight = when.replace(hour=0, minute=0, second=0, microsecond=0)
    day = (when - midnight) / datetime.timedelta(days=1)
    century = julianday_to_juliancentury(julianday(midnight) + day)
    return sun_declination(century), 180.0 - 360.0 * day - eq_of_time(century) / 4.0


def refracted(altitude: float) -> float:
    """Degrees by which refraction lifts an object at a geometric altitude, at 1010 hPa and 10 °C (Sæmundsson 1986).

    Below −1°, where nothing is visible from level ground, the value at −1° is used.
    """
    h = max(altitude, -1.0)
    return max(1.02 / math.tan(math.radians(h + 10.3 / (h + 5.11))) / 60.0, 0.0)


def positions(times: Iterable[datetime.datetime], longitude: float, latitude: float) -> Array:
    """The sun at many times: (n, 3) float64, azimuth from true north, apparent and geometric altitude, in degrees."""
    found = []
    for when in times:
        azimuth, altitude = position(when, longitude, latitude, refraction=False)
        found.append((azimuth, altitude + refracted(altitude), altitude))
    return np.array(found, np.float64).reshape(-1, 3)


def place(grid: Grid) -> tuple[float, float]:
    """Longitude and latitude of a grid's middle, degrees.

    Raises:
        UsageError: the grid has no CRS, or is not on the Earth.
    """
    from orograph.geo.transform import transformer

    crs = _earthly(grid)
    x, y = grid.xy((grid.cols - 1) / 2, (grid.rows - 1) / 2)
    longitude, latitude = transformer(crs, crs.geodetic_crs)(x, y)
    if not (math.isfinite(float(longitude)) and math.isfinite(float(latitude))):
        raise UsageError(f"The middle of the terrain lies outside {crs.name}.")
    return float(longitude), float(latitude)


def _earthly(grid: Grid) -> CRS:
    crs = grid.crs
    if crs is None or crs.geodetic_crs is None:
        raise UsageError(
            "It is unknown where on Earth the terrain lies, so a time does not determine the sun's position.",
            remedy="Give the sun as azimuth,altitude, or the CRS with `assume_crs`.",
        )
    body = crs.geodetic_crs.ellipsoid
    if body is None or abs(body.semi_major_metre / _EARTH - 1.0) > 0.01:
        raise UsageError(
            f"{crs.name} is not on the Earth; the sun's position is known for the Earth only.",
            remedy="Give the sun as azimuth,altitude.",
        )
    return crs


def grid_azimuths(grid: Grid, azimuths: ArrayLike) -> Array:
    """Azimuths from grid north, in [0, 360), of directions (n,) given from true north at the grid's middle.

    A short step on the ellipsoid is projected, so this holds in projections that distort angles too.

    Raises:
        UsageError: as ``place``.
    """
    from orograph.geo.transform import transformer

    crs, true = _earthly(grid), np.asarray(azimuths, np.float64)
    if crs.is_geographic:  # degrees of longitude are shorter; the grid's north is true north
        return np.asarray(true % 360.0)
    geodetic = crs.geodetic_crs
    assert geodetic is not None
    geod = geodetic.get_geod()
    assert geod is not None
    longitude, latitude = (np.full(true.shape, v) for v in place(grid))
    step = np.full(true.shape, _STEP)
    ends = (geod.fwd(longitude, latitude, true + turn, step)[:2] for turn in (180.0, 0.0))
    (x0, y0), (x1, y1) = (transformer(geodetic, crs)(lon, lat) for lon, lat in ends)
    return np.asarray(np.degrees(np.arctan2(x1 - x0, y1 - y0)) % 360.0)


def grid_azimuth(grid: Grid, azimuth: float) -> float:
    """``grid_azimuths`` for one."""
    return float(grid_azimuths(grid, [azimuth])[0])
