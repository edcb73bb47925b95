"""The lab's commands and questions over HTTP, for programs and for the command line."""
