"""Circuit models behind one interface."""
