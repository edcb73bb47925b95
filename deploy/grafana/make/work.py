"""Whose work goes on, and why some of it waits."""

from __future__ import annotations

from deploy.grafana.make.parts import CELL, LAB, USER, Board, bars, lines, number

USERS = Board(
    "labos-users",
    "LabOS: campaigns and users",
    "Whose runs the lab carries out, which workflows, and how they end.",
    ("lab", "workcell", "user"),
    (
        (
            "Now",
            (
                number("Experiments", "Experiments that go on.", f'labos_experiments{{{LAB},status="open"}}'),
                number("Runs", "Runs of these users that have not ended.", f"sum(labos_user_runs{{{USER}}})"),
                number(
                    "Completed",
                    "Runs that were completed in the time shown.",
                    f'sum(increase(labos_runs_ended_total{{{CELL},outcome="completed"}}[$__range]))',
                ),
                number(
                    "Completed of all",
                    "The share of the runs that have ended, in the time shown.",
                    f'sum(increase(labos_runs_ended_total{{{CELL},outcome="completed"}}[$__range])) / '
                    f"sum(increase(labos_runs_ended_total{{{CELL}}}[$__range]))",
                    unit="percentunit",
                ),
                number(
                    "Wait for the first step",
                    "On the average.",
                    f"sum(labos_run_wait_seconds_sum{{{CELL}}}) / "
                    f"sum(labos_run_wait_seconds_count{{{CELL}}})",
                    unit="s",
                ),
                number(
                    "Users",
                    "Users whose runs have taken time of modules.",
                    f"count(labos_user_module_seconds_total{{{USER}}})",
                ),
            ),
        ),
        (
            "Users",
            (
                lines(
                    "Runs by user",
                    "Runs that have not ended.",
                    (f"sum by (user) (labos_user_runs{{{USER}}})", "{{user}}"),
                    stacked=True,
                ),
                lines(
                    "Modules at work for a user",
                    "Time of modules that a user's runs take, in modules.",
                    (f"rate(labos_user_module_seconds_total{{{USER}}}[$__rate_interval])", "{{user}}"),
                    stacked=True,
                ),
                bars(
                    "Share of the lab's time",
                    "As the scheduler counts it: time counts half after a day.",
                    (f"sort_desc(labos_user_share_ratio{{{USER}}})", "{{user}}"),
                    unit="percentunit",
                    most=1,
                ),
                lines(
                    "Experiments",
                    "Experiments that have not ended, by status.",
                    (f"labos_experiments{{{LAB}}}", "{{status}}"),
                ),
            ),
        ),
        (
            "Workflows",
            (
                bars(
                    "Runs ended",
                    "In the time shown, by workflow and outcome.",
                    (
                        "sort_desc(sum by (workflow, outcome) "
                        f"(increase(labos_runs_ended_total{{{CELL}}}[$__range])))",
                        "{{workflow}} {{outcome}}",
                    ),
                ),
                bars(
                    "Half of the runs take less",
                    "From the first step to the end, by workflow.",
                    (
                        "histogram_quantile(0.5, sum by (workflow, le) "
                        f"(rate(labos_run_duration_seconds_bucket{{{LAB}}}[$__range])))",
                        "{{workflow}}",
                    ),
                    unit="s",
                ),
                lines(
                    "Runs by workflow",
                    "Runs that have not ended.",
                    (f"sum by (workflow) (labos_runs{{{CELL}}})", "{{workflow}}"),
                    stacked=True,
                ),
                lines(
                    "Failures",
                    "Runs that have failed since the kernel's start, and all that have ended.",
                    (f"sum(labos_run_failures_total{{{CELL}}}) or vector(0)", "failed"),
                    (f"sum(labos_runs_ended_total{{{CELL}}})", "ended"),
                ),
            ),
        ),
    ),
)

SCHEDULING = Board(
    "labos-scheduling",
    "LabOS: scheduling",
    "Why things wait, and how long.",
    ("lab", "workcell"),
    (
        (
            "Now",
            (
                number(
                    "Waiting runs",
                    "Runs that wait to be started.",
                    f"sum(labos_queue_runs{{{CELL}}})",
                    width=6,
                ),
                number(
                    "Oldest waiting",
                    "How long the oldest of them has waited.",
                    f"max(labos_queue_oldest_age_seconds{{{CELL}}})",
                    unit="s",
                    width=6,
                ),
                number(
                    "Steps that wait",
                    "Steps that wait although it is their turn.",
                    f"sum(labos_waiting_steps{{{CELL}}})",
                    width=6,
                ),
                number(
                    "Starts paused",
                    "Things that somebody lets nothing start on.",
                    f"labos_starts_paused{{{LAB}}}",
                    warn=1,
                    width=6,
                ),
            ),
        ),
        (
            "Why things wait",
            (
                lines(
                    "Waits by reason",
                    "Steps that wait although it is their turn; queued runs that wait alike count as one.",
                    (f"sum by (reason) (labos_waiting_steps{{{CELL}}})", "{{reason}}"),
                    width=24,
                    stacked=True,
                ),
                bars(
                    "Reasons, on the average of the time shown",
                    "The ten that keep most steps waiting.",
                    (
                        f"topk(10, sum by (reason) (sum_over_time(labos_waiting_steps{{{CELL}}}[$__range]))"
                        f" / scalar(count_over_time(labos_log_available{{{LAB}}}[$__range])))",
                        "{{reason}}",
                    ),
                ),
                lines(
                    "Busiest modules",
                    "The ten modules with the highest utilisation: where the bottleneck is.",
                    (
                        "topk(10, sum by (workcell, module) "
                        f"(rate(labos_module_busy_seconds_total{{{CELL}}}[$__rate_interval])))",
                        "{{module}}",
                    ),
                    unit="percentunit",
                ),
            ),
        ),
        (
            "Queue",
            (
                lines(
                    "Queue", "Runs that wait to be started.", (f"labos_queue_runs{{{CELL}}}", "{{workcell}}")
                ),
                lines(
                    "Age of the oldest",
                    "How long the oldest run has waited.",
                    (f"labos_queue_oldest_age_seconds{{{CELL}}}", "{{workcell}}"),
                    unit="s",
                ),
                lines(
                    "Submitted and started",
                    "Runs in a minute.",
                    (
                        f'rate(labos_events_total{{{LAB},type="run.submitted"}}[$__rate_interval]) * 60',
                        "submitted",
                    ),
                    (
                        f'rate(labos_events_total{{{LAB},type="run.started"}}[$__rate_interval]) * 60',
                        "started",
                    ),
                ),
                lines(
                    "Time to decide",
                    "Of the kernel's turns, planning included.",
                    *(
                        (
                            f"histogram_quantile({share}, sum by (le) "
                            f"(rate(labos_turn_duration_seconds_bucket{{{LAB}}}[$__rate_interval])))",
                            f"{int(share * 100)} of 100 take less",
                        )
                        for share in (0.5, 0.99)
                    ),
                    unit="s",
                ),
            ),
        ),
    ),
)
