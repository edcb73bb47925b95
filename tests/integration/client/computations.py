"""Functions that the tests of computations have computed elsewhere."""

from __future__ import annotations

import os
import signal
from pathlib import Path


def square(number: float) -> float:
    return number * number


def mean(numbers: list[float], *, scale: float = 1.0) -> dict[str, float]:
    return {"mean": scale * sum(numbers) / len(numbers)}


def spectrum(length: int) -> list[int]:
    return list(range(length))


def pair(number: int) -> tuple[int, int]:
    return number, number + 1


def divide(number: int) -> float:
    return 1 / number


def die_once(folder: str) -> str:
    """The first worker that comes here is killed; the next one finds its mark."""
    mark = Path(folder, "died")
    if not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return "alive"


def die(_: int) -> None:
    os.kill(os.getpid(), signal.SIGKILL)
