"""``labos`` and ``python -m labos``."""

from __future__ import annotations

import sys

from labos.imports import import_without


def main() -> None:
    # structlog would load these only to colour tracebacks: a third of the start of a node's process.
    import_without("structlog", "rich", "better_exceptions", "colorama")
    from labos.cli.app import main as run

    sys.exit(run())


if __name__ == "__main__":
    main()
