"""The results of the suite: checks, the resulting badge, and its evidence."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import msgspec

from labos.node.torture import Torture

Badge = Literal["none", "bronze", "silver", "gold"]
Tier = Literal["bronze", "silver", "gold"]
Verdict = Literal["passed", "failed", "left out"]

RANKS: tuple[Badge, ...] = ("none", "bronze", "silver", "gold")
MEANING = {
    "none": "no badge",
    "bronze": "speaks",
    "silver": "survives",
    "gold": "reconciles an unknown by observing",
}


class Finding(msgspec.Struct, frozen=True):
    """One check. ``why`` is the error, the reason why the check was left out, or a remark."""

    check: str
    tier: Tier
    verdict: Verdict
    why: str = ""
    seconds: float = 0.0


class Report(msgspec.Struct, frozen=True):
    """The report for one driver. ``limits`` is the reason why it has no higher badge."""

    driver: str
    version: str
    badge: Badge
    evidence: tuple[str, ...]
    limits: str
    findings: tuple[Finding, ...]
    seconds: float = 0.0

    @property
    def failed(self) -> list[Finding]:
        return [finding for finding in self.findings if finding.verdict == "failed"]


def badge_of(findings: Sequence[Finding]) -> tuple[Badge, str]:
    """The badge, and the reason why it is not higher. A tier is reached when all its checks and those of the
    lower tiers were made and passed."""
    reached: Badge = "none"
    for tier in RANKS[1:]:
        short = [f for f in findings if f.tier == tier and f.verdict != "passed"]
        if short:
            return reached, _explain_limit(short)
        reached = tier
    return reached, ""


def _explain_limit(short: Sequence[Finding]) -> str:
    failed = [f"{finding.check}: {finding.why}" for finding in short if finding.verdict == "failed"]
    if failed:
        return "; ".join(failed)
    reasons = list(dict.fromkeys(finding.why for finding in short))
    return "; ".join(reasons)


def evidence_of(torture: Torture, *, wired: bool) -> tuple[str, ...]:
    """The evidence for the badge, the weakest first. The simulator is weak evidence, because the author of
    the driver also wrote the simulator."""
    how = "behind a real wire" if wired else "without a wire"
    return (
        f"self-simulated, {how}",
        *(f"foreign counterpart: {f.software} {f.version} ({f.shown_by})" for f in torture.foreign),
        *(f"hardware: serial {h.serial}, {h.date}, {h.who}" for h in torture.hardware),
    )
