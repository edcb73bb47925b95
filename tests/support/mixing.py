"""A program that mixes colours in rounds, and may be killed at a place of its own choosing.

``--die before:3`` kills it before its third message to the lab, ``--die after:3`` when the lab has carried
that out and before the program knows. Each round asks for chance, decides, computes, and checks a condition.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import sys

import httpx

from labos.client import Experiment, LabClient

WELLS = 2


class Dying(httpx.BaseTransport):
    """Carries requests, and kills this process at one of them. Heartbeats do not count."""

    def __init__(self, inner: httpx.BaseTransport, die: str) -> None:
        self._inner = inner
        self._when, _, number = die.partition(":")
        self._left = int(number or 0)

    def handle_request(self, request: httpx.Request) -> httpx.Response:
        counts = request.method == "POST" and not request.url.path.endswith("/heartbeat")
        self._left -= counts
        is_due = counts and self._left == 0
        if is_due and self._when == "before":
            os.kill(os.getpid(), signal.SIGKILL)
        response = self._inner.handle_request(request)
        if is_due:
            response.read()
            os.kill(os.getpid(), signal.SIGKILL)
        return response


class DyingClient(LabClient):
    die = ""

    def _open_http(self) -> httpx.Client:
        client = super()._open_http()
        client._transport = Dying(client._transport, self.die)
        return client


def add_up(colors: list[float]) -> float:
    return round(sum(colors), 6)


def mix(lab: LabClient, resume: str, rounds: int) -> list[float]:
    """The sums of what was mixed, round by round."""
    found = []
    with Experiment(lab, "mixing", "bo", closing="cp_trashplate", resume=resume) as experiment:
        experiment.run("cp_newplate")
        with experiment.loop("mix", rounds=rounds) as loop:
            for number in range(rounds):
                wells = [f"{'ABCDEFGH'[number]}{column + 1}" for column in range(WELLS)]
                amounts = [round(experiment.random.uniform(20, 90), 1) for _ in wells]
                # Chance that is not the log's: another one each time that the program is started.
                extra = experiment.decide("extra", lambda: [round(random.uniform(20, 90), 1)] * WELLS)
                payload = {
                    "color_A_volumes": amounts,
                    "color_B_volumes": extra,
                    "color_C_volumes": [20.0] * WELLS,
                    "destination_wells": wells,
                    "use_existing_resources": number > 0,
                }
                experiment.run("cp_mixcolor", payload)
                found.append(experiment.compute(add_up, [*amounts, *extra], where="local"))
                if loop.check("all mixed", number + 1 == rounds):
                    break
        experiment.run("cp_trashplate")
    return found


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--home")
    parser.add_argument("--resume", default="")
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--die", default="")
    given = parser.parse_args()
    DyingClient.die = given.die
    with DyingClient(home=given.home) as lab:
        json.dump(mix(lab, given.resume, given.rounds), sys.stdout)


if __name__ == "__main__":
    main()
