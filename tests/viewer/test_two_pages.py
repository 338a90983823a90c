"""A widget in two pages of a browser (see ``test_front_end``)."""

from __future__ import annotations

import numpy as np
import pytest
from test_front_end import SOON, VIEW, page, run, seen

__all__ = ["page"]
pytestmark = pytest.mark.stress


def test_a_cell_in_two_pages(page):
    """It is drawn as long as one of them has it in sight."""
    run(page, 0)
    page.wait_for_selector(f"{VIEW}[src^=blob]", timeout=SOON)
    page.keyboard.press("Control+s")
    page.wait_for_timeout(2000)
    other = page.context.new_page()
    other.goto(page.url.replace("/lab/tree/", "/lab/workspaces/other/tree/"))
    other.wait_for_selector(f"{VIEW}[src^=blob]", timeout=SOON)
    other.evaluate(f"document.querySelector('{VIEW}').style.display = 'none'")
    other.wait_for_timeout(1000)
    page.bring_to_front()  # a page behind another one hardly gets to run
    box = page.locator(VIEW).bounding_box()
    page.mouse.click(box["x"] + 300, box["y"] + 300)
    page.wait_for_timeout(500)
    before = seen(page).astype(int)
    page.mouse.wheel(0, -300)
    for _ in range(50):
        page.wait_for_timeout(200)
        if np.abs(seen(page) - before).mean() > 3:
            return
    raise AssertionError("it is not drawn")
