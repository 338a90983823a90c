"""The window as a person uses it: ``orograph view`` under Xvfb, mouse and keyboard by xdotool, on software Vulkan.

The ground of the test terrain is a plain of known height, so where the mouse is on it is known in closed form.
"""

from __future__ import annotations

import json
import math
import random
import shutil
import subprocess
import time

import numpy as np
import pytest

from orograph.viewpoint import View

PLAIN = 500.0
"""Metres: the height of the ground (conftest)."""
SCREEN = 3.0
"""Pixels by which what is held may be off: xdotool and the mouse count whole ones."""


def view_of(values: dict) -> View:
    return View.from_dict(values)


def under(view: View, x: float, y: float) -> np.ndarray:
    """The place on the plain at a pixel."""
    o0, _, _, d0, du, dv = view.ray_basis()
    d = d0 + x * du + y * dv
    return o0 + d * (PLAIN - o0[2]) / d[2]


def heading(view: View) -> float:
    dx, dy = (t - e for t, e in zip(view.target[:2], view.eye[:2]))
    return math.degrees(math.atan2(dx, dy)) % 360


@pytest.mark.stress
def test_exploring_with_mouse_and_keyboard(person):
    someone = person()
    home = view_of(someone.settled())
    assert (home.width, home.height) != (1200, 800)  # docked panels take their part
    assert home.height == 800

    # Left drag: the ground stays under the cursor.
    place = under(home, 400, 600)
    someone.drag(1, (400, 600), (420, 590), (500, 560), (550, 540))
    panned = view_of(someone.settled())
    assert np.abs(panned.project(place)[0] - (550, 540)).max() < SCREEN
    assert panned.eye[2] == pytest.approx(home.eye[2], abs=1.0)

    # The wheel: nearer, and the place under the cursor stays.
    place = under(panned, 300, 500)
    someone.do("mousemove", "300", "500")
    someone.do("click", "--repeat", "4", "--delay", "60", "4")
    near = view_of(someone.settled())
    assert np.abs(near.project(place)[0] - (300, 500)).max() < SCREEN
    ratio = math.dist(panned.eye, place) / math.dist(near.eye, place)
    assert ratio == pytest.approx(1.25**4, rel=0.02)

    # Right drag: orbits the place under the cursor.
    place = under(near, 450, 450)
    someone.drag(3, (450, 450), (480, 450), (550, 430), (600, 420))
    orbited = view_of(someone.settled())
    assert np.abs(orbited.project(place)[0] - (450, 450)).max() < SCREEN
    assert 30 < abs(math.remainder(heading(orbited) - heading(near), 360)) < 60
    assert math.dist(orbited.eye, place) == pytest.approx(math.dist(near.eye, place), rel=1e-3)

    # Keys: north up, straight down, home.
    someone.do("key", "n")
    north = view_of(someone.settled())
    assert abs(math.remainder(heading(north), 360)) < 0.1
    someone.do("key", "t")
    down = view_of(someone.settled())
    assert down.axes()[2] == pytest.approx((0, 0, -1), abs=1e-6)
    someone.do("key", "h")
    again = view_of(someone.settled())
    assert again.eye == pytest.approx(home.eye, abs=0.1)

    # A double click goes there: the place comes to the middle.
    place = under(again, 300, 600)
    someone.do("mousemove", "300", "600")
    someone.do("click", "--repeat", "2", "--delay", "80", "1")
    there = view_of(someone.settled())
    assert np.abs(there.project(place)[0] - (there.width / 2, there.height / 2)).max() < SCREEN

    # Flying: forward while W is held, then it stands.
    someone.do("keydown", "w")
    someone.wait(lambda: math.dist(view_of(someone.view() or {}).eye, there.eye) > 50, 30)
    someone.do("keyup", "w")
    flown = view_of(someone.settled())
    forward = np.subtract(flown.eye, there.eye)
    assert forward @ there.axes()[2] / np.linalg.norm(forward) > 0.95

    assert someone.close() == 0
    assert "Error" not in someone.log.read_text()


@pytest.mark.stress
def test_panels_help_views_and_pictures(person):
    someone = person()
    home = someone.settled()
    picture = someone.see()
    assert picture.std() > 10

    someone.do("key", "F1")
    someone.wait(lambda: (np.abs(someone.see().astype(int) - picture).max(2) > 60).mean() > 0.05, 20)
    someone.do("key", "F1")

    someone.do("key", "Tab")  # the terrain takes the whole window
    wide = someone.settled()
    assert wide["width"] == 1200 > home["width"]
    sky = someone.wait(
        lambda: (seen := someone.see()[10:40, 560:640]).mean() > 0.9 * picture[10:40, 560:640].mean() and seen, 20
    )
    assert sky.std() < 10  # nothing of the panels lies over the picture
    someone.do("key", "Tab")
    assert someone.settled()["width"] == home["width"]

    # A view is kept, copied, left, and gone back to in both ways.
    someone.do("key", "o")
    kept = someone.settled()
    someone.do("key", "ctrl+1")
    someone.do("key", "ctrl+c")
    for back in ("1", "ctrl+v"):
        someone.do("key", "t")
        assert someone.settled()["eye"] != pytest.approx(kept["eye"], abs=1.0)
        someone.do("key", back)
        assert someone.settled()["eye"] == pytest.approx(kept["eye"], abs=0.01)

    # A picture, and the view it shows, as render takes it.
    someone.do("key", "F12")
    path = someone.wait(lambda: next(iter(someone.folder.glob("plain-*.json")), None), 90)
    from PIL import Image

    saved = np.asarray(Image.open(path.with_suffix(".png")))
    assert saved.shape == (kept["height"], kept["width"], 3)
    assert saved.std() > 10
    assert View.load(path).eye == pytest.approx(kept["eye"], abs=0.01)
    assert someone.close() == 0


@pytest.mark.stress
def test_resizing_hiding_and_closing_at_once(person):
    someone = person()
    before = someone.settled()
    someone.do("windowsize", someone.window, "900", "600")
    after = someone.wait(lambda: (v := someone.view()) and v["height"] == 600 and v, 30)
    assert after["width"] < before["width"]
    someone.do("windowsize", someone.window, "160", "120")
    someone.wait(lambda: (v := someone.view()) and v["height"] <= 120 and v, 30)
    someone.do("windowsize", someone.window, "1000", "700")
    someone.wait(lambda: (v := someone.view()) and v["height"] == 700 and v, 30)
    someone.do("windowunmap", someone.window)
    someone.do("windowmap", someone.window)
    someone.do("windowfocus", "--sync", someone.window)
    assert someone.settled()["height"] == 700
    assert someone.wait(lambda: bool(someone.see().std() > 10), 30)  # what comes back has to be drawn first
    someone.do("mousemove", "300", "300")
    someone.do("click", "--repeat", "8", "4")  # closed while it moves and loads
    assert someone.close() == 0


@pytest.mark.stress
def test_a_window_may_be_closed_at_any_moment(person, dem, tmp_path):
    """While it opens, while tiles load, while the camera moves: the exit code is 0, and nothing is printed."""
    store, rng = tmp_path / "ground.oro", random.Random(18)
    import orograph

    orograph.build([str(dem)], str(store), shard=64, chunk=32, progress=False).close()
    for _ in range(30):
        someone = person(str(store), pause=0.02)
        then = time.monotonic() + rng.choice([rng.uniform(0.0, 0.3), rng.uniform(0.2, 2.0), rng.uniform(0.2, 8.0)])
        if rng.random() < 0.5:
            someone.do("mousemove", "300", "300")
            someone.do("click", "--repeat", "6", "4")
        time.sleep(max(then - time.monotonic(), 0.0))
        assert someone.close() == 0
        assert not any(word in someone.log.read_text() for word in ("Traceback", "rror", "panicked"))


@pytest.mark.stress
def test_closing_by_key_right_after_a_click_on_a_panel(person):
    someone = person()
    someone.settled()
    someone.do("mousemove", "300", "300", "click", "4", "mousemove", "1100", "300", "click", "1", "key", "ctrl+q")
    assert someone.program.wait(30) == 0
    assert "Error" not in someone.log.read_text()


@pytest.mark.stress
def test_a_store_that_vanishes_is_said_and_survived(person, dem, tmp_path):
    import orograph

    store = tmp_path / "gone.oro"
    orograph.build([str(dem)], str(store)).close()
    someone = person(str(store))
    someone.settled()
    for part in store.rglob("*"):
        if part.is_file():
            part.unlink()
    shutil.rmtree(store, ignore_errors=True)
    someone.do("mousemove", "400", "600")
    someone.do("click", "--repeat", "12", "--delay", "50", "4")
    someone.settled()
    someone.do("key", "h")
    someone.settled()
    assert someone.program.poll() is None
    assert someone.close() == 0


LOOKS = "--contours auto --silhouettes --method soar --light aperture --water none --no-shadows"


@pytest.mark.stress
@pytest.mark.parametrize(("frames", "looks"), [("1", ""), ("100000", ""), ("1", LOOKS)])
def test_a_screenshot_is_made_without_a_hand(screen, device, dem, tmp_path, own_config, frames, looks):
    """Also when more frames are asked for than are drawn until the picture is as good as it gets."""
    import os
    import sys

    out = tmp_path / "shot.png"
    done = subprocess.run(
        [sys.executable, "-m", "orograph", "view", str(dem), "--size", "800x500", "--screenshot", str(out),
         "--frames", frames, *looks.split()],
        env={**os.environ, "DISPLAY": screen, "OROGRAPH_ADAPTER": "software"}, capture_output=True, text=True,
        timeout=240,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    from PIL import Image

    assert Image.open(out).size == (800, 500)
    assert done.stdout.strip() == str(out)
    assert not json.dumps(done.stderr).count("Traceback")
