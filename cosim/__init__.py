"""Circuit-level co-simulation of haptic devices."""

__version__ = "0.1.0"
