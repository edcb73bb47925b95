"""What the log does not say: whether a lab looks for an order of waiting runs, and which runs wait for it."""

from __future__ import annotations

from labos.cli._query import Where
from labos.client import LabClient
from labos.core.runs import RunState
from labos.core.state import LabState
from labos.errors import LabosError
from labos.services.waits import WaitReason, list_unknown_reasons
from labos.settings import Settings, find_kernel, last_kernel


def ask_order_setting(where: Where) -> bool:
    """Whether the lab looks for an order of all waiting runs: as its kernel says, else by the setting on this
    computer. Raises BadInput."""
    info = None if where.lab else last_kernel(where.home)
    if info is not None and info.database == where.url and info.searches_order is not None:
        return info.searches_order
    return Settings.make(where.home).searches_order


class KernelWaits:
    """Why runs wait by the kernel itself: the orders that it has found are not in the log. It is asked once,
    when the first run needs it."""

    def __init__(self, where: Where) -> None:
        self._where = where
        self._reasons: dict[str, list[WaitReason]] | None = None

    def correct_reasons(
        self, state: LabState, run: RunState, now: int, reasons: list[WaitReason]
    ) -> list[WaitReason]:
        """The ``reasons`` that the log has for a run, corrected by what the kernel says. If none answers, the
        state has to do. What a person can end is as the log has it."""
        if self._reasons is None:
            self._reasons = _ask_kernel(self._where)
        by_kernel = self._reasons.get(run.id)
        if by_kernel is None:
            return reasons or list_unknown_reasons(state, run, now)
        kept = [reason for reason in reasons if reason.blocked or reason.remedy]
        steps = {reason.step for reason in kept}
        return [*kept, *(reason for reason in by_kernel if reason.step not in steps)]


def _ask_kernel(where: Where) -> dict[str, list[WaitReason]]:
    if not where.lab:
        info = find_kernel(where.home)
        if info is None or info.database != where.url:
            return {}
    try:
        with LabClient(where.lab, home=where.home, patience_s=0.0) as client:
            runs = client.state()["runs"]
    except LabosError:
        return {}
    return {
        run["id"]: [
            WaitReason(wait["step"], wait["why"], wait["blocked"])
            for wait in run["waits"]
            if wait["code"] != "not_pending"
        ]
        for run in runs
    }
