"""One seed's day, from the first run to what is found wrong with it."""

from __future__ import annotations

import random
import shutil
import tempfile
from functools import cache, partial
from pathlib import Path

import msgspec

from labos.core import state as state_code
from labos.core.state import encode_picture, fingerprint_folder
from labos.errors import Fenced, LabosError
from labos.testing.lab import SimulatedLab
from labos.testing.loop import Stalled
from tests.simulation.proof.checks import Obedience, findings
from tests.simulation.proof.labs import cell, jobs, meddles
from tests.simulation.proof.steering import RATES, Steered, hits, plan

PACE = 4.0
"""Devices work so much faster: what fails is then more often in the midst of something."""

LEASE_S = 20.0
"""Shorter than most freezes (1 to 60 s)."""

MOST_KERNELS = 100
"""A good day has some ten."""

SNAPSHOT_EVERY = 5
"""So many events: most kernels begin with one."""

LIMIT_S = 3 * 3600.0
KINDS = ("sealing", "dosing", "cycling")


class Day(msgspec.Struct, frozen=True):
    """What became of a seed. ``hits`` counts pairs as ``point × fault``; ``wrong`` is empty if all holds;
    ``hash`` names the log's last record and the state."""

    seed: int
    hash: str
    wrong: tuple[str, ...]
    hits: dict[str, int]
    counts: dict[str, int]


def live(seed: int, save: Path | None = None) -> Day:
    """Live through one seed; ``save`` keeps its log for ``labos replay``."""
    rng = random.Random(f"proof/{seed}")
    tried = plan(rng)
    kind = "watched" if "mishap" in tried.faults else rng.choice(KINDS)
    work = jobs(rng, kind)
    lab = SimulatedLab(
        cell(kind).stand,
        seed,
        RATES,
        make_faults=partial(Steered, tried),
        meddles=meddles(rng, work),
        pace=PACE,
        lease_s=LEASE_S,
        standby=True,
        most_kernels=MOST_KERNELS,
        snapshot_every=SNAPSHOT_EVERY,
    )
    lab.tidies = lab.answers_all = lab.asks_access = True
    upgraded = rng.random() < 0.5
    if upgraded:
        lab.before_restart = lambda: leave_older_snapshot(lab)
    obedience = Obedience(lab.network)
    try:
        try:
            state = lab.run_for(work, LIMIT_S)
            wrong = findings(lab, state, obedience)
        except Stalled as error:
            state, wrong = lab.fold_log(), [f"end: {error}"]
        except Exception as error:
            state, wrong = lab.fold_log(), [f"surprise: {error!r}"]
        if save is not None:
            lab.save(save)
        counts = {
            "events": state.position,
            "deaths": len(lab.faults.deaths),
            "kernels": lab.kernels,
            "takeovers": lab.takeovers,
            "messages fenced": obedience.fenced,
            "kernels fenced": sum(isinstance(error, Fenced) for error in ends(lab)),
            "commits dropped": lab.store.dropped,
            "journals torn": lab.faults.torn,
            "answers": lab.answered,
            "virtual_s": round(lab.loop.time()),
        }
        found = {f"{point} × {fault}": count for (point, fault), count in hits(lab.faults).items()}
        hash_ = f"{lab.store.head().hash.hex()[:16]}-{lab.fingerprint()[:16]}"
        return Day(seed, hash_, tuple(wrong), found, counts)
    finally:
        lab.close()


def ends(lab: SimulatedLab) -> list[LabosError]:
    """Why kernels stopped that did so themselves."""
    return [kernel.failed.result() for kernel in lab.opened if kernel.failed.done()]


def leave_older_snapshot(lab: SimulatedLab) -> None:
    """Leave a snapshot such as another version's fold would have: it names labware otherwise."""
    head = lab.store.head()
    if head.position:
        state = lab.fold_log()
        state.bench.named += 100
        lab.store.save_snapshot(
            head.position, head.hash, fingerprint_of_another_fold(), encode_picture(state)
        )


@cache
def fingerprint_of_another_fold() -> str:
    """The fingerprint of a LabOS whose core has one line more."""
    with tempfile.TemporaryDirectory() as folder:
        core = Path(folder) / "core"
        shutil.copytree(Path(state_code.__file__).parent, core)
        with (core / "fold.py").open("a") as file:
            file.write("# as it was\n")
        return fingerprint_folder(core)
