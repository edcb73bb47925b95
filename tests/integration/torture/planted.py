"""Bugs that people have built into drivers, one of each kind, each planted in a good one.

Each is a check that finds it, what of ``shaker.py`` is replaced by what (several pairs, one after the other),
and a part of what the suite then says.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

SHAKER = Path(__file__).with_name("shaker.py")


class Bug(NamedTuple):
    """``changes`` are pairs of texts: what stands in the good driver, and what stands there in its place."""

    check: str
    changes: tuple[tuple[str, str], ...]
    says: str


POLL = 'while (state := self.ask("STAT")) in ("BUSY", "IDLE"):'
ANSWER = '        if answer == "LOCKED":'
ENDS = 'if state == "IDLE" and self.count_done() == before + 1:'
UNLESS_DONE = (
    '            if state == "IDLE" and asked - begun > START_S:\n'
    '                raise DeviceError("It rests, and has not done it: was it switched off?")\n'
)
IN_WORDS = "{FAULTS.get(state, 'nobody knows what that means')}"
IN_ERROR = f'        raise DeviceError(f"It says {{state}}: {IN_WORDS}.")\n'
REFUSED = 'DeviceError("Its drive is locked.", effects="none", remedy="Unlock it.")'
STOP = "    async def stop(self) -> None:\n"
LISTEN = (
    "        return self.line.exchange(question.encode(), ANSWER_S).decode",
    "        try:\n"
    "            said = self.line.exchange(question.encode(), ANSWER_S)\n"
    "        except NoReply:\n"
    '            return "LOST"\n'
    "        return said.decode",
)
NO_REPLY = ("from labos.node import (", "from labos.errors import NoReply\nfrom labos.node import (")
LENIENT = (
    "        return self.line.exchange(question.encode(), ANSWER_S).decode",
    "        try:\n"
    "            said = self.line.exchange(question.encode(), ANSWER_S)\n"
    "        except LinkError:\n"
    '            return "OK"\n'
    "        return said.decode",
)
LINK_ERROR = ("from labos.node import (", "from labos.errors import LinkError\nfrom labos.node import (")


def take_up(body: str) -> tuple[str, str]:
    return STOP, f"    async def take_up(self, name: str, handle: str) -> None:\n{body}\n{STOP}"


BUGS: dict[str, Bug] = {
    # -- what it says of itself
    "has no unit": Bug("about", (('unit="rpm", ', ""),), "has no unit"),
    "describes nothing": Bug("about", (('        """Shake the plate."""\n', ""),), "has no description"),
    "has a default that it would refuse": Bug("about", (("] = 800.0", "] = 80.0"),), "would refuse"),
    "does not tell what it uses": Bug(
        "happy path", ((', Consumes("grease", 1)', ""),), "declares that it uses 0 grease"
    ),
    "uses twice as much": Bug(
        "happy path", (('self.name, "grease", 1)', 'self.name, "grease", 2)'),), "used 2"
    ),
    "tells another level": Bug(
        "true state", (('self.ask, "GREASE"))', 'self.ask, "GREASE")) + 50'),), "there are"
    ),
    "tells of what nobody knows": Bug(
        "true state", (('return {"grease":', 'return {"fat":'),), "which about does not name"
    ),
    # -- set points
    "always shakes at one speed": Bug("set points", (("SHAKE {speed:.0f}", "SHAKE 900"),), "speed_rpm"),
    "mixes up two arguments": Bug(
        "set points", (("SHAKE {speed:.0f} {time:.1f}", "SHAKE {time:.0f} {speed:.1f}"),), "should"
    ),
    "sends another unit": Bug("set points", (("OIL {volume * 10:.0f}", "OIL {volume:.0f}"),), "volume_ul"),
    "rounds too much": Bug(
        "set points", (("OIL {volume * 10:.0f}", "OIL {volume // 10 * 100:.0f}"),), "volume_ul"
    ),
    # -- the end of a motion
    "does not wait for the end": Bug(
        "happy path",
        (
            (
                "        with assume_motion():\n            self.await_end(before)\n\n    @action(Needs",
                "    @action(Needs",
            ),
        ),
        "but its device continues",
    ),
    "takes the rest before the start for the end": Bug(
        "happy path", ((ENDS, 'if state == "IDLE":'),), "but its device continues"
    ),
    "takes a restart for the end": Bug(
        "restart",
        (
            (ENDS, 'if state == "IDLE" and asked - begun > 0.3:'),
            (
                UNLESS_DONE,
                "",
            ),
        ),
        "it did nothing",
    ),
    # Its motion is over long before it says so: what is interrupted is the motion, not the waiting after it.
    "takes a restart for the end after a long wait": Bug(
        "restart", ((ENDS, 'if state == "IDLE" and asked - begun > 2:'), (UNLESS_DONE, "")), "it did nothing"
    ),
    "takes an error for the end": Bug(
        "device error",
        (
            (
                IN_ERROR,
                "        return\n",
            ),
        ),
        "reports that all was done",
    ),
    "is surprised by a second error": Bug(
        "device error",
        (
            (
                "FAULTS.get(state, 'nobody knows what that means')",
                "dict(zip(['FAULT 7'], ['blocked']))[state]",
            ),
        ),
        "unexpected error",
    ),
    "waits for ever": Bug(
        "device error",
        (
            (POLL, 'while (state := self.ask("STAT")) != "NEVER":'),
            ("START_S, MOTION_S = 1.0, 1.0, 10.0", "START_S, MOTION_S = 1.0, 1e9, 1e9"),
        ),
        "neither continues nor ends, and reports no reason",
    ),
    "fails without a word": Bug(
        "device error",
        (
            (
                'DeviceError("Its drive is locked.", effects="none", remedy="Unlock it.")',
                'DeviceError("", effects="none")',
            ),
        ),
        "without a message",
    ),
    "takes a refusal for a start": Bug(
        "device error",
        (
            (
                f"            raise {REFUSED}\n",
                "            self.is_refused = True\n            return\n",
            ),
            (
                "        begun = asked = time.monotonic()\n",
                '        if self.__dict__.pop("is_refused", False):\n'
                "            return\n"
                "        begun = asked = time.monotonic()\n",
            ),
        ),
        "reports that all was done",
    ),
    # -- the wire
    "says that nothing moved": Bug(
        "unplugged during",
        (
            (
                "        with assume_motion():\n            self.await_end(before)\n\n    @action(Needs",
                "        with contextlib.ExitStack() as end:\n"
                '            end.push(lambda _, error, __: error and setattr(error, "effects", "none"))\n'
                "            self.await_end(before)\n\n    @action(Needs",
            ),
            ("import asyncio\n", "import asyncio\nimport contextlib\n"),
        ),
        "nothing was done",
    ),
    "shakes again when nobody answers": Bug(
        "lost reply",
        (
            (
                ANSWER,
                '        if answer == "LOST":\n'
                '            while self.ask("STAT") == "BUSY":\n'
                "                time.sleep(0.02)\n"
                "            answer = self.ask(order)\n" + ANSWER,
            ),
            LISTEN,
            NO_REPLY,
        ),
        "",
    ),
    "believes that a lost start was none": Bug(
        "lost reply",
        (
            (
                ANSWER,
                '        if answer == "LOST":\n'
                '            raise DeviceError("It has not heard that.", effects="none")\n' + ANSWER,
            ),
            LISTEN,
            NO_REPLY,
        ),
        "nothing was done",
    ),
    "takes silence for consent": Bug(
        "unplugged before",
        (
            LENIENT,
            LINK_ERROR,
            (
                "        if not answer.isdecimal():\n",
                '        if answer == "OK":\n            return 0\n        if not answer.isdecimal():\n',
            ),
            (
                '        raise DeviceError(f"It says {state}:',
                '        if state == "OK":\n            return\n        raise DeviceError(f"It says {state}:',
            ),
        ),
        "reports that all was done",
    ),
    "takes noise for a refusal": Bug(
        "garbled reply", ((ANSWER, '        if answer != "OK":'),), "nothing was"
    ),
    "is surprised by noise": Bug(
        "garbled reply",
        (("        if not answer.isdecimal():\n", '        if answer == "":\n'),),
        "unexpected error",
    ),
    "takes what was said unasked for an answer": Bug(
        "unasked",
        (
            ('            unasked=lambda said: said.startswith(b"*"),\n', ""),
            (
                ANSWER,
                '        if answer.startswith("*"):\n            raise DeviceError(answer, effects="none")\n'
                + ANSWER,
            ),
        ),
        "nothing was done",
    ),
    "takes a late answer for the next": Bug(
        "late reply",
        (
            (
                "        await asyncio.to_thread(self.line.open)\n",
                "        self.line = serial.Serial(self.setup.config['port'], timeout=ANSWER_S)\n"
                "        self.lock = threading.Lock()\n",
            ),
            (
                '        return self.line.exchange(question.encode(), ANSWER_S).decode("ascii", "replace")\n',
                "        with self.lock:\n"
                '            self.line.write(question.encode() + b"\\r\\n")\n'
                '            return self.line.readline().decode("ascii", "replace").strip()\n',
            ),
            ("import asyncio\nimport time\n", "import asyncio\nimport threading\nimport time\n"),
            ("from labos.link import", "import serial\n\nfrom labos.link import"),
        ),
        "",
    ),
    "never connects again": Bug(
        "unplugged after",
        (
            (
                "    def ask(self, question: str) -> str:\n",
                "    gone = False\n\n    def ask(self, question: str) -> str:\n"
                "        if self.gone:\n"
                '            raise DeviceError("It is not there.", effects="none")\n',
            ),
            (
                "        return self.line.exchange(question.encode(), ANSWER_S).decode",
                "        try:\n"
                "            said = self.line.exchange(question.encode(), ANSWER_S)\n"
                "        except LinkError:\n"
                "            self.gone = True\n"
                "            raise\n"
                "        return said.decode",
            ),
            LINK_ERROR,
        ),
        "does not bring it back",
    ),
    # -- stop and reset
    "does not stop": Bug(
        "stop", (('self.ask, "HALT") != "OK"', 'self.ask, "STAT") == ""'),), "went on to its end"
    ),
    "cannot be reset": Bug(
        "device error",
        (('        await asyncio.to_thread(self.ask, "RESET")', '        raise DeviceError("Not here.")'),),
        "bring it back",
    ),
    # -- at the same time
    "sees what is not there": Bug(
        "true state",
        (
            (
                STOP,
                "    async def observe(self) -> dict[str, Any]:\n"
                '        return {"labware": {"plate": False}}\n\n' + STOP,
            ),
        ),
        "observe reports",
    ),
    "starts two things at once": Bug(
        "about",
        (
            (
                '@action(Needs("plate"), Consumes("grease", 1), duration_s=60)',
                '@action(Needs("plate"), Consumes("grease", 1), duration_s=60, exclusive=False)',
            ),
        ),
        "may run beside other work",
    ),
    "blocks the loop": Bug(
        "event loop",
        (
            (
                '        return await asyncio.to_thread(self.ask, "STAT") == "IDLE"',
                '        time.sleep(0.3)\n        return await asyncio.to_thread(self.ask, "STAT") == "IDLE"',
            ),
        ),
        "is_idle",
    ),
    # -- after a death of the node
    "is always idle": Bug(
        "node killed", (('self.ask, "STAT") == "IDLE"', 'self.ask, "STAT") != ""'),), "ready for new"
    ),
    "believes that all went well": Bug(
        "power cut", (take_up("        return None\n"),), "reports that all was done"
    ),
    "takes an error after a restart for the end": Bug(
        "node killed",
        (
            take_up(
                '        while (state := await asyncio.to_thread(self.ask, "STAT")) == "BUSY":\n'
                "            await asyncio.sleep(0.02)\n"
                '        if not state.startswith("FAULT"):\n'
                '            raise DeviceError("Nobody knows how it ended.")\n'
            ),
        ),
        "reports that all was done",
    ),
    "believes that nothing was done": Bug(
        "node killed",
        (take_up('        raise DeviceError("It was not begun.", effects="none")\n'),),
        "nothing was done",
    ),
    "takes rest for success after a kill": Bug(
        "node killed",
        (
            take_up(
                '        while await asyncio.to_thread(self.ask, "STAT") == "BUSY":\n'
                "            await asyncio.sleep(0.02)\n"
            ),
        ),
        "reports that all was done",
    ),
    "begins again after a kill": Bug(
        "node killed",
        (take_up("        await asyncio.to_thread(self.shake)\n"),),
        "",
    ),
}


def plant(folder: Path, name: str) -> Path:
    """The shaker with one bug, in a file of its own."""
    text = SHAKER.read_text()
    for good, bad in BUGS[name].changes:
        assert text.count(good) == 1, (name, good)
        text = text.replace(good, bad)
    path = folder / f"shaker_{list(BUGS).index(name)}.py"
    path.write_text(text)
    return path
