"""The lab as a whole, and how long it does without people."""

from __future__ import annotations

from deploy.grafana.make.parts import CELL, LAB, Board, bars, lines, number

OVERVIEW = Board(
    "labos-overview",
    "LabOS: lab overview",
    "What goes on in the lab, whom it waits for, and what runs out.",
    ("lab", "workcell"),
    (
        (
            "Now",
            (
                number(
                    "Runs under way", "Runs that have begun.", f'sum(labos_runs{{{CELL},state="active"}})'
                ),
                number("Runs waiting", "Runs that wait to be started.", f"sum(labos_queue_runs{{{CELL}}})"),
                number(
                    "Oldest waiting",
                    "How long the oldest run that waits to be started has waited.",
                    f"max(labos_queue_oldest_age_seconds{{{CELL}}})",
                    unit="s",
                ),
                number(
                    "Questions open",
                    "Questions and tasks for a person.",
                    f"sum(labos_interventions_open{{{LAB}}})",
                    warn=1,
                ),
                number(
                    "Modules usable",
                    "The share of modules that are idle or at work.",
                    f'sum(labos_module_state{{{CELL},state=~"idle|busy"}}) / '
                    f'count(labos_module_state{{{CELL},state="idle"}})',
                    unit="percentunit",
                    warn=1,
                    less=True,
                ),
                number(
                    "Without people",
                    "Working time since the last human intervention.",
                    f'labos_twh_current_seconds{{{LAB},scope="lab"}}',
                    unit="s",
                ),
            ),
        ),
        (
            "Work",
            (
                lines(
                    "Runs by state",
                    "Runs that have not ended.",
                    (f"sum by (state) (labos_runs{{{CELL}}})", "{{state}}"),
                    stacked=True,
                ),
                lines(
                    "Runs ended in an hour",
                    "How many runs ended in the hour before, by outcome.",
                    (f"sum by (outcome) (increase(labos_runs_ended_total{{{CELL}}}[1h]))", "{{outcome}}"),
                ),
                lines(
                    "Utilisation",
                    "The share of time in which an action keeps a module busy, on the average of a workcell.",
                    (
                        "avg by (workcell) (rate(labos_module_busy_seconds_total"
                        f"{{{CELL}}}[$__rate_interval]))",
                        "{{workcell}}",
                    ),
                    unit="percentunit",
                ),
                lines(
                    "Modules by state",
                    "How many modules are in each state.",
                    (f"sum by (state) (labos_module_state{{{CELL}}})", "{{state}}"),
                    stacked=True,
                ),
            ),
        ),
        (
            "Supplies",
            (
                bars(
                    "What is left",
                    "The ten resources that are the emptiest, as a share of what there can be.",
                    (
                        f"bottomk(10, labos_resource_level{{{CELL}}} / labos_resource_capacity{{{CELL}}})",
                        "{{module}} {{resource}}",
                    ),
                    unit="percentunit",
                    most=1,
                ),
                lines(
                    "Labware on the bench",
                    "Uncertain is labware of which nobody knows where it is.",
                    (f"sum by (place) (labos_labware{{{LAB}}})", "{{place}}"),
                ),
            ),
        ),
    ),
)

UNATTENDED = Board(
    "labos-twh",
    "LabOS: time without humans",
    "How long the lab works without a human intervention, and what ended it. The page "
    "docs/time-without-human-intervention.md defines it.",
    ("lab", "workcell"),
    (
        (
            "Now",
            (
                number(
                    "Current",
                    "Working time since the last human intervention.",
                    f'labos_twh_current_seconds{{{LAB},scope="lab"}}',
                    unit="s",
                ),
                number(
                    "Longest",
                    "The longest working time without one.",
                    f'labos_twh_longest_seconds{{{LAB},scope="lab"}}',
                    unit="s",
                ),
                number(
                    "The clock runs",
                    "1 while a run goes on and waits for nobody.",
                    f'labos_twh_working{{{LAB},scope="lab"}}',
                ),
                number(
                    "Interventions",
                    "Human interventions in the whole log.",
                    f"sum(labos_human_interventions_total{{{LAB}}})",
                ),
                number(
                    "Planned touches",
                    "What people did by plan; it ends no stretch.",
                    f'labos_planned_touches_total{{{LAB},scope="lab"}}',
                ),
                number(
                    "Oldest question",
                    "How long the oldest question or task has waited.",
                    f"max(labos_intervention_oldest_age_seconds{{{LAB}}})",
                    unit="s",
                ),
            ),
        ),
        (
            "Stretches",
            (
                lines(
                    "Current stretch",
                    "It grows while the clock runs, and falls to 0 with an intervention.",
                    (f'labos_twh_current_seconds{{{LAB},scope="lab"}}', "lab"),
                    (f'labos_twh_current_seconds{{{CELL},scope="workcell"}}', "{{workcell}}"),
                    unit="s",
                ),
                lines(
                    "On the clock",
                    "The share of time in which the clock runs.",
                    (f'rate(labos_twh_clock_seconds_total{{{LAB},scope="lab"}}[$__rate_interval])', "lab"),
                    unit="percentunit",
                ),
            ),
        ),
        (
            "Why people were needed",
            (
                bars(
                    "Interventions by cause",
                    "What ended stretches: the kind of question, or what somebody did.",
                    (f"sort_desc(sum by (cause) (labos_human_interventions_total{{{LAB}}}))", "{{cause}}"),
                ),
                lines(
                    "Questions open",
                    "Questions and tasks that wait for an answer.",
                    (f"labos_interventions_open{{{CELL}}}", "{{workcell}}"),
                ),
                lines(
                    "Questions asked",
                    "In the time shown before each moment, by kind.",
                    (
                        f"sum by (kind) (increase(labos_interventions_requested_total{{{LAB}}}[$__range]))",
                        "{{kind}}",
                    ),
                ),
                bars(
                    "Time to the answer",
                    "On the average, by kind of question.",
                    (
                        f"sum by (kind) (labos_intervention_duration_seconds_sum{{{LAB}}}) / "
                        f"sum by (kind) (labos_intervention_duration_seconds_count{{{LAB}}})",
                        "{{kind}}",
                    ),
                    unit="s",
                ),
            ),
        ),
    ),
)
