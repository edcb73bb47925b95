"""Makes simulated devices stand still in the midst of a motion: Python loads this at start when its folder is
on PYTHONPATH. What runs is the real thing; only the device takes its time.

A file ``<LABOS_HOLD>/<module>`` holds ``<pause> <word>``: at that pause of its motion (1: the first) the
device writes the word into ``<module>.held`` and stands still as long as the file says so. It can be stopped
meanwhile, as in any motion.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

SOON_S = 0.005
"""How often (real time) a device that stands still looks whether it may go on."""

FOLDER = Path(os.environ.get("LABOS_HOLD", ""))


def read_pause(name: str) -> tuple[int, str]:
    """At which pause to stand still, and the word; 0 for none."""
    try:
        pause, word = (FOLDER / name).read_text().split()
    except (OSError, ValueError):
        return 0, ""
    return int(pause), word


if "LABOS_HOLD" in os.environ and "node" in sys.argv:
    from labos_drivers._simulation import Simulated

    take_time = Simulated.take_time
    passed: dict[str, int] = {}

    async def hold_motion(self: Any, nominal_s: float) -> None:
        await take_time(self, nominal_s)
        pause, word = read_pause(self.name)
        passed[word] = passed.get(word, 0) + 1
        if not pause or passed[word] != pause:
            return
        (FOLDER / f"{self.name}.held").write_text(word)
        while read_pause(self.name) == (pause, word):
            await take_time(self, SOON_S * self._setup.pace)

    Simulated.take_time = hold_motion  # type: ignore[method-assign]
