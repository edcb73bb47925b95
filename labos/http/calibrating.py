"""Calibrations of modules: recorded with their reports."""

from __future__ import annotations

import asyncio

import msgspec

from labos.core.decide.calibrations import CalibrateModule
from labos.core.structs import make_from
from labos.http.answers import CalibrationRecord
from labos.http.bodies import NewCalibration
from labos.http.service import LabService
from labos.http.stock import check


async def calibrate(service: LabService, name: str, new: NewCalibration, by: str) -> CalibrationRecord:
    """Record a calibration of a module, and keep its report. Raises NotFound, Refused."""
    module = service.module(name)
    command = make_from(CalibrateModule, new, module=module, by=by)
    if new.report:
        check(service, command, by)  # a refused request must not leave a file behind
        file = await asyncio.to_thread(service.parts.blobs.put, new.report)
        command = msgspec.structs.replace(command, file=file)
    await service.kernel.execute(command, by)
    return make_from(CalibrationRecord, command)
