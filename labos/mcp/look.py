"""Tools that read."""

from __future__ import annotations

from typing import Any

import msgspec

from labos.client import LabClient
from labos.errors import BadInput
from labos.mcp.pages import LONGEST, cut, encode_answer, page
from labos.services.times import with_iso_times

ENDED = 20
"""The number of ended runs in a list."""

NEWEST = 50
"""The number of the last events in an answer."""


class Look:
    """Tools that show the state of the lab. They change nothing."""

    def __init__(self, lab: LabClient) -> None:
        self._lab = lab

    def lab(self) -> str:
        """Shows the lab and its workcells, your user and rights, which of your submissions need an approval,
        and the number of open runs and questions."""
        health, state = self._lab.health(), self._lab.state(waits=False)
        counts = {name: len(state[name]) for name in ("modules", "runs", "labware", "interventions")}
        asked = [q["text"] for q in state["interventions"][:20]]
        return encode_answer(
            {
                "lab": {name: health[name] for name in ("name", "status", "simulated")},
                "you": self._lab.identity(),
                "workcells": list(state["lab"]["workcells"]),
                "counts": counts,
                "people_are_asked": cut(asked),
                "policy": self._lab.policy()["policy"],
            }
        )

    def modules(self, after: int = 0) -> str:
        """Lists the modules (instruments, arms, people) of the lab, with kind, status and present action.
        `after` is the `next` of the previous page."""
        found = self._lab.state(waits=False)["modules"]
        kept = ("module", "driver", "status", "problem", "out_of_service", "simulated", "doing")
        rows = [{name: module[name] for name in kept} for module in found]
        return page(rows[after:], lambda number: after + number)

    def module_actions(self, module: str, after: int = 0) -> str:
        """Lists the actions of a module with their arguments, units and ranges, as a step of a workflow uses
        them. `module` is its name; `after` is the `next` of the previous page."""
        found = self._lab.actions(module)
        actions = found.pop("actions")
        return page(actions[after:], lambda number: after + number, module=found["module"])

    def bench(self, after: int = 0) -> str:
        """Lists the stations of the bench and the labware on them. `after` is the `next` of the previous
        page."""
        state = self._lab.state(waits=False)
        labware = {item["id"]: item for item in state["labware"]}
        rows = [
            {
                "station": place["name"],
                "known": place["known"],
                "stock": place["stock"],
                "labware": [
                    {part: labware[name][part] for part in ("id", "type", "owner", "barcode")}
                    for name in place["labware"]
                    if name in labware
                ],
            }
            for place in state["stations"]
        ]
        return page(rows[after:], lambda number: after + number)

    def inventory(self) -> str:
        """Shows the remaining consumables with their lots, and the first run that will have too little."""
        return encode_answer(cut(with_iso_times(self._lab.inventory()), LONGEST))

    def runs(self, after: int = 0) -> str:
        """Lists the runs that wait or are under way, and the last ended runs. `after` is the `next` of the
        previous page."""
        found = self._lab.runs(after=after, ended=0 if after else ENDED)
        rows = [
            {name: run[name] for name in ("id", "workflow", "user", "status", "why")} for run in found["runs"]
        ]
        return encode_answer(cut(rows, LONGEST), next=found["position"] if found["more"] else None)

    def run(self, run: str, first_step: int = 0) -> str:
        """Shows the progress of a run, with the results and errors of its steps. `run` is its id, such as R7.
        A long run comes in pages: `first_step` is the `next` of the previous page."""
        found = with_iso_times(msgspec.to_builtins(self._lab.status(run)))
        steps = found.pop("steps", [])
        return page(steps[first_step:], lambda number: first_step + number, run=cut(found))

    def why_run_waits(self, run: str) -> str:
        """Explains why a run does not continue: the reasons why its next steps wait, whether it waits for an
        approval, and the remedies. `run` is its id, such as R7."""
        state = self._lab.state()
        alive = next((found for found in state["runs"] if found["id"] == run), None)
        if alive is None:
            over = self._lab.status(run)
            return encode_answer(cut({"run": run, "status": over.status, "why": over.why}))
        waits = [f"{wait['key']}: {wait['why']}" for wait in alive["waits"]]
        asked = [q["text"] for q in state["interventions"] if q["run"] == run]
        return encode_answer(
            cut({"run": run, "status": alive["status"], "waits": waits, "people_are_asked": asked})
        )

    def campaigns(self, after: int = 0) -> str:
        """Lists the campaigns that have not ended, with their progress and terms. `after` is the `next` of
        the previous page."""
        found = self._lab.campaigns()
        return page(with_iso_times(found)[after:], lambda number: after + number)

    def proposals(self, subject: str = "", after: int = 0) -> str:
        """Lists the submissions that wait for an operator's approval, with the reasons. With `subject` (R7,
        C3, E2), shows only that one: the work and material that it needs, and how it differs from the last
        approved one. `after` is the `next` of the previous page."""
        if subject:
            return encode_answer(cut(with_iso_times(self._lab.approval_of(subject)), LONGEST))
        found = with_iso_times(self._lab.approvals())
        return page(found[after:], lambda number: after + number)

    def log(
        self, after: int = 0, before: int = 0, type: str = "", mentions: str = "", newest: bool = False
    ) -> str:
        """Reads the log of events, a page of them, the oldest first. `type` selects a kind of event (such as
        `run.failed`, or `run` for all about runs), and `mentions` selects events that name an id. `after` is
        the `next` of the previous page. With `newest`, the last events come first; `before` is then the
        `next` of the previous page."""
        if newest and before == 1:
            return page([], lambda number: number)
        last = {"last": NEWEST, "upto": max(before - 1, 0)} if newest else {"after": after}
        asked = {**last, "type": type, "mentions": mentions}
        found = msgspec.json.decode(self._lab.page_of_events({k: v for k, v in asked.items() if v}))
        events = found["events"][::-1] if newest else found["events"]
        rows = list(map(_event, events))
        if newest:
            rest = events[-1]["position"] if len(events) == NEWEST else None
            return page(rows, lambda number: events[number - 1]["position"], rest=rest)
        rest = found["position"] if events else None
        return page(rows, lambda number: events[number]["position"] - 1, rest=rest)

    def provenance(self, subject: str, after: int = 0) -> str:
        """Shows the history of a piece of labware, a run, an experiment or a campaign from the log: the
        actions, with user and time. `subject` is its id, such as P7 or R1; `after` is the `next` of the
        previous page."""
        if not subject.strip():
            raise BadInput("The id is missing.", remedy="Give an id, as P7 or R1.")
        return self.log(after=after, mentions=subject)

    def read_file(self, sha256: str, first: int = 0) -> str:
        """Reads a text file that a step has returned. `sha256` is its digest from the result; `first` is the
        `next` of the previous page (bytes)."""
        size = LONGEST // 2
        content = self._lab.file(sha256, first=first, last=first + size - 1)
        try:
            text = content.decode("utf-8", errors="strict" if len(content) < size else "ignore")
        except UnicodeDecodeError:
            raise BadInput(
                f"The file {sha256[:12]}… is not a text.", remedy="Fetch it: labos files"
            ) from None
        return encode_answer(text, next=first + len(content) if len(content) == size else None)


def _event(event: dict[str, Any]) -> dict[str, Any]:
    return {name: event[name] for name in ("position", "time", "type", "actor", "stream", "payload")}
