"""Opentrons' own software, if it is installed. It runs a protocol as a robot does, on simulated hardware.

``opentrons_simulate`` is part of the package ``opentrons``, which needs an environment of its own. Version
8.8 is the last one that accepts protocols for an OT-2. The program prints text for people: a log of the run,
or a traceback.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec

from labos.errors import DeviceError

VARIABLE = "LABOS_OPENTRONS_SIMULATE"
"""The environment variable that says where the program is."""

END_S = 5.0
"""A program that was killed is gone within this."""

STROKE = re.compile(
    r"\s*(?P<what>Aspirating|Dispensing) (?P<volume>[\d.]+) uL (?:from|into) (?P<well>[A-Z]+\d+) of "
    r".* on (?:slot )?(?P<slot>\d+)(?: at .*)?"
)
TIP = re.compile(r"\s*Picking up tip from ")
FRAME = '  File "'
WRAPPED = "opentrons.protocols.execution.errors.ExceptionInProtocolError: "
RAISED = re.compile(
    r"(?:\w+\.)*(?P<kind>\w+)(?: \[line (?P<line>\d+)\])?:"
    r"(?: Error (?P<code>\d{4}) [A-Z_]+ \(\w+\):)? ?(?P<detail>.*)"
)


class ProtocolOutput(msgspec.Struct, frozen=True):
    """The output of a protocol: after a success the lines of its log, after a failure its errors in the form
    of the robot server. The other one is empty."""

    log: tuple[str, ...] = ()
    errors: tuple[dict[str, Any], ...] = ()

    @property
    def tips(self) -> int:
        """How often tips were picked up. The log does not say whether one or eight at a time."""
        return sum(bool(TIP.match(line)) for line in self.log)

    def sum_changes(self) -> dict[int, dict[str, float]]:
        """The change of volume (µL) by slot and well; negative if more was aspirated than dispensed. With a
        pipette of eight channels, the well is the first of its column. Labware on a module counts under the
        module's slot."""
        found: dict[int, dict[str, float]] = {}
        for stroke in self._find_strokes():
            wells = found.setdefault(int(stroke["slot"]), {})
            sign = 1 if stroke["what"] == "Dispensing" else -1
            wells[stroke["well"]] = round(wells.get(stroke["well"], 0.0) + sign * float(stroke["volume"]), 3)
        return found

    def _find_strokes(self) -> Iterator[re.Match[str]]:
        for line in self.log:
            if (stroke := STROKE.fullmatch(line)) is not None:
                yield stroke


class RunningProtocol:
    """A protocol that runs in a process of its own."""

    def __init__(self, program: str, name: str, content: bytes) -> None:
        self._folder = Path(tempfile.mkdtemp(prefix="labos-opentrons-"))
        protocol = self._folder / name
        protocol.write_bytes(content)
        # Opentrons settings of this computer must not apply to the simulated robot.
        environment = {**os.environ, "OT_API_CONFIG_DIR": str(self._folder / "robot")}
        with self._output_path.open("wb") as output, self._error_path.open("wb") as errors:
            self._process = subprocess.Popen(
                [program, str(protocol)],
                cwd=self._folder,
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=errors,
            )

    @property
    def _output_path(self) -> Path:
        return self._folder / "output.txt"

    @property
    def _error_path(self) -> Path:
        return self._folder / "errors.txt"

    def poll(self) -> ProtocolOutput | None:
        """The output; None while the protocol runs. Not to be called again after the output was returned."""
        if (code := self._process.poll()) is None:
            return None
        output, errors = (
            self._output_path.read_text("utf-8", "replace"),
            self._error_path.read_text("utf-8", "replace"),
        )
        shutil.rmtree(self._folder, ignore_errors=True)
        if code == 0:
            return ProtocolOutput(log=tuple(output.splitlines()))
        return ProtocolOutput(errors=(parse_error(errors, code),))

    def kill(self) -> None:
        """End the process and delete its files."""
        self._process.kill()
        self._process.wait(END_S)
        shutil.rmtree(self._folder, ignore_errors=True)


class Software:
    """The program that runs protocols. Raises DeviceError if it is not found."""

    def __init__(self, program: str) -> None:
        found = shutil.which(program)
        if found is None:
            raise DeviceError(
                f"There is no program {program} to run protocols of an OT-2.",
                effects="none",
                remedy=f"Set {VARIABLE} to the path of opentrons_simulate (opentrons 8.8), or unset it.",
            )
        self._program = found

    def run(self, name: str, content: bytes) -> RunningProtocol:
        return RunningProtocol(self._program, Path(name).name, content)


def parse_error(printed: str, code: int) -> dict[str, Any]:
    """The error at the end of the printed text, in the form of the robot server, with its cause inside."""
    lines = printed.rstrip().splitlines()
    frames = [number for number, line in enumerate(lines) if line.startswith(FRAME)]
    plain = [number for number, line in enumerate(lines) if line.strip() and not line.startswith(" ")]
    after = [number for number in plain if frames and number > frames[-1]] or plain[-1:]
    text = " ".join(" ".join(lines[after[0] :]).split()) if after else f"it ended with {code}"
    text = text.removeprefix(WRAPPED)
    raised = RAISED.fullmatch(text)
    if raised is None:
        return _make_error("UnexpectedProtocolError", "4000", text)
    where = f"line {raised['line']}: " if raised["line"] else ""
    inner = _make_error(raised["kind"], raised["code"] or "4000", f"{where}{raised['detail']}".strip())
    return {**_make_error("ExceptionInProtocolError", "4000", text), "wrappedErrors": [inner]}


def _make_error(kind: str, code: str, detail: str) -> dict[str, Any]:
    return {"errorType": kind, "errorCode": code, "detail": detail, "wrappedErrors": []}
