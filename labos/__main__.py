"""``labos`` and ``python -m labos``."""

from __future__ import annotations

import sys


def main() -> None:
    from labos.cli.app import main as run

    sys.exit(run())


if __name__ == "__main__":
    main()
