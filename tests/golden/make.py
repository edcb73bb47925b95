"""Writes golden logs with the present version: ``python -m tests.golden.make NAME``.

Make new ones when events have come that no golden log holds; never write one again that is there.
``--state NAME`` notes anew which state a log folds to, after a change of the fold that was meant:
the log itself stays.
"""

from __future__ import annotations

import gzip
import json
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec

from labos.client import LabClient
from labos.core.envelope import Record
from labos.core.state import LabState
from labos.runtime.ledger import fold
from labos.store import FolderBlobs, backup, open_store, read_backup, read_segment, records_of, write_segment
from labos.testing.faults import STORMY
from labos.testing.lab import SimulatedLab
from tests.golden.shape import plain_hash
from tests.simulation.mixes import colour_picker, generated, pcr, stand
from tests.support.lab_process import Up, statuses, until

FOLDER = Path(__file__).parent
SEED = 11


def simulated() -> Iterator[Record]:
    """PCR, colour picker and a generated route on a bad day: faults, restarts, questions, a stop."""
    lab = SimulatedLab(stand(), SEED, STORMY, stops=[("rpl/pf400", 900.0)])
    try:
        lab.run([pcr("a", "ada"), colour_picker("b", "bo", 2, 300.0), generated("c", "ada", 3, 600.0)])
        yield from list(lab.store.records)
    finally:
        lab.close()


def real() -> Iterator[Record]:
    """Processes: a PCR and a cancelled one, a module out of service, an emergency stop and its reset."""
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder) / "lab"
        up = Up(home, "--simulate", "--speed", "1500", "--quiet")
        try:
            up.start("rpl")
            with up.client() as client:
                _work(client)
            assert up.interrupt() == 0, up.said()
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


MAKERS: dict[str, Callable[[], Iterator[Record]]] = {"simulated-1": simulated, "real-1": real}


def note_state(name: str) -> None:
    """Keep the state that a log folds to."""
    state = LabState()
    fold(state, read_segment(FOLDER / f"{name}.jsonl.gz"))
    plain = msgspec.to_builtins(state, str_keys=True)
    data = {"position": state.position, "state_hash": plain_hash(plain), "state": plain}
    text = json.dumps(data, sort_keys=True, indent=1, ensure_ascii=False).encode() + b"\n"
    (FOLDER / f"{name}.state.json.gz").write_bytes(gzip.compress(text, mtime=0))
    print(f"{name}: position {state.position}, state {data['state_hash']}")


def main(*arguments: str) -> None:
    if arguments[:1] == ("--state",):
        note_state(arguments[1])
        return
    for name in arguments or tuple(MAKERS):
        path = FOLDER / f"{name}.jsonl.gz"
        if path.exists():
            raise SystemExit(f"{path} is there and stays as it is: give the new log another name.")
        write_segment(path, MAKERS[name]())
        note_state(name)


if __name__ == "__main__":
    main(*sys.argv[1:])
