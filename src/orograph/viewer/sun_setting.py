"""Where the light of a window comes from: a sun placed by hand, or the real sun (``lighting.sun``) at a time and the
terrain's place.

A day can be played. Times are shown in a zone of whole hours from UTC, initially that of the place's longitude. Units:
degrees, seconds.
"""

from __future__ import annotations

import datetime
import math
from dataclasses import dataclass, field
from typing import Any, Literal

from orograph.errors import OrographError, UsageError
from orograph.lighting.sun import Moment, Sun, place, sun_of
from orograph.store.terrain import Terrain

DAY = 86_400.0
PLAY = 3600.0
"""Speed of a played day: seconds of the sun's time per second."""


@dataclass(slots=True)
class SunSetting:
    """Where the light comes from.

    Attributes:
        mode: "placed" (azimuth, altitude) or "moment" (when).
        azimuth, altitude: degrees, from grid north.
        when: a time in ``zone``.
        playing: whether time passes; ``speed``: seconds per second.
        place: (longitude, latitude) of the terrain's middle; None if only placed suns make sense.
        trouble: why there is no place.
    """

    mode: Literal["placed", "moment"] = "placed"
    azimuth: float = 315.0
    altitude: float = 45.0
    when: datetime.datetime = field(default_factory=lambda: datetime.datetime.now(datetime.UTC))
    playing: bool = False
    speed: float = PLAY
    place: tuple[float, float] | None = None
    trouble: str = ""

    @classmethod
    def over(cls, terrain: Terrain, given: Any = None) -> SunSetting:
        """The light for a terrain; ``given``: a sun as ``sun_of`` takes it."""
        light = cls()
        try:
            light.place = place(terrain.grid)
            light.zone = round(light.place[0] / 15.0)
            light.when = light.when.replace(hour=12, minute=0, second=0, microsecond=0)
        except OrographError as error:
            light.trouble = str(error)
        if isinstance(given, Moment):
            if light.place is None:
                raise UsageError(light.trouble)
            light.mode, light.when = "moment", given.when
        elif given is not None:
            sun = sun_of(given, terrain.grid)
            light.azimuth, light.altitude = sun.azimuth % 360.0, sun.altitude
        return light

    @property
    def zone(self) -> float:
        """Hours that ``when`` is ahead of UTC."""
        offset = self.when.utcoffset()
        return 0.0 if offset is None else offset.total_seconds() / 3600.0

    @zone.setter
    def zone(self, hours: float) -> None:
        self.when = self.when.astimezone(datetime.timezone(datetime.timedelta(hours=hours)))

    @property
    def hour(self) -> float:
        """Hours since midnight, in the zone."""
        w = self.when
        return w.hour + w.minute / 60.0 + w.second / 3600.0

    @hour.setter
    def hour(self, hours: float) -> None:
        minutes = min(max(round(hours * 60.0), 0), 24 * 60 - 1)
        self.when = self.when.replace(hour=minutes // 60, minute=minutes % 60, second=0, microsecond=0)

    @property
    def day(self) -> int:
        """Day of the year, from 1."""
        return self.when.timetuple().tm_yday

    @day.setter
    def day(self, number: int) -> None:
        first = self.when.replace(month=1, day=1)
        last = (first.replace(year=first.year + 1) - first).days
        self.when = first + datetime.timedelta(days=min(max(number, 1), last) - 1)

    def advance(self, seconds: float) -> bool:
        """Advance time; returns whether the light moved. A played day starts again at its end."""
        if not (self.playing and self.mode == "moment"):
            return False
        begin = self.when.replace(hour=0, minute=0, second=0, microsecond=0)
        gone = (self.when - begin).total_seconds() + seconds * self.speed
        self.when = begin + datetime.timedelta(seconds=math.fmod(gone, DAY))
        return True

    def sun(self, terrain: Terrain) -> Sun:
        """The sun over the terrain."""
        if self.mode == "moment" and self.place is not None:
            return Moment(self.when).over(terrain.grid)
        return Sun(self.azimuth, self.altitude)
