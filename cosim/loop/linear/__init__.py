"""The loop of the `ideal` and `linear` models: exact or error-controlled steps."""
