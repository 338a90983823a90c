"""Errors made in groups: the same bytes as area by area, also where a group was interrupted or damaged."""

from __future__ import annotations

import pytest
from surfaces import rough, source
from test_in_parts import SIZES, files

from orograph import store
from orograph.store import executing
from orograph.store.survey_groups import ErrorGroups

KINDS = ("exact", "wedgie", "midpoint")


def in_groups(patch, levels):
    """Let threads make errors in groups."""
    patch.setattr(
        executing.Threads, "groups", lambda self, stage, shape, shard: levels if stage == ErrorGroups.name else 0
    )


@pytest.mark.cases(1)
@pytest.mark.parametrize(("shape", "levels"), [((700, 530), 1), ((513, 512), 2), ((1200, 66), 4)])
def test_groups_make_what_areas_make(tmp_path, monkeypatch, shape, levels):
    given = source(rough(shape, 3, missing=0.01, hole=True))
    store.build(given, tmp_path / "whole", errors=KINDS, **SIZES).close()
    in_groups(monkeypatch, levels)
    store.build(given, tmp_path / "s", errors=KINDS, **SIZES).close()
    assert files(tmp_path / "s") == files(tmp_path / "whole")


@pytest.mark.stress
def test_a_whole_raster_has_no_states(tmp_path, monkeypatch):
    given = source(rough((1025, 1025), 5))
    store.build(given, tmp_path / "whole", **SIZES).close()
    in_groups(monkeypatch, 2)
    store.build(given, tmp_path / "s", **SIZES).close()
    assert files(tmp_path / "s") == files(tmp_path / "whole")


@pytest.mark.cases(1)
@pytest.mark.parametrize("damage", ["diamonds/1/radius/c/0/0", "parts/errors/groups/2.0.0.part"])
def test_groups_go_on(tmp_path, monkeypatch, damage):
    given = source(rough((700, 530), 3, missing=0.01))
    store.build(given, tmp_path / "whole", **SIZES).close()
    in_groups(monkeypatch, 2)

    class Stop(Exception):
        pass

    def stop(self):
        raise Stop

    with monkeypatch.context() as patch:
        patch.setattr(ErrorGroups, "finish", stop)
        with pytest.raises(Stop):
            store.build(given, tmp_path / "s", **SIZES)
    path = tmp_path / "s.partial" / damage
    path.write_bytes(path.read_bytes()[:-3] + b"xyz")
    made = []
    with monkeypatch.context() as patch:
        make = ErrorGroups.make
        patch.setattr(ErrorGroups, "make", lambda self, spot: (made.append(spot), make(self, spot))[1])
        store.build(given, tmp_path / "s", resume=True, **SIZES).close()
    assert made == [(0, 0)]
    assert files(tmp_path / "s") == files(tmp_path / "whole")
