"""Calibrations of modules: recorded with their reports."""

from __future__ import annotations

import asyncio

from labos.core.decide.calibrations import CalibrateModule
from labos.http.answers import CalibrationRecord
from labos.http.bodies import NewCalibration
from labos.http.service import LabService
from labos.http.stock import check


async def calibrate(service: LabService, name: str, told: NewCalibration, by: str) -> CalibrationRecord:
    """Record a calibration of a module, and keep its report. Raises NotFound, Refused."""
    module = service.module(name)
    command = CalibrateModule(module, by, told.what, told.certificate, "", told.until, told.why)
    if told.report:
        check(service, command, by)  # a request that is refused leaves no file behind
        file = await asyncio.to_thread(service.parts.blobs.put, told.report)
        command = CalibrateModule(module, by, told.what, told.certificate, file, told.until, told.why)
    await service.kernel.execute(command, by)
    return CalibrationRecord(module, told.what, told.certificate, command.file, told.until)
