"""What users give for a scene's options in Python: the command line's texts, and what makes no sense."""

import numpy as np
import pytest

import orograph
from orograph.errors import OrographError, UsageError
from orograph.scene.parts import OPTIONS

HEIGHTS = np.add.outer(np.arange(40.0), np.sin(np.arange(40.0) / 4) * 9).astype(np.float32)


def drawn(**options):
    return orograph.render(HEIGHTS, size=(48, 32), progress=False, **({"samples": 1} | options))


@pytest.mark.parametrize(
    ("text", "same"),
    [
        ({"contours": "auto"}, {"contours": orograph.Contours()}),
        ({"contours": "10"}, {"contours": 10}),
        ({"range": "5:30"}, {"range": (5, 30)}),
        ({"water": "none"}, {"water": None}),
        ({"water": "12"}, {"water": 12}),
        ({"sun": "250,30"}, {"sun": (250, 30)}),
        ({"max_memory": "1GiB"}, {"max_memory": 1 << 30}),
    ],
    ids=lambda given: " ".join(given),
)
def test_texts_mean_what_they_mean_on_the_command_line(text, same):
    np.testing.assert_array_equal(drawn(**text).pixels, drawn(**same).pixels)


@pytest.mark.parametrize("name", OPTIONS)
@pytest.mark.parametrize(
    "value", ["nonsense", -np.inf, np.nan, object(), (1,), [[]], {"a": 1}, np.zeros(3), 1 + 2j],
    ids=lambda value: type(value).__name__,
)  # fmt: skip
def test_what_cannot_be_meant_is_an_error_of_ours(name, value):
    try:
        drawn(**{name: value})
    except OrographError as error:
        assert len(str(error)) > 15


def test_the_error_names_the_option():
    for options in ({"contours": "many"}, {"range": "abc"}, {"max_memory": "lots"}, {"water": [1]}, {"priority": 3}):
        with pytest.raises(UsageError, match=f"`{next(iter(options))}`"):
            drawn(**options)
