"""A day of a shared facility: four users, an operator, an agent and an intruder in one lab, killed once.

Everything goes through the HTTP API with the tokens of those who ask.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

from labos.client import LabClient
from labos.client._lab import API
from labos.core.registry import decode
from labos.core.runs import RunSubmitted
from labos.core.state import LabState
from labos.errors import Forbidden, NotSignedIn, Refused
from labos.node.world import World
from labos.runtime.ledger import fold
from labos.settings import find_kernel
from labos.testing.person import look
from tests.support.lab_process import Up, labos, until

pytestmark = pytest.mark.slow

USERS = ("bo", "cy", "di", "greedy")
RUNS = 12
PASSWORD = "correct horse battery"
FLOW = """
labos: 1
name: seal
steps:
  - {name: get, module: sciclops, action: get_plate, args: {loc: tower2}}
  - {name: in, module: pf400, action: transfer, args: {source: sciclops.exchange, target: sealer.default}}
  - {name: seal, module: sealer, action: seal, args: {time: payload.time, temperature: 175}}
  - {name: away, module: pf400, action: transfer, args: {source: sealer.default, target: wc.trash}}
"""
WORKFLOW = {"text": FLOW, "name": "seal.yaml"}
SHARES = """
labos: 1
groups:
  biology: {weight: 2, members: {bo: {}, cy: {}}}
  chemistry: {weight: 1, members: {di: {}, greedy: {quota: {running: 1}}}}
"""


class Facility:
    """The lab, and a client of each who has a token."""

    def __init__(self, lab: Up) -> None:
        self.lab = lab
        self.tokens: dict[str, str] = {}
        with lab.client() as home:
            home.add_user("ada", by="ada")
            home.set_password("ada", PASSWORD)
            self.tokens["ada"] = home.make_token("day", user="ada", scope="admin")["secret"]
        with self.who("ada") as ada:
            for user in (*USERS, "olga", "mallory"):
                ada.add_user(user, by="ada")
                ada.set_password(user, f"{PASSWORD} of {user}")
            ada.add_user("agent", by="ada", kind="service")
            for user in (*USERS, "agent"):
                ada.grant_role(f"user:{user}", "submitter", "ada")
            ada.grant_role("user:olga", "operator", "ada")
            ada.grant_role("user:mallory", "viewer", "ada")
            ada.apply_shares(SHARES, "shares.yaml", "ada")
            for user in (*USERS, "olga", "agent", "mallory"):
                self.tokens[user] = ada.make_token("day", user=user, scope="admin")["secret"]

    def who(self, user: str) -> LabClient:
        return LabClient(home=self.lab.home, token=self.tokens[user])

    def answer_all(self) -> None:
        """The operator answers what is asked, by a look at the bench."""
        state = LabState()
        fold(state, self.lab.records())
        world = World(str(self.lab.home / "world" / "rpl.db"))
        try:
            with self.who("olga") as olga:
                for question in state.interventions.open.values():
                    try:
                        olga.resolve(question.id, look(world, state, question), by="olga")
                    except Refused:
                        continue  # it was answered by what happened meanwhile
        finally:
            world.close()


@pytest.fixture
def facility(tmp_path: Path) -> Iterator[Facility]:
    up = Up(tmp_path / "lab", "--simulate", "--speed", "400", "--quiet")
    try:
        up.start_with("sciclops", "pf400", "sealer")
        yield Facility(up)
    finally:
        up.clean_up()


def submit_all(facility: Facility) -> dict[str, list[str]]:
    """What each wants of the day; the greedy one wants most."""
    wanted: dict[str, list[str]] = {}
    for user, count in (("greedy", 5), ("bo", 2), ("cy", 1), ("di", 1)):
        with facility.who(user) as client:
            # Who asks is whoever shows the token, whatever the request says.
            wanted[user] = [client.submit(WORKFLOW, {"time": 1}, user="ada") for _ in range(count)]
            if user == "greedy":
                client.pause(wanted[user][-1])  # an intruder will try to end it: it is not over before
    with facility.who("cy") as cy:
        rows = "labos: 1\ncampaign: times\nworkflow: seal.yaml\nrows: {list: [{time: 1}, {time: 2}]}\n"
        cy.submit_campaign({"text": rows, "name": "times.yaml", "workflow": WORKFLOW}, user="cy")
    return wanted


def propose_and_approve(facility: Facility) -> str:
    """The agent's run waits until the operator has looked at it."""
    with facility.who("agent") as agent, facility.who("olga") as olga:
        run = agent.submit(WORKFLOW, {"time": 3}, user="")
        assert run in agent.approval
        with pytest.raises(Forbidden):
            agent.approve(run, "", agent.approval_of(run)["proposal"]["digest"])
        assert agent.status(run).status == "queued"
        olga.approve(run, "", olga.approval_of(run)["proposal"]["digest"], comment="looked at it")
    return run


def book(facility: Facility) -> None:
    tomorrow = time.time_ns() + 24 * 3600 * 10**9
    with facility.who("di") as di, facility.who("bo") as bo:
        di.book("sealer", tomorrow, tomorrow + 3600 * 10**9, "di")
        with pytest.raises(Refused):
            bo.book("sealer", tomorrow, tomorrow + 60 * 10**9, "bo")


def intrude(facility: Facility, wanted: dict[str, list[str]]) -> int:
    """Somebody who may look on, and one with no token or a revoked one, try what is not theirs; returns how
    many tries were refused."""
    victim = wanted["greedy"][-1]
    with facility.who("ada") as ada:
        made = ada.make_token("lost", user="di", scope="admin")
        ada.revoke_token(made["token"]["id"])
    facility.tokens.update(nobody="labos_0000", thief=made["secret"])
    refused = 0
    for intruder in ("mallory", "nobody", "thief"):
        with facility.who(intruder) as client:
            tries = (
                lambda: client.submit(WORKFLOW, {"time": 1}, user="ada"),
                lambda: client.cancel(victim, by="greedy"),
                lambda: client.take_out("sealer", "mine", by="olga"),
                lambda: client.unload("wc.trash", by="olga"),
                lambda: client.grant_role("user:mallory", "admin", "ada"),
                lambda: client.set_password("ada", "mine alone for ever"),
                lambda: client.make_token("x", user="ada", scope="admin"),
            )
            for attempt in tries:
                with pytest.raises((Forbidden, NotSignedIn)):
                    attempt()
                refused += 1
    headers = {"authorization": f"Bearer {facility.tokens['mallory']}", "labos-on-behalf-of": "olga"}
    kernel = find_kernel(facility.lab.home)
    assert kernel is not None
    with httpx.Client(base_url=kernel.url + API, headers=headers) as raw:
        for path in (f"/runs/{victim}/cancel", f"/runs/{victim}/pause", "/estop"):
            assert raw.post(path, json={"by": "olga", "target": "*"}).status_code == 403
            refused += 1
    with facility.who("bo") as bo, pytest.raises(Forbidden):
        bo.cancel(victim, by="bo")
    with facility.who("greedy") as greedy:
        greedy.resume(victim)
    return refused + 1


def test_a_day_of_a_shared_facility(facility: Facility) -> None:
    lab = facility.lab
    book(facility)
    wanted = submit_all(facility)
    wanted["agent"] = [propose_and_approve(facility)]
    with facility.who("olga") as olga:  # so that no run ends before somebody has tried to cancel it
        olga.take_out("sealer", "somebody intrudes", by="olga")
        refused = intrude(facility, wanted)
        olga.put_back("sealer", by="olga")
    until(lambda: "action.succeeded" in lab.types(), "something has happened")
    with facility.who("olga") as olga:
        olga.take_out("sealer", "wipe it", by="olga")
    lab.kill()
    lab.start()
    with facility.who("olga") as olga:
        olga.put_back("sealer", by="olga")

    def is_over() -> bool:
        facility.answer_all()
        ended = ("run.completed", "run.failed", "run.cancelled")
        return sum(kind in ended for kind in lab.types()) == RUNS

    until(is_over, "the day is over", patience_s=120.0)
    facility.answer_all()
    with facility.who("bo") as bo:
        bo.sign_run(wanted["bo"][0], "reviewed", f"{PASSWORD} of bo")
        ledger = {account["user"]: account["group"] for account in bo.shares()}
    assert {user: ledger[user] for user in USERS} == {
        "bo": "biology",
        "cy": "biology",
        "di": "chemistry",
        "greedy": "chemistry",
    }

    assert lab.interrupt() == 0, lab.read_log()
    audit(lab, wanted)
    print(f"{refused} tries were refused; {Counter(lab.types())['run.completed']} of {RUNS} runs completed")


def audit(lab: Up, wanted: dict[str, list[str]]) -> None:
    """Who did what, and where everything is."""
    checked = labos("verify", "--home", str(lab.home))
    assert checked.returncode == 0, checked.stdout + checked.stderr
    assert lab.disagreements() == []
    records = lab.records()
    owners = {
        event.run: (event.user, record.head.actor)
        for record in records
        if isinstance(event := decode(record.head.type, record.head.schema, record.payload), RunSubmitted)
    }
    for user, runs in wanted.items():
        for run in runs:
            assert owners[run] == (user, user), run
    actors = {record.head.actor for record in records}
    assert "mallory" not in actors
    assert {"ada", "olga", "bo", "cy", "di", "greedy", "agent"} <= actors
    taken = Counter(motion.plate for motion in lab.motions("discard"))
    assert set(taken.values()) <= {1}, "no plate was thrown away twice"
