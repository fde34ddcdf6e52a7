"""The verbs of the command line, a module each: `HELP`, `add_arguments(parser)`, `run(arguments) -> exit code`."""
