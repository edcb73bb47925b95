"""A lab whose steps take their nominal times."""

from __future__ import annotations

from labos.core.ids import RunId
from tests.support.bench import SECOND, Driver


class TimedDriver(Driver):
    """Time passes as the plans say. ``ends`` is when the actions in flight end."""

    careful = False
    ends: dict[str, int]

    def go_on(self, most: int = 10_000) -> None:
        """Carry on for so many turns, or until nothing moves."""
        self.ends = getattr(self, "ends", {})
        for _ in range(most):
            self.pump()
            for action in self.state.actions.open.values():
                if action.id not in self.ends:
                    lasts = self.state.runs.plan_of(self.run(action.run)).steps[action.step].duration_s
                    self.ends[action.id] = action.requested_at + int(lasts * SECOND)
            times = [self.ends[name] for name in self.list_flying()]
            alarm = self.scheduler.find_next_deadline(self.state)
            times += [alarm] if alarm is not None else []
            if not times:
                return
            self.now = max(self.now, min(times))
            for name in self.list_flying():
                if self.ends[name] <= self.now:
                    self.finish(name)

    def find_times(self, kind: type) -> dict[RunId, int]:
        """When the events of a kind were recorded, by run."""
        return {entry.event.run: entry.at for entry in self.log if isinstance(entry.event, kind)}
