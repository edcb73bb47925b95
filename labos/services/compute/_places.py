"""Where functions are computed: each place is an executor of `concurrent.futures`, opened by its name."""

from __future__ import annotations

import multiprocessing
import os
import threading
from collections.abc import Callable
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from typing import Any

from labos.errors import BadInput, NotFound


def _open_local(configuration: Any) -> Executor:
    """A thread of the application's own process."""
    return ThreadPoolExecutor(configuration or 1, thread_name_prefix="compute")


def _open_pool(configuration: Any) -> Executor:
    """Processes on this computer. They are spawned and not forked, as the application has threads."""
    workers = configuration or min(os.cpu_count() or 1, 61)
    return ProcessPoolExecutor(
        workers, mp_context=multiprocessing.get_context("spawn"), initializer=_follow_parent
    )


def _follow_parent() -> None:
    """A worker ends when its parent ends, whatever the reason. The worker itself holds the writing end of the
    pipe that would report the parent's end, and a parent that is killed cannot send anything."""
    parent = multiprocessing.parent_process()

    def follow() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=follow, name="follow-parent", daemon=True).start()


def _open_parsl(configuration: Any) -> Executor:
    """``configuration`` is a `parsl.config.Config`, for this computer or for a cluster."""
    try:
        from parsl.concurrent import ParslPoolExecutor
    except ImportError:
        raise _report_missing("parsl", "parsl") from None
    if configuration is None:
        raise BadInput(
            "Parsl needs a configuration of the place to compute.", remedy="Give a parsl.config.Config."
        )
    opened: Executor = ParslPoolExecutor(configuration)
    return opened


def _open_dask(configuration: Any) -> Executor:
    """``configuration`` is a `distributed.Client`."""
    try:
        from distributed import Client
    except ImportError:
        raise _report_missing("Dask", "dask") from None
    if not isinstance(configuration, Client):
        raise BadInput("Dask needs a client for the place to compute.", remedy="Give a distributed.Client.")
    # Not pure: two calls with the same arguments are two computations.
    client: Any = configuration
    opened: Executor = client.get_executor(pure=False)
    return opened


def _open_globus(configuration: Any) -> Executor:
    """``configuration`` is a `labos.services.globus.GlobusEndpoint`."""
    from labos.services.globus import GlobusEndpoint

    if not isinstance(configuration, GlobusEndpoint):
        raise BadInput(
            "Globus Compute needs an endpoint.",
            remedy="Give a labos.services.globus.GlobusEndpoint.",
        )
    return configuration.open()


PLACES: dict[str, Callable[[Any], Executor]] = {
    "local": _open_local,
    "pool": _open_pool,
    "parsl": _open_parsl,
    "dask": _open_dask,
    "globus": _open_globus,
}


def open_place(where: str, configuration: Any = None) -> Executor:
    """Raises NotFound for an unknown place, BadInput for one that is not configured."""
    if where not in PLACES:
        raise NotFound(
            f"There is no place {where!r} to compute at.", remedy=f"Known places: {', '.join(PLACES)}."
        )
    return PLACES[where](configuration)


def _report_missing(name: str, extra: str) -> BadInput:
    return BadInput(f"{name} is not installed.", remedy=f'pip install "labos-sdl[{extra}]"')
