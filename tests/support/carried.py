"""What hands carried, held against what the log says that they were asked to carry."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from labos.core.actions import ActionRequested, ActionSucceeded, ActionUnknown
from labos.core.effects import Move, Take
from labos.core.envelope import Record
from labos.core.ids import local
from labos.core.registry import decode
from labos.node.world import World


def find_carried_wrong(world: World, records: Sequence[Record]) -> list[str]:
    """Hands that closed more often, or less often, than their actions account for.

    An action that its device reports as done closed the hand once, or twice if the plate went by a place
    where the grip turns. One of which nobody knew how it ended may have closed it once more for each time
    that it was not known; whatever else ended may have closed it or not.
    """
    legs: dict[str, tuple[str, int]] = {}
    doubts: Counter[str] = Counter()
    done: set[str] = set()
    for record in records:
        if not record.head.type.startswith("action."):
            continue
        event = decode(record.head.type, record.head.schema, record.payload)
        if isinstance(event, ActionRequested):
            count = sum(2 if e.via else 1 for e in event.effects if isinstance(e, Move))
            count += sum(isinstance(e, Take) for e in event.effects)
            legs[event.action] = (local(event.module), count)
        elif isinstance(event, ActionUnknown):
            doubts[event.action] += 1
        elif isinstance(event, ActionSucceeded):
            done.add(event.action)
    least: Counter[str] = Counter()
    most: Counter[str] = Counter()
    for action, (device, count) in legs.items():
        least[device] += count * (action in done)
        most[device] += count * (1 + doubts[action])
    grips = Counter(motion.device for motion in world.motions("grip"))
    return [
        f"{device} closed its hand {grips[device]} times, "
        f"its actions account for {least[device]} to {most[device]}"
        for device in sorted({*grips, *most})
        if not least[device] <= grips[device] <= most[device]
    ]
