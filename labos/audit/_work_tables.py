"""The tables of work: events, runs, steps, actions, their results, and their users."""

from __future__ import annotations

from labos.audit._columns import (
    ACTION,
    AT,
    MODULE,
    POSITION,
    RUN,
    Table,
    flag,
    json,
    make_words_column,
    number,
    text,
    time,
    whole,
)

EVENTS = Table(
    "event",
    "Every event of the log, without its payload (`labos log --json` shows that).",
    ("position",),
    (
        whole("position", "Its position in the log: 1, 2, 3 … without gaps."),
        AT,
        text("type", "The type of the event, as in the reference of events."),
        text("actor", "The cause: a user, a module, or `labos`."),
        text("stream", "The run to which it belongs, else its subject."),
        text("correlation", "The run or experiment to which it belongs."),
        text("run", "The run that it names; empty if none."),
        whole("step", "The step of that run; null if none."),
        text("module", "The module that it names; empty if none."),
        text("action", "The action that it names; empty if none."),
        text("labware", "The labware that it names; empty if none or several (see `labware_touches`)."),
        text("id", "The event's own id."),
    ),
    view="events",
    indexes=(("at_s",),),
)

RUNS = Table(
    "run",
    "Every run, from its submission on.",
    ("run",),
    (
        text("run", "Its id."),
        text("workflow", "The workflow's name."),
        text("workcell", "The workcell in which it runs."),
        text("user_id", "The user who submitted it."),
        text("experiment", "The experiment to which it belongs; empty if none."),
        text("campaign", "The campaign to which it belongs; empty if none."),
        whole("row", "The row of the campaign's table that it carries out, from 0; null if none."),
        whole("priority", "The requested priority."),
        text("status", "queued, active, paused, cancelling, leaving, completed, failed or cancelled."),
        time("submitted_at", "The time at which it was submitted."),
        time("started_at", "The time at which its first step was requested; null before."),
        time("ended_at", "The time at which it completed, failed or was cancelled; null before."),
        time("due_at", "The time by which it should end; null if no time was set."),
        whole("steps", "The number of steps in its plan, including those for failures and cancellation."),
        whole("steps_done", "The number of these steps that are done."),
        make_words_column("why", "The reason why it was paused or cancelled, or has failed."),
        text("failure", "software, operational or experiment; empty if it has not failed."),
        flag("closing", "True if it is the closing workflow of its experiment."),
        text("plan", "The digest of its workflow with the payload filled in."),
        json(
            "pins", "The digests of the workflow file, the workcell and each module's description, by name."
        ),
        json("payload", "The values with which it was submitted."),
        whole("submitted_position", "The position of its submission in the log."),
        whole("started_position", "The position of its start; null before."),
        whole("ended_position", "The position of its end; null before."),
    ),
    view="runs",
    indexes=(("submitted_at_s",), ("user_id",), ("campaign", "row")),
)

STEPS = Table(
    "step",
    "Every step of every run's plan.",
    ("run", "step"),
    (
        text("run", "The run."),
        whole("step", "Its number in the plan, from 0."),
        text("key", "Its name in the workflow."),
        MODULE,
        text("name", "The action's name."),
        text(
            "state",
            "pending, in flight, done, failed, unknown, skipped, or asleep (for a failure or cancellation).",
        ),
        whole(
            "part",
            "-1: of the workflow itself; -2: under `on_cancel`; else in the recovery of that step.",
        ),
        json("after", "The numbers of the steps that have to be done before."),
        whole("attempts", "The number of actions that were requested for it."),
        time("requested_at", "The time of the last request of its action; null before."),
        time("ended_at", "The time at which that action ended; null before."),
        make_words_column("error", "The last error; empty if none."),
        flag("breached", "True if it started later than its window allows."),
    ),
    view="steps",
)

ACTIONS = Table(
    "action",
    "Every action that a run or a person requested.",
    ("action",),
    (
        text("action", "Its id."),
        text("run", "The run; empty if a person requested it."),
        whole("step", "The step of that run."),
        text("key", "The step's name in the workflow."),
        MODULE,
        text("driver", "The driver of the node to which the request went."),
        text("driver_version", "The driver's version, as the node reported it when it joined."),
        text("about", "The digest of the node's description."),
        flag("simulated", "True if the node controlled a simulated device."),
        text("name", "The action's name."),
        json("args", "Its arguments."),
        json("labware", "The ids of the labware that it moved, took or processed."),
        text("plate", "The labware that it processed; empty if none or several."),
        json("files", "The digests of its input files, by argument."),
        text("status", "requested, accepted, reported, unknown, succeeded, failed, rejected or reconciled."),
        text(
            "effects",
            "How much of it took place: all, none, partial or unknown; empty until that is reported.",
        ),
        make_words_column("error", "The error; empty if none."),
        json("result", "The result of the device; null if none."),
        text(
            "settled_by",
            "The person or module that reported the outcome, if that was unknown; else empty.",
        ),
        whole("attempts", "The number of times that it was sent."),
        time("requested_at", "The time of the first request."),
        time("accepted_at", "The time at which the node wrote it into its journal; null before."),
        time("ended_at", "The time at which its end was logged; null before."),
        time("device_ended_at", "Its end by the node's own clock; null if the node did not report it."),
        whole("requested_position", "The position of the request in the log."),
        whole("ended_position", "The position of its end; null before."),
    ),
    view="actions",
    indexes=(("run",), ("module", "requested_at_s")),
)

RESULTS = Table(
    "result",
    "The measured results of steps, one row per well.",
    ("position", "number"),
    (
        whole("position", "The position of the result in the log."),
        whole("number", "The number of the value in the result, from 0."),
        time("at", "The end of the step, by the device's clock if the device reported it."),
        RUN,
        whole("step", "The step of that run."),
        text("key", "The step's name in the workflow."),
        text("action", "The action that measured it."),
        MODULE,
        text("labware", "The plate; empty if the step processed none or several."),
        text("well", "The well, such as `B7`."),
        text("sample", "The sample in the well by the last sheet before the result; empty if none."),
        text("quantity", "The measured quantity."),
        number("value", "The value; null if it is not a number."),
        text("text", "The value as text."),
        text("unit", "Its unit; empty if the device did not report it."),
    ),
    view="results",
    indexes=(("run",), ("labware", "well"), ("action",)),
)

FILES = Table(
    "file",
    "Files that were inputs or results of actions.",
    ("position", "number"),
    (
        POSITION,
        whole("number", "The number of the file in the event, from 0."),
        AT,
        text("kind", "given (an input) or returned (a result)."),
        text("digest", "The SHA-256 of its content."),
        text("file", "Its name, or the argument for which it was the input."),
        whole("bytes", "Its size; null for an input."),
        RUN,
        ACTION,
    ),
    view="files",
    indexes=(("digest",), ("action",)),
)

INTERVENTIONS = Table(
    "intervention",
    "Every question to a person, with its answer.",
    ("intervention",),
    (
        text("intervention", "Its id."),
        text("kind", "The kind of the question, as in the reference of questions."),
        text("subject", "The id of its subject."),
        make_words_column("text", "The question."),
        text("run", "The run that waits for the answer; empty if none."),
        MODULE,
        json("labware", "The ids of the labware that it concerns."),
        json("choices", "The possible answers."),
        time("asked_at", "The time at which it was asked."),
        time("due_at", "The time by which planned work should be done; null if no time was set."),
        time("resolved_at", "The time at which it was answered; null before."),
        text("choice", "The answer; `withdrawn` if the question was auto-resolved."),
        text("resolved_by", "The user who answered."),
        make_words_column("note", "Their comment."),
        whole("asked_position", "The position of the question in the log."),
        whole("resolved_position", "The position of the answer; null before."),
    ),
    view="interventions",
    indexes=(("asked_at_s",), ("run",)),
)

USERS = Table(
    "person",
    "Everybody who ever did something in this lab, by the id in the events.",
    ("user_id",),
    (
        text("user_id", "Their id, as in `actor` of events."),
        time("first_at", "The time of their first event."),
        time("last_at", "The time of their last event."),
        whole("runs", "The number of runs that they submitted, including those of their experiments."),
        whole("experiments", "The number of experiments that they started."),
        whole("answers", "The number of questions that they answered."),
        whole("events", "The number of events that they caused."),
        time("erased_at", "The time at which the lab erased their name and address; null if it did not."),
    ),
    view="users",
)

EXPERIMENTS = Table(
    "experiment",
    "Every experiment: one execution of an application.",
    ("experiment",),
    (
        text("experiment", "Its id."),
        text("name", "The application's name."),
        text("user_id", "The user who started it."),
        whole("priority", "The requested priority."),
        text("status", "open, cancelled, closing or ended."),
        make_words_column("why", "The reason why it was cancelled or closed."),
        whole("runs", "The number of runs that it has submitted."),
        time("started_at", "The time at which it started."),
        time("ended_at", "The time at which all its work had ended; null before."),
        whole("started_position", "The position of its start in the log."),
        whole("ended_position", "The position of its end; null before."),
    ),
    view="experiments",
)

CAMPAIGNS = Table(
    "campaign",
    "Every campaign: one workflow, carried out once for each row of a table.",
    ("campaign",),
    (
        text("campaign", "Its id."),
        text("name", "Its name."),
        text("user_id", "The user who submitted it."),
        text("workflow", "The workflow's name."),
        text("workcell", "The workcell in which its runs are carried out."),
        whole("rows", "The number of rows of its table."),
        text("status", "proposed, open, paused, stopped (by its own rules), cancelled or completed."),
        whole("priority", "The priority of the runs that are submitted from now on."),
        time("deadline", "The time by which it should end; null if no time was set."),
        json("tags", "Its tags."),
        time("submitted_at", "The time at which it was submitted."),
        time("ended_at", "The time at which all its work had ended; null before."),
        whole("runs", "The number of runs that it has submitted: one for each row that was not refused."),
        whole("completed", "The number of completed runs."),
        whole("failed", "The number of failed runs."),
        whole("cancelled", "The number of cancelled runs."),
        whole("refused", "The number of rows that could not be carried out, so that no run was submitted."),
        make_words_column("why", "The reason why it is paused, or was stopped or cancelled."),
        text("by_run", "The run whose results fulfilled its stop rule; empty if none did."),
        text("row_table", "Digest of its table."),
        text("definition", "Digest of the workflow's text and files."),
        text(
            "visibility", "The people who may see it besides its user and operators: lab, group or private."
        ),
        text("cloned_from", "The campaign from which it was copied; empty if none."),
        flag("archived", "True if it is hidden from lists."),
        whole("submitted_position", "The position of its submission in the log."),
        whole("ended_position", "The position of its end; null before."),
    ),
    view="campaigns",
    indexes=(("submitted_at_s",), ("user_id",)),
)

NODES = Table(
    "node",
    "Every time that a node joined for a module, with its driver's version.",
    ("position",),
    (
        whole("position", "The position of the event in the log."),
        MODULE,
        text("driver", "The driver."),
        text("driver_version", "Its version."),
        text("about", "The digest of the node's description."),
        text("journal", "The node's journal."),
        flag("simulated", "True if it controls a simulated device."),
        time("joined_at", "The time at which it joined."),
        time("left_at", "The time at which it left, or another node joined for the module; null before."),
    ),
    view="nodes",
    indexes=(("module", "position"),),
)

PLANS = Table(
    "plan",
    "The plans, for the projector's own use.",
    ("plan",),
    (
        text("plan", "Its digest."),
        text("workflow", "The workflow's name."),
        text("workcell", "The workcell in which it runs."),
        json("steps", "Its steps: key, module, action, part, after, when."),
    ),
)

PRESENT = Table(
    "present_node",
    "Which node answers for a module, for the projector's own use.",
    ("module",),
    (MODULE, whole("position", "Where it joined.")),
)

APPROVALS = Table(
    "approval",
    "Every requested approval, by the lab's policy or by a second person, with its answer.",
    ("requested_position",),
    (
        whole("requested_position", "The position of the request in the log."),
        text("subject", "The run, campaign or experiment."),
        text("kind", "run, campaign, experiment, amendment (of a campaign) or second person."),
        text("name", "The name of its workflow, campaign or application."),
        text("user_id", "The user to whom it belongs."),
        text("asked_by", "The submitter: the user, or a service account for the user."),
        text(
            "digest",
            "The digest of everything that needs approval; for a second person's approval, that of the plan.",
        ),
        json("why", "The reason why it needed an approval."),
        json("parts", "The digest of each of its parts."),
        text("before", "The digest of the last approved submission with the same name; empty if none."),
        json("changed", "The parts that differ from it."),
        time("requested_at", "The time of the request."),
        text("answer", "approved, refused or changed (a new request has replaced it); empty while it waits."),
        text("answered_by", "The user who answered."),
        make_words_column("comment", "Their comment."),
        json("changes", "The changes by the answer: priority, terms; null if none."),
        time("answered_at", "The time at which it was answered; null before."),
        whole("answered_position", "The position of the answer in the log; null before."),
    ),
    view="approvals",
    indexes=(("subject",),),
)

WAITING = Table(
    "waiting_approval",
    "What was asked for last of each subject, for the projector's own use.",
    ("subject",),
    (text("subject", "The run, campaign or experiment."), whole("position", "Where it was asked for.")),
)

SIGNATURES = Table(
    "signature",
    "Every electronic signature for the record of a run, an experiment or a campaign.",
    ("position",),
    (
        whole("position", "Its position in the log."),
        text("subject", "The run, experiment or campaign."),
        text("kind", "run, experiment or campaign."),
        text("signed_by", "The user who signed."),
        text("meaning", "authored, responsible, reviewed, approved or rejected."),
        make_words_column("comment", "Their comment."),
        text("method", "How they confirmed their identity: password."),
        AT,
        whole("runs", "The number of its runs; 0 for a run."),
        whole("records", "The number of signed records."),
        text("digest", "The SHA-256 over the leaf hashes of those records."),
    ),
    view="signatures",
    indexes=(("subject",),),
)

WORK_TABLES = (
    *(EVENTS, RUNS, STEPS, ACTIONS, RESULTS, FILES),
    *(INTERVENTIONS, USERS, EXPERIMENTS, CAMPAIGNS, NODES, PLANS, PRESENT, APPROVALS, WAITING, SIGNATURES),
)
