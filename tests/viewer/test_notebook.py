"""The window in a cell: with a canvas in the widget's stead, and where there is none."""

from __future__ import annotations

import asyncio
import base64
import io
import sys
import types
from unittest import mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

import orograph
from orograph.store.prepare import prepare
from orograph.viewer import cell
from orograph.viewer.cell import Ordered, make_canvas
from orograph.viewer.notebook import Still

pytest.importorskip("imgui_bundle")
traitlets = pytest.importorskip("traitlets")


@pytest.fixture(scope="module")
def terrain(dem):
    return prepare([str(dem)])


def pixels(data: bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(data)))


def test_a_cell_holds_the_widget_and_a_still(terrain, device, front_end):
    widget = orograph.view(terrain, size=(400, 300), sun="2026-06-21T12:00Z", exaggeration=2.0)
    assert type(widget).__name__ == "Widget"
    data, _ = widget._repr_mimebundle_()
    assert "application/vnd.jupyter.widget-view+json" in data
    still = pixels(base64.b64decode(data["image/png"]))
    assert still.shape == (300, 400, 3)
    assert still.std() > 10
    for _ in range(3):
        widget.canvas._process_events()
        shown = np.asarray(widget.canvas.draw())[..., :3]
    assert shown.shape == (300, 400, 3)
    home = widget.camera
    assert (home.width, home.height) == (400, 300)  # no panels at first
    from dataclasses import replace

    widget.fly(replace(home, eye=(home.eye[0] + 1000.0, *home.eye[1:])))
    for _ in range(1000):
        widget.canvas.draw()
        if not widget.window.session.moving:
            break
    assert widget.camera.eye[0] == pytest.approx(home.eye[0] + 1000.0)
    widget.close()
    widget.window.gui.close()


def test_what_is_set_is_seen_and_what_is_done_is_told(terrain, device, front_end):
    """Traits go into the picture; camera, panels and clicks come back."""
    widget = orograph.view(terrain, size=(200, 150))
    widget.canvas.draw()
    session, tools = widget.window.session, widget.window.tools
    widget.exaggeration, widget.azimuth, widget.altitude, widget.light = 2.0, 100.0, 20.0, "none"
    widget.layers = [np.full((4, 4, 3), 200, np.uint8)]
    scene = session.scene()
    assert scene.surface.exaggeration == 2.0 and scene.lighting.light == "none" and len(scene.data.layers) == 1
    assert (scene.lighting.sun.azimuth, scene.lighting.sun.altitude) == (100.0, 20.0)
    before = np.asarray(widget.canvas.draw())[..., :3].astype(int)
    seen: list[tuple[str, object]] = []
    widget.observe(lambda change: seen.append((change["name"], change["new"])))
    session.settings.light = "relief"  # as a panel does
    session.nav.jump(widget.camera.resized(300, 200))
    tools.active, tools.kind = True, "pick"
    middle = tuple(float(v) for v in session.nav.centre())
    widget.canvas.draw()
    assert dict(seen)["light"] == "relief" and widget.measure == "pick"
    widget.picked = [middle]
    for _ in range(1000):
        widget.canvas._process_events()
        widget.canvas.draw()
        if widget.measured is not None:
            break
    assert widget.measured.height == pytest.approx(middle[2], abs=1.0) and widget.picked == (middle,)
    widget.layers = ()
    assert np.abs(np.asarray(widget.canvas.draw())[..., :3].astype(int) - before).max() > 5
    for name, wrong in (("exaggeration", -1.0), ("light", "lamp"), ("measure", "weight"), ("picked", [(1, 2)]),
                        ("camera", "plan")):  # fmt: skip
        with pytest.raises(traitlets.TraitError):
            setattr(widget, name, wrong)
    with pytest.raises(traitlets.TraitError):
        widget.measured = 1
    widget.close()
    widget.window.gui.close()


def test_cells_share_a_camera(terrain, device, front_end):
    """Linked, of different sizes: each follows the other, and both come to rest."""
    from dataclasses import replace

    a, b = orograph.view(terrain, size=(200, 150)), orograph.view(terrain, size=(160, 160))
    traitlets.link((a, "camera"), (b, "camera"))
    slider = traitlets.HasTraits()
    slider.add_traits(value=traitlets.Float(45.0))
    traitlets.link((slider, "value"), (a, "altitude"))
    for mover, other in ((a, b), (b, a)):
        view = mover.camera
        mover.window.session.nav.jump(replace(view, eye=(view.eye[0] + 500.0, view.eye[1], view.eye[2] + 300.0)))
        for widget in (mover, other, mover, other):
            widget.canvas.draw()
        assert other.camera.eye == mover.camera.eye == mover.window.session.view.eye
        assert (a.camera.width, b.camera.width) == (200, 160)
        changes: list[object] = []
        for widget in (a, b):
            widget.observe(changes.append, "camera")
        for widget in (a, b, a, b):
            widget.canvas.draw()
        assert not changes
    slider.value = 10.0
    assert a.window.session.scene().lighting.sun.altitude == 10.0
    for widget in (a, b):
        widget.close()
        widget.window.gui.close()


def test_a_closed_canvas_tells_itself_nothing_more(monkeypatch):
    pytest.importorskip("anywidget")

    async def messages() -> list[dict]:
        canvas, told = make_canvas((40, 30)), []
        handle = type(canvas)._rfb_handle_msg

        def heard(self, widget, content, buffers):
            told.append(content)
            handle(self, widget, content, buffers)

        monkeypatch.setattr(type(canvas), "_rfb_handle_msg", heard)
        canvas.close()
        for _ in range(50):
            await asyncio.sleep(0)
        assert canvas.get_closed()
        return told

    assert asyncio.run(messages()) == [{"type": "close"}]


@given(st.lists(st.permutations(range(1, 9)), min_size=1, max_size=3), st.sets(st.integers(1, 8), max_size=3))
def test_messages_of_a_page_come_in_its_order(orders, lost):
    """Whatever overtakes what. After lost ones, later messages still come, in order."""

    async def passed_on() -> list[tuple[int, int]]:
        told: list[tuple[int, int]] = []
        ordered = Ordered(asyncio.get_running_loop(), told.append)
        for k in range(8):
            for page, order in enumerate(orders):
                if order[k] not in lost:
                    ordered.take(page, order[k], (page, order[k]))
        if lost:
            await asyncio.sleep(3 * cell.LATE)
        return told

    with mock.patch.object(cell, "LATE", 0.01):
        told = asyncio.run(passed_on())
    for page in range(len(orders)):
        assert [number for p, number in told if p == page] == [n for n in range(1, 9) if n not in lost]


def test_a_message_that_comes_too_late_is_passed_on(monkeypatch):
    monkeypatch.setattr(cell, "LATE", 0.01)

    async def passed_on() -> list[int]:
        told: list[int] = []
        ordered = Ordered(asyncio.get_running_loop(), told.append)
        for number in (1, 3, 4):
            ordered.take(0.5, number, number)
        await asyncio.sleep(0.05)
        for number in (2, 6, 5):
            ordered.take(0.5, number, number)
        return told

    assert asyncio.run(passed_on()) == [1, 3, 4, 2, 5, 6]


def test_a_cell_goes_on_with_a_store_that_was_replaced(terrain, device, front_end, tmp_path, monkeypatch):
    from orograph import store
    from orograph.dem import Dem
    from orograph.viewer import replacing

    monkeypatch.setattr(replacing, "EVERY", 0.05)
    rows, cols = terrain.grid.shape
    z, path = terrain.read(0, 0, rows, 0, cols), tmp_path / "a.oro"
    store.build(Dem(z, terrain.grid, name="a"), path).close()
    widget = orograph.view(store.open(path), size=(200, 150))
    widget.canvas.draw()
    old = widget.window.session.terrain
    store.build(Dem(z + np.float32(40), terrain.grid, name="a"), path, overwrite=True).close()
    for _ in range(1000):
        widget.canvas._process_events()
        widget.canvas.draw()
        if widget.window.session.terrain is not old:
            break
    assert widget.window.session.terrain.height_range[0] == pytest.approx(old.height_range[0] + 40)
    assert widget.window.drawing.renderer.terrain is widget.window.session.terrain
    widget.close()
    widget.window.gui.close()


def test_a_still_where_the_extra_is_missing(terrain, monkeypatch):
    monkeypatch.setitem(sys.modules, "rendercanvas.anywidget", None)
    still = orograph.view(terrain, size=(200, 150))
    assert isinstance(still, Still)
    assert "orograph[notebook]" in still.why
    assert pixels(still._repr_png_()).shape == (150, 200, 3)


def test_a_still_where_there_is_no_gpu(terrain, front_end, monkeypatch):
    monkeypatch.setenv("OROGRAPH_ADAPTER", "nonsuch")
    still = orograph.view(terrain, size=(200, 150))
    assert isinstance(still, Still)
    assert "nonsuch" in still.why
    assert pixels(still._repr_png_()).std() > 10


def test_messages_of_a_page_are_heard_in_the_thread_that_draws(monkeypatch):
    """Also where Jupyter hands them to another (subshells): a scheduler of another thread's loop is never woken."""
    import asyncio
    import threading

    heard: list[tuple[str, int]] = []

    class Canvas:
        def __init__(self, size):
            pass

        def _rfb_maybe_draw(self):
            heard.append(("draw", threading.get_ident()))

        def _rfb_handle_msg(self, widget, content, buffers):
            heard.append((content["type"], threading.get_ident()))

        def submit_event(self, event):
            heard.append((event["event_type"], threading.get_ident()))

    module = types.ModuleType("rendercanvas.anywidget")
    module.RenderCanvas = Canvas
    monkeypatch.setitem(sys.modules, "rendercanvas.anywidget", module)
    from orograph.viewer.cell import Clipboard, make_canvas

    async def live() -> str:
        canvas = make_canvas((300, 200))
        clipboard = Clipboard(canvas)

        def page() -> None:
            canvas._rfb_schedule_maybe_draw({"name": "_frame_feedback"})
            canvas._rfb_handle_msg(None, {"type": "pointer_move"}, [])
            canvas._rfb_handle_msg(None, {"type": "orograph_paste", "text": "a view"}, [])

        other = threading.Thread(target=page)
        other.start()
        other.join()
        await asyncio.sleep(0.01)
        return clipboard.get()

    assert asyncio.run(live()) == "a view"
    assert heard == [(kind, threading.get_ident()) for kind in ("draw", "pointer_move", "key_down", "key_up")]


def test_held_keys_are_released_when_the_keyboard_goes_elsewhere():
    """Or the camera would fly on. A key pressed with Shift may be released without."""
    pytest.importorskip("anywidget")

    async def told() -> list[tuple[str, str]]:
        canvas, events = make_canvas((40, 30)), []
        canvas.add_event_handler(lambda event: events.append((event["event_type"], event["key"])), "key_down", "key_up")
        for kind, key in (("key_down", "Shift"), ("key_down", "W"), ("key_down", "a"), ("key_up", "w"),
                          ("focus_out", ""), ("focus_out", "")):  # fmt: skip
            canvas._handle((canvas, {"type": kind, "key": key, "modifiers": [], "timestamp": 0.0}, []))
        canvas._process_events()
        canvas.close()
        return events[4:]

    assert asyncio.run(told()) == [("key_up", "Shift"), ("key_up", "a")]


def test_frames_that_were_lost_hold_up_no_others(monkeypatch):
    class Canvas:
        _frame_feedback, _rfb_frame_index, _max_buffered_frames = {}, 0, 2

        def __init__(self, size):
            pass

        def _rfb_send_frame(self, array):
            self._rfb_frame_index += 1

        def _rfb_handle_msg(self, widget, content, buffers):
            pass

    module = types.ModuleType("rendercanvas.anywidget")
    module.RenderCanvas = Canvas
    monkeypatch.setitem(sys.modules, "rendercanvas.anywidget", module)
    from orograph.viewer import cell

    now = [10.0]
    monkeypatch.setattr(cell.time, "monotonic", lambda: now[0])
    canvas = cell.make_canvas((300, 200))

    def moved():
        canvas._rfb_handle_msg(None, {"type": "pointer_move"}, [])
        return canvas._frame_feedback.get("index", 0)

    now[0] += 60.0
    assert moved() == 0  # nothing was sent
    canvas._rfb_send_frame(None)
    now[0] += cell.LOST + 1.0
    assert moved() == 0  # another may follow
    canvas._rfb_send_frame(None)
    now[0] += cell.LOST - 1.0
    assert moved() == 0  # they may still come
    now[0] += 2.0
    assert moved() == 2
