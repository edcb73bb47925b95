"""A simulated SWING. All durations are invented, because none is published."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from labos_drivers._simulation import Gated


class ChemspeedSimulator(Gated):
    """A platform that needs a plate from outside only for a program with ``wells``. ``bubbles`` of the config
    (0 to 1) is the share of wells that keep a bubble."""

    gate_s = 6.0

    async def run_program(
        self,
        program: str,
        wells: Sequence[str] = (),
        volumes: Mapping[str, Sequence[float]] | None = None,
        lengths: Sequence[float] = (),
    ) -> None:
        volumes = volumes or {}
        for what, values in {**volumes, "chain_lengths": lengths}.items():
            if len(values) != len(wells):
                raise self.make_refusal(
                    f"{len(wells)} wells, but {len(values)} values of {what}", "Give one value a well."
                )
        with self.motion():
            self.check_closed()
            await self.take_time(3600)
            place = self.place("default")
            if wells and not self.top(place):
                raise self.make_refusal("there is no plate to fill")
            recipe = {"wells": list(wells), "volumes": dict(volumes), "lengths": list(lengths)}
            self.world.work(
                self.name,
                "synthesise",
                place if self.top(place) else "",
                program=program,
                **(recipe if wells else {}),
            )
            for well in wells:
                if self._random.random() < float(self.config.get("bubbles", 0.0)):
                    self.world.work(self.name, "bubble", place, well=well)
