"""A simulated beamline as an EPICS IOC, on ``softioc``: a detector that sees speckle, and a microscope.

It looks at the simulated bench: what the arm mixed, and whether a drop hung after the detector was armed.
Spheres in the drop move by Brownian motion, and each pixel sees a speckle that forgets itself at the rate
D q². All sizes are those of a small area of a fast detector; numbers are plausible, and invented.

    WORLD=lab/world/aps_8id.db python specs/apps/pendant_drop/beamline_ioc.py

``FAULTS`` is a list by commas of what goes wrong with the first series: ``dark`` (no beam), ``bright`` (no
attenuator helps) or nothing.
"""

import contextlib
import json
import math
import os
import sqlite3
import sys
import threading
import time

import numpy as np
from softioc import asyncio_dispatcher, builder, softioc

BOLTZMANN = 1.380649e-23
TEMPERATURE_K = 298.15
VISCOSITY_PAS = {"water": 0.89e-3, "glycerol_30": 2.2e-3, "glycerol_50": 5.0e-3}
RADIUS_NM = {"silica_30": 30.0, "silica_50": 50.0, "silica_100": 100.0, "silica": 50.0}

SIDE, MOST_FRAMES = 40, 400
Q_PER_PIXEL = 1.0e6  # 1/m
CENTRE = -12.0  # in pixels: where the beam would hit, outside of the area
MODES = 3  # how many patterns add up in a pixel: contrast 1/3
PHOTONS = 400.0  # a pixel and frame, without an attenuator
MOST_COUNTS = 255


def diffusion(liquid, particle):
    """Stokes and Einstein, in m²/s."""
    radius = RADIUS_NM[particle] * 1e-9
    return BOLTZMANN * TEMPERATURE_K / (6 * math.pi * VISCOSITY_PAS[liquid] * radius)


def q_of_pixels():
    rows, columns = np.mgrid[0:SIDE, 0:SIDE]
    return Q_PER_PIXEL * np.hypot(rows - CENTRE, columns - CENTRE)


def speckle(rate, frames, period, photons, random):
    """Counts by frame and pixel: intensities of fields that forget themselves at ``rate`` (1/s), and the
    noise of counting."""
    keep = np.exp(-rate * period)
    renew = np.sqrt(1 - keep**2)

    def fresh():
        real, imaginary = random.normal(size=(2, MODES, *rate.shape)) / math.sqrt(2)
        return real + 1j * imaginary

    field = fresh()
    counts = np.empty((frames, *rate.shape), dtype="uint8")
    for number in range(frames):
        counts[number] = np.minimum(
            random.poisson(photons * np.mean(np.abs(field) ** 2, axis=0)), MOST_COUNTS
        )
        field = keep * field + renew * fresh()
    return counts


def microscope(hangs):
    """A picture: the tip, and a drop under it."""
    rows, columns = np.mgrid[0:64, 0:64]
    picture = np.full((64, 64), 200, dtype="uint8")
    picture[(np.abs(columns - 32) < 4) & (rows < 18)] = 60
    if hangs:
        picture[((rows - 30) / 14) ** 2 + ((columns - 32) / 11) ** 2 < 1] = 110
    return picture


class Bench:
    """What the arm has really done, as the simulated bench keeps it."""

    def __init__(self, path):
        self.path = path

    def motions(self, after=0):
        words = (
            "SELECT seq, verb, facts FROM motion"
            " WHERE seq > ? AND verb IN ('create_sample', 'run_droplet') ORDER BY seq"
        )
        try:
            with contextlib.closing(sqlite3.connect(f"file:{self.path}?mode=ro", uri=True, timeout=5)) as db:
                return [(seq, verb, json.loads(facts)) for seq, verb, facts in db.execute(words, (after,))]
        except sqlite3.OperationalError:
            return []  # the lab has not begun yet


class Beamline:
    def __init__(self, bench, faults, seed):
        self.bench, self.faults = bench, faults
        self.random = np.random.default_rng(seed)
        self.armed_at = None

    def arm(self):
        if not os.path.exists(self.bench.path):
            print(f"There is no simulated bench {self.bench.path}: no drop will be seen.", flush=True)  # noqa: T201
        seen = self.bench.motions()
        self.armed_at = seen[-1][0] if seen else 0

    def expose(self, frames, period, transmission):
        """A series and a picture; the series is None if no drop was seen."""
        drops = [facts for _, verb, facts in self.bench.motions(self.armed_at) if verb == "run_droplet"]
        self.armed_at = None
        if not drops or drops[-1].get("fell"):
            return None, microscope(False)
        made = [facts for _, verb, facts in self.bench.motions() if verb == "create_sample"][-1]
        rate = diffusion(made["liquid_1"], made["liquid_2"]) * q_of_pixels() ** 2
        fault = self.faults.pop(0) if self.faults else ""
        photons = {"dark": 0.0, "bright": PHOTONS}.get(fault, PHOTONS * transmission)
        return speckle(rate, frames, period, photons, self.random), microscope(True)


def main():
    world = os.environ.get("WORLD", "")
    if not world:
        sys.exit("Set WORLD to the file of the lab's simulated bench, as lab/world/aps_8id.db.")
    faults = [fault.strip() for fault in os.environ.get("FAULTS", "").split(",") if fault.strip()]
    beamline = Beamline(Bench(world), faults, int(os.environ.get("SEED", "0")))
    dispatcher = asyncio_dispatcher.AsyncioDispatcher()
    builder.SetDeviceName(os.environ.get("PREFIX", "8IDI"))

    builder.longIn("Boot", initial_value=time.time_ns() % 2**31)
    state = builder.mbbIn("State", "Idle", "Armed", "Exposing", initial_value=0)
    drop = builder.boolIn("Drop", "No", "Yes", initial_value=0)
    last = builder.stringIn("Last", initial_value="")
    builder.longIn("Side", initial_value=SIDE)
    builder.aIn("QPerPixel", initial_value=Q_PER_PIXEL, PREC=3)
    builder.aIn("Centre", initial_value=CENTRE, PREC=3)
    builder.aIn("Temperature", initial_value=TEMPERATURE_K, PREC=2)
    shape = builder.longIn("Taken", initial_value=0)
    series = builder.WaveformIn("Series", [0], FTVL="UCHAR", length=SIDE * SIDE * MOST_FRAMES)
    picture = builder.WaveformIn("Microscope", [0], FTVL="UCHAR", length=64 * 64)
    frames = builder.longOut("Frames", initial_value=256, always_update=True)
    period = builder.aOut("Period", initial_value=2e-5, always_update=True)
    transmission = builder.aOut("Transmission", initial_value=0.1, always_update=True)
    job = builder.stringOut("Job", initial_value="", always_update=True)

    def arm(_):
        beamline.arm()
        last.set(job.get())
        state.set(1)

    def expose(_):
        state.set(2)
        taken, seen = beamline.expose(
            min(frames.get(), MOST_FRAMES), period.get(), min(transmission.get(), 1.0)
        )
        drop.set(int(taken is not None))
        series.set((taken if taken is not None else np.zeros(0, "uint8")).reshape(-1))
        shape.set(0 if taken is None else len(taken))
        picture.set(seen.reshape(-1))
        last.set(job.get())
        state.set(0)

    builder.boolOut("Arm", "Done", "Arm", on_update=arm, blocking=True, always_update=True)
    builder.boolOut("Expose", "Done", "Expose", on_update=expose, blocking=True, always_update=True)
    builder.boolOut("Reset", "Done", "Reset", on_update=lambda _: state.set(0), always_update=True)

    builder.LoadDatabase()
    softioc.iocInit(dispatcher)
    print("the IOC is up", flush=True)  # noqa: T201
    threading.Event().wait()


if __name__ == "__main__":
    main()
