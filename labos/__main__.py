"""``labos`` and ``python -m labos``."""

from __future__ import annotations

import sys


def main() -> None:
    _load_structlog_plainly()
    from labos.cli.app import main as run

    sys.exit(run())


def _load_structlog_plainly() -> None:
    """structlog imports rich, if it is installed, only to colour tracebacks. That takes a third of the start
    of a node's process, so rich is hidden during this import. Code that needs rich can import it
    afterwards."""
    hidden = "rich" not in sys.modules
    if hidden:
        sys.modules["rich"] = None  # type: ignore[assignment]
    try:
        import structlog  # noqa: F401
    finally:
        if hidden:
            del sys.modules["rich"]


if __name__ == "__main__":
    main()
