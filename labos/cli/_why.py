"""The output of ``labos twh --losses``: the accounts of lost time, and the next tasks for a person."""

from __future__ import annotations

import msgspec

from labos.cli._out import show_json, show_table
from labos.core.ids import local
from labos.services.losses import Loss, LossAccount, Losses, waits_for_a_person
from labos.services.next_touch import Touch
from labos.services.times import show_span, show_time
from labos.services.twh import Twh

TOUCHES_SHOWN = 8


def show_why(found: Losses, shown: list[Twh]) -> None:
    """The account of each scope on a line, then the causes of the first scope, then the next tasks."""
    accounts = [account_of(found, twh) for twh in shown]
    columns = ("scope", "had work", "at work", "lost", "of it for a person", "most of it to")
    show_table(columns, [_list_cells(each) for each in accounts])
    first = accounts[0]
    show_table(
        ("cause", "module", "class", "lost", "share", "waits for"),
        [_list_loss_cells(first, loss) for loss in first.losses],
        title=f"Losses of {_name(first)}",
        gap=True,
    )
    show_table(
        ("when", "what", "run", "do"),
        [_touch(touch, found.end) for touch in found.next_touches[:TOUCHES_SHOWN]],
        title="A person is needed next",
        gap=True,
    )


def why_as_json(found: Losses, shown: list[Twh]) -> None:
    scopes = [{**make_plain_twh(twh), "why": _make_plain(account_of(found, twh))} for twh in shown]
    touches = [msgspec.to_builtins(touch) for touch in found.next_touches]
    show_json({"pace": found.twh.pace, "scopes": scopes, "next_touches": touches})


def account_of(found: Losses, twh: Twh) -> LossAccount:
    """The account of a scope; an empty one if it never had work."""
    known = {"run": found.runs, "experiment": found.experiments, "workcell": found.workcells}
    if twh.kind == "lab":
        return found.lab
    return known[twh.kind].get(twh.name) or LossAccount(twh.kind, twh.name, 0, 0, 0, ())


def make_plain_twh(twh: Twh) -> dict[str, object]:
    """For programs: nanoseconds and seconds."""
    plain: dict[str, object] = msgspec.to_builtins(twh)
    for name, stretch in (("current", twh.current), ("longest", twh.longest)):
        plain[f"{name}_s"] = stretch.worked_ns / 1e9
    return plain


def _make_plain(each: LossAccount) -> dict[str, object]:
    return {
        "span_s": each.span_ns / 1e9,
        "at_work_s": each.at_work_ns / 1e9,
        "lost_s": each.lost_ns / 1e9,
        "for_a_person_s": each.for_a_person_ns / 1e9,
        "losses": [
            {
                **msgspec.to_builtins(loss.cause),
                "lost_s": loss.lost_ns / 1e9,
                "on_clock_s": loss.on_clock_ns / 1e9,
            }
            for loss in each.losses
        ],
    }


def _name(each: LossAccount) -> str:
    return "the lab" if each.kind == "lab" else f"{each.kind} {each.name}"


def _list_cells(each: LossAccount) -> tuple[str, ...]:
    most = _name_cause(each.losses[0]) if each.losses else ""
    times = (each.span_ns, each.at_work_ns, each.lost_ns, each.for_a_person_ns)
    return (f"{each.kind} {each.name}".strip(), *(show_span(ns / 1e9) for ns in times), most)


def _name_cause(loss: Loss) -> str:
    return f"{local(loss.cause.module)} {loss.cause.what}".strip()


def _list_loss_cells(each: LossAccount, loss: Loss) -> tuple[str, ...]:
    cause = loss.cause
    share = f"{100 * loss.lost_ns / each.span_ns:.1f} %"
    named = cause.what if cause.kind in ("error", "other") else f"{cause.kind}: {cause.what}"
    waits = "a person" if waits_for_a_person(cause) else ""
    return (named, local(cause.module), cause.error_class, show_span(loss.lost_ns / 1e9), share, waits)


def _touch(touch: Touch, now: int) -> tuple[str, ...]:
    when = "now" if touch.at <= now else show_time(touch.at)
    return (when, touch.what, touch.run, touch.remedy)
