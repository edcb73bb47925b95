"""``labos explain``: why a run does not continue."""

from __future__ import annotations

import click

from labos.cli._complete import make_completer
from labos.cli._liveness import has_kernel, open_current_log
from labos.cli._orders import KernelWaits, ask_order_setting
from labos.cli._out import end_with_json, show_lines
from labos.cli._query import Where, log_and_json, now_ns
from labos.cli.runs import show_duration
from labos.core.ids import RunId, local
from labos.core.interventions import Intervention
from labos.core.runs import find_open_modules
from labos.core.state import LabState
from labos.core.topics import PlannedWork
from labos.services.due import describe_due
from labos.services.experiments import list_experiment_histories
from labos.services.history import fold_state_at
from labos.services.runs import RunHistory, run_history
from labos.services.times import show_span, show_time
from labos.services.waits import list_reasons


@click.command("explain", short_help="Explain why a run is waiting.")
@click.argument("run", shell_complete=make_completer("run", "experiment"), metavar="RUN|EXPERIMENT")
@log_and_json
def command(where: Where, run: str) -> None:
    """Explain why RUN waits now, and show what it has done so far. For an EXPERIMENT, do so for each of its
    open runs.

    \b
    labos explain R3
    labos explain E1
    """
    with open_current_log(where) as store:
        inside = list_experiment_histories(store).get(run) if run.startswith("E") else None
        named = [name for name, kind in inside.runs.items() if kind == "alive"] if inside else [run]
        stories, state = [run_history(store, name) for name in named], fold_state_at(store)
        lives = has_kernel(where.url)
    now = max(now_ns(), state.recorded_at) if lives else state.recorded_at
    kernel, searches = KernelWaits(where) if lives else None, ask_order_setting(where)
    now_of = [list_sentences(state, story, now, kernel, searches=searches) for story in stories]
    for story, waits in zip(stories, now_of, strict=True):
        if not lives and not story.over:
            waits.append("no kernel runs this lab now, so no step starts: labos up WORKCELL")
    runs = [
        {"run": story, "now": waits, "kernel": lives} for story, waits in zip(stories, now_of, strict=True)
    ]
    end_with_json({"experiment": inside, "runs": runs} if inside else runs[0])
    if inside:
        why = f" ({inside.why})" if inside.why else ""
        click.echo(f"{inside.id} ({inside.name}, {inside.user}) is {inside.status}{why}.")
        if not stories:
            click.echo("It has no active and no waiting runs.")
    for story, waits in zip(stories, now_of, strict=True):
        click.echo(f"{story.id} ({story.workflow}, {story.user}) is {story.status}.")
        show_lines(waits, "- ")
        click.echo(describe_progress(story))


def list_sentences(
    state: LabState, story: RunHistory, now: int, kernel: KernelWaits | None = None, *, searches: bool = False
) -> list[str]:
    """The present actions and waits of a run; ``kernel`` says more if one runs the lab. ``searches``: the lab
    looks for orders of its own."""
    if story.over:
        when = (
            f"It ended at {show_time(story.ended_at)}, after {show_duration(story, now)}."
            if story.started_at
            else ""
        )
        ended = "was cancelled" if story.status == "cancelled" else story.status
        why = f"It {ended}: {story.why}" if story.why else ""
        return [*(text for text in (why, when) if text), *list_questions(state, story.id)]
    found = [
        f"#{step.index} {step.key!r} is in "
        f"{'progress' if step.state == 'in flight' else 'an unknown state'} on {local(step.module)} since "
        f"{show_time(step.requested_at)} ({show_span(max(now - step.requested_at, 0) / 1e9)})"
        + (f": {step.error}" if step.error else "")
        + _describe_usual(state, story, step.index)
        + _describe_in_progress(state, story, step.index)
        for step in story.steps
        if step.state in ("in flight", "unknown")
    ]
    if story.why:
        found.append(f"it is {story.status}: {story.why}")
    asked = list_questions(state, story.id)
    found += asked
    run = state.runs.get(RunId(story.id))
    if run is None:
        return found
    reasons = list_reasons(state, run, now)
    if kernel is not None:
        reasons = kernel.correct_reasons(state, run, now, reasons)
    for reason in reasons:
        who = " It continues after a person or a device has acted." if reason.blocked and not asked else ""
        remedy = f" {reason.remedy}" if reason.remedy else ""
        found.append(
            f"#{reason.step} {story.steps[reason.step].key!r} waits: {reason.why.rstrip('.')}.{who}{remedy}"
        )
    for key, names in find_open_modules(state.runs, run).items() if not run.has_started else ():
        found.append(f"{key!r} may be done by {' or '.join(map(local, names))}")
    if run.status == "queued":
        before = sum(other.position < run.position for other in state.runs.queued.values())
        if before:
            found.append(f"{before} runs that were submitted before it wait too")
    found = found or ["It can continue, and will do so at once."]
    if run.due_at:
        found.append(f"it is due at {describe_due(state, [story], now, searches=searches)[story.id]}")
    return found


def _describe_usual(state: LabState, story: RunHistory, index: int) -> str:
    """How long a step usually takes, if that differs from the plan."""
    run = state.runs.get(RunId(story.id))
    steps = state.runs.plan_of(run).steps if run is not None else ()
    known = state.lengths.estimate(steps[index], state.lab.pace) if index < len(steps) else None
    if known is None:
        return ""
    usual_s, planned_s = known.usual * state.lab.pace / 1e9, steps[index].duration_s
    if abs(usual_s - planned_s) < max(1.0, planned_s / 4):
        return ""
    return f"; it usually takes {show_span(usual_s)}, planned {show_span(planned_s)}"


def _describe_in_progress(state: LabState, story: RunHistory, index: int) -> str:
    """How long the module is set up for a step in progress, and the other runs for which it carries it out at
    the same time."""
    text = ""
    for action in state.actions.open.values():
        if (action.run, action.step) != (story.id, index):
            continue
        flight = state.modules.by_name[action.module].in_flight.get(action.id)
        if flight is not None and flight.setup_s:
            text += f"; {local(action.module)} is set up for it first, {show_span(flight.setup_s)}"
        runs = [state.actions.open[name].run for name in action.together if name in state.actions.open]
        others = [run for run in runs if run != story.id]
        text += f"; together with {', '.join(others)}" if others else ""
    return text


def list_questions(state: LabState, run: str) -> list[str]:
    """The lab's questions about a run, and the commands that answer them."""
    return [
        f"a person has to answer {question.id}: {question.text} " + _explain_how(question)
        for question in state.interventions.open.values()
        if question.run == run
    ]


def _explain_how(question: Intervention) -> str:
    if question.kind == PlannedWork.KIND:
        return f"labos confirm {question.id}"
    return "; ".join(f"labos resolve {question.id} {c.name}" for c in question.choices)


def describe_progress(story: RunHistory) -> str:
    """The progress of a run, in a sentence."""
    text = f"So far {story.done} of {story.in_play} steps are done"
    last = max((step for step in story.steps if step.ended_at), key=lambda s: s.ended_at, default=None)
    if last is not None:
        text += f"; the last was #{last.index} {last.key!r}, {last.state} at {show_time(last.ended_at)}"
    late = [step.key for step in story.steps if step.breached]
    return f"{text}." + (f" Started too late: {', '.join(late)}." if late else "")
