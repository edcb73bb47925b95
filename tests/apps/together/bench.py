"""One lab with the packaged workcells, its users with their tokens, and the beamline that it talks to."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType

from labos.client import LabClient, LabUnreachable
from labos.core.state import LabState
from labos.errors import LabosError, NotFound, Refused
from labos.node.world import World
from labos.runtime.ledger import fold
from labos.settings import Settings
from labos.spec import find_spec
from tests.apps.beamline import Beamline
from tests.apps.together.person import answer
from tests.support.lab_process import Up, until

BEAMLINE_AT = "127.0.0.1:5064"
PASSWORD = "four words of a user"
START_S = 180.0
"""So long a lab of four workcells may take to start where much else is under way."""


class Bench:
    """The lab as processes. ``users`` may submit, ``olga`` operates it, ``ada`` is its admin."""

    def __init__(self, folder: Path, cells: Sequence[str], speed: float, *, detach: bool = False) -> None:
        self.folder, self.cells = folder, tuple(cells)
        self.settings = Settings.make(folder / "lab")
        self._detach = ("--detach-nodes",) if detach else ()
        self.up = Up(folder / "lab", "--simulate", "--quiet", "--speed", f"{speed:g}", *self._detach)
        self.beamline = (
            Beamline(folder / "beamline", self.world_file("aps_8id")) if "aps_8id" in cells else None
        )
        self.tokens: dict[str, str] = {}

    def start(self, users: Sequence[str]) -> None:
        """Start it, wait for its nodes, and give each user a token."""
        if self.beamline is not None:
            self.beamline.start()
        self._start(*map(str, self._cell_files()))
        self.up.options = ("--quiet", *self._detach)
        with self.up.client() as home:
            home.add_user("ada", by="ada")
            home.set_password("ada", f"{PASSWORD}, ada")
            self.tokens["ada"] = home.make_token("applications", user="ada", scope="admin")["secret"]
        with self.client("ada") as ada:
            for user in ("olga", *users):
                ada.add_user(user, by="ada")
                ada.grant_role(f"user:{user}", "operator" if user == "olga" else "submitter", "ada")
                self.tokens[user] = ada.make_token("applications", user=user, scope="admin")["secret"]
        self.await_nodes()

    def kill(self) -> None:
        """kill -9 of the kernel; its nodes end with it, unless they are detached."""
        self.up.kill()

    def nodes(self) -> dict[str, int]:
        """The processes of the nodes, by module."""
        notes = (self.up.home / "nodes").glob("*.json")
        return {note.stem: int(json.loads(note.read_text())["pid"]) for note in notes}

    def start_again(self) -> None:
        self._start()

    def close(self) -> None:
        self.up.clean_up()
        if self.beamline is not None:
            self.beamline.kill()

    def client(self, user: str, patience_s: float = START_S) -> LabClient:
        return LabClient(home=self.up.home, token=self.tokens[user], patience_s=patience_s)

    def await_nodes(self) -> None:
        with self.client("olga") as olga:
            until(
                lambda: all(m["status"] != "GONE" for m in olga.state(waits=False)["modules"]),
                "all nodes are there",
                START_S,
            )

    def world_file(self, cell: str) -> Path:
        return Path(self.settings.world(cell))

    @contextmanager
    def world(self, cell: str) -> Iterator[World]:
        """What really happened in a workcell."""
        world = World(str(self.world_file(cell)))
        try:
            yield world
        finally:
            world.close()

    def _start(self, *cells: str) -> None:
        self.up.launch(*cells)
        process = self.up.process
        assert process is not None
        until(lambda: self.up.is_there() or process.poll() is not None, "the lab answers", START_S)
        assert self.up.is_there(), self.up.read_log()

    def _cell_files(self) -> list[Path]:
        """The packaged workcells; the beamline is reached at the port that it has here."""
        folder = self.folder / "workcells"
        folder.mkdir(parents=True, exist_ok=True)
        found = []
        for cell in self.cells:
            text = find_spec("workcells", cell).read_text("utf-8")
            if self.beamline is not None:
                text = text.replace(BEAMLINE_AT, f"127.0.0.1:{self.beamline.port}")
            found.append(folder / f"{cell}.yaml")
            found[-1].write_text(text, "utf-8")
        return found


class Operator:
    """Olga, who answers what the lab asks by a look at the bench, until the block ends. ``answered`` is what
    she said to which question."""

    PAUSE_S = 0.5

    def __init__(self, bench: Bench) -> None:
        self._bench = bench
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._work, name="operator", daemon=True)
        self.answered: list[tuple[str, str]] = []
        self.failed: list[BaseException] = []

    def __enter__(self) -> Operator:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._over.set()
        self._thread.join(60)

    def _work(self) -> None:
        try:
            with self._bench.client("olga", patience_s=1.0) as olga:
                while not self._over.wait(self.PAUSE_S):
                    self._look_once(olga)
        except BaseException as error:
            self.failed.append(error)

    def _look_once(self, olga: LabClient) -> None:
        try:
            if not olga.state(waits=False)["interventions"]:
                return
            state = LabState()
            fold(state, self._bench.up.records())
            for question in state.interventions.open.values():
                told = answer(self._bench.world, state, question)
                if told:
                    olga.resolve(question.id, told, by="olga")
                    self.answered.append((question.text, told))
        except (LabUnreachable, Refused, NotFound):
            return  # the lab is away, or what happened meanwhile has answered it
        except LabosError as error:
            self.failed.append(error)
