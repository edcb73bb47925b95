"""A person records that a module was calibrated."""

from __future__ import annotations

from labos.core.calibrations import MOST_CALIBRATIONS
from labos.core.days import is_day
from labos.core.decide._base import Command, Decision, Rejection
from labos.core.decide.lookups import decides_about, expect_module
from labos.core.ids import ModuleName, local
from labos.core.modules import Module, ModuleCalibrated
from labos.core.state import LabState
from labos.core.structs import make_from
from labos.core.words import Words


class CalibrateModule(Command, frozen=True):
    """Record a calibration of a module, or of its part ``what``. ``file`` is the digest of its report;
    ``until`` is its last day."""

    module: ModuleName
    by: str
    what: str = ""
    certificate: str = ""
    file: str = ""
    until: str = ""
    why: Words = ""


@decides_about(CalibrateModule, expect_module)
def calibrate_module(state: LabState, command: CalibrateModule, module: Module) -> Decision:
    if command.until and not is_day(command.until):
        return Rejection("bad_date", f"{command.until!r} is not a date.", "Write it like 2027-05-31.")
    known = module.calibrations
    if command.what not in known and len(known) >= MOST_CALIBRATIONS:
        return Rejection(
            "too_many",
            f"{local(command.module)} has {len(known)} calibrations; more are not possible.",
            f"Replace one of them: {', '.join(sorted(name for name in known if name)[:5])} …",
        )
    return [make_from(ModuleCalibrated, command)]
