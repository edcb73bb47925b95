"""A workcell, and the health of its modules."""

from __future__ import annotations

from deploy.grafana.make.parts import CELL, LAB, MODULE, NODE, Board, bars, lines, number, states

_BAD = f'sum by (workcell, module) (increase(labos_actions_total{{{MODULE},outcome!="succeeded"}}[$__range]))'
_ALL = f"sum by (workcell, module) (increase(labos_actions_total{{{MODULE}}}[$__range]))"

WORKCELL = Board(
    "labos-workcell",
    "LabOS: workcell",
    "What the modules of a workcell do, what stands on them, and what is left.",
    ("lab", "workcell", "module"),
    (
        (
            "Now",
            (
                number(
                    "Modules at work",
                    "Modules that an action keeps busy.",
                    f"sum(rate(labos_module_busy_seconds_total{{{MODULE}}}[$__rate_interval]))",
                ),
                number(
                    "Places taken",
                    "The share of the room for labware that is taken.",
                    f"sum(labos_module_places_occupied{{{CELL}}}) / sum(labos_module_places{{{CELL}}})",
                    unit="percentunit",
                ),
                number(
                    "Labware nobody can find",
                    "Labware of which it is not known where it is, in the whole lab.",
                    f'labos_labware{{{LAB},place="uncertain"}}',
                    warn=1,
                ),
                number(
                    "Outcomes nobody knows",
                    "Actions of which nobody knows how they ended.",
                    f'labos_actions_open{{{LAB},status="unknown"}}',
                    warn=1,
                ),
                number(
                    "Hands in the workcell",
                    "1 while a person reaches in.",
                    f"max(labos_workcell_access{{{CELL}}})",
                    warn=1,
                ),
                number(
                    "Out of service",
                    "Modules that are out of service.",
                    f'sum(labos_module_state{{{MODULE},state="out_of_service"}})',
                    warn=1,
                ),
            ),
        ),
        (
            "Modules",
            (
                states(
                    "At work",
                    "Dark while the module carries out an action.",
                    (
                        "clamp_max(ceil(rate(labos_module_busy_seconds_total"
                        f"{{{MODULE}}}[$__rate_interval])), 1)",
                        "{{module}}",
                    ),
                ),
                lines(
                    "Utilisation",
                    "The share of time in which an action keeps the module busy.",
                    (f"rate(labos_module_busy_seconds_total{{{MODULE}}}[$__rate_interval])", "{{module}}"),
                    unit="percentunit",
                ),
                lines(
                    "Occupancy",
                    "The share of the module's places that are taken.",
                    (
                        f"labos_module_places_occupied{{{MODULE}}} / labos_module_places{{{MODULE}}}",
                        "{{module}}",
                    ),
                    unit="percentunit",
                ),
                bars(
                    "Actions",
                    "Actions that have ended in the time shown.",
                    (f"sort_desc({_ALL})", "{{module}}"),
                ),
                bars(
                    "Time an action takes",
                    "On the average, from its request to its end.",
                    (
                        f"labos_action_duration_seconds_sum{{{MODULE}}} / "
                        f"labos_action_duration_seconds_count{{{MODULE}}}",
                        "{{module}} {{action}}",
                    ),
                    unit="s",
                ),
            ),
        ),
        (
            "Supplies",
            (
                lines(
                    "What is left",
                    "Of each resource, in its own unit.",
                    (f"labos_resource_level{{{MODULE}}}", "{{module}} {{resource}}"),
                ),
                bars(
                    "Days left",
                    "If it goes on as in the time shown.",
                    (
                        f"labos_resource_level{{{MODULE}}} / "
                        f"(rate(labos_resource_consumed_total{{{MODULE}}}[$__range]) * 86400 > 0)",
                        "{{module}} {{resource}}",
                    ),
                ),
            ),
        ),
    ),
)

MODULES = Board(
    "labos-modules",
    "LabOS: module health",
    "How well modules work: their states, failures, times, and the processes of their nodes.",
    ("lab", "workcell", "module"),
    (
        (
            "States",
            (
                states(
                    "Not usable",
                    "Dark while the module is in error, gone, or out of service.",
                    (
                        "sum by (workcell, module) (labos_module_state"
                        f'{{{MODULE},state=~"error|gone|out_of_service"}})',
                        "{{module}}",
                    ),
                ),
            ),
        ),
        (
            "Actions",
            (
                lines(
                    "Actions by outcome",
                    "In a minute.",
                    (
                        f"sum by (outcome) (rate(labos_actions_total{{{MODULE}}}[$__rate_interval])) * 60",
                        "{{outcome}}",
                    ),
                    stacked=True,
                ),
                bars(
                    "Share that did not succeed",
                    "Failed, rejected, or of unknown outcome, in the time shown.",
                    (f"({_BAD} or {_ALL} * 0) / ({_ALL} > 0)", "{{module}}"),
                    unit="percentunit",
                    most=1,
                ),
                lines(
                    "95 of 100 actions take less",
                    "From the request to the end, by driver and action.",
                    (
                        "histogram_quantile(0.95, sum by (driver, action, le) "
                        f"(rate(labos_driver_action_duration_seconds_bucket{{{LAB}}}[$__range])))",
                        "{{driver}} {{action}}",
                    ),
                    unit="s",
                ),
                bars(
                    "Time on the device",
                    "On the average, as the nodes measure it.",
                    (
                        f"labos_node_action_duration_seconds_sum{{{NODE}}} / "
                        f"labos_node_action_duration_seconds_count{{{NODE}}}",
                        "{{module}} {{action}}",
                    ),
                    unit="s",
                ),
            ),
        ),
        (
            "Nodes (labos up --node-metrics)",
            (
                lines(
                    "Nodes that answer",
                    "Prometheus reaches them.",
                    (f"sum(up{{{NODE}}})", "answer"),
                    (f"count(up{{{NODE}}})", "all"),
                ),
                lines(
                    "Joined and left",
                    "How often nodes joined the lab and left it, in the time shown.",
                    (
                        "sum by (type) (increase(labos_events_total"
                        f'{{{LAB},type=~"node.joined|node.left"}}[$__range]))',
                        "{{type}}",
                    ),
                ),
                lines(
                    "Memory",
                    "Of the nodes' processes.",
                    (f"process_resident_memory_bytes{{{NODE}}}", "{{module}}"),
                    unit="bytes",
                ),
                lines(
                    "Processor",
                    "Of the nodes' processes, in processors.",
                    (f"rate(process_cpu_seconds_total{{{NODE}}}[$__rate_interval])", "{{module}}"),
                ),
                lines(
                    "Not acknowledged",
                    "Actions that have ended and that the lab has not acknowledged yet.",
                    (f"labos_node_actions_unacknowledged{{{NODE}}}", "{{module}}"),
                ),
                lines(
                    "State",
                    "Nodes by state.",
                    (f"sum by (state) (labos_node_state{{{NODE}}})", "{{state}}"),
                ),
            ),
        ),
    ),
)
