"""The subcommands of sawbench; all wiring."""
