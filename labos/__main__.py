"""``labos`` and ``python -m labos``."""

from __future__ import annotations

import sys


def main() -> None:
    _load_structlog_plainly()
    from labos.cli.app import main as run

    sys.exit(run())


def _load_structlog_plainly() -> None:
    """structlog takes up rich where it finds it, only to colour tracebacks, and that is a third of
    the time in which a node's process starts. What asks for rich by itself finds it afterwards."""
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
