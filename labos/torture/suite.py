"""The suite: its checks, their order, and the resulting badge."""

from __future__ import annotations

import asyncio
import inspect
import sys
import tempfile
import time
from collections.abc import Awaitable, Callable, Collection
from pathlib import Path

import msgspec

from labos.bootstrap import import_module_beside, load_driver
from labos.errors import BadInput, LabosError
from labos.node.node import Node
from labos.node.torture import Torture
from labos.torture import checks_speak, checks_survive
from labos.torture.report import Finding, Report, Tier, Verdict, badge_of, evidence_of
from labos.torture.session import Failed, LeftOut, Session

Check = Callable[[Session], Awaitable[str | None]]
"""A check; the text that it returns is shown beside its result."""
Show = Callable[[Finding], None]

MOTION_S = 1.0
"""The duration of the longest motion under torture."""

CHECK_S = 600.0

CHECKS: dict[str, tuple[Tier, Check]] = {
    "about": ("bronze", checks_speak.check_about),
    "happy path": ("bronze", checks_speak.check_happy_path),
    "set points": ("bronze", checks_speak.check_set_points),
    "invalid arguments": ("bronze", checks_speak.check_invalid_arguments),
    "duplicate id": ("bronze", checks_speak.check_duplicate_id),
    "busy": ("bronze", checks_speak.check_busy),
    "true state": ("silver", checks_survive.check_true_state),
    "device error": ("silver", checks_survive.check_device_error),
    "stop": ("silver", checks_survive.check_stop),
    "emergency stop": ("silver", checks_survive.check_emergency_stop),
    "unplugged before": ("silver", checks_survive.unplug_before),
    "unplugged during": ("silver", checks_survive.unplug_during),
    "unplugged after": ("silver", checks_survive.unplug_after),
    "lost reply": ("silver", checks_survive.lose_reply),
    "half reply": ("silver", checks_survive.cut_reply),
    "garbled reply": ("silver", checks_survive.garble_reply),
    "late reply": ("silver", checks_survive.delay_reply),
    "unasked": ("silver", checks_survive.say_unasked),
    "power cycle": ("silver", checks_survive.power_cycle),
    "restart": ("silver", checks_survive.restart_device),
    "power cut": ("silver", checks_survive.cut_power),
    "node killed": ("silver", checks_survive.kill_node),
    "event loop": ("silver", checks_survive.check_event_loop),
    "reconciles": ("gold", checks_survive.check_reconciliation),
}

PREPARES = "happy path"
"""The check on which all others rely: it learns what each action does when all goes well."""


def find_declaration(node: type[Node]) -> Torture:
    """The driver's ``TORTURE``: in its module, or in the module ``torture`` beside it."""
    own = getattr(sys.modules[node.__module__], "TORTURE", None)
    if own is None:
        own = getattr(import_module_beside(node, "torture"), "TORTURE", None)
    if own is None:
        return Torture()
    if not isinstance(own, Torture):
        raise BadInput(
            f"TORTURE of {node.__module__} is a {type(own).__name__}.",
            remedy="Write TORTURE = Torture(…), from labos.node.",
        )
    return own


def is_person(node: type[Node]) -> bool:
    """Whether all its actions are done by people."""
    offered = [spec for spec in node.describe().actions if not spec.recovers]
    return bool(offered) and all(spec.by_person for spec in offered)


async def torture(
    driver: str,
    *,
    show: Show = lambda finding: None,
    only: Collection[str] = (),
    motion_s: float = MOTION_S,
    folder: Path | None = None,
) -> Report:
    """Torture a driver: an installed one by its name, or one in a file. ``only`` names checks; the badge then
    has less evidence. Raises NotFound, BadInput."""
    if unknown := [name for name in only if name not in CHECKS]:
        raise BadInput(f"There is no check {unknown[0]!r}.", remedy=f"There are: {', '.join(CHECKS)}.")
    node = load_driver(driver)
    if is_person(node):
        raise BadInput(
            f"{node.driver or driver} has no badge: a person carries out all its actions, so there is no "
            "wire to unplug.",
            remedy="Test such steps in a lab, with labos inbox.",
        )
    declared = find_declaration(node)
    began = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="torture-", ignore_cleanup_errors=True) as temporary:
        home = folder or Path(temporary)
        home.mkdir(parents=True, exist_ok=True)
        session = Session(driver, node, declared, home, motion_s)
        findings = await _run(session, only, show)
    about = node.describe()
    badge, limits = badge_of(findings) if not only else ("none", "only some checks were requested")
    return Report(
        driver=about.driver or driver,
        version=about.version,
        badge=badge,
        evidence=evidence_of(declared, wired=session.is_wired),
        limits=limits,
        findings=tuple(findings),
        seconds=round(time.monotonic() - began, 1),
    )


async def _run(on: Session, only: Collection[str], show: Show) -> list[Finding]:
    findings: list[Finding] = []
    lost = ""
    await on.open()
    try:
        for name, (tier, check) in CHECKS.items():
            if only and name not in only and name != PREPARES:
                finding = Finding(name, tier, "left out", "it was not requested")
            elif name in on.torture.left_out:
                finding = Finding(name, tier, "left out", on.torture.left_out[name])
            elif lost or (lost := await _bring_back(on)):
                finding = Finding(name, tier, "failed", f"not made: {lost}")
            else:
                finding = await _run_check(on, name, tier, check)
            findings.append(finding)
            show(finding)
    finally:
        await on.close()
    return findings


async def _bring_back(on: Session) -> str:
    """The reason why no further check is possible; empty if the node is idle."""
    try:
        await on.make_ready()
    except (Failed, LabosError) as error:
        return str(error)
    return ""


async def _run_check(on: Session, name: str, tier: Tier, check: Check) -> Finding:
    began = time.monotonic()
    verdict: Verdict = "passed"
    why = ""
    try:
        async with asyncio.timeout(CHECK_S):
            why = await check(on) or ""
    except LeftOut as reason:
        verdict, why = "left out", str(reason)
    except Failed as reason:
        verdict, why = "failed", str(reason)
    except TimeoutError:
        verdict, why = "failed", f"it has not ended after {CHECK_S:g} s"
    except (LabosError, msgspec.MsgspecError) as error:
        verdict, why = "failed", f"{type(error).__name__}: {error}"
    return Finding(name, tier, verdict, why, round(time.monotonic() - began, 2))


def describe_check(name: str) -> str:
    """The requirement of a check, from its docstring."""
    return inspect.cleandoc(CHECKS[name][1].__doc__ or "").replace("\n", " ")
