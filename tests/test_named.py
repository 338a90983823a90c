"""Keywords that are nearly right are answered with the right one: every public class, method and function."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from affine import Affine
from pyproj import CRS

import orograph
from orograph.errors import UsageError

LEFT = {"Picture", "Terrain", "Tour.readable", "render"}
"""What users do not make themselves, a method of a base class, and what passes on the options in its signature."""


def public() -> Iterator[tuple[str, Callable[..., Any], bool]]:
    """Names, what they stand for, and whether it needs an object first."""
    for name in dir(orograph):
        found = getattr(orograph, name)
        if inspect.isclass(found):
            yield name, found, False
            for of_it in (one for one in dir(found) if not one.startswith("_")):
                made = inspect.getattr_static(found, of_it)
                if isinstance(made, classmethod | staticmethod):
                    yield f"{name}.{of_it}", getattr(found, of_it), False
                elif inspect.isfunction(made):
                    yield f"{name}.{of_it}", made, True
        elif callable(found):
            yield name, found, False


def checked(name: str, made: Callable[..., Any]) -> bool:
    """Whether all of its keywords are its own, and there are any."""
    kinds = [one.kind for one in inspect.signature(inspect.unwrap(made)).parameters.values()]
    own = inspect.signature(made).parameters.keys() - {"self"}
    return bool(own) and inspect.Parameter.VAR_KEYWORD not in kinds and name not in LEFT and "Terrain." not in name


CASES = [pytest.param(made, bound, id=name) for name, made, bound in public() if checked(name, made)]


@pytest.mark.parametrize(("made", "bound"), CASES)
def test_a_misspelt_keyword_is_answered_with_the_right_one(made: Callable[..., Any], bound: bool) -> None:
    parameters = [
        one for one in inspect.signature(made).parameters.values()
        if one.kind in (one.KEYWORD_ONLY, one.POSITIONAL_OR_KEYWORD) and one.name != "self"
    ]  # fmt: skip
    right = parameters[-1].name
    with pytest.raises(UsageError, match=rf"has no (option )?'{right}_'. Did you mean {right}\?"):
        made(*[None] * bound, **{f"{right}_": 1})


DEM = orograph.Dem(
    np.add.outer(np.arange(20.0), np.arange(20.0)).astype(np.float32),
    orograph.Grid((20, 20), Affine(30, 0, 400000, 0, -30, 4000000), CRS.from_epsg(32617)),
)


@pytest.mark.parametrize(
    ("call", "wrong"),
    [
        (lambda: orograph.Layer("a.tif", cmap="viridis"), "A layer has no 'cmap'. It is called colormap here"),
        (lambda: orograph.Dataset("a.tif", cmap="viridis"), "A dataset has no 'cmap'. It is called colormap here"),
        (lambda: orograph.tin(DEM, max_error=1, outputs="a.ply"), "tin has no option 'outputs'. Did you mean output?"),
        (lambda: orograph.tessellate(DEM, tolerence=1), "tessellate has no option 'tolerence'. Did you mean tolerance"),
        (lambda: orograph.contours(DEM, 20, simplfy=1), "contours has no option 'simplfy'. Did you mean simplify"),
        (lambda: orograph.info(DEM, spacng=30), "info has no option 'spacng'. Did you mean spacing"),
        (lambda: orograph.build(DEM, "a.oro", overwite=True), "build has no option 'overwite'. Did you mean overwrite"),
        (lambda: orograph.measure.profile(DEM, [(0, 0)], lonlats=True), "profile has no option 'lonlats'. Did you"),
        (lambda: orograph.measure.profile(), "profile needs `terrain`"),
        (lambda: orograph.camera.whole(DEM, azimut=30), "whole has no option 'azimut'. Did you mean azimuth"),
        (lambda: orograph.movie(DEM, "a.mp4", fsp=30), "movie has no option 'fsp'. Did you mean fps"),
        (lambda: orograph.Picture.save(None, "a.png", dip=300), "save has no option 'dip'. Did you mean dpi"),
        (lambda: orograph.read("a.oro", bbox=(1, 2, 3, 4)), "bbox=(7, 45, 8, 46))` reads a part"),
        (lambda: orograph.render(DEM, cellsize=30), "render has no option 'cellsize'. It is called spacing here"),
        (lambda: orograph.render(DEM, **{"from": 225}), "Here the camera is given as a view"),
        (lambda: orograph.tin(DEM, 1, output="a.dxf"), "Use .npz, .ply, .obj, .glb, .stl or .3mf"),
        (lambda: orograph.movie(DEM, "a.mp4", 3), "A tour is made by orograph.tour, or is its file, not int"),
        (lambda: orograph.View((0, 0, 9), (1, 1, 0), fov=40), "A view has no 'fov'. Did you mean fov_y"),
    ],
)  # fmt: skip
def test_what_is_passed_on(call: Callable[[], Any], wrong: str) -> None:
    with pytest.raises(UsageError, match=re.escape(wrong)):
        call()


def test_a_tour_may_be_given_as_it_is_at_hand() -> None:
    places = [(-82.11, 36.139), (-82.108, 36.137)]
    tour = orograph.tour(DEM, line=places, progress=False)
    assert tour == orograph.tour(DEM, points=places, progress=False)
    with pytest.raises(UsageError, match=r"must end in|cannot be written|ending"):
        orograph.movie(DEM, "film.xyz", tour.to_dict(), progress=False)
