"""PreciseFlex 400 plate arm."""

from labos_drivers.pf400.interface import PF400

__all__ = ["PF400"]
