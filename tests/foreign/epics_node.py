"""A shaker, and a tool changer, as an EPICS IOC, on ``softioc``; run by the tests in its own environment.

The records answer over Channel Access and PV Access. Every motion is a line in the file named by TRUTH,
synced before and after it: what really happened.
"""

import asyncio
import json
import os
import threading
import time
from pathlib import Path

from softioc import alarm, asyncio_dispatcher, builder, softioc

TRUTH = Path(os.environ["TRUTH"])


def note(**what):
    with TRUTH.open("a") as file:
        file.write(json.dumps(what) + "\n")
        file.flush()
        os.fsync(file.fileno())


dispatcher = asyncio_dispatcher.AsyncioDispatcher()
builder.SetDeviceName("SHAKER")

boot = builder.longIn("Boot", initial_value=time.time_ns() % 2**31)
state = builder.mbbIn("State", "Idle", "Shaking", "Error", initial_value=0)
why = builder.stringIn("Why", initial_value="")
turns = builder.aIn("Turns", initial_value=0.0)
position = builder.aIn("Position", initial_value=0.0)
heat = builder.aIn("Heat", initial_value=20.0)
plate = builder.boolIn("Plate", "Empty", "Present", initial_value=1)
last = builder.stringIn("Last", initial_value="")

speed = builder.longOut("Speed", initial_value=0, always_update=True)
label = builder.stringOut("Label", initial_value="", always_update=True)
job = builder.stringOut("Job", initial_value="", always_update=True)
mode = builder.mbbOut("Mode", "Gentle", "Rough", initial_value=0)


# Texts of more than 39 characters, and bytes that are no text.
builder.longStringOut("Story", length=256, initial_value="Once", always_update=True)
builder.WaveformOut("Bytes", [72, 105, 0, -56], FTVL="CHAR")
builder.WaveformOut("Image", [200, 201, 0, 7], FTVL="UCHAR")


async def shake(time_s):
    """Put-callback ends with the motion."""
    this = {"speed": speed.get(), "label": label.get()}
    note(what="shake", **this)
    state.set(1)
    await asyncio.sleep(time_s)
    turns.set(this["speed"] * time_s)
    note(what="shaken", label=this["label"])
    last.set(job.get())
    if this["label"] == "jam":
        why.set("The plate is stuck.")
    state.set(2 if this["label"] == "jam" else 0)


async def travel(target):
    """Put-callback ends at once, the motion later, or never for 1000 and more."""
    note(what="travel", target=target)
    state.set(1)

    async def go():
        await asyncio.sleep(1.5)
        if target >= 1000.0:
            return  # it is stuck
        position.set(target)
        note(what="travelled", target=target)
        state.set(0)

    _going.append(asyncio.ensure_future(go()))


def reset(_):
    note(what="reset")
    why.set("")
    heat.set(20.0)
    state.set(0)


def overheat(degrees):
    heat.set(degrees, severity=alarm.MAJOR_ALARM, alarm=alarm.HIHI_ALARM)


_going = []
builder.aOut("Shake", on_update=shake, blocking=True, always_update=True)
builder.aOut("Target", on_update=travel, always_update=True)
builder.boolOut("Reset", "Done", "Reset", on_update=reset, always_update=True)
builder.boolOut("Stop", "Done", "Stop", on_update=lambda _: note(what="stop"), always_update=True)
builder.aOut("Overheat", on_update=overheat, always_update=True)


# A tool changer: 1 locks, 0 unlocks; a sensor tells when its bolt has arrived. Without air it stays.
builder.SetDeviceName("CHANGER")
status = builder.mbbIn("Status", "Unlocked", "Locked", "Between", initial_value=0)
air = builder.boolOut("Air", "Off", "On", initial_value=1)


async def turn(locked):
    note(what="lock" if locked else "unlock")
    if not air.get():
        return
    status.set(2)
    await asyncio.sleep(0.3)
    status.set(int(locked))
    note(what="locked" if locked else "unlocked")


builder.boolOut("Lock", "Unlock", "Lock", on_update=turn, blocking=True, always_update=True)

builder.LoadDatabase()
softioc.iocInit(dispatcher)
note(what="startup")
print("the IOC is up", flush=True)
threading.Event().wait()
