"""The pictures of the applications' pages are those that the applications draw."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image

from tests.apps.pictures import APPS, PICTURES, draw_picture, picture_of


@pytest.mark.parametrize("app", PICTURES)
def test_the_picture_of_a_page_is_the_one_that_is_drawn(app: str) -> None:
    """Letters and points may lie a little elsewhere, by the versions of the libraries."""
    now, kept = (
        Image.open(io.BytesIO(c)).convert("L") for c in (draw_picture(app), picture_of(app).read_bytes())
    )
    assert now.size == kept.size
    apart = np.abs(np.asarray(now, float) - np.asarray(kept, float))
    assert np.mean(apart) < 12, "draw it anew: python -m tests.apps.pictures"
    assert np.std(np.asarray(kept)) > 20, "it shows something"
    assert f"]({app}.png)" in (APPS / app / "README.md").read_text("utf-8")
