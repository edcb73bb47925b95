"""Globus Compute as a place where functions are computed: an executor that sends each task once.

A submission has no key of ours by which the service could recognise it if its answer was lost. But each task
belongs to a group, and a group can list its tasks. So all tasks of an experiment are sent to one group, one
after the other, and each is recorded before and after it is sent. If a task is in the group but not in the
record, its answer was lost. The task itself shows to which computation it belongs: it returns its mark.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from typing import Any

from labos.errors import BadInput
from labos.services.compute import (
    ComputesOnce,
    MemoryRecord,
    Returned,
    SendingRecord,
    do_nothing,
    return_marked,
)
from labos.services.globus._asking import (
    GlobusAccess,
    GlobusFailed,
    GlobusTimes,
    report_missing_sdk,
    send_once,
    wait_for,
)

SERVICE = "Globus Compute"
MOST_WAITING = 64

WORKER_DEATHS = ("WorkerLost", "ManagerLost")
"""The names of the errors by which an endpoint reports that a worker died during a task."""


class WorkerLost(Exception):
    """A worker at a Globus endpoint died with its task."""


class GlobusEndpoint(GlobusAccess):
    """An endpoint of Globus Compute: its id, and how the program authenticates (see `GlobusAccess`)."""

    service = SERVICE

    endpoint: str

    def open(self) -> GlobusExecutor:
        """Raises BadInput if the SDK is not installed."""
        asked, sent = self.open_client("ComputeClientV2"), self.open_client("ComputeClientV3")
        try:
            from globus_compute_sdk.serialize import ComputeSerializer
        except ImportError:
            raise report_missing_sdk() from None
        return GlobusExecutor(self.endpoint, asked, sent, ComputeSerializer(), self.patience)


class GlobusExecutor(ComputesOnce, Executor):
    """Computes at an endpoint. May be used by many threads."""

    def __init__(self, endpoint: str, asked: Any, sending: Any, forms: Any, patience: GlobusTimes) -> None:
        self._endpoint, self._asked, self._sending = endpoint, asked, sending
        self._forms, self._patience = forms, patience
        self._lock = threading.Lock()
        self._groups: dict[str, _Group] = {}
        self._functions: dict[Callable[..., Any], str] = {}
        self._threads = ThreadPoolExecutor(MOST_WAITING, thread_name_prefix="globus")

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """As for every executor: the record of what was sent ends with the process."""
        return self._threads.submit(self.compute_once, MemoryRecord(), fn, args, kwargs)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        self._threads.shutdown(wait, cancel_futures=cancel_futures)

    def compute_once(
        self, sent: SendingRecord, function: Callable[..., Any], args: tuple[Any, ...], named: dict[str, Any]
    ) -> Any:
        """Returns the result of the function. Raises the function's error, WorkerLost, GlobusError."""
        known = sent.find_own("sent")
        if known is None:
            task = self._find_task_in_doubt(sent) if sent.find_own("sending") is not None else ""
            with self._lock:
                known = sent.find_own("sent")  # another thread may have sent it meanwhile
                if known is None:
                    known = self._adopt(sent, task) if task else self._send(sent, function, args, named)
        mark, returned = self._fetch_result(known["task"])
        if mark != sent.mark:
            raise GlobusFailed(
                f"The task {known['task']} of {SERVICE} was expected to be {sent.mark}, but it is {mark}."
            )
        return returned.value()

    def _find_task_in_doubt(self, sent: SendingRecord) -> str:
        """The task with this mark that was sent by a program which was killed before the answer; empty if
        there is none. A task returns its mark when it ends."""
        with self._lock:
            strays = self._find_group(sent).strays
        for task in sorted(strays):
            try:
                mark, _ = self._fetch_result(task)
            except WorkerLost:
                continue  # the task no longer exists
            if mark == sent.mark:
                return task
        return ""

    def _adopt(self, sent: SendingRecord, task: str) -> dict[str, Any]:
        group = self._find_group(sent)
        group.own.add(task)
        return sent.keep("sent", {"task": task, "task_group": group.id})

    def _send(
        self, sent: SendingRecord, function: Callable[..., Any], args: tuple[Any, ...], named: dict[str, Any]
    ) -> dict[str, Any]:
        """Tasks are sent one after the other, so that at most one is in doubt."""
        group = self._find_group(sent)
        sent.keep("sending", {"endpoint": self._endpoint, "task_group": group.id})
        batch = self._make_batch(return_marked, sent.mark, function, args, named)
        batch["task_group_id"] = group.id

        def send() -> str:
            return _find_only_task(self._sending.submit(self._endpoint, batch))

        def find() -> str | None:
            return min(self._list_tasks(group.id) - group.own - group.strays, default=None)

        task = send_once(SERVICE, self._sending, self._patience, send, find)
        return self._adopt(sent, task)

    def _find_group(self, sent: SendingRecord) -> _Group:
        """The group of an experiment's tasks; its first task does nothing."""
        if (group := self._groups.get(sent.of)) is not None:
            return group
        name = f"task group at {self._endpoint}"
        known = sent.find_shared(name)
        if known is None:
            batch = self._make_batch(do_nothing)
            answer = wait_for(SERVICE, self._patience, lambda: self._sending.submit(self._endpoint, batch))
            opened = {"task_group": str(answer["task_group_id"]), "task": _find_only_task(answer)}
            known = sent.keep_shared(name, {"endpoint": self._endpoint, **opened})
        own = {str(known["task"]), *sent.list_known("task")}
        there = wait_for(SERVICE, self._patience, lambda: self._list_tasks(known["task_group"]))
        group = self._groups[sent.of] = _Group(known["task_group"], own, there - own)
        return group

    def _list_tasks(self, group: str) -> set[str]:
        return {str(task["id"]) for task in self._asked.get_task_group(group)["tasks"]}

    def _make_batch(self, function: Callable[..., Any], *args: Any) -> dict[str, Any]:
        if function not in self._functions:
            code = self._forms.pack_buffers([self._forms.serialize(function)])
            registration = {"function_name": function.__name__, "function_code": code, "serialized": True}
            answer = wait_for(SERVICE, self._patience, lambda: self._asked.register_function(registration))
            self._functions[function] = str(answer["function_uuid"])
        try:
            payload = self._forms.pack_buffers([self._forms.serialize(args), self._forms.serialize({})])
        except Exception as error:  # __reduce__ of any class
            raise BadInput(
                f"An argument cannot be sent to {SERVICE}: {error}.",
                remedy="Give numbers, text, lists, tables or arrays.",
            ) from error
        return {"create_queue": False, "tasks": {self._functions[function]: [payload]}}

    def _fetch_result(self, task: str) -> tuple[str, Returned]:
        """The mark of a task and its outcome. Raises WorkerLost, GlobusFailed, GlobusError."""

        def look() -> dict[str, Any] | None:
            found: dict[str, Any] = self._asked.get_task(task).data
            return found if found.get("status") in ("success", "failed") else None

        ended = wait_for(SERVICE, self._patience, look)
        if "result" in ended:
            mark, returned = self._forms.deserialize(ended["result"])
            return mark, returned
        why = str(ended.get("exception") or ended.get("reason") or "without a reason").strip()
        last = why.splitlines()[-1]
        if any(death in why for death in WORKER_DEATHS):
            raise WorkerLost(last)
        raise GlobusFailed(f"The task {task} of {SERVICE} failed: {last}.")


class _Group:
    """Tasks of an experiment: ``own`` are recorded; ``strays`` were in the group before this program began,
    and are not recorded."""

    def __init__(self, id_: str, own: set[str], strays: set[str]) -> None:
        self.id, self.own, self.strays = id_, own, strays


def _find_only_task(answer: Any) -> str:
    ((task,),) = answer["tasks"].values()
    return str(task)
