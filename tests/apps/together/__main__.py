"""``python -m tests.apps.together`` runs all five applications at the same time; ``--seed 1`` kills the
kernel, an application, a compute worker and the broker of Kafka on the way.

Needs the foreign environments ``epics`` and, with ``--kafka`` or ``--seed``, ``kafka``
(``python tests/foreign/make.py epics kafka``).
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import tests.apps.conftest  # noqa: F401 - makes the applications' own modules importable
from tests.apps.together.kills import MORE, WHAT, plan_of
from tests.apps.together.programs import FIVE
from tests.apps.together.scenario import run_together

EVENTS = 1000
"""About so many events five applications make after the last of them has begun."""


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.apps.together", description=__doc__)
    parser.add_argument("--seed", type=int, help="kill each part once, at places that the seed says")
    parser.add_argument("--what", default=",".join(WHAT), help=f"what is killed; more are {', '.join(MORE)}")
    parser.add_argument("--times", type=int, default=1, help="how often each part is killed")
    parser.add_argument("--speed", type=float, default=1500.0, help="simulated time divided by real time")
    parser.add_argument("--detach", action="store_true", help="nodes live on when the kernel is killed")
    parser.add_argument("--kafka", action="store_true", help="carry events to Kafka, too")
    parser.add_argument("--apps", default="", help="only these, by commas")
    parser.add_argument("--folder", type=Path, help="where to keep everything; not kept if left out")
    given = parser.parse_args()
    apps = [app for app in FIVE if not given.apps or app.name in given.apps.split(",")]
    kills = (
        [] if given.seed is None else plan_of(given.seed, given.what.split(","), EVENTS, times=given.times)
    )
    with tempfile.TemporaryDirectory(prefix="together-") as made:
        found = run_together(
            given.folder or Path(made),
            apps,
            speed=given.speed,
            kills=kills,
            detach=given.detach,
            kafka=given.kafka or any(kill.what == "broker" for kill in kills),
        )
    for line in found.lines():
        sys.stdout.write(f"{line}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
