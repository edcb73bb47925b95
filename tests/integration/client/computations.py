"""Functions that the tests of computations have computed elsewhere."""

from __future__ import annotations

import os
import signal
import sys
import time
from pathlib import Path

from labos.services.compute import Computing


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


def process_after(seconds: float) -> int:
    """The process in which it was computed."""
    time.sleep(seconds)
    return os.getpid()


def main() -> None:
    """Says which two workers it has; one of them waits, the other computes until it is killed."""
    computing = Computing({"pool": 2})
    workers: set[int] = set()
    while len(workers) < 2:
        both = [computing.submit(process_after, (0.1,)) for _ in range(2)]
        workers |= {each.result() for each in both}
    computing.submit(process_after, (600.0,))
    sys.stdout.write(f"{' '.join(map(str, workers))}\n")
    sys.stdout.flush()
    time.sleep(600)


if __name__ == "__main__":
    main()
