"""Whether a board is stable at its operating point: search, proof and verdict."""
