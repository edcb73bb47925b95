"""A lab over seven hosts, of which one or two at a time are cut off from the network without a word.

Each host is a set of namespaces (tests/support/hosts.py). Afterwards the simulated devices' own account
says that each plate was moved once for each step, the log agrees with the bench, and everybody has joined
again by himself.
"""

from __future__ import annotations

import itertools
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path

import pytest

from tests.docs.markdown import ROOT
from tests.support.hosts import Hosts, why_not
from tests.support.lab_process import until
from tests.support.postgres import find_binaries
from tests.support.processes import run_process
from tests.support.spread import HOSTS, MOTIONS, NODES, Spread

TAKEN_OVER_S = 10.0
CUT_S = 14.0
ACTIVE, STANDBY, API = "active", "standby", "a1"
PARTS = ("n1", "r", "db", ACTIVE, API)
"""Whom a cut takes: the host of a node, the router, the database, the kernel that has the lab, the API."""


@cache
def _reason() -> str:
    return why_not() or ("" if find_binaries() else "there is no PostgreSQL here")


@pytest.fixture
def lab() -> Iterator[Spread]:
    if _reason():
        pytest.skip(_reason())
    with Hosts(*HOSTS) as hosts:
        made = Spread(hosts, 60.0)
        try:
            made.open()
            yield made
        finally:
            made.close()


def sound(lab: Spread) -> None:
    """Nothing was moved twice, or not at all, by the devices' own account; nobody had to be asked."""
    done = Counter(motion.verb for motion in lab.motions())
    assert done == {verb: number * len(lab.runs) for verb, number in MOTIONS.items()}, lab.describe_all()
    assert lab.disagreements() == []
    assert lab.find_asked_twice() == []
    types = Counter(lab.types())
    assert types["run.completed"] == len(lab.runs)
    assert not types.keys() & {"intervention.requested", "action.unknown"}, lab.describe_all()


def cut_off(lab: Spread, parts: tuple[str, ...], seconds: float) -> str:
    """Cut hosts off in the midst of work and mend the line; returns what came of it."""
    active, epoch = lab.active(), lab.epochs()[-1][0]
    (other,) = {"k1", "k2"} - {active}
    names = [{ACTIVE: active, STANDBY: other}.get(part, part) for part in parts]
    before = lab.count_done()
    lab.submit(3)
    until(lambda: lab.count_done() > before, "the lab is at work")
    since = time.time()
    lab.hosts.cut(*names)
    with ThreadPoolExecutor(1) as user:
        try:
            # Whoever works on the host of the API process asks on, under one key, and is heard later.
            asked = user.submit(lab.submit, 1) if API in parts else None
            if ACTIVE in parts and "db" not in parts:
                until(lambda: lab.epochs()[-1][0] > epoch, "the standby takes over", 30.0)
            if parts == (API,):
                until(lambda: lab.count_done() >= before + 3, "the lab works without its API process")
            time.sleep(max(0.0, since + seconds - time.time()))
            assert asked is None or not asked.done(), "nobody heard the request, but it was answered"
        finally:
            lab.hosts.heal()
        mended = time.time()
        if asked is not None:
            asked.result(90.0)
    until(lambda: len(lab.list_answering()) == len(NODES), "all nodes answer the API process", 40.0)
    served = time.time() - mended
    lab.finish()
    took = lab.epochs()[-1][1] - since
    ended = time.time() - mended
    (other,) = {"k1", "k2"} - {lab.active()}
    try:
        until(
            lambda: any(name.endswith(f" on {other}") for name in lab.has_standby()),
            f"{other} stands by",
            40.0,
        )
    except AssertionError as error:
        raise AssertionError(f"{error}\n{lab.describe_all()}") from None
    back = time.time() - mended
    if ACTIVE in parts and "db" not in parts:
        assert lab.epochs()[-1][0] == epoch + 1
        assert lab.active() != active
        assert took <= TAKEN_OVER_S, lab.describe_all()
        over = f"taken over {took:.1f} s after the cut; "
    else:
        assert lab.epochs()[-1][0] - epoch <= 1
        over = "the kernel stayed; " if lab.epochs()[-1][0] == epoch else "another kernel; "
    return (
        f"{over}after the cut was mended all nodes answered the API process in {served:.1f} s, all runs "
        f"ended in {ended:.1f} s, and somebody stood by in {back:.1f} s"
    )


MAKES = """
import time
from tests.support.hosts import Hosts

hosts = Hosts("a", "b")
started = hosts["a"].start("sleep", "1234")
print(hosts["a"].first, hosts["b"].first, started.pid, flush=True)
time.sleep(60)
"""


@pytest.mark.skipif(bool(why_not()), reason="there can be no hosts here")
def test_hosts_end_with_a_test_that_is_killed() -> None:
    with run_process([sys.executable, "-c", MAKES], stdout=subprocess.PIPE, text=True, cwd=ROOT) as test:
        assert test.stdout is not None
        made = [int(word) for word in test.stdout.readline().split()]
        assert len(made) == 3
        test.kill()
        until(
            lambda: not any(Path(f"/proc/{pid}/ns/net").exists() for pid in made), "all of it is gone", 10.0
        )
    Hosts().remove()
    assert not list(Path("/tmp").glob(f"labos-hosts-{test.pid}-*"))


@pytest.mark.slow
@pytest.mark.timeout(120)
def test_the_kernels_host_is_cut_off(lab: Spread, capsys: pytest.CaptureFixture[str]) -> None:
    told = cut_off(lab, (ACTIVE,), 8.0)
    sound(lab)
    with capsys.disabled():
        print(f"\n{told}")


@pytest.mark.slow
@pytest.mark.timeout(180)
def test_the_hosts_of_the_api_process_and_the_kernel_are_cut_off(
    lab: Spread, capsys: pytest.CaptureFixture[str]
) -> None:
    told = cut_off(lab, (ACTIVE, API), 8.0)
    sound(lab)
    with capsys.disabled():
        print(f"\n{told}")


@pytest.mark.full
@pytest.mark.timeout(1800)
def test_each_part_and_each_pair_is_cut_off(lab: Spread, capsys: pytest.CaptureFixture[str]) -> None:
    """One after the other, in one lab, and each of them joins again by itself."""
    cuts = [(part,) for part in (*PARTS, STANDBY)] + list(itertools.combinations(PARTS, 2))
    for parts in cuts:
        told = cut_off(lab, parts, CUT_S)
        sound(lab)
        with capsys.disabled():
            print(f"\n{' and '.join(parts)}: {told}")
