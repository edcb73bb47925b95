"""What a forecast of a whole queue takes: processor time for 50 and for 200 runs that wait in a simulated lab
with more than they need. Each of them must have a start and an end with a range.
"""

from __future__ import annotations

import time

import msgspec
from msgspec.structs import replace

from labos.core.state import encode_picture
from labos.planning.hindsight import Hindsight
from labos.planning.lab_forecast import ForecastRequest, LabForecast, forecast_lab
from labos.testing.faults import QUIET
from labos.testing.lab import SimulatedLab
from tests.benchmarks.figures import Figure, Report, times
from tests.simulation.calibration import jobs, well_stocked

FEW, MANY = 50, 200
MUST = 2.0
"""How much more a run may cost among many than among few."""

SUBMITTED_S = 5.0
"""Lab seconds in which all are submitted and the first ones begin."""


class Work(msgspec.Struct):
    """A forecast of so many runs: what it took of the processor, and how long the lab will go on."""

    runs: int
    took_s: float
    ahead_s: float
    whole: int


def request(count: int) -> ForecastRequest:
    """A lab to which so many runs have just been submitted that throw their plates away: none waits for a
    person."""
    lab = SimulatedLab(well_stocked(), 1, QUIET)
    try:
        routes = [job for job in jobs(3 * count, 1, batches=True) if job.runs[0].plan.workflow != "pcr"]
        asked = [replace(job, after_s=0.01 * n) for n, job in enumerate(routes[:count])]
        state = lab.run_for(asked, SUBMITTED_S)
        return ForecastRequest(encode_picture(state), state.recorded_at, Hindsight())
    finally:
        lab.close()


def forecast(count: int) -> Work:
    asked = request(count)
    began = time.process_time()
    told = forecast_lab(asked)
    took_s = time.process_time() - began
    last = max(run.ends.latest_at for run in told.runs if run.ends is not None)
    return Work(len(told.runs), took_s, (last - asked.now) / 1e9, count_whole(told))


def count_whole(told: LabForecast) -> int:
    """How many runs have a start and an end, each with a range."""
    return sum(run.starts is not None and run.ends is not None for run in told.runs)


def report(few: Work, many: Work) -> Report:
    ratio = (many.took_s / many.runs) / (few.took_s / few.runs)
    return Report(
        [
            Figure(
                f"forecast of {many.runs} runs that wait",
                f"{many.took_s:.1f} s",
                f"{few.runs}: {few.took_s:.1f} s",
                f"{times(ratio)} a run",
                f"≤ {MUST:g} ×",
                ratio <= MUST,
            ),
            Figure(
                "of these with start and end",
                str(many.whole),
                must=str(many.runs),
                ok=many.whole == many.runs,
            ),
        ],
        [
            f"the lab is carried on by {many.ahead_s / 3600:.0f} h, "
            f"{many.ahead_s / many.took_s:.0f} times as fast as it works"
        ],
    )


def measure() -> Report:
    return report(forecast(FEW), forecast(MANY))


def smoke() -> Report:
    return report(forecast(2), forecast(4))
