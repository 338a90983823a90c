"""A canvas in a notebook's cell: ``rendercanvas``'s widget, and what it lacks for a window.

- Jupyter may handle the page's messages in another thread (*subshells*, ipykernel 7), where ``rendercanvas`` would also
  draw; its scheduler waits in the loop of the thread that made it, and is never woken. So all messages go to that loop.
- A cell has the keyboard as soon as it was clicked: no key that follows goes elsewhere.
- A drag ends where the button was released. ``rendercanvas`` holds moves back for some milliseconds but not the
  release, which would otherwise overtake the last of them, or all of a quick drag's.
- A frame that the page never confirms (its connection was cut) holds up the next ones no longer than ``LOST``.
- While the cell has the keyboard, the browser does not get the keys that it would use itself (Tab, F1, F12, Ctrl +
  digit).
- The clipboard is the page's: copied text is sent there, and pasted text comes with the page's own event (a page cannot
  read the clipboard otherwise).

Lengths are CSS pixels.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable, Sequence
from typing import Any

FRAME = 4
"""CSS pixels that the widget's frame adds to the picture."""

LOST = 3.0
"""Seconds after which an unconfirmed frame counts as lost, if the page sends events."""

SCRIPT = """
{
  const register = AnywidgetRenderView.prototype._registerEvents
  AnywidgetRenderView.prototype._registerEvents = function () {
    const signal = this._abortController.signal
    const element = this._focusElement
    const seconds = () => performance.now() / 1000
    // The widget gets the keyboard by a timer, 25 ms after a press; a key may come first.
    this.viewElement.addEventListener('pointerup', (event) => {
      if (event.pointerType === 'mouse') { element.focus({ preventScroll: true, focusVisible: false }) }
      this.onEvent({ type: 'pointer_move', x: event.offsetX, y: event.offsetY, button: 0, buttons: [], modifiers: [],
                     ntouches: 0, touches: {}, timestamp: seconds() })
    }, { signal })
    element.addEventListener('keydown', (event) => {
      const control = event.ctrlKey || event.metaKey
      if (control && event.key.toLowerCase() === 'v') {
        event.stopImmediatePropagation()
      } else if (['Tab', 'F1', 'F12'].includes(event.key) || (control && /^[1-9q]$/i.test(event.key))) {
        event.preventDefault()
      }
    }, { signal })
    element.addEventListener('paste', (event) => {
      event.preventDefault()
      this.onEvent({ type: 'orograph_paste', text: event.clipboardData.getData('text'), timestamp: seconds() })
    }, { signal })
    register.call(this)
  }
  const add = RenderviewAnywidgetModel.prototype.addView
  RenderviewAnywidgetModel.prototype.addView = function (view) {
    if (this.views.length === 0) {
      this.anymodel.on('msg:custom', (message) => {
        if (message.type === 'orograph_copy') { navigator.clipboard?.writeText(message.text).catch(() => {}) }
      })
    }
    add.call(this, view)
  }
}
"""
"""Appended to the widget's own script, whose classes it patches."""


def make_canvas(size: tuple[int, int], **options: Any) -> Any:
    """A canvas of ``size``, or narrower if the cell is.

    Raises:
        ImportError: the extra is missing.
    """
    from rendercanvas.anywidget import RenderCanvas

    class Canvas(RenderCanvas):  # type: ignore[misc]
        """The widget; ``pasted`` is called with what the page pastes."""

        _esm = getattr(RenderCanvas, "_esm", "") + SCRIPT
        _frame_feedback: dict[str, Any]

        def __init__(self, **given: Any) -> None:
            try:
                self._home: asyncio.AbstractEventLoop | None = asyncio.get_running_loop()
            except RuntimeError:
                self._home = None
            self.pasted: Callable[[str], None] = lambda text: None
            self._sent = math.inf
            self._closed = False
            super().__init__(**given)

        def _at_home(self, do: Callable[..., None], *arguments: Any) -> None:
            if self._home is None or self._home.is_closed():
                do(*arguments)
            else:
                self._home.call_soon_threadsafe(do, *arguments)

        def _rfb_schedule_maybe_draw(self, *_: Any) -> None:
            self._at_home(super()._rfb_maybe_draw)

        def _rfb_send_frame(self, *arguments: Any, **options: Any) -> None:
            self._sent = time.monotonic()
            super()._rfb_send_frame(*arguments, **options)

        def _rc_close(self) -> None:
            if not self._closed:  # rendercanvas would tell itself without end that it is closed
                self._closed = True
                super()._rc_close()

        def _go_on(self) -> None:
            """Forget frames that were lost on the way; called when the page is known to be there."""
            if not time.monotonic() - self._sent > LOST:
                return
            last, now = self._rfb_frame_index, time.time()
            if last - self._frame_feedback.get("index", 0) >= self._max_buffered_frames:
                self._frame_feedback = {"index": last, "timestamp": now, "localtime": now}

        def _rfb_handle_msg(self, widget: Any, content: dict[str, Any], buffers: Sequence[Any]) -> None:
            self._at_home(self._go_on)
            if content.get("type") == "orograph_paste":
                self._at_home(self.pasted, str(content.get("text", "")))
            else:
                self._at_home(super()._rfb_handle_msg, widget, content, buffers)

    canvas = Canvas(size=size, **options)
    if hasattr(canvas, "set_css_width"):
        canvas.set_css_width(f"min({size[0]}px, calc(100% - {FRAME}px))")
    return canvas


class Clipboard:
    """The clipboard of the page that shows a canvas: what was last copied here or pasted there."""

    def __init__(self, canvas: Any) -> None:
        self._canvas, self._text = canvas, ""
        canvas.pasted = self._pasted

    def get(self) -> str:
        """The text."""
        return self._text

    def put(self, text: str) -> None:
        """Have the page copy a text."""
        self._text = text
        send = getattr(self._canvas, "send", None)
        if send is not None:
            send({"type": "orograph_copy", "text": text})

    def _pasted(self, text: str) -> None:
        """Act as if Ctrl + V were pressed, now that the text is here."""
        self._text = text
        for kind in ("key_down", "key_up"):
            self._canvas.submit_event({"event_type": kind, "key": "v", "modifiers": ("Control",), "time_stamp": 0.0})
