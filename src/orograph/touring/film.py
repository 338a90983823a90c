"""A film: the frames of a tour over a terrain, drawn one by one by a backend, and written to a destination.

The seam to the backends is ``backends.Session``: a scene in, a finished picture out, with all of its tiles. The CPU
caster's session keeps data that frames share (``memo``); a frame does not depend on those drawn before it, so films can
be made in parts and resumed.

Units: seconds, pixels.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from orograph.errors import UsageError
from orograph.geovis.data.shared import Kept, sharing
from orograph.lighting.sun import Passage
from orograph.memo import Memo
from orograph.progress import SILENT, Progress
from orograph.rendering.backends import Session, session
from orograph.rendering.picture import Picture
from orograph.rendering.standing import extent_of
from orograph.scene.contours import Contours
from orograph.scene.flying import Flown
from orograph.scene.scene import Scene
from orograph.store.terrain import Terrain
from orograph.touring.course import Course, Grading
from orograph.touring.playing import Playing
from orograph.touring.tour import Tour

PACE, INSTANT = 3.0, 0.1
"""Minimum seconds over which scenarios of a flight change; half the seconds over which a camera's speed is measured."""

WAYPOINTS = 9
"""Places of a tour that the interval of contour lines must suit."""


class Film:
    """The frames of a tour.

    Args:
        tour: the camera, and its settings of light and scene.
        scene: everything else: its view gives the size, the tour the camera; if the tour sets no sun (or exaggeration,
            …), the scene's is used.
        draw: the backend; None: the CPU caster.
        fps: frames per second; None: the tour's.
        first, last: the part of the tour to film, seconds; None: from its beginning, to its end.
        playing: data that change during the film; the scene has those of the first frame; None: none change.
        progress: gets the progress of preparations.

    Attributes:
        numbers: of the frames to film, from 0 at the tour's beginning. given: the scene. kept: data that were read, for
            the next frames.

    Raises:
        UsageError: the part has no frame. NothingInViewError: the tour never shows the terrain.
    """

    def __init__(
        self, tour: Tour, scene: Scene, *, draw: Session | None = None, fps: float | None = None,
        first: float | None = None, last: float | None = None, playing: Playing | None = None,
        progress: Progress = SILENT,
    ) -> None:  # fmt: skip
        self.tour = replace(tour.resized(scene.view.width, scene.view.height), fps=tour.fps if fps is None else fps)
        self.base, self.given, self.draw = scene, scene, session() if draw is None else draw
        count = len(self.tour)
        begin = 0 if first is None else round(first * self.tour.fps)
        end = count if last is None else round(last * self.tour.fps)
        if not 0 <= begin < end <= count:
            what = f"{0 if first is None else first:g} to {self.tour.duration if last is None else last:g} s"
            raise UsageError(f"From {what} there are no frames: the tour takes {self.tour.duration:g} s, at "
                             f"{self.tour.fps:g} frames per second.")  # fmt: skip
        self.numbers = range(begin, end)
        self.course = Course(self.tour, scene.terrain, progress)
        self.playing, self.kept = playing, Kept()
        self._lines: dict[Contours, Contours] = {}
        self.base = self._lined(scene)
        self._shown: tuple[Any, Scene] = (None if playing is None else playing.key(0), self.base)
        graded = (scene.lighting.relief is None and "relief" not in self.tour.settings(0.0)) or (
            scene.lighting.sky and scene.lighting.depths is None
        )
        self.grading = Grading(self.course, self._scene, progress) if graded else None

    @classmethod
    def of(
        cls, tour: Tour, terrain: Terrain, size: tuple[int, int], options: Mapping[str, Any], *, draw: Session,
        fps: float | None, first: float | None, last: float | None, progress: Progress,
        again: Callable[..., Tour] | None = None, passage: Passage | None = None,
    ) -> Film:  # fmt: skip
        """The film of a tour over a terrain.

        Args:
            again: makes the tour, with further positions ``also`` (n, 3) to keep in view; None: its cameras are given.
            passage: of the sun over the whole tour; None: the tour's own, or none.
            size: (width, height) of its frames. options: of its scene, by name. Others: as of a film.

        Raises: as ``Scene.of`` and ``Playing.of``; a UsageError also as a film.
        """

        def lit(tour: Tour) -> Tour:
            return tour if passage is None else replace(tour, passage=passage)

        tour = lit(tour)
        moving = tour if fps is None else replace(tour, fps=fps)
        playing = Playing.of(options, terrain, len(moving), moving.fps)
        shown = options if playing is None else playing.at(playing.key(0), terrain.grid)
        scene = Scene.of(terrain, tour.keys[0].view.resized(*size), **shown)
        everything = scene
        if again is not None and playing is not None and any("trail_s" in fact for fact in playing.facts):
            everything = Scene.of(terrain, scene.view, **playing.widest(terrain.grid))
        if again is not None and (standing := extent_of(everything)) is not None:
            tour = lit(again(also=standing))
            scene = scene.but(view=tour.keys[0].view.resized(*size))
        made = cls(tour, scene, draw=draw, fps=fps, first=first, last=last, playing=playing, progress=progress)
        if playing is not None:
            playing.tell(progress)
        return made

    def __len__(self) -> int:
        return len(self.numbers)

    def scene(self, number: int) -> Scene:
        """The scene of a frame."""
        time = number / self.tour.fps
        scene = self._scene(time, self._base(number))
        if self.grading is None:
            return scene
        graded = self.grading.settings(time)
        return scene.but(
            relief=graded["relief"] if scene.lighting.relief is None else scene.lighting.relief,
            depths=graded["depths"] if scene.lighting.depths is None else scene.lighting.depths,
        )

    def picture(self, number: int) -> Picture:
        """A frame, drawn.

        Raises:
            NothingInViewError and others: as the backend's ``draw``; the frame's time is added to the message.
        """
        from orograph.errors import NothingInViewError

        try:
            return self.draw(self.scene(number))
        except NothingInViewError as error:
            raise NothingInViewError(
                f"At {number / self.tour.fps:.2f} s (frame {number}): {error.what}", path=error.path,
                remedy="Move the keys around that time, so that some of the terrain stays in view.",
            ) from error  # fmt: skip

    def fingerprint(self) -> str:
        """An identifier of every frame's content: of the tour, the scene's options and the terrain."""
        content = {"tour": self.tour.to_dict(), **self.base.summary()}
        if self.playing is not None:
            content["played"] = self.playing.data
        return hashlib.sha256(json.dumps(content, sort_keys=True, default=str).encode()).hexdigest()[:32]

    def _base(self, number: int) -> Scene:
        """The scene of a frame without its camera, with the tour's other settings."""
        if self.playing is None:
            return self.base
        key = self.playing.key(number)
        if key != self._shown[0]:
            with sharing(self.kept):
                made = Scene.of(self.base.terrain, self.base.view, **self.playing.at(key, self.base.terrain.grid))
            self._shown = key, self._lined(made)
        return self._shown[1]

    def _lined(self, scene: Scene) -> Scene:
        """A scene and its variants, with contour lines for a film.

        There is one interval for the whole film (the median of the suitable ones along the way); labels fade in and
        out.
        """
        variants = tuple(replace(one, scene=self._lined(one.scene)) for one in scene.variants)
        contours = scene.annotations.contours
        if contours is None:
            return replace(scene, variants=variants)
        if contours not in self._lines:
            memo = Memo()
            times = [self.tour.duration * k / (WAYPOINTS - 1) for k in range(WAYPOINTS)]
            suits = sorted(contours.fitted(scene.terrain, self.course.at(t), memo).interval or 1.0 for t in times)
            self._lines[contours] = replace(contours, interval=suits[WAYPOINTS // 2], fading=True)
        lined = replace(scene, annotations=replace(scene.annotations, contours=self._lines[contours]))
        return replace(lined, variants=variants)

    def _scene(self, time: float, base: Scene | None = None) -> Scene:
        base = self.base if base is None else base
        settings: dict[str, Any] = self.tour.settings(time)
        sun = self.tour.sun(time)
        if sun is not None:
            settings["sun"] = sun.over(base.terrain.grid)
        layers = self.tour.layers(time)
        if layers is not None:
            settings["layers"] = layers
        scene = base.but(view=self.course.at(time), **settings)
        if not any(isinstance(one.weight, Flown) for one in scene.variants):
            return scene
        flown = [one.weight for one in scene.variants if isinstance(one.weight, Flown)]
        shares = self._shares(time, flown[0])
        variants = (replace(one, weight=replace(weight, filmed=shares)) for one, weight in zip(scene.variants, flown))
        return replace(scene, variants=tuple(variants))

    def _shares(self, time: float, flown: Flown) -> tuple[float, float, float]:
        """The shares of the scenarios that a flight shows, averaged over ``PACE`` seconds around a time.

        So they change gradually, even where the camera stops at once.
        """
        found = []
        for t in np.clip(time + PACE * np.linspace(-0.5, 0.5, WAYPOINTS * 2 - 1), 0.0, self.tour.duration):
            first, last = max(t - INSTANT, 0.0), min(t + INSTANT, self.tour.duration)
            a, b = (np.asarray(self.course.at(float(v)).eye) for v in (first, last))
            speed = float(np.linalg.norm(b - a) / (last - first)) if last > first else 0.0
            found.append(flown.flight.shares(flown.height((a + b) / 2), speed))
        approach, overflight, replanning = np.mean(found, axis=0)
        return float(approach), float(overflight), float(replanning)


def spoken(tour: Tour) -> Sequence[str]:
    """The parts of the scene that a tour sets: "sun", "layers" and names of ``keys.SETTINGS``."""
    more = [name for name, value in (("sun", tour.sun(0.0)), ("layers", tour.layers(0.0))) if value is not None]
    return [*more, *tour.settings(0.0)]
