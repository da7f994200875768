"""The front door: what scripts and notebooks call. Each command calls the same function."""
