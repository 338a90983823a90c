"""Ctrl-C and SIGTERM: the command line ends with 130 or 143 within a second, whatever it is doing.

A signal raises KeyboardInterrupt in the main thread, which cleans up. Libraries may turn that into an error of their
own, so ``asked`` remembers it. A compiler or a driver may block the main thread for seconds, so a thread that the
signal wakes ends the process after ``GRACE``. Until ``guard`` is called there is nothing to clean up.

Numba calls Python to build a kernel's results, and LLVM calls it to look up compiled kernels. Neither checks for an
exception, so one raised there would crash the interpreter; one raised while garbage is collected is lost. A signal that
arrives there is sent again a moment later.

This module is the first that the command line imports, and imports little itself.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from types import FrameType
from typing import NoReturn

GRACE = 0.8  # seconds
AGAIN = 0.005  # seconds until a signal is sent again
CODES = {signal.SIGINT: 130, signal.SIGTERM: 143}
_asked: list[int] = []
_postponed: list[int] = []


class Stopped(KeyboardInterrupt):
    """The system asked the process to end: a scheduler, a shutdown, ``kill``."""


def asked() -> int:
    """The exit code of the signal that asked the process to end; 0 if none did."""
    return CODES[signal.Signals(_asked[0])] if _asked else 0


def guard_imports() -> None:
    """End at once on a signal, if this process is the command line and is still loading."""
    main = sys.modules.get("__main__")
    spec = getattr(main, "__spec__", None)
    name = os.path.basename(getattr(main, "__file__", None) or "")  # noqa: PTH119 (pathlib is not loaded yet)
    if (spec is not None and spec.name == "orograph.__main__") or name.partition(".")[0] == "orograph":
        _handle(lambda signum, frame: end(CODES[signal.Signals(signum)]))


def guard(cleaning: bool = True) -> None:
    """From here on a signal raises KeyboardInterrupt (``Stopped`` for SIGTERM), and ends the process after ``GRACE``.

    Args:
        cleaning: False: SIGTERM ends the process at once, and no deadline follows SIGINT (the window has a loop of its
            own).
    """
    _handle(_raise, *(() if cleaning else (signal.SIGINT,)))
    if not cleaning:
        _handle(signal.SIG_DFL, signal.SIGTERM)
    sys.unraisablehook = _unraisable
    if os.name == "posix":
        reading, writing = os.pipe()
        os.set_blocking(writing, False)
        signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
        grace = GRACE if cleaning else float("inf")
        threading.Thread(target=_watch, args=(reading, grace), daemon=True).start()


def end(code: int) -> NoReturn:
    """Print a message, and end without waiting for anything."""
    os.write(2, b"\norograph: interrupted\n")
    os._exit(code)


def _handle(handler: signal._HANDLER, *signals: signal.Signals) -> None:
    for signum in signals or CODES:
        if signal.getsignal(signum) is not signal.SIG_IGN:  # as for background jobs of a shell
            signal.signal(signum, handler)


def _raise(signum: int, frame: FrameType | None) -> None:
    _asked.append(signum)
    if os.name == "posix" and _called_by_native_code(frame):
        _postponed.append(signum)
        return
    raise KeyboardInterrupt if signum == signal.SIGINT else Stopped


def _called_by_native_code(frame: FrameType | None) -> bool:
    """Whether an exception in this frame would reach machine code that does not check for one."""
    if frame is not None and str(frame.f_globals.get("__name__")).startswith("namedtuple_"):
        return True
    while frame is not None:
        if frame.f_code.co_name == "_numba_unpickle" or "llvmlite" in frame.f_code.co_filename:
            return True
        frame = frame.f_back
    return False


def _unraisable(what: sys.UnraisableHookArgs) -> None:
    """Send a signal again whose interrupt arrived where Python cannot pass it on (a callback during garbage
    collection)."""
    if not isinstance(what.exc_value, KeyboardInterrupt):
        sys.__unraisablehook__(what)
    elif _asked:
        _postponed.append(_asked[-1])


def _watch(reading: int, grace: float) -> None:
    """Resend a signal that came at a bad moment, and end the process ``grace`` seconds after a signal."""
    main = threading.main_thread().ident
    assert main is not None
    while signals := os.read(reading, 1):
        code = CODES.get(signals[0])  # type: ignore[call-overload]
        if code is not None:
            ending = time.monotonic() + grace
            while time.monotonic() < ending:
                time.sleep(AGAIN)
                if _postponed:
                    signal.pthread_kill(main, _postponed.pop())
            output = sys.modules.get("orograph.output")
            if output is not None:
                output.remove_unfinished()
            end(code)
