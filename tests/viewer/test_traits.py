"""The widget's traits as a cell sets and observes them, rightly and wrongly."""

from __future__ import annotations

import base64
from dataclasses import replace

import numpy as np
import pytest

import orograph
from orograph.store.prepare import prepare

pytest.importorskip("imgui_bundle")
traitlets = pytest.importorskip("traitlets")


@pytest.fixture
def widget(dem, device, front_end):
    widget = orograph.view(prepare([str(dem)]), size=(200, 150))
    drawn(widget)
    yield widget
    widget.close()
    widget.window.gui.close()


def drawn(widget, frames: int = 2) -> None:
    for _ in range(frames):
        widget.canvas._process_events()
        widget.canvas.draw()


def moved(widget, metres: float = 500.0):
    """The view from further east."""
    view = widget.camera
    return replace(view, eye=(view.eye[0] + metres, *view.eye[1:]))


def test_an_observer_sets_other_traits_and_its_own(widget):
    """As when a click adds a layer, or a camera is held within limits."""
    home = widget.camera

    def held(change) -> None:
        widget.exaggeration, widget.camera = 2.0, home

    widget.observe(held, "camera")
    widget.window.session.nav.jump(moved(widget))
    drawn(widget)
    assert widget.window.session.settings.exaggeration == widget.exaggeration == 2.0
    assert widget.window.session.view.eye == widget.camera.eye == home.eye


def test_what_is_wrong_in_an_observer_is_told_and_frames_go_on(widget, capsys):
    """Told once; other observers hear of their traits; and a text with "lost" is no lost device."""
    device, lights = widget.window.device, []

    def wrong(change) -> None:
        raise ValueError("I am lost")

    widget.observe(wrong, "camera")
    widget.observe(lambda change: lights.append(change["new"]), "light")
    widget.window.session.settings.light = "none"
    widget.fly(moved(widget))
    for _ in range(1000):
        drawn(widget, 1)
        if not widget.window.session.moving:
            break
    assert widget.camera.eye == pytest.approx(moved(widget, 0.0).eye) and not widget.window.session.moving
    assert lights == ["none"]
    assert widget.window.device is device and not widget.window.drawing.coming
    assert capsys.readouterr().err.count("ValueError: I am lost") == 1


def test_what_cannot_be_drawn_is_refused(widget):
    for name, wrong in (
        ("azimuth", np.nan), ("azimuth", np.inf), ("altitude", np.nan), ("altitude", -95.0), ("altitude", 1000.0),
        ("picked", [(np.nan, 4_985_000.0, 500.0)]), ("picked", [(415_000.0, 4_985_000.0, np.inf)]),
        ("selection", {"ranges": 5}), ("selection", {"ranges": [(1, 2)]}),
    ):  # fmt: skip
        before = getattr(widget, name)
        with pytest.raises(traitlets.TraitError):
            setattr(widget, name, wrong)
        assert getattr(widget, name) == before, name


def test_no_layers(widget):
    widget.layers = [np.full((4, 4, 3), 200, np.uint8)]
    widget.layers = None
    drawn(widget)
    assert widget.layers == () and widget.window.session.scene().data.layers == ()


def test_a_closed_widget_holds_values_and_its_still(widget):
    """Links to it may go on; a cell that shows it again shows the first view."""
    widget.close()
    widget.camera, widget.picked = moved(widget), [(415_000.0, 4_985_000.0, 500.0)]
    assert widget.picked == ((415_000.0, 4_985_000.0, 500.0),)
    data = widget._repr_mimebundle_()
    assert list(data) == ["image/png"] and base64.b64decode(data["image/png"]).startswith(b"\x89PNG")
