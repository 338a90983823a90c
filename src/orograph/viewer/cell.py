"""A canvas in a notebook's cell: ``rendercanvas``'s widget, and what it lacks for a window.

- Jupyter may handle the page's messages in another thread (*subshells*, ipykernel 7), where ``rendercanvas`` would also
  draw; its scheduler waits in the loop of the thread that made it, and is never woken. So all messages go to that loop.
- A cell has the keyboard as soon as it was clicked: no key that follows goes elsewhere.
- Messages of a page are handled in the order in which it sent them. ipykernel 7 may let one overtake another.
- A drag ends where the button was released. ``rendercanvas`` holds moves back for some milliseconds but not the
  release, which would otherwise overtake the last of them, or all of a quick drag's.
- A frame that the page never confirms (its connection was cut) holds up the next ones no longer than ``LOST``.
- Keys that are held are released when the keyboard goes elsewhere, where the page does not hear of their release.
- A widget that is shown in two pages is drawn as long as one of them has it in sight.
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

LATE = 0.25
"""Seconds for which messages wait for one that they have overtaken."""

SCRIPT = """
{
  const tell = RenderviewAnywidgetModel.prototype.onEvent
  RenderviewAnywidgetModel.prototype.onEvent = function (event) {
    this.page ??= Math.random()
    this.told = (this.told ?? 0) + 1
    tell.call(this, { ...event, page: this.page, number: this.told })
  }
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
      // A page that hides the widget says that none shows it. Say otherwise, once this change is through.
      this.anymodel.on('change:_has_visible_views', () => setTimeout(() => {
        if (!this.anymodel.get('_has_visible_views') && this.views.some(view => view.isVisible)) {
          this.updateVisibility()
        }
      }))
    }
    add.call(this, view)
  }
}
"""
"""Appended to the widget's own script, whose classes it patches."""


class Ordered:
    """Messages of pages, passed on in the order in which each page numbered its own, from 1 on.

    Args:
        loop: the event loop of the only thread that calls ``take``.
        pass_on: what handles a message.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, pass_on: Callable[[Any], None]) -> None:
        self._loop, self._pass_on = loop, pass_on
        self._due: dict[float, int] = {}
        self._early: dict[float, dict[int, Any]] = {}

    def take(self, page: float, number: int, message: Any) -> None:
        """Pass on a message, and those that waited for it, or let it wait for those before it."""
        early, due = self._early.setdefault(page, {}), self._due.setdefault(page, 1)
        early[number] = message
        self._go_on(page, min(number, due))
        if number in early:
            self._loop.call_later(LATE, self._give_up, page, number)

    def _give_up(self, page: float, number: int) -> None:
        """Wait no longer for the messages before this one: they were lost."""
        early = self._early[page]
        while number in early:
            self._go_on(page, min(early))

    def _go_on(self, page: float, number: int) -> None:
        early = self._early[page]
        while number in early:
            message = early.pop(number)
            number += 1
            self._due[page] = max(self._due[page], number)
            self._pass_on(message)


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
            self._ordered = None if self._home is None else Ordered(self._home, self._handle)
            self.pasted: Callable[[str], None] = lambda text: None
            self._held: dict[str, str] = {}
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
            page, number = content.pop("page", None), content.pop("number", 0)
            if self._ordered is None or page is None:
                self._at_home(self._handle, (widget, content, buffers))
            else:
                self._at_home(self._ordered.take, page, number, (widget, content, buffers))

        def _handle(self, message: tuple[Any, dict[str, Any], Sequence[Any]]) -> None:
            self._go_on()
            content = message[1]
            kind, key = content.get("type"), str(content.get("key", ""))
            if kind == "orograph_paste":
                self.pasted(str(content.get("text", "")))
                return
            if kind == "key_down":
                self._held[key.lower()] = key
            elif kind == "key_up":
                self._held.pop(key.lower(), None)
            elif kind == "focus_out":
                self._release()
            super()._rfb_handle_msg(*message)

        def _release(self) -> None:
            """Release the keys that are held."""
            held, self._held = self._held, {}
            for key in held.values():
                self.submit_event({"event_type": "key_up", "key": key, "modifiers": (), "time_stamp": 0.0})

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
