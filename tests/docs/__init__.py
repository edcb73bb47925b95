"""Documents that cannot rot: what they say is run, compiled or compared with the code."""
