"""The client for programs that use asyncio: each method calls the method with the same name of the
synchronous client."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

from labos.client._experiment import Experiment
from labos.client._generated.twin_calls import AsyncCalls
from labos.client._lab import LabClient
from labos.client._logged import Loop
from labos.client._threads import Threads, Twin, ask, ask_and_wait, ask_in_turn, ask_one_by_one

if TYPE_CHECKING:
    from collections.abc import AsyncIterator
    from contextlib import AbstractAsyncContextManager
    from random import Random

    from numpy.random import Generator


class AsyncLabClient(AsyncCalls):
    """As ``LabClient``, which is its attribute ``sync``, with methods that are awaited. A cancelled call may
    have been carried out. The methods of a ``RunResult`` send requests that block the event loop: use
    ``readings``, ``file`` and the other methods of this class in their place."""

    sync: LabClient

    def __init__(
        self,
        url: str = "",
        *,
        home: str | Path | None = None,
        patience_s: float = 30.0,
        token: str = "",
        behalf: str = "",
    ) -> None:
        super().__init__(
            LabClient(url, home=home, patience_s=patience_s, token=token, behalf=behalf), Threads()
        )

    async def __aenter__(self) -> AsyncLabClient:
        return self

    async def __aexit__(self, *error: object) -> None:
        await self.close()

    async def close(self) -> None:
        self.threads.give_up()
        await self.threads.call(self.sync.close)

    @property
    def warnings(self) -> list[str]:
        return self.sync.warnings

    @property
    def approval(self) -> str:
        return self.sync.approval

    @property
    def token_place(self) -> str:
        return self.sync.token_place

    def events(
        self, after: int = 0, *, follow: bool = False, wait_s: float | None = None, **filters: Any
    ) -> AsyncIterator[dict[str, Any]]:
        """As ``LabClient.events``."""
        pages = self.sync._iterate_pages_of_events(after, follow=follow, wait_s=wait_s, **filters)
        return self.threads.iterate_pages(pages)

    amend_campaign = ask(LabClient.amend_campaign)
    apply_workcell = ask(LabClient.apply_workcell)
    approvals = ask(LabClient.approvals)
    as_completed = ask_one_by_one(LabClient.as_completed)
    ask_nodes = ask(LabClient.ask_nodes)
    check = ask(LabClient.check)
    check_nodes = ask(LabClient.check_nodes)
    clone_campaign = ask(LabClient.clone_campaign)
    control = ask(LabClient.control)
    do = ask(LabClient.do)
    file = ask(LabClient.file)
    forecast_campaign = ask(LabClient.forecast_campaign)
    forecast_run = ask(LabClient.forecast_run)
    image = ask(LabClient.image)
    leave = ask(LabClient.leave)
    load_samples = ask(LabClient.load_samples)
    page_of_events = ask(LabClient.page_of_events)
    readings = ask(LabClient.readings)
    reset = ask_and_wait(LabClient.reset)
    run = ask_and_wait(LabClient.run)
    start_experiment = ask(LabClient.start_experiment)
    status = ask_and_wait(LabClient.status)
    submit = ask(LabClient.submit)
    submit_all = ask(LabClient.submit_all)
    submit_campaign = ask(LabClient.submit_campaign)
    table = ask(LabClient.table)
    wait = ask_and_wait(LabClient.wait)


class AsyncExperiment(Twin):
    """As ``Experiment``, which is its attribute ``sync``, with methods that are awaited::

    async with AsyncLabClient(home="lab") as lab, AsyncExperiment(lab, "mix", "ada") as experiment:
        result = await experiment.run("mix.yaml")
    """

    sync: Experiment

    def __init__(
        self,
        lab: AsyncLabClient,
        name: str,
        user: str,
        *,
        closing: str | Path | None = None,
        closing_payload: Mapping[str, Any] | None = None,
        workcell: str = "",
        priority: int = 0,
        parking: Sequence[str] = (),
        resume: str = "",
        keep_open: bool = False,
        part_of: AsyncExperiment | None = None,
    ) -> None:
        self.lab = lab
        behind = Experiment(
            lab.sync,
            name,
            user,
            closing=closing,
            closing_payload=closing_payload,
            workcell=workcell,
            priority=priority,
            parking=parking,
            resume=resume,
            keep_open=keep_open,
            part_of=part_of.sync if part_of is not None else None,
        )
        super().__init__(behind, lab.threads)

    async def __aenter__(self) -> AsyncExperiment:
        try:
            await self.threads.wait(self.sync.__enter__)
        except BaseException:
            self.sync._over.set()  # the block has ended: no more heartbeats
            raise
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.threads.wait(self.sync.__exit__, kind, error, trace)

    @property
    def name(self) -> str:
        return self.sync.name

    @property
    def user(self) -> str:
        return self.sync.user

    @property
    def workcell(self) -> str:
        return self.sync.workcell

    @property
    def id(self) -> str:
        return self.sync.id

    @property
    def numpy_random(self) -> Generator:
        return self.sync.numpy_random

    @property
    def random(self) -> Random:
        return self.sync.random

    def loop(self, name: str, **facts: Any) -> AbstractAsyncContextManager[AsyncLoop]:
        """As ``Experiment.loop``."""
        return self.threads.block_of(self.sync.loop(name, **facts), AsyncLoop)

    as_completed = ask_one_by_one(Experiment.as_completed)
    compute = ask_in_turn(Experiment.compute)
    compute_all = ask_in_turn(Experiment.compute_all)
    configure_compute = ask_and_wait(Experiment.configure_compute)
    configure_transfer = ask_and_wait(Experiment.configure_transfer)
    decide = ask_in_turn(Experiment.decide)
    keep_file = ask_and_wait(Experiment.keep_file)
    log_check = ask_and_wait(Experiment.log_check)
    log_decision = ask_and_wait(Experiment.log_decision)
    log_flow = ask_and_wait(Experiment.log_flow)
    log_local_compute = ask_and_wait(Experiment.log_local_compute)
    log_loop_end = ask_and_wait(Experiment.log_loop_end)
    log_loop_start = ask_and_wait(Experiment.log_loop_start)
    log_publication = ask_and_wait(Experiment.log_publication)
    log_remote_compute = ask_and_wait(Experiment.log_remote_compute)
    note = ask_and_wait(Experiment.note)
    publish = ask_in_turn(Experiment.publish)
    run = ask_in_turn(Experiment.run)
    run_flow = ask_in_turn(Experiment.run_flow)
    submit = ask_in_turn(Experiment.submit)
    submit_all = ask_in_turn(Experiment.submit_all)
    submit_compute = ask_in_turn(Experiment.submit_compute)
    transfer = ask_in_turn(Experiment.transfer)


class AsyncLoop(Twin):
    """As ``Loop``, with methods that are awaited."""

    sync: Loop

    @property
    def name(self) -> str:
        return self.sync.name

    @property
    def facts(self) -> dict[str, Any]:
        return self.sync.facts

    check = ask(Loop.check)

    async def report(self, **facts: Any) -> None:
        """As ``Loop.report``."""
        await self.threads.call(self.sync.report, **facts)
