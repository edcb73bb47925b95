"""What is in the log, and how the kernel, its store and the bus do."""

from __future__ import annotations

from deploy.grafana.make.parts import KERNEL, LAB, Board, bars, lines, number

_PEOPLE = (
    "intervention.resolved|module.taken_out|module.put_back|module.emergency_stopped|station.observed|"
    "station.declared|station.loaded|station.unloaded|resource.replenished|resource.level_set|"
    "workcell.access_requested|starts.paused|run.cancelled|workcell.applied"
)

AUDIT = Board(
    "labos-audit",
    "LabOS: event log",
    "What was recorded, what people did, and whether the log is whole. Who did what is in the log itself.",
    ("lab",),
    (
        (
            "The log",
            (
                number("Events", "The position of the last event on disk.", f"labos_log_position{{{LAB}}}"),
                number(
                    "Checked",
                    "The share of the log's chain that was checked since the kernel started.",
                    f"clamp_max(labos_log_checked_events{{{LAB}}} / labos_log_position{{{LAB}}}, 1)",
                    unit="percentunit",
                ),
                number("Damaged", "1 if the check found a damage.", f"labos_log_damaged{{{LAB}}}", warn=1),
                number("Kernel's epoch", "One more at each start.", f"labos_kernel_epoch{{{LAB}}}"),
                number(
                    "Emergency stops",
                    "In the time shown.",
                    f'increase(labos_events_total{{{LAB},type="module.emergency_stopped"}}[$__range])',
                    warn=1,
                ),
                number(
                    "Size", "Of the database (SQLite only).", f"labos_store_size_bytes{{{LAB}}}", unit="bytes"
                ),
            ),
        ),
        (
            "What was recorded",
            (
                lines(
                    "Events",
                    "In a second, the ten most frequent types.",
                    (f"topk(10, rate(labos_events_total{{{LAB}}}[$__rate_interval]))", "{{type}}"),
                    stacked=True,
                ),
                bars(
                    "Events by type",
                    "In the time shown.",
                    (f"topk(15, increase(labos_events_total{{{LAB}}}[$__range]) > 0)", "{{type}}"),
                ),
            ),
        ),
        (
            "What people did and were asked",
            (
                bars(
                    "Acts",
                    "Events that mostly people bring about, in the time shown.",
                    (f'increase(labos_events_total{{{LAB},type=~"{_PEOPLE}"}}[$__range]) > 0', "{{type}}"),
                ),
                lines(
                    "Questions and answers",
                    "Since the kernel's start.",
                    (f'labos_events_total{{{LAB},type="intervention.requested"}}', "asked"),
                    (f'labos_events_total{{{LAB},type="intervention.resolved"}}', "answered"),
                ),
            ),
        ),
        (
            "Growth",
            (
                lines("Position", "Of the last event on disk.", (f"labos_log_position{{{LAB}}}", "events")),
                lines(
                    "Size",
                    "Of the database (SQLite only).",
                    (f"labos_store_size_bytes{{{LAB}}}", "bytes"),
                    unit="bytes",
                ),
            ),
        ),
    ),
)


def _quantiles(metric: str) -> list[tuple[str, str]]:
    return [
        (
            f"histogram_quantile({share}, sum by (le) (rate({metric}_bucket{{{LAB}}}[$__rate_interval])))",
            f"{int(share * 100)} of 100 take less",
        )
        for share in (0.5, 0.99)
    ]


KERNEL_AND_BUS = Board(
    "labos-kernel",
    "LabOS: kernel and bus",
    "How the kernel, its database and its bus do.",
    ("lab",),
    (
        (
            "Now",
            (
                number(
                    "Log",
                    "0 while the log cannot be written.",
                    f"labos_log_available{{{LAB}}}",
                    warn=1,
                    less=True,
                ),
                number(
                    "Planning suspended",
                    "1 for a fault of LabOS.",
                    f"labos_kernel_suspended{{{LAB}}}",
                    warn=1,
                ),
                number("Not yet on disk", "Events.", f"labos_log_unwritten_events{{{LAB}}}"),
                number("Log read again", "Since the start.", f"labos_log_reopened_total{{{LAB}}}", warn=1),
                number(
                    "Up",
                    "Since the kernel took the lab.",
                    f"time() - labos_kernel_start_time_seconds{{{LAB}}}",
                    unit="s",
                ),
                number(
                    "Disk free",
                    "Of the disk of the lab's folder.",
                    f"labos_disk_free_bytes{{{LAB}}} / labos_disk_size_bytes{{{LAB}}}",
                    unit="percentunit",
                    warn=0.1,
                    less=True,
                ),
            ),
        ),
        (
            "Decisions and commits",
            (
                lines(
                    "Commit",
                    "How long the database takes.",
                    *_quantiles("labos_commit_duration_seconds"),
                    unit="s",
                ),
                lines(
                    "Turn",
                    "How long a decision takes, planning included.",
                    *_quantiles("labos_turn_duration_seconds"),
                    unit="s",
                ),
                lines(
                    "Rates",
                    "In a second.",
                    (f"sum(rate(labos_events_total{{{LAB}}}[$__rate_interval]))", "events"),
                    (f"rate(labos_commit_duration_seconds_count{{{LAB}}}[$__rate_interval])", "commits"),
                    (f"rate(labos_turn_duration_seconds_count{{{LAB}}}[$__rate_interval])", "turns"),
                ),
                lines(
                    "Part of the time",
                    "That the kernel decides, and that the database commits.",
                    (f"rate(labos_turn_duration_seconds_sum{{{LAB}}}[$__rate_interval])", "decides"),
                    (f"rate(labos_commit_duration_seconds_sum{{{LAB}}}[$__rate_interval])", "commits"),
                    unit="percentunit",
                ),
            ),
        ),
        (
            "Bus",
            (
                lines(
                    "Messages",
                    "In a second.",
                    (f"rate(labos_bus_queries_total{{{LAB}}}[$__rate_interval])", "asked"),
                    (f"rate(labos_bus_publications_total{{{LAB}}}[$__rate_interval])", "published"),
                ),
                lines(
                    "Lost",
                    "Since the start: no answer, dropped, not announced.",
                    (f"labos_bus_queries_unanswered_total{{{LAB}}}", "no answer"),
                    (f"labos_bus_dropped_total{{{LAB}}}", "dropped"),
                    (f"labos_bus_announcements_left_out_total{{{LAB}}}", "not announced"),
                ),
            ),
        ),
        (
            "Process",
            (
                lines(
                    "Memory",
                    "Of the kernel's process.",
                    (f"process_resident_memory_bytes{{{KERNEL}}}", "kernel"),
                    unit="bytes",
                ),
                lines(
                    "Processor",
                    "In processors.",
                    (f"rate(process_cpu_seconds_total{{{KERNEL}}}[$__rate_interval])", "kernel"),
                ),
                lines(
                    "Open files",
                    "And how many there may be.",
                    (f"process_open_fds{{{KERNEL}}}", "open"),
                    (f"process_max_fds{{{KERNEL}}}", "may be"),
                ),
                lines(
                    "Metrics",
                    "How many series the kernel shows.",
                    (f"labos_metrics_series{{{LAB}}}", "series"),
                ),
            ),
        ),
    ),
)
