"""All five applications of four users at the same time, on one lab with four workcells.

``bench`` is the lab with its users, ``programs`` are the applications as processes, ``kills`` ends what a
plan names with SIGKILL and starts it again, ``sinks`` carry events away, ``truth`` and ``results`` compare
what the simulated instruments did with what log and applications say.
"""
