"""Computes in a process of this computer what Globus Compute would compute at an endpoint."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor
from typing import Any


class Client:
    def run(self, function: Callable[..., Any], endpoint: str, *args: Any) -> Future[Any]:
        with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
            return pool.submit(function, *args)
