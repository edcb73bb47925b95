"""What tests of applications ask a lab."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

from labos.client import LabClient


def notes(client: LabClient, name: str) -> list[dict[str, Any]]:
    """The facts of what applications logged under a name."""
    found = client.events(type="experiment.noted")
    return [event["payload"].get("facts", {}) for event in found if event["payload"]["name"] == name]


def list_standing(client: LabClient) -> list[str]:
    """Where single pieces of labware stand."""
    stations = client.state()["stations"]
    return sorted(s["name"].rpartition("/")[2] for s in stations if s["labware"])


def until_clean(client: LabClient) -> None:
    deadline = time.monotonic() + 20
    while left := unclean(client):
        assert time.monotonic() < deadline, left
        time.sleep(0.02)


def unclean(client: LabClient) -> list[Any]:
    """What runs, who is asked, and which doors, lids and tools are not as at rest."""
    state = client.state()
    alive = [*client.runs()["runs"], *state["experiments"], *state["interventions"]]
    at_rest = {"lid": "open", "gate": "open", "tool": "", "tip": "", "docked": False}
    away = [
        (m["name"], k, v)
        for m in state["modules"]
        for k, v in m["variables"].items()
        if at_rest.get(k, v) != v
    ]
    return [*alive, *away]


def says_the_same_again(client: LabClient, work: Callable[[], str], before: str) -> None:
    """An application that has ended is started again with ``--resume E1``: all it says comes from the log,
    and nothing is written into it."""
    position = client.health()["position"]
    assert work() == before
    assert list(client.events(position, correlation="E1")) == []


def cancel_at(
    client: LabClient, work: Callable[[], object], action: str, *, count: int = 1
) -> BaseException | None:
    """Start an application, and cancel its experiment when an action is requested for the ``count``th time;
    what it raised."""
    raised: list[BaseException] = []
    after = client.health()["position"]

    def start() -> None:
        try:
            work()
        except BaseException as error:
            raised.append(error)

    thread = threading.Thread(target=start)
    thread.start()
    for event in client.events(after, follow=True, type="action.requested"):
        if event["payload"]["action_name" if "action_name" in event["payload"] else "name"] == action:
            count -= 1
            if not count:
                break
    (experiment,) = client.state()["experiments"]
    client.control("cancel", experiment["id"], "ada")
    thread.join(60)
    assert not thread.is_alive()
    return raised[0] if raised else None
