"""NAME: runs a workflow with several values and stores each result.

With a lab running (`labos up WORKCELL --simulate`):

    python NAME.py --home lab --user ada

If it was killed, `labos experiments` shows its experiment, and it continues with `--resume E1`.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from labos.client import Experiment, LabClient
from labos.errors import LabosError

WORKFLOW = Path(__file__).with_name("NAME.yaml")
SECONDS = (2.0, 3.0, 4.0)


def try_out(lab: LabClient, user: str, resume: str = "") -> dict[float, float]:
    """How long a run took, in seconds, by how long the sealer pressed."""
    took: dict[float, float] = {}
    with (
        Experiment(lab, "NAME", user, resume=resume) as experiment,
        experiment.loop("pressing times", seconds=SECONDS) as loop,
    ):
        for seconds in SECONDS:
            result = experiment.run(WORKFLOW, {"seconds": seconds})
            took[seconds] = round((result.ended_at - result.started_at) / 1e9, 1)
            # Compute here what to try next, and say why: it goes into the lab's log.
            experiment.log_decision("go on", seconds < SECONDS[-1], took_s=took[seconds])
        loop.report(runs=len(took))
    return took


def main() -> int:
    parser = argparse.ArgumentParser(description="Run a workflow with several values.")
    parser.add_argument("--home", help="the lab's folder")
    parser.add_argument("--url", default="", help="the lab's address, instead of its folder")
    parser.add_argument("--user", default="ada", help="the user of the experiment")
    parser.add_argument("--resume", default="", help="the experiment to go on with, such as E1")
    given = parser.parse_args()
    try:
        with LabClient(given.url, home=given.home) as lab:
            took = try_out(lab, given.user, given.resume)
    except LabosError as error:
        print(f"NAME: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    for seconds, run_s in took.items():
        print(f"pressed {seconds:g} s: the run took {run_s:g} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
