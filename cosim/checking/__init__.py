"""What a designer asks of a board before simulating it: constants, headroom, margins, delays, noise."""
