"""The lab's commands and queries over HTTP, for programs and for the command line."""
