"""Places for tiles against a list that is searched."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from orograph.slots import HELD, Slots

ACTIONS = st.lists(
    st.tuples(st.sampled_from(["use", "take", "hold", "release"]), st.integers(0, 7), st.integers(0, 2)), max_size=60
)


@given(st.integers(1, 5), ACTIONS)
def test_what_was_used_longest_ago_leaves(capacity: int, actions: list[tuple[str, int, int]]) -> None:
    slots: Slots[int] = Slots(capacity)
    there: dict[int, tuple[int, int]] = {}  # by key: its slot and last use
    for now, (what, key, back) in enumerate(actions):
        if what == "take" and key not in there:
            before = now - back
            oldest = min(there, key=lambda k: there[k][1:] + there[k][:1], default=None)
            slot, gone = slots.take(key, before)
            if len(there) < capacity:
                assert gone is None and slot not in {place for place, _ in there.values()}
            elif there[oldest][1] < before:
                assert (slot, gone) == (there.pop(oldest)[0], oldest)
            else:
                assert (slot, gone) == (-1, None)
                continue
            assert slots.last[slot] == HELD
            slots.last[slot] = now
            there[key] = slot, now
        elif what == "use" and key in there:
            slot, last = there[key]
            slots.touch([slot], now - back)
            there[key] = slot, max(last, now - back)
        elif what == "hold" and key in there:
            slots.last[there[key][0]] = HELD
            there[key] = there[key][0], HELD
        elif what == "release" and key in there:
            slots.release(key)
            del there[key]
        assert {k: slots.find(k) for k in range(8) if slots.find(k) >= 0} == {k: s for k, (s, _) in there.items()}
        assert len(slots) == len(there)
        assert slots.room(now) == capacity - sum(last >= now for _, last in there.values())
