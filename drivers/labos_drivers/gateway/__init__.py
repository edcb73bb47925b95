"""Instruments behind their makers' own software: a small protocol, a gateway that speaks it, a driver."""
