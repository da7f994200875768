"""Seeded fuzzers: whatever a file or a command line holds, the program says what is wrong with it and ends.

``python -m tests.fuzz --help`` runs them at length (``make fuzz``); ``tests/test_fuzz.py`` runs a short form.
"""
