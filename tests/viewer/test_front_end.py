"""The widget in JupyterLab, Notebook 7 and marimo, in a headless Chromium: mouse, wheel, keys, clipboard, traits.

Skipped where JupyterLab, playwright or a Chromium is missing: no other test needs them.
"""

from __future__ import annotations

import importlib.util
import io
import json
import os
import shutil
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import orograph

pytest.importorskip("anywidget")
if importlib.util.find_spec("jupyterlab") is None:  # (importing it takes five seconds)
    pytest.skip("JupyterLab is not installed", allow_module_level=True)
sync_api = pytest.importorskip("playwright.sync_api")
CHROMIUM = next((p for p in map(shutil.which, ("chromium", "chromium-browser", "google-chrome")) if p), None)
pytestmark = [pytest.mark.stress, pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium")]

VIEW = ".renderview-view"
DRAWN = f"""(() => {{
    const all = root => [...root.querySelectorAll("*")].flatMap(e => e.shadowRoot ? [e, ...all(e.shadowRoot)] : [e]);
    return all(document).some(e => e.matches("{VIEW}") && (e.src ?? "").startsWith("blob"));
}})()"""
"""Whether the widget has a picture; marimo keeps it in a shadow tree."""
SOON = 120_000
"""Milliseconds: nothing takes as long."""


def cell(code: str) -> dict:
    return {"cell_type": "code", "source": code, "metadata": {}, "outputs": [], "execution_count": None}


FRONT_ENDS = {"jupyterlab": "lab/tree", "notebook": "notebooks"}
"""Modules that serve notebooks, and where."""


@pytest.fixture(params=["jupyterlab", pytest.param("notebook", marks=pytest.mark.stress)])
def page(request, dem: Path, device, tmp_path: Path) -> Iterator:
    """A notebook, opened, whose first cell shows the test terrain and whose second closes it."""
    pytest.importorskip(request.param)
    orograph.build([str(dem)], str(tmp_path / "area.oro")).close()
    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    notebook = {
        "nbformat": 4, "nbformat_minor": 4, "metadata": {"kernelspec": kernel},
        "cells": [
            cell("import orograph\nw = orograph.view('area.oro', size=(700, 420))\nw"),
            cell("w.close()\nprint('closed' if w.canvas.get_closed() else 'open')"),
            cell("import ipywidgets, traitlets\ns = ipywidgets.FloatSlider(10.0, min=0, max=90)\n"
                 "traitlets.link((s, 'value'), (w, 'altitude'))\n"
                 "print('sun', w.window.session.scene().lighting.sun.altitude, 'eye', w.camera.eye[2])"),
        ],
    }  # fmt: skip
    (tmp_path / "look.ipynb").write_text(json.dumps(notebook))
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    folders = {f"JUPYTER_{kind}_DIR": str(tmp_path / kind) for kind in ("CONFIG", "DATA", "RUNTIME")}
    server = subprocess.Popen(
        [sys.executable, "-m", request.param, "--allow-root", "--no-browser", "--ip=127.0.0.1", f"--port={port}",
         "--ServerApp.token=", "--ServerApp.password=", "--ServerApp.disable_check_xsrf=True"],
        cwd=tmp_path, env={**os.environ, **folders, "OROGRAPH_ADAPTER": "software"}, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    base = f"http://127.0.0.1:{port}"
    try:
        for _ in range(300):
            try:
                urllib.request.urlopen(f"{base}/api").close()
                break
            except OSError:
                time.sleep(0.2)
        with sync_api.sync_playwright() as play:
            browser = play.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
            context = browser.new_context(viewport={"width": 1280, "height": 900})
            context.grant_permissions(["clipboard-read", "clipboard-write"], origin=base)
            found = context.new_page()
            found.goto(f"{base}/{FRONT_ENDS[request.param]}/look.ipynb")
            found.wait_for_selector(".jp-CodeCell", timeout=SOON)
            for _ in range(300):  # until the notebook has its kernel
                found.wait_for_timeout(200)
                with urllib.request.urlopen(f"{base}/api/sessions") as answer:
                    if any(s["kernel"]["connections"] for s in json.load(answer)):
                        break
            yield found
            browser.close()
    finally:
        server.terminate()
        server.wait(30)


def run(page, k: int) -> None:
    """Run a cell: again where the notebook, still being laid out, has not heard of it."""
    code = page.locator(".jp-CodeCell").nth(k)
    for _ in range(20):
        code.locator(".cm-content").click()
        page.keyboard.press("Control+Enter")
        page.wait_for_timeout(1000)
        if code.locator(".jp-InputPrompt").inner_text() != "[ ]:":
            return
    raise AssertionError("the cell does not run")


def seen(page) -> np.ndarray:
    """The widget on the page."""
    return np.asarray(Image.open(io.BytesIO(page.locator(VIEW).screenshot())).convert("RGB"))


def camera(page) -> dict:
    """The view as Ctrl + C gives it to the page's clipboard."""
    page.evaluate("navigator.clipboard.writeText('')")
    page.keyboard.press("Control+c")
    for _ in range(SOON // 100):  # a kernel that compiles answers late
        page.wait_for_timeout(100)
        text = page.evaluate("navigator.clipboard.readText()")
        if text:
            assert text.startswith("{"), f"{text!r} is copied, not the view"
            return json.loads(text)
    raise AssertionError("nothing is copied")


def rested(page) -> dict:
    """The camera when it has come to rest."""
    last = camera(page)
    for _ in range(60):
        page.wait_for_timeout(400)
        now = camera(page)
        if now == last:
            return now
        last = now
    raise AssertionError("the camera does not come to rest")


def rested_where(page, holds: Callable[[dict], bool]) -> dict:
    """The camera at rest, as soon as it is where it should be: the browser passes events on when it has the time."""
    for _ in range(60):
        now = rested(page)
        if holds(now):
            return now
    raise AssertionError(f"the camera comes to rest elsewhere: {now}")


def test_a_person_explores_a_cell(page):
    run(page, 0)
    page.wait_for_function(f"(document.querySelector('{VIEW}')?.src ?? '').startsWith('blob')", timeout=SOON)
    box = page.locator(VIEW).bounding_box()
    assert (box["width"], box["height"]) == (700, 420)
    x, y = box["x"], box["y"]
    page.evaluate("window.elsewhere = []; document.addEventListener('keydown', event => {"
                  "if (event.target.parentElement?.id !== 'rendercanvas-focus-element-container')"
                  "window.elsewhere.push(event.key) }, true)")  # fmt: skip
    page.mouse.click(x + 300, y + 300)
    page.keyboard.press("Home")  # at once
    home = rested(page)
    shown = seen(page)
    assert shown.std() > 15
    assert shown[5:15, 500:600].mean() > 140  # the sky: nothing lies over the picture

    page.mouse.move(x + 300, y + 300)
    page.evaluate("window.prompt_timer = setTimeout; setTimeout = (f, ms) => prompt_timer(f, ms + 300)")
    page.mouse.down()
    page.mouse.move(x + 400, y + 260, steps=6)
    page.mouse.up()  # the moves still wait for their timer
    page.evaluate("setTimeout = prompt_timer")
    panned = rested_where(page, lambda now: now["eye"][0] < home["eye"][0] - 100)  # the ground went to the right
    assert panned["eye"][2] == pytest.approx(home["eye"][2], abs=1.0)
    assert np.abs(seen(page).astype(int) - shown).mean() > 3

    page.mouse.wheel(0, -300)
    rested_where(page, lambda now: now["eye"][2] < 0.8 * panned["eye"][2])

    page.evaluate("text => navigator.clipboard.writeText(text)", json.dumps(home))
    page.keyboard.press("Control+v")
    page.wait_for_timeout(500)  # (Ctrl + C would take the page's clipboard first)
    rested_where(page, lambda now: now["eye"] == pytest.approx(home["eye"], abs=0.1))

    page.keyboard.press("Tab")  # panels, and the keyboard stays here
    rested_where(page, lambda now: now["width"] < 500)

    handle = page.locator(".renderview-resizer").bounding_box()
    page.mouse.move(handle["x"] + 5, handle["y"] + 5)
    page.mouse.down()
    page.mouse.move(handle["x"] - 95, handle["y"] - 45, steps=4)
    page.mouse.up()
    page.mouse.click(x + 100, y + 300)
    small = rested_where(page, lambda now: now["height"] == page.locator(VIEW).bounding_box()["height"] < 400)

    assert page.evaluate("window.elsewhere") == []
    run(page, 2)  # traits: a slider moves the sun, the mouse moved the camera
    said = page.locator("text=/^sun /").first.inner_text(timeout=SOON).split()
    assert float(said[1]) == 10.0 and float(said[3]) == pytest.approx(small["eye"][2], rel=1e-3)

    run(page, 1)
    page.wait_for_selector("text=/^closed/", timeout=SOON)
    page.wait_for_function(f"!document.querySelector('{VIEW}')", timeout=SOON)


def test_a_cell_of_marimo(dem: Path, device, tmp_path: Path) -> None:
    """It shows the terrain, and a drag moves the camera."""
    pytest.importorskip("marimo")
    orograph.build([str(dem)], str(tmp_path / "area.oro")).close()
    (tmp_path / "app.py").write_text(
        "import marimo\napp = marimo.App()\n\n@app.cell\ndef _():\n"
        "    import orograph\n    w = orograph.view('area.oro', size=(700, 420))\n    w\n    return (w,)\n\n"
        "@app.cell\ndef _(w):\n    w.observe(lambda c: open('eye', 'w').write(repr(c.new.eye)), 'camera')\n    return\n"
    )
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    server = subprocess.Popen(
        [sys.executable, "-m", "marimo", "run", "app.py", "--headless", "--no-token", "--port", str(port)],
        cwd=tmp_path, env={**os.environ, "OROGRAPH_ADAPTER": "software"}, stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )  # fmt: skip
    try:
        with sync_api.sync_playwright() as play:
            browser = play.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
            found = browser.new_page(viewport={"width": 1280, "height": 900})
            for _ in range(300):
                try:
                    found.goto(f"http://127.0.0.1:{port}")
                    break
                except sync_api.Error:
                    time.sleep(0.2)
            found.wait_for_selector(VIEW, timeout=SOON)
            found.wait_for_function(DRAWN, timeout=SOON)
            box = found.locator(VIEW).bounding_box()
            found.mouse.move(box["x"] + 300, box["y"] + 300)
            found.mouse.down()
            found.mouse.move(box["x"] + 400, box["y"] + 260, steps=6)
            found.mouse.up()
            for _ in range(300):
                found.wait_for_timeout(100)
                if (tmp_path / "eye").exists():
                    break
            assert (tmp_path / "eye").exists() and seen(found).std() > 15
            browser.close()
    finally:
        server.terminate()
        server.wait(30)
