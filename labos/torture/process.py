"""A driver's node as a separate process with a watched event loop, which the suite can kill."""

from __future__ import annotations

import argparse
import asyncio
import importlib
from pathlib import Path
from typing import Any

from labos.bootstrap import load_driver, run_node
from labos.node.node import Node
from labos.settings import Settings
from labos.telemetry.logs import configure_logs
from labos.torture.watch import LoopWatch


def main() -> None:
    """``python -m labos.torture.process DRIVER NAME --home DIR --connect ENDPOINT …``"""
    parser = argparse.ArgumentParser()
    parser.add_argument("driver")
    parser.add_argument("name")
    parser.add_argument("--home", required=True)
    parser.add_argument("--workcell", required=True)
    parser.add_argument("--connect", required=True)
    parser.add_argument("--blocks", required=True)
    parser.add_argument("--simulate", action="store_true")
    parser.add_argument("--wait", action="append", default=[])
    options = parser.parse_args()
    configure_logs("info")
    node = load_driver(options.driver)
    for wait in options.wait:
        _set_wait(wait)
    asyncio.run(
        run_node(
            _watch(node, LoopWatch(Path(options.blocks), node.__module__.partition(".")[0])),
            options.name,
            options.workcell,
            Settings.make(options.home),
            connect=[options.connect],
            simulate=options.simulate,
            with_parent=True,
            finish_s=0.0,
        )
    )


def _watch(node: type[Node], watch: LoopWatch) -> type[Node]:
    """The driver's class; the watch starts when it connects its device."""

    class Watched(node):  # type: ignore[misc, valid-type]
        __doc__ = node.__doc__
        watching = False

        async def connect(self) -> None:
            if not self.watching:
                self.watching = True
                watch.start()
            await super().connect()

    return Watched


def _set_wait(wait: str) -> None:
    """Give a constant of a module another value: ``module:NAME=seconds``. Raises AttributeError."""
    place, _, seconds = wait.partition("=")
    module, _, name = place.partition(":")
    found: Any = importlib.import_module(module)
    if not hasattr(found, name):
        raise AttributeError(f"{module} has no {name} to be shortened")
    setattr(found, name, float(seconds))


if __name__ == "__main__":
    main()
