"""The picture in the growth assay's README. Run as a module, this writes it anew."""

from __future__ import annotations

import io

import pytest
from PIL import Image

from labos_drivers._growth import IC50_MG_PER_L
from tests.apps.growth import APP, table

pytest.importorskip("scipy")
pytest.importorskip("matplotlib")

import growth_analysis
import growth_plots

PICTURE = APP / "growth.png"


def picture() -> bytes:
    """Of one plate, as the bench shows it."""
    first = [growth_analysis.check(table(seed=1), "T0")]
    last = [growth_analysis.check(table((12.0, 37.0), seed=2), "T12")]
    curve = growth_analysis.fit(first, last)
    assert curve.ic50 == pytest.approx(IC50_MG_PER_L["tetracycline"], rel=0.1)
    drawn = io.BytesIO()
    growth_plots.draw(first, last, curve, "tetracycline").savefig(drawn, format="png", dpi=100)
    return drawn.getvalue()


def test_the_picture_of_the_readme_shows_what_is_drawn_now() -> None:
    """Fonts and versions of the drawing library differ by a few pixels: what is drawn is about the same."""
    shown = Image.open(PICTURE).convert("L").resize((70, 44))
    drawn = Image.open(io.BytesIO(picture())).convert("L").resize((70, 44))
    apart = [abs(a - b) for a, b in zip(shown.tobytes(), drawn.tobytes(), strict=True)]
    assert sum(apart) / len(apart) < 4, "python -m tests.apps.test_growth_picture"
    assert "(growth.png)" in (APP / "README.md").read_text()


if __name__ == "__main__":
    PICTURE.write_bytes(picture())
