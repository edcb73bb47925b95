"""A kernel in a process of its own: claims the lab and appends until somebody stops it.

Run as ``python -m tests.integration.store.writer URL [batch]``. Prints the position after every
append that was acknowledged, and the message of the error that ends it.
"""

from __future__ import annotations

import sys

from labos.errors import LabosError
from labos.store import open_store
from tests.integration.store.records import LAB, LEASE_S, batch


def say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def main(url: str, size: int = 3) -> None:
    store = open_store(url)
    try:
        head = store.claim(LAB, "the writer", LEASE_S)
        say(str(head.position))
        while True:
            head = store.append(head, batch(head, size))
            say(str(head.position))
    except LabosError as error:
        say(f"{type(error).__name__}: {error}")
    finally:
        store.close()


if __name__ == "__main__":
    main(sys.argv[1], *(int(argument) for argument in sys.argv[2:]))
