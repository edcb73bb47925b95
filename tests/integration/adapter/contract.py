"""What every REST adapter must do with a real foreign node; a subclass names the kind."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path
from typing import ClassVar

import pytest
from msgspec.structs import replace

from labos.adapter import describe_foreign
from labos.core.model import ActionSpec, Arg, Description
from labos.settings import free_port
from tests.integration.adapter.bench import Bench
from tests.integration.adapter.scenario import play
from tests.integration.bus.contract import until
from tests.support.foreign import ForeignProcess
from tests.support.proxy import Proxy


class Contract:
    """Inherit, and name the kind of foreign node."""

    kind: ClassVar[str]
    startup_words: ClassVar[bytes]
    version: ClassVar[str]

    @pytest.fixture(scope="class")
    @classmethod
    def foreign(cls, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ForeignProcess]:
        process = ForeignProcess(cls.kind, tmp_path_factory.mktemp(cls.kind), free_port())
        try:
            yield process.start()
        finally:
            process.kill()

    @pytest.fixture
    def proxy(self, foreign: ForeignProcess) -> Iterator[Proxy]:
        proxy = Proxy(foreign.port)
        yield proxy
        proxy.close()

    def describe(self, foreign: ForeignProcess) -> Description:
        """As a lab would write it down: WEI's nodes do not say that an argument is a place."""
        told = asyncio.run(describe_foreign(foreign.interface, {"node_url": foreign.url}))
        places = tuple(Arg(name=name, type="station") for name in ("source", "target"))
        actions = [
            replace(action, args=places) if action.name == "transfer" else action for action in told.actions
        ]
        return replace(told, actions=tuple(actions))

    def run(self, folder: Path, scenario: Callable[[Bench], Awaitable[None]]) -> None:
        play(folder, scenario, limit_s=90.0)

    # -- every day ---------------------------------------------------------------------------

    def test_it_says_what_it_offers(self, foreign: ForeignProcess) -> None:
        description = self.describe(foreign)
        shake = description.action("shake")
        assert shake is not None
        assert shake.description == "Shake the plate."
        assert [(arg.name, arg.type) for arg in shake.args] == [
            ("speed", "int"),
            ("time_s", "float"),
            ("label", "str"),
        ]
        assert shake.args[1].default == 0.2
        run = description.action("run")
        assert run is not None
        assert run.args[0].type == "file"

    def test_actions_files_errors_reset_and_state(self, foreign: ForeignProcess, tmp_path: Path) -> None:
        description = self.describe(foreign)

        async def scenario(here: Bench) -> None:
            places = {"source": [1, 2], "nest": [3, 4]}
            where = {"node_url": foreign.url, "representations": places}
            adapter = await here.adapter(foreign.interface, description, **where)
            await here.idle()
            await here.start("a1", "shake", speed=300, label="everyday")
            done = await here.outcome("a1")
            assert (done.succeeded, done.effects) == (True, "all")
            assert done.result == {"speed": 300, "turns": 60.0}
            assert adapter.node.setup.firmware == self.version
            assert len(foreign.truth("shake", label="everyday")) == 1
            await here.start("a2", "transfer", source="source", target="arm.nest")
            assert (await here.outcome("a2")).succeeded
            assert foreign.truth("transfer")[-1] == {"what": "transfer", "source": [1, 2], "target": [3, 4]}
            # files, both ways
            await here.start("a3", "run", {"p.yaml": b"steps: 3"}, protocol="p.yaml")
            assert (await here.outcome("a3")).succeeded
            assert foreign.truth("run")[-1]["text"] == "steps: 3"
            await here.start("a4", "picture")
            (image,) = (await here.outcome("a4")).result["files"].values()
            assert here.blobs.get(image["sha256"]) == b"\x89PNG" + bytes(range(256))
            # an action that the node refuses unread, and one that fails
            refused = await here.start("a5", "shake", speed="fast")
            assert (refused.status, "whole number" in refused.why) == ("refused", True)
            await here.start("a6", "jam", label="everyday")
            failed = await here.outcome("a6")
            assert (failed.succeeded, failed.effects) == (False, "unknown")
            assert "The plate is stuck." in failed.error
            assert (await here.kernel.state()).status == "ERROR"
            assert (await here.kernel.recover("a7")).succeeded
            await here.idle()
            assert (await here.kernel.admin("observe")).result["speed"] == 0
            # a known attempt is never passed on again
            told = await here.start("a1", "shake", speed=300, label="everyday")
            assert told.outcome == done
            assert len(foreign.truth("shake", label="everyday")) == 1

        self.run(tmp_path, scenario)

    @pytest.mark.full
    def test_what_never_left_is_a_failure_without_effects(
        self, foreign: ForeignProcess, tmp_path: Path
    ) -> None:
        description = self.describe(foreign)

        async def scenario(here: Bench) -> None:
            proxy = Proxy(foreign.port)
            await here.adapter(foreign.interface, description, node_url=proxy.url)
            await here.idle()
            proxy.close()
            await here.start("a1", "shake", speed=1, label="never")
            failed = await here.outcome("a1")
            assert (failed.succeeded, failed.effects) == (False, "none")
            await here.in_error("does not answer")
            assert foreign.truth("shake", label="never") == []

        self.run(tmp_path, scenario)

    @pytest.mark.full
    def test_what_the_node_lacks_is_said(self, foreign: ForeignProcess, tmp_path: Path) -> None:
        told = self.describe(foreign)
        more = (*told.actions, ActionSpec(name="dance"))

        async def scenario(here: Bench) -> None:
            mine = await here.adapter(
                foreign.interface, replace(told, version="", actions=more), node_url=foreign.url
            )
            await here.in_error("does not offer dance")
            await mine.close()
            await here.await_node_gone()
            # A driver may know more than this node.
            await here.adapter(
                foreign.interface, replace(told, version="1", actions=more), node_url=foreign.url
            )
            await here.idle()
            await here.start("a1", "dance")
            failed = await here.outcome("a1")
            assert (failed.succeeded, failed.effects) == (False, "none")

        self.run(tmp_path, scenario)

    # -- what goes wrong ---------------------------------------------------------------------

    @pytest.mark.full
    @pytest.mark.parametrize("early", [False, True], ids=["answer lost", "line cut"])
    def test_a_lost_answer_never_moves_twice(
        self, foreign: ForeignProcess, proxy: Proxy, tmp_path: Path, early: bool
    ) -> None:
        description = self.describe(foreign)
        label = f"lost {early}"

        async def scenario(here: Bench) -> None:
            await here.adapter(foreign.interface, description, node_url=proxy.url)
            await here.idle()
            proxy.lose_next(b"POST", self.startup_words, early=early)
            await here.start("a1", "shake", speed=2, time_s=1.0, label=label)
            await self.see_lost(here, "a1")
            assert proxy.lost == 1
            await until(lambda: len(foreign.truth("shaken", label=label)) == 1, 20)
            again = await here.start("a1", "shake", speed=2, time_s=1.0, label=label)
            assert again.status in ("finished", "interrupted")
            await here.idle()
            await here.start("a2", "shake", speed=3, time_s=0.0, label=label)
            assert (await here.outcome("a2")).succeeded
            assert [line["speed"] for line in foreign.truth("shake", label=label)] == [2, 3]

        self.run(tmp_path, scenario)

    async def see_lost(self, here: Bench, action: str) -> None:
        """What the lab learns of an action whose answer was lost."""
        raise NotImplementedError

    @pytest.mark.full
    def test_the_adapter_is_killed_in_mid_action(self, foreign: ForeignProcess, tmp_path: Path) -> None:
        description = self.describe(foreign)

        async def scenario(here: Bench) -> None:
            first = await here.process(foreign.interface, description, node_url=foreign.url)
            await here.idle()
            await here.start("a1", "shake", speed=4, time_s=8.0, label="killed")
            await until(lambda: len(foreign.truth("shake", label="killed")) == 1, 20)
            first.kill()
            await here.await_node_gone()
            await here.process(foreign.interface, description, node_url=foreign.url)
            if not foreign.truth("shaken", label="killed"):
                assert (await here.kernel.ask("a1", void=True)).status == "running"
            await self.see_lost(here, "a1")
            assert len(foreign.truth("shaken", label="killed")) == 1
            again = await here.start("a1", "shake", speed=4, time_s=8.0, label="killed")
            assert again.status in ("finished", "interrupted")
            await here.idle()
            assert len(foreign.truth("shake", label="killed")) == 1

        self.run(tmp_path, scenario)

    @pytest.mark.full
    def test_the_foreign_node_is_killed_in_mid_action(self, tmp_path: Path, foreign: ForeignProcess) -> None:
        description = self.describe(foreign)

        async def scenario(here: Bench) -> None:
            await here.adapter(foreign.interface, description, node_url=foreign.url, patience_s=60.0)
            await here.idle()
            await here.start("a1", "shake", speed=5, time_s=30.0, label="died")
            await until(lambda: len(foreign.truth("shake", label="died")) == 1, 20)
            foreign.kill()
            await here.in_error("does not answer")
            foreign.start()
            told = await here.status("a1", "interrupted")
            assert "foreign node" in told.why or "lost" in told.why
            await here.idle()
            again = await here.start("a1", "shake", speed=5, time_s=30.0, label="died")
            assert again.status == "interrupted"
            await here.start("a2", "shake", speed=6, time_s=0.0, label="died")
            assert (await here.outcome("a2")).succeeded
            assert [line["speed"] for line in foreign.truth("shake", label="died")] == [5, 6]

        self.run(tmp_path, scenario)
