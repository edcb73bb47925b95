"""The report on the windows of a compiled workflow: sentences, warnings, and the refusal of its run."""

from __future__ import annotations

from collections.abc import Iterator

import msgspec

from labos.core.model import Workcell
from labos.planning.certificate import MOST_STEPS, Certificate, WindowVerdict, certify
from labos.spec import Compiled
from labos.spec.findings import Finding, FindingList

REMEDY = "Let `at_most` be {needed:g} s or more, or move steps that need not stand between the two."
ACCEPT = "{remedy} To accept it, write `windows: {word}` at the top."


def check_windows(compiled: Compiled, workcell: Workcell) -> Compiled:
    """A compiled workflow with a warning for each window that cannot be kept for all durations of its steps.
    If it says `windows: refuse`, raises SpecErrors for such a window, or if there are too many steps to
    certify. If it says `windows: accept`, nothing is added."""
    if compiled.windows == "accept" or not compiled.written:
        return compiled
    report = FindingList()
    for finding in compiled.findings:
        report.keep(finding)
    for finding in _find_broken(compiled, certify_all(compiled, workcell)):
        report.keep(finding)
    if compiled.windows == "refuse":
        report.raise_if_failed()
    return msgspec.structs.replace(compiled, findings=report.sort_findings())


def certify_all(compiled: Compiled, workcell: Workcell) -> Certificate:
    """The certificate of a run. If the run may choose modules, each window has its worst verdict of all
    plans."""
    first, *others = (certify(plan, workcell) for plan in compiled.plans)
    worst = list(first.windows)
    for other in others:
        worst = [
            max(one, two, key=lambda window: window.breaks_by_s)
            for one, two in zip(worst, other.windows, strict=True)
        ]
    return msgspec.structs.replace(first, windows=tuple(worst))


def describe_window(window: WindowVerdict, spread: float) -> str:
    """The text about a window and whether it can be kept, without a full stop."""
    if window.is_kept:
        return f"{_describe_limits(window)}: kept for all durations within ±{spread * 100:g} %"
    if window.path:
        times = " and ".join(f"{taken.step!r} takes {taken.takes_s:g} s" for taken in window.path)
        return f"{_describe_limits(window)}: can be missed by {window.breaks_by_s:g} s, if {times}"
    return f"{_describe_limits(window)}: is missed by {window.breaks_by_s:g} s"


def describe_certificate(found: Certificate) -> Iterator[str]:
    """The sentences about all windows of a run."""
    for window in found.windows:
        yield f"{describe_window(window, found.spread)}."
    if not found.is_whole:
        yield f"With more than {MOST_STEPS} steps, windows are not certified together."
    for step in found.left_out:
        yield (
            f"{step!r} has a window that is anchored at another run, so it cannot be certified in advance."
        )


def _describe_limits(window: WindowVerdict) -> str:
    least = f"at least {window.wait_s:g} s"
    if window.within_s is None:
        return f"{window.step!r} {least} after the end of {window.anchor!r}"
    most = f"within {window.within_s:g} s of the end of {window.anchor!r}"
    return f"{window.step!r} {least} after and {most}" if window.wait_s else f"{window.step!r} {most}"


def _find_broken(compiled: Compiled, found: Certificate) -> Iterator[Finding]:
    word = "warn" if compiled.windows == "refuse" else "accept"
    for window in found.windows:
        if window.is_kept or window.within_s is None:
            continue
        remedy = REMEDY.format(needed=window.within_s + window.breaks_by_s)
        yield Finding(
            "error" if compiled.windows == "refuse" else "warning",
            f"{describe_window(window, found.spread)}.",
            *compiled.written[window.index],
            remedy=ACCEPT.format(remedy=remedy, word=word),
        )
    if compiled.windows == "refuse" and not found.is_whole:
        index = min(compiled.written)
        yield Finding(
            "error",
            f"The windows cannot be certified: the workflow has more than {MOST_STEPS} steps.",
            *compiled.written[index],
            remedy="Split it into several runs, or write `windows: warn` at the top.",
        )
