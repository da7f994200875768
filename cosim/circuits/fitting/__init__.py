"""Rational fits of frequency responses, and their reduction. Knows no netlist."""
