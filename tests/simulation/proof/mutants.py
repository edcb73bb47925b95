"""Eight flaws, fixed beforehand, and the unmutated control: does the campaign notice?

python -m tests.simulation.proof.mutants
python -m tests.simulation.proof.mutants --only "no tombstone"

Each is the smallest change of the source that stands for its flaw. It is made in a copy of ``labos`` and
run in a process of its own: what is tried is code that somebody could have written, with nothing patched in
memory that another import may have bound already.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import msgspec

ROOT = Path(__file__).parents[3]
BESIDE = ("tests", "specs", "drivers", "migrations", "pyproject.toml")


class Change(msgspec.Struct, frozen=True):
    """``old`` stands in ``file`` exactly once."""

    file: str
    old: str
    new: str


class Mutant(msgspec.Struct, frozen=True):
    name: str
    flaw: str
    changes: tuple[Change, ...] = ()


CONTROL = Mutant("control", "nothing is changed")

MUTANTS = (
    Mutant(
        "send before commit",
        "requests go to nodes as soon as they are decided",
        (
            Change(
                "runtime/kernel.py",
                "            self._writer.submit([entry.record for entry in entries], may_wait=may_wait)\n",
                "            self._writer.submit([entry.record for entry in entries], may_wait=may_wait)\n"
                "            for listener in self.listeners:\n"
                "                listener.on_committed(entries)\n",
            ),
            Change(
                "runtime/kernel_log.py",
                "        for listener in self.listeners:\n"
                "            if not self._notify(listener, partial(listener.on_committed, entries)):\n"
                "                self._notify(listener, listener.on_reopened)"
                "  # it looks at everything again\n"
                "        while self._waiting",
                "        while self._waiting",
            ),
        ),
    ),
    Mutant(
        "no journal",
        "a node writes down neither what it accepted nor how that ended",
        (
            Change(
                "node/journal.py",
                "                data = write_line(batch)\n",
                '                names = (b"accepted", b"handle", b"ended", b"void")\n'
                """                forgotten = tuple(b'{"t":"%b"' % name for name in names)\n"""
                "                data = write_line([r for r in batch if not r.startswith(forgotten)])\n",
            ),
        ),
    ),
    Mutant(
        "no epoch check",
        "a node obeys a kernel that has been replaced",
        (
            Change(
                "node/_admission.py",
                "        if epoch < memory.epoch:\n",
                "        if epoch < 0:\n",
            ),
        ),
    ),
    Mutant(
        "no tombstone",
        "a node says of what it never heard of that it can never run, and does not see to it",
        (
            Change(
                "node/server.py",
                "            self.journal.forbid_attempts(ask.action, ask.attempt, ask.position)\n",
                '            return reply or self._reply("void", attempt=ask.attempt)\n',
            ),
        ),
    ),
    Mutant(
        "result dropped",
        "a result whose publication was lost is not fetched",
        (
            Change(
                "runtime/registry.py",
                "(ended or lost):\n                self._dispatcher.find_out(action.id)\n",
                "(ended or lost):\n                pass\n",
            ),
        ),
    ),
    Mutant(
        "effects applied twice",
        "the end of an action says twice what it did",
        (
            Change(
                "core/decide/actions.py",
                '    yield from list_effect_events(state, action, "all", "", command.result)\n',
                '    took_place = [*list_effect_events(state, action, "all", "", command.result)]\n'
                "    yield from [*took_place, *took_place]\n",
            ),
        ),
    ),
    Mutant(
        "snapshot of another fold",
        "all fold code has the same fingerprint",
        (Change("core/state.py", "    return total.hexdigest()\n", '    return "fold"\n'),),
    ),
    Mutant(
        "lease by local clock",
        "a lease runs by the clock of whoever asks (in the simulated store: in the real ones this is SQL)",
        (
            Change(
                "testing/disk.py",
                'always the server\'s."""\n        return self._now()\n',
                'always the server\'s."""\n'
                "        clock = self.process.clock if self.process is not None else None\n"
                "        return clock.now_ns() / 1e9 if clock is not None else self._now()\n",
            ),
        ),
    ),
)


def mutate(mutant: Mutant) -> dict[str, str]:
    """The files with the flaw in them. Raises ValueError if a change does not fit the source any more."""
    files: dict[str, str] = {}
    for change in mutant.changes:
        text = files.get(change.file) or (ROOT / "labos" / change.file).read_text()
        if text.count(change.old) != 1:
            raise ValueError(f"{mutant.name}: {change.file} has changed; the mutant has to be written anew")
        files[change.file] = text.replace(change.old, change.new)
    return files


def plant(mutant: Mutant, folder: Path) -> None:
    """A checkout with the flaw in it."""
    shutil.copytree(ROOT / "labos", folder / "labos", ignore=shutil.ignore_patterns("__pycache__"))
    for name in BESIDE:
        (folder / name).symlink_to(ROOT / name)
    for file, text in mutate(mutant).items():
        (folder / "labos" / file).write_text(text)


def try_mutant(mutant: Mutant, seeds: int) -> tuple[int | None, list[str], int]:
    """The first seed that notices, what it says, and how many seeds were lived through."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        plant(mutant, folder)
        known = folder / "known.jsonl"
        argv = ["-m", "tests.simulation.proof", "--range", f"0:{seeds}", "--known", str(known), "--stop"]
        env = {**os.environ, "PYTHONPATH": str(folder / "drivers"), "PYTHONDONTWRITEBYTECODE": "1"}
        done = subprocess.run([sys.executable, *argv], cwd=folder, env=env, capture_output=True, text=True)
        days = [json.loads(line) for line in known.read_text().splitlines()] if known.exists() else []
        wrong = next((day for day in days if day["wrong"]), None)
        if wrong is None and done.returncode:
            raise RuntimeError(f"{mutant.name}: {done.stderr[-2000:]}")
        return (wrong["seed"], wrong["wrong"], len(days)) if wrong else (None, [], len(days))


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.simulation.proof.mutants")
    parser.add_argument("--seeds", type=int, default=1000)
    parser.add_argument("--only", default="", help="one mutant, by name; control is one too")
    asked = parser.parse_args()
    caught = spared = 0
    for mutant in (CONTROL, *MUTANTS):
        if asked.only not in ("", mutant.name):
            continue
        seed, lines, lived = try_mutant(mutant, asked.seeds)
        checks = ", ".join(sorted({line.partition(":")[0] for line in lines}))
        found = f"caught by seed {seed} ({checks})" if seed is not None else f"not caught in {lived} seeds"
        print(f"{mutant.name:26} {found}: {mutant.flaw}", flush=True)
        for line in lines[:2]:
            print(f"{'':26}   {line[:160]}")
        caught += mutant is not CONTROL and seed is not None
        spared += mutant is CONTROL and seed is None
    if not asked.only:
        print(f"{caught} of {len(MUTANTS)} caught; control {'clean' if spared else 'NOT CLEAN'}")
        return 0 if spared and caught >= len(MUTANTS) - 1 else 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
