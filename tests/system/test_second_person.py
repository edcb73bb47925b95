"""What is dangerous takes a second person: from the word in `about` to the motion of the device."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from labos.bootstrap import LabThread
from labos.cli.app import group
from labos.client import LabClient
from labos.core.decide.users import AddUser, GrantRole
from labos.errors import Forbidden, Refused
from labos.settings import Settings
from labos.spec import parse_workcell
from tests.integration.http.signed import execute, token_of
from tests.support.lab_process import until

CELL = """
labos: 1
name: corner
modules:
  - name: cutter
    second_person: true
    about:
      actions:
        look: {duration: 1}
        cut: {duration: 1, dangerous: laser}
        anneal: {duration: 1, dangerous: hot}
        burn: {duration: 1, dangerous: irreversible}
"""
FLOW = "labos: 1\nname: NAME\nsteps:\n  - {name: once, module: cutter, action: NAME}\n"
ROLES = {"olga": "operator", "otto": "operator", "bo": "submitter", "robot": "operator"}


@pytest.mark.slow
def test_nothing_dangerous_moves_before_a_second_person_has_said_so(tmp_path: Path) -> None:
    settings = Settings.make(tmp_path / "lab", speed=100.0, simulate=True)
    with LabThread(settings, [parse_workcell(CELL, {})], nodes="processes") as lab:
        execute(lab, AddUser("ada"), "ada")
        for name, role in ROLES.items():
            execute(lab, AddUser(name, "service" if name == "robot" else "person"), "ada")
            execute(lab, GrantRole(f"user:{name}", role), "ada")  # type: ignore[arg-type]
        tokens = {name: token_of(tmp_path, name, scope="admin") for name in ROLES}
        people = {name: LabClient(lab.url, token=token) for name, token in tokens.items()}
        look, bo, olga = people["otto"], people["bo"], people["olga"]
        until(lambda: look.state()["modules"][0]["status"] == "IDLE", "the node is there")

        def labos(user: str, *words: str) -> Result:
            env = {"LABOS_URL": lab.url, "LABOS_TOKEN": tokens[user], "LABOS_HOME": ""}
            return CliRunner().invoke(group, words, env=env)

        shown = {action["name"]: action["dangerous"] for action in look.actions("cutter")["actions"]}
        assert shown == {"look": "", "reset": "", "cut": "laser", "anneal": "hot", "burn": "irreversible"}
        assert "laser" in labos("bo", "actions", "cutter").output

        def submit(client: LabClient, name: str) -> str:
            return client.submit({"text": FLOW.replace("NAME", name), "name": f"{name}.yaml"}, {}, user="")

        def question_of(run: str) -> str:
            return str(next(q["id"] for q in look.state()["interventions"] if q["run"] == run))

        def list_moved(run: str) -> bool:
            return any(e["payload"]["run"] == run for e in look.events(type="action.requested"))

        # What is not dangerous does not wait.
        assert bo.wait(submit(bo, "look"), timeout_s=60).status == "completed"
        for name in ("cut", "anneal", "burn"):
            run = submit(bo, name)
            question = question_of(run)
            assert name != "cut" or "(laser)" in labos("bo", "interventions").output
            with pytest.raises(Forbidden):
                bo.resolve(question, "approve", "")
            with pytest.raises(Refused, match="is not a person"):
                people["robot"].resolve(question, "approve", "")
            assert not list_moved(run)
            assert labos("olga", "resolve", question, "approve").exit_code == 0
            assert bo.wait(run, timeout_s=60).status == "completed"
            (approved,) = (e for e in look.events(type="run.approved") if e["payload"]["run"] == run)
            (asked,) = (e for e in look.events(type="action.requested") if e["payload"]["run"] == run)
            assert approved["position"] < asked["position"]
            assert approved["payload"]["by"] == "olga"
        # An operator is no second person for what is their own, and no is no.
        run = submit(olga, "cut")
        with pytest.raises(Refused, match="second person"):
            olga.resolve(question_of(run), "approve", "")
        assert (
            labos("otto", "resolve", question_of(run), "refuse", "--why", "the guard is open").exit_code == 0
        )
        assert olga.wait(run, timeout_s=60).status == "cancelled"
        assert not list_moved(run)
        for client in people.values():
            client.close()
