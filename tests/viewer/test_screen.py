"""How drafts follow the speed of a device."""

from __future__ import annotations

from orograph.viewer.screen import DRAFTS, Draft


def settle(draft: Draft, seconds: float) -> float:
    """A device that takes so long for a full picture, in proportion to its pixels."""
    for _ in range(100):
        draft.tell(0.004 + seconds * draft.scale**2)
    return 0.004 + seconds * draft.scale**2


def test_a_fast_device_draws_all_pixels():
    for slow in (False, True):
        draft = Draft(slow)
        assert settle(draft, 0.015) < 0.03
        assert draft.scale == 1.0


def test_a_slow_device_draws_as_many_as_it_can():
    for seconds in (0.1, 0.2, 0.5):
        draft = Draft()
        assert settle(draft, seconds) < 0.1
        assert draft.scale < 1.0
        scale = draft.scale
        settle(draft, seconds)
        assert draft.scale == scale  # and does not swing


def test_a_very_slow_device_is_not_waited_for():
    draft = Draft()
    draft.tell(2.0)
    draft.tell(2.0)
    assert draft.scale == DRAFTS[-1]
