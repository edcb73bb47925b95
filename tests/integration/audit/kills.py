"""Projects a golden log with a child process that is killed at random moments: ``python -m … URL SEED``."""

from __future__ import annotations

import os
import random
import signal
import sys
import time

from labos.audit import projector
from labos.audit.database import open_audit
from tests.integration.audit.logs import GrowingLog, golden, project

KILLS = 15


def main(url: str, seed: str) -> None:
    rng = random.Random(seed)
    projector.BATCH = 2
    log = GrowingLog(golden("simulated-1"))
    seen = []
    longest_s = 0.05  # until the child is done, on a computer that has nothing else to do
    for _ in range(KILLS):
        child = os.fork()
        if child == 0:
            database = open_audit(url)
            project(log, database)
            os._exit(0)
        time.sleep(rng.uniform(0.0, longest_s))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        database = open_audit(url)
        seen.append(database.prepare().position)
        database.close()
        if seen[-1] == (seen[-2] if len(seen) > 1 else 0) != log.end:
            longest_s *= 1.5  # it got nowhere
        if seen[-1] == log.end:  # from the beginning once more
            longest_s /= 1.5
            database = open_audit(url)
            database.reset()
            database.close()
    print(*seen)


if __name__ == "__main__":
    main(*sys.argv[1:])
