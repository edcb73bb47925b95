"""The colours of a plate's wells in a picture."""

from __future__ import annotations

from PIL import Image, ImageStat

A1_PX, PITCH_PX, HALF_PX = (112, 71), 37.8, 5
"""The middle of A1 in the picture, the distance of two wells, and half of the square that is looked at."""


def get_colors_from_file(img_path: str) -> tuple[str, dict[str, list[float]]]:
    """The picture's path, and blue, green and red by well."""
    colors = {}
    with Image.open(img_path) as picture:
        shown = picture.convert("RGB")
    for row, letter in enumerate("ABCDEFGH"):
        for column in range(12):
            x, y = A1_PX[0] + PITCH_PX * column, A1_PX[1] + PITCH_PX * row
            box = (round(x) - HALF_PX, round(y) - HALF_PX, round(x) + HALF_PX, round(y) + HALF_PX)
            colors[f"{letter}{column + 1}"] = ImageStat.Stat(shown.crop(box)).mean[::-1]
    return img_path, colors
