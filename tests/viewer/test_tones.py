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


@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("word", list(theme.legend()))
def test_every_colour_of_the_legend_is_seen_as_meant(word: str, dark: bool) -> None:
    colour = theme.legend(dark)[word]
    assert np.abs(seen(np.array(sent(colour))) - colour).max() <= 2


def test_colours_beyond_the_curve_come_as_close_as_they_can() -> None:
    assert (
        np.abs(seen(np.array(sent((230, 159, 0)))) - (230, 159, 0)).max()
        < np.abs(seen(np.array((230, 159, 0))) - (230, 159, 0)).max()
    )


@pytest.mark.parametrize("dark", [False, True])
def test_buttons_and_the_chosen_tab_can_be_read(dark: bool) -> None:
    def light(colour: tuple[float, ...]) -> float:
        c = np.array(colour) / 255
        return float(np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4) @ [0.2126, 0.7152, 0.0722])

    accent = light(theme.accent(dark)) + 0.05
    ground = light((36, 36, 36) if dark else (255, 255, 255)) + 0.05  # of the page's panels
    assert max(accent, ground) / min(accent, ground) > 4.5
    assert not dark or accent / 0.05 > 4.5  # black words on a button
