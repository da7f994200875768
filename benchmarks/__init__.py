"""Peers side by side: `python -m benchmarks` measures ratios in one run and writes `latest.json`."""
