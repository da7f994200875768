"""Figures and pages: Run -> Figure -> one self-contained HTML page."""
