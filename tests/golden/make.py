"""Writes golden logs with the present version: ``python -m tests.golden.make NAME``.

Make new ones when events have come that no golden log holds; never write one again that is there.
``--view NAME`` notes anew what a log folds to, after a change of the fold that was meant: the log itself
stays. What is noted is the canonical view of the lab (``tests.golden.view``), never the layout in memory.
"""

from __future__ import annotations

import gzip
import json
import sys
import tempfile
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

from msgspec import structs

from labos.client import LabClient
from labos.core.envelope import Record
from labos.core.state import LabState
from labos.runtime.ledger import fold
from labos.store import FolderBlobs, backup, open_store, read_backup, read_segment, records_of, write_segment
from labos.testing.faults import STORMY
from labos.testing.lab import Job, SimulatedLab
from tests.golden.view import lab_view
from tests.simulation.mixes import (
    colour_picker,
    compile_text,
    make_dosed_and_read,
    make_generated,
    make_timed,
    pcr,
    stand,
)
from tests.support.lab_process import Up, statuses, until

FOLDER = Path(__file__).parent
SEED = 11


def simulate() -> Iterator[Record]:
    """PCR, colour picker and a generated route on a bad day: faults, restarts, questions, a stop."""
    lab = SimulatedLab(stand(), SEED, STORMY, stops=[("rpl/pf400", 900.0)])
    try:
        lab.run([pcr("a", "ada"), colour_picker("b", "bo", 2, 300.0), make_generated("c", "ada", 3, 600.0)])
        yield from list(lab.store.records)
    finally:
        lab.close()


def steps_of_every_kind() -> Iterator[Record]:
    """Steps that are read by later ones, left out, tried again, recovered from and late, on a worse day."""
    rates = structs.replace(STORMY, crash=0.012)
    lab = SimulatedLab(stand(), SEED, rates, stops=[("rpl/sealer", 400.0)])
    late = make_timed(2, "ask", "1 s")
    jobs = [
        *(Job(f"c{n}", "ada", (structs.replace(compile_text(CAREFUL), user="ada"),)) for n in range(4)),
        Job("late", "bo", (structs.replace(late, user="bo"),)),
        make_dosed_and_read("b", "bo", 300.0),
    ]
    try:
        lab.run_for(jobs, 3 * 3600.0)
        yield from list(lab.store.records)
    finally:
        lab.close()


CAREFUL = """
labos: 1
name: careful
steps:
  - {name: Get, module: sciclops, action: get_plate, args: {loc: tower1}}
  - name: In
    module: pf400
    action: transfer
    args: {source: sciclops.exchange, target: camera_module.plate_station}
  - name: Shoot
    module: camera_module
    action: take_picture
    args: {file_name: a.jpg}
    retry: {times: 2, delay: 5 s, reset: true}
    on_error: skip
  - name: Again
    module: camera_module
    action: take_picture
    args: {file_name: b.jpg}
    when: steps.Shoot.result == 1
  - name: Strict
    module: camera_module
    action: take_picture
    args: {file_name: c.jpg}
    expect: result == 1
    on_error:
      run:
        - {name: Once more, module: camera_module, action: take_picture, args: {file_name: d.jpg}}
      then: go_on
  - name: Over
    module: pf400
    action: transfer
    args: {source: camera_module.plate_station, target: sealer.default}
  - name: Seal
    module: sealer
    action: seal
    args: {time: 3.0, temperature: 175}
    retry: {times: 1, reset: true}
    on_error: ask
  - {name: Away, module: pf400, action: transfer, args: {source: sealer.default, target: wc.trash}}
"""


def real() -> Iterator[Record]:
    """Processes: a PCR and a cancelled one, a module out of service, an emergency stop and its reset."""
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder) / "lab"
        up = Up(home, "--simulate", "--speed", "1500", "--quiet")
        try:
            up.start("rpl")
            with up.client() as client:
                _work(client)
            assert up.interrupt() == 0, up.read_log()
            store = open_store(f"sqlite:///{home / 'labos.db'}", read_only=True)
            backup(store, FolderBlobs(home / "blobs"), Path(folder) / "safe")
            store.close()
        finally:
            up.clean_up()
        safe = Path(folder) / "safe"
        yield from list(records_of(safe, read_backup(safe)))


def _work(client: LabClient) -> None:
    first = client.submit("pcr", user="ada")
    second = client.submit("pcr", user="bo")
    until(lambda: client.status(second).status == "active", "both run")
    client.cancel(second, "bo")
    assert statuses(client, [first, second])[0] == "completed"
    client.take_out("hidex", "its lamp is changed", "ada")
    client.put_back("hidex", "ada")
    client.emergency_stop("sealer", "ada")
    assert client.reset("sealer", "ada").succeeded


MAKERS: dict[str, Callable[[], Iterator[Record]]] = {
    "simulated-1": simulate,
    "real-1": real,
    "simulated-2": steps_of_every_kind,
}


MOMENTS = 60
"""At so many positions of a log, and at its end, the view is noted: at the end most runs are over."""


def views(records: list[Record]) -> list[dict[str, Any]]:
    """What a log folds to at its moments, the end last."""
    state, found = LabState(), []
    ends = sorted({len(records) * part // MOMENTS for part in range(1, MOMENTS + 1)})
    for begin, end in pairwise([0, *ends]):
        fold(state, records[begin:end])
        found.append(lab_view(state))
    return found


def note_views(name: str) -> None:
    """Keep what a log folds to."""
    found = views(list(read_segment(FOLDER / f"{name}.jsonl.gz")))
    text = json.dumps(found, sort_keys=True, indent=1, ensure_ascii=False).encode() + b"\n"
    (FOLDER / f"{name}.views.json.gz").write_bytes(gzip.compress(text, mtime=0))
    print(f"{name}: {len(found)} views, the last one at position {found[-1]['position']}")


def main(*arguments: str) -> None:
    if arguments[:1] == ("--view",):
        note_views(arguments[1])
        return
    for name in arguments or tuple(MAKERS):
        path = FOLDER / f"{name}.jsonl.gz"
        if path.exists():
            raise SystemExit(f"{path} is there and stays as it is: give the new log another name.")
        write_segment(path, MAKERS[name]())
        note_views(name)


if __name__ == "__main__":
    main(*sys.argv[1:])
