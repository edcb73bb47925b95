"""The badges of the packaged drivers: ``python -m tests.docs.badges [DRIVER …]``.

Tortures the drivers that have changed since they got their badge (or those that are named) and keeps what
came of it in ``docs/reference/badges.json``; ``python -m tests.docs.generate`` makes the table of it. A test
holds that no badge is older than its driver: what is compared is the code, without comments and docstrings.
"""

from __future__ import annotations

import ast
import asyncio
import hashlib
import sys
from importlib.metadata import entry_points
from pathlib import Path

import msgspec

import labos_drivers
from labos.bootstrap import load_driver
from labos.torture import MEANING, Report, is_person, torture
from tests.docs.markdown import REFERENCE

KEPT = REFERENCE / "badges.json"
HERE = Path(labos_drivers.__file__).parent
MOTION_S = 0.6


class Badge(msgspec.Struct, frozen=True):
    """What a driver came away with, and which code it was."""

    driver: str
    badge: str
    evidence: tuple[str, ...]
    limits: str
    passed: int
    failed: int
    left_out: int
    code: str


def drivers() -> list[str]:
    """The packaged ones, without people: those have no badge."""
    packaged = [e.name for e in entry_points(group="labos.drivers") if e.value.startswith("labos_drivers.")]
    return sorted(name for name in packaged if not is_person(load_driver(name)))


def read_badges() -> dict[str, Badge]:
    """By driver."""
    if not KEPT.exists():
        return {}
    return {badge.driver: badge for badge in msgspec.json.decode(KEPT.read_bytes(), type=list[Badge])}


def code_of(driver: str) -> str:
    """A digest of a driver's code, with the shared modules that it uses."""
    package = load_driver(driver).__module__.split(".")[1]
    files = set((HERE / package).glob("*.py"))
    waiting = list(files)
    while waiting:
        for name in _list_shared(waiting.pop()):
            path = HERE / f"{name}.py"
            if path.exists() and path not in files:
                files.add(path)
                waiting.append(path)
    code = hashlib.sha256()
    for path in sorted(files):
        code.update(_bare(path.read_text("utf-8")).encode())
    return code.hexdigest()[:16]


def _list_shared(path: Path) -> list[str]:
    """The modules of ``labos_drivers`` that a file imports, as paths without their ending."""
    found = []
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        parts = (node.module or "").split(".") if isinstance(node, ast.ImportFrom) else []
        if len(parts) > 1 and parts[0] == "labos_drivers":
            found.append("/".join(parts[1:]))
    return found


def _bare(text: str) -> str:
    tree = ast.parse(text)
    for node in ast.walk(tree):
        match getattr(node, "body", None):
            case [ast.Expr(value=ast.Constant(value=str())), *_] as body:
                body[0] = ast.Pass()
    return ast.dump(tree)


def badges() -> str:
    """The table of the reference."""
    lines = ["| driver | badge | evidence | checks | why not higher |", "| --- | --- | --- | --- | --- |"]
    for badge in read_badges().values():
        tally = f"{badge.passed} passed, {badge.failed} failed, {badge.left_out} left out"
        cells = (badge.driver, badge.badge, "; ".join(badge.evidence), tally, badge.limits)
        lines.append("| " + " | ".join(cell.replace("|", r"\|") for cell in cells) + " |")
    return "\n".join(lines) + "\n"


def badge_of(report: Report) -> Badge:
    verdicts = [finding.verdict for finding in report.findings]
    return Badge(
        driver=report.driver,
        badge=report.badge,
        evidence=report.evidence,
        limits=report.limits,
        passed=verdicts.count("passed"),
        failed=verdicts.count("failed"),
        left_out=verdicts.count("left out"),
        code=code_of(report.driver),
    )


def main() -> None:
    known = {name: badge for name, badge in read_badges().items() if name in drivers()}
    wanted = sys.argv[1:] or [n for n in drivers() if n not in known or known[n].code != code_of(n)]
    for name in wanted:
        report = asyncio.run(torture(name, motion_s=MOTION_S))
        known[name] = badge_of(report)
        print(f"{name}: {report.badge} ({MEANING[report.badge]}) {report.limits}", flush=True)
        rows = msgspec.json.encode([known[name] for name in sorted(known)])
        KEPT.write_bytes(msgspec.json.format(rows, indent=2) + b"\n")


if __name__ == "__main__":
    main()
