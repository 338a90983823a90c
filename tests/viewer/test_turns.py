"""Members in turn: each is shown as it is, on one scale, and none for less than a third of a second."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rasterio.transform import from_origin

import orograph
from orograph.geovis.data.dataset import Dataset, Uncertainty
from orograph.geovis.data.priority import Priority
from orograph.viewer.data import ShownData
from orograph.viewer.session import Session
from orograph.viewer.turns import Turns

MEMBERS = 5


@pytest.fixture(scope="module")
def ground() -> orograph.Terrain:
    return orograph.terrain(np.zeros((40, 60), np.float32), crs="EPSG:32632", transform=from_origin(5e5, 5.6e6, 10, 20))


def ensemble(**more: Any) -> Dataset:
    """Five members; in member k all values are 10 k, but one."""
    values = 10.0 * np.arange(1, MEMBERS + 1)[:, None, None] + np.zeros((1, 40, 60))
    values[0, 0, 0] = -7
    return Dataset(values.astype(np.float32), band="all", **{"uncertainty": "spread", "name": "warmth", **more})


@given(st.lists(st.floats(0.001, 0.5), min_size=1, max_size=400), st.floats(0.2, 3.0))
def test_no_member_is_seen_for_less_than_its_time(frames: list[float], rate: float) -> None:
    turns = Turns(0, rate, True)
    turns.members = (1, 2, 3)
    since, seen = 0.0, turns.member
    for seconds in frames:
        since += seconds
        changed = turns.advance(seconds)
        assert changed == (turns.member != seen)
        if changed:
            assert since >= 1 / rate - 1e-9 and turns.member == seen % 3 + 1
            since, seen = 0.0, turns.member


@pytest.mark.stress
def test_each_member_is_itself_on_one_scale(ground: orograph.Terrain) -> None:
    """With ``style=members`` they take turns from the beginning; else when asked."""
    session = Session(ground, size=(90, 60), data=ensemble(uncertainty=Uncertainty("spread", style="members", rate=3)))
    try:
        shown = session.settings.shown
        assert shown is not None and shown.turns is not None and shown.turns.on and shown.changing
        values, scales = [], set()
        for _ in range(MEMBERS + 1):
            (painted,) = shown.painted
            values.append(float(np.nanmax(painted.values)))
            scales.add((painted.scale.low, painted.scale.high))
            assert painted.sigma is None and painted.sign == "none"
            assert shown.turns.advance(0.34)
            session.settings.show(ground)
        assert values == [10, 20, 30, 40, 50, 10]
        assert scales == {(-7.0, 50.0)}
        shown.turns.on = False
        session.settings.show(ground)
        (painted,) = shown.painted
        assert float(np.nanmax(painted.values)) == pytest.approx(30) and painted.sigma is not None
    finally:
        session.close()


def test_what_has_no_members_has_no_turns(ground: orograph.Terrain) -> None:
    priority = Priority()
    assert ShownData((ensemble(uncertainty=None),), priority).turns is None
    assert ShownData((ensemble(exceeds=3.0),), priority).turns is None
    one = Dataset(np.ones((1, 40, 60), np.float32), band="all", uncertainty="spread", range=(0, 2))
    alone = ShownData((one,), priority, ground.grid)
    assert alone.turns is not None
    alone.turns.on = True
    assert alone.current(ground) == (one,) and alone.turns.member == 0 and not alone.turns.advance(9)


def test_a_probability_is_of_all_members(ground: orograph.Terrain) -> None:
    shown = ShownData((ensemble(),), Priority(), ground.grid)
    assert shown.turns is not None
    shown.turns.on, shown.exceeds = True, 25.0
    (one,) = shown.current(ground)
    assert one.exceeds == 25.0 and one.member is None
