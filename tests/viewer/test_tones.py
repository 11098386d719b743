"""The film curve and its inverse: pairs (sent, seen) were read from pictures of a real browser."""

import numpy as np
import pytest

from viewer_app import theme
from viewer_app.tones import seen, sent


@pytest.mark.parametrize(
    ("colour", "picture"),
    [
        ((204, 121, 167), (211, 138, 180)),
        ((0, 114, 178), (0, 121, 187)),
        ((230, 159, 0), (224, 177, 41)),
        ((213, 94, 0), (221, 104, 13)),
        ((20, 20, 20), (4, 4, 4)),
        ((128, 128, 128), (141, 141, 141)),
    ],
)
def test_the_curve_is_the_one_of_the_browser(colour: theme.Colour, picture: theme.Colour) -> None:
    assert np.abs(seen(np.array(colour)) - picture).max() < 1


@pytest.mark.parametrize("colour", [theme.INITIAL, theme.PERSPECTIVE, theme.GEOREFERENCED, theme.CONTROL, theme.FOREGROUND_LIGHT])
def test_what_is_sent_is_seen_as_meant(colour: theme.Colour) -> None:
    assert np.abs(seen(np.array(sent(colour))) - colour).max() <= 2


def test_colours_beyond_the_curve_come_as_close_as_they_can() -> None:
    assert (
        np.abs(seen(np.array(sent(theme.ORTHOGONAL))) - theme.ORTHOGONAL).max()
        < np.abs(seen(np.array(theme.ORTHOGONAL)) - theme.ORTHOGONAL).max()
    )
