"""A program that has Globus compute, carry a flow out and a file over, and publishes there; tests kill it.

python -m tests.integration.client.far_away LAB GLOBUS EXPERIMENT
"""

from __future__ import annotations

import sys
from types import SimpleNamespace

from labos.client import Experiment, LabClient
from tests.integration.client import computations as work
from tests.integration.client import test_globus as given


def main() -> None:
    url, globus, resume = sys.argv[1:]
    fake = given.Fake(SimpleNamespace(), globus)
    with (
        LabClient(url) as lab,
        Experiment(lab, "far away", "ada", resume=resume, keep_open=True) as experiment,
    ):
        experiment.configure_compute(globus=fake.endpoint())
        experiment.configure_transfer(globus=fake.carrier())
        print(experiment.compute(work.square, 3, where="globus"))
        print(experiment.run_flow(fake.flow(), values=[1.0, 2.0]).state["output"]["Fit"]["mean"])
        print(experiment.transfer(given.SOURCE, given.TARGET).bytes)
        experiment.publish("A grey", index=fake.index())
        print("published")


if __name__ == "__main__":
    main()
