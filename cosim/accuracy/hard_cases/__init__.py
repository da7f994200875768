"""Cases whose answer theory knows and that are hard for numbers: run them on every circuit model."""
