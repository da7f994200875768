"""The subcommands of ``cosim``, one module each; heavy imports wait until a command runs."""
