"""A server of the Model Context Protocol: through it an agent looks, plans and proposes, and nothing more.

``look`` and ``plan`` change nothing. ``propose`` hands in what waits until an operator has approved it.
There is no tool that starts, approves, cancels or changes anything; whatever the token would allow.
"""
