"""A server for the Model Context Protocol. An agent can use it only to read, plan and propose. ``look`` and
``plan`` change nothing. ``propose`` submits runs and campaigns that wait until an operator has approved them.
There is no tool that starts, approves, cancels or changes anything, even if the token would allow it."""
