"""A first colour picker: finds the amounts of three dyes that make a wanted colour.

A small application in one file, to be read first, and for ``labos demo``: a fresh plate, then mix, look and
learn in a loop, then the plate into the trash. It needs nothing that LabOS does not install. The whole
application, which finds the plate in the picture and has several solvers, is ``color_picker/``.

    python specs/apps/first_color_picker.py --home lab --user bo
"""

from __future__ import annotations

import argparse
import random  # noqa: TID251 - an application brings its own randomness, from a seed
import sys
from collections.abc import Iterable

from PIL import ImageStat
from PIL.Image import Image

from labos.client import Experiment, LabClient
from labos.errors import LabosError

Mixture = tuple[float, float, float]
Color = tuple[float, float, float]

TARGET: Color = (120.0, 120.0, 120.0)
"""Red, green and blue, 0 to 255."""

LEAST_UL, MOST_UL = 20.0, 90.0
"""Of each dye: the least that a pipette of 300 µL takes, and what three of which fit into a well."""

CORNERS_PX, HALF_PX = ((155, 93), (641, 90), (157, 402), (639, 402)), 4
"""Where the camera sees A1, A12, H1 and H12 in its picture, and half the side of the square that is looked
at. Another camera is measured once."""


class Solver:
    """Keeps the best half of each generation and varies it."""

    def __init__(self, size: int, seed: int) -> None:
        self.random = random.Random(seed)
        self.population = [self._mixture() for _ in range(size)]

    def ask(self) -> list[Mixture]:
        """The mixtures to try next (µL of each dye)."""
        return self.population

    def tell(self, scores: list[float]) -> None:
        """How far each mixture's colour was from the wanted one."""
        ranked = sorted(zip(scores, self.population, strict=True))
        best = [mixture for _, mixture in ranked[: max(len(ranked) // 2, 1)]]
        children = [self._vary(self.random.choice(best)) for _ in range(len(ranked) - len(best))]
        self.population = [*best, *children]

    def _mixture(self) -> Mixture:
        return _allowed(self.random.uniform(LEAST_UL, MOST_UL) for _ in range(3))

    def _vary(self, mixture: Mixture) -> Mixture:
        return _allowed(ul * self.random.gauss(1.0, 0.2) for ul in mixture)


def _allowed(amounts: Iterable[float]) -> Mixture:
    a, b, c = (round(min(max(ul, LEAST_UL), MOST_UL), 1) for ul in amounts)
    return a, b, c


def color_of(picture: Image, well: str) -> Color:
    """The mean colour in the middle of a well."""
    right, down = (int(well[1:]) - 1) / 11, "ABCDEFGH".index(well[0]) / 7
    shares = ((1 - right) * (1 - down), right * (1 - down), (1 - right) * down, right * down)
    x, y = (sum(s * corner[n] for s, corner in zip(shares, CORNERS_PX, strict=True)) for n in (0, 1))
    middle = picture.crop((round(x) - HALF_PX, round(y) - HALF_PX, round(x) + HALF_PX, round(y) + HALF_PX))
    red, green, blue = ImageStat.Stat(middle.convert("RGB")).mean
    return round(red, 1), round(green, 1), round(blue, 1)


def distance(color: Color) -> float:
    return round(sum((a - b) ** 2 for a, b in zip(color, TARGET, strict=True)) ** 0.5, 1)


def well_names(first: int, count: int) -> list[str]:
    """A1, A2 … H12, row by row."""
    return [f"{'ABCDEFGH'[well // 12]}{well % 12 + 1}" for well in range(first, first + count)]


def pick_color(
    lab: LabClient, user: str, *, rounds: int = 3, wells: int = 4, close: float = 3.0, seed: int = 0
) -> float | None:
    """Run the experiment; returns how near it came, None if there was no picture. Stops early once nearer
    than ``close``."""
    solver = Solver(wells, seed)
    nearest: float | None = None
    with Experiment(lab, "color picker", user, closing="cp_trashplate") as experiment:
        experiment.run("cp_newplate")
        experiment.note("loop_started", "mix and learn", rounds=rounds, target=TARGET)
        for number in range(rounds):
            mixtures = solver.ask()
            names = well_names(number * wells, wells)
            amounts = {f"color_{name}_volumes": [m[i] for m in mixtures] for i, name in enumerate("ABC")}
            result = experiment.run(
                "cp_mixcolor",
                {
                    **amounts,
                    "destination_wells": names,
                    "use_existing_resources": number > 0,
                },
            )
            picture = result.result("Take picture")
            if picture is None:  # its outcome was unknown, and a person has answered that it was taken
                experiment.note("decision", "no picture: the same mixtures again")
                continue
            shown = lab.image(picture)
            colors = [color_of(shown, name) for name in names]
            experiment.note("local_compute", "colors of the wells", picture=picture, colors=colors)
            scores = [distance(color) for color in colors]
            nearest = min(scores if nearest is None else [nearest, *scores])
            enough = nearest < close
            experiment.note("condition_checked", "near enough", nearest=nearest, limit=close, met=enough)
            if enough:
                break
            solver.tell(scores)
            experiment.note("decision", "next mixtures", mixtures=solver.ask())
        experiment.note("loop_ended", "mix and learn", nearest=nearest)
        experiment.run("cp_trashplate")
    return nearest


def main() -> int:
    parser = argparse.ArgumentParser(description="Find the amounts of three dyes that make a wanted colour.")
    parser.add_argument("--home", help="the lab's folder")
    parser.add_argument("--url", default="", help="the lab's address, instead of its folder")
    parser.add_argument("--user", default="bo", help="whose experiment it is")
    parser.add_argument("--rounds", type=int, default=3, help="how often to mix at the most")
    parser.add_argument("--seed", type=int, default=0, help="of the solver")
    parser.add_argument("--patience", type=float, default=30.0, help="how long the lab may be silent (s)")
    given = parser.parse_args()
    try:
        with LabClient(given.url, home=given.home, patience_s=given.patience) as lab:
            nearest = pick_color(lab, given.user, rounds=given.rounds, seed=given.seed)
    except LabosError as error:
        print(f"color picker: {error}", file=sys.stderr)  # noqa: T201
        return 1
    except KeyboardInterrupt:
        return 130
    if nearest is None:
        print("color picker: there was no picture of a plate.", file=sys.stderr)  # noqa: T201
        return 1
    print(f"color picker: nearest {nearest:g} of 255 from the wanted colour.")  # noqa: T201
    return 0


if __name__ == "__main__":
    sys.exit(main())
