"""A simulated Infinite."""

from __future__ import annotations

from labos_drivers._simulation import Gated


class TecanSimulator(Gated):
    """Reads what is on its carrier."""

    variable = "gate"
    gate_s = 10.0

    async def measure(self, method: str, start_nm: float, end_nm: float, iteration: int) -> str:
        with self.motion():
            self.needs_closed()
            self.needs_bare(self.place("default"), "reads through a lid")
            await self.take_time(350)
            self.world.work(
                self.name, "read", self.place("default"), method=method, start_nm=start_nm, end_nm=end_nm
            )
            return f"{self.name}_{iteration}.asc"
